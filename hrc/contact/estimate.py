"""From what the residual feels and what vision sees to a contact: where Eq. (4), (5) and (10) meet."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.contact.force import Doubt, ForceConfig, estimate_force, force_covariance, place_covariance
from hrc.contact.pair import Pair, PairConfig, PairFinder
from hrc.contact.proprioception import Guess, ResidualLocalizer
from hrc.contact.residual import Detector
from hrc.geometry import apply
from hrc.jacobian import Terms, contact_jacobian
from hrc.messages import Contact, Nearest
from hrc.parameters import Parameters, param

Array = NDArray[np.float64]
EYE = np.eye(3)
MAIN = 2.0
"""Of two contacts the other becomes the main one when its force is so many times as strong."""


@dataclass(frozen=True)
class TrackerConfig(Parameters):
    """When a contact that the residual feels is given a place, and how that place may move."""

    reach: float = param(0.1, low=0.0, high=0.5, unit="m")
    """An obstacle farther from the robot than this does not explain a contact."""
    stale: float = param(0.2, low=0.05, high=10.0, unit="s")
    """A depth image older than this says nothing, and a camera without a newer one is silent: contacts count as not seen."""
    hold: float = param(0.2, low=0.0, high=5.0, unit="s")
    """A place that is lost is kept this long."""
    smoothing: float = param(0.1, low=0.0, high=2.0, unit="s")
    """Time constant with which the place moves over its link: vision may jump from side to side of an obstacle."""
    switch: float = param(0.15, low=0.0, high=5.0, unit="s")
    """The contact moves to another link only when that one has been the likeliest for this long."""
    every: int = param(2, low=1, high=40)
    """A place is looked for in every so-many-th control cycle: the evidence is averaged over ten anyway, and nothing else that
    a contact takes costs as much."""
    felt_after: float = param(0.06, low=0.0, high=1.0, unit="s")
    """A place where no camera sees an obstacle is taken when the contact was felt for this long."""
    felt_radius: float = param(0.2, low=0.0, high=1.0, unit="m")
    """And only if the joints alone tell it as well as this (radius that holds it with 90 %); else its place is not known."""
    felt_misfit: float = param(2.0, low=0.1, high=100.0)
    """And only if one contact explains the residual to so many standard deviations."""


@dataclass(frozen=True, eq=False, slots=True)
class _Point:
    """A point fixed to a link [m] (3,)."""

    link: int
    p_link: Array


class ContactTracker:
    """Gives a contact that is felt its place, by residual and vision together, keeps it on its link, estimates the force."""

    def __init__(self, config: TrackerConfig, force: ForceConfig, localizer: ResidualLocalizer, dt: float,
                 pair: PairConfig | None = None) -> None:
        self.config = config
        self.force = force
        self.localizer = localizer
        self.finder = PairFinder(pair or PairConfig(), localizer.samples, dt)
        self._dt = dt
        self.reset()

    def reset(self) -> None:
        """Forget the contact."""
        self.localizer.reset()
        self.finder.reset()
        self.contacts: tuple[Contact, ...] = ()
        """All contacts with a known place, as of the last update, the main one first: one, or two at a time."""
        self.doubt = Doubt.NONE
        """Of two contacts: why the joints alone do not tell the one force from the other."""
        self._point: _Point | None = None
        self._guess: Guess | None = None
        self._newest: Guess | None = None
        self._covariance: Array | None = None
        self._covered: Guess | None = None  # what it was made for
        self._kept = 0  # for so many control cycles
        self._felt = self._lost = self._other = 0.0

    def update(self, r: Array, detector: Detector, seen: Sequence[Nearest], terms: Terms, *, keep: bool,
               touches: Sequence[Nearest] = ()) -> Contact | None:
        """The contact now, or None when nothing is detected or its place is not known; of two, the stronger one.

        r: residual [N m] (7,); detector: what Eq. (4) says of it. seen: the latest localization, a point for each link near
        an obstacle. keep: hold on to a place that is lost, however long, because the controller still acts at it.
        touches: separate places where vision sees an obstacle touch.
        """
        if not detector.detected:
            self.reset()
            return None
        guess = self._guessed(r, terms, seen)
        self._felt += self._dt
        self._follow(guess if guess is not None and self._trusted(guess) else None, keep=keep)
        pair = self.finder.update(r, touches, terms, self.force, self.localizer.config)
        if pair is not None:
            self.contacts, self.doubt = self._both(pair, terms, detector.margin), pair.doubt
        else:
            self.contacts, self.doubt = self._single(r, terms, detector.margin), Doubt.NONE
        return self.contacts[0] if self.contacts else None

    def _guessed(self, r: Array, terms: Terms, seen: Sequence[Nearest]) -> Guess | None:
        """Where the contact is by residual and vision; not looked for anew while the newest guess is young enough."""
        if self._newest is None or self._kept >= self.config.every:
            near = [n for n in seen if n.distance <= self.config.reach]
            self._newest, self._kept = self.localizer.update(r, terms, self.config.every * self._dt, near), 0
        self._kept += 1
        return self._newest

    def _single(self, r: Array, terms: Terms, margin: float) -> tuple[Contact, ...]:
        if self._point is None or self._guess is None:
            return ()
        link, p_link = self._point.link, self._point.p_link
        T, J_i = terms.T_world_link[link], terms.J_link(link)
        p_world = apply(T, p_link)
        J_c = contact_jacobian(J_i, p_world, T[:3, 3])  # Eq. (10)
        F, sigma_min, unobservable, inverse = estimate_force(J_c, r, self.force)  # Eq. (5)
        strength, known = math.sqrt(F @ F), self.localizer.config
        if self._kept == 1 or self._guess is not self._covered:  # nothing acts by it: so not in every cycle
            spread = (self._guess.radius / known.deviations) ** 2 * EYE
            R = np.diag(np.square(known.sigma)) + place_covariance(J_i[3:], F, spread)
            self._covariance = force_covariance(inverse, J_c, R, max(known.f_typical, strength) ** 2 * EYE)
            self._covered = self._guess
        return (Contact(link, p_world, p_link, J_c, F, sigma_min, unobservable, strength / max(margin, 1.0), self._guess.seen,
                        self._guess.radius, self._covariance),)

    def _both(self, pair: Pair, terms: Terms, margin: float) -> tuple[Contact, ...]:
        found, self._covered = [], None
        for i, place in enumerate(pair.places):
            p_world = apply(terms.T_world_link[place.link], place.p_link)
            J_c = terms.J_contact(place.link, p_world)
            U, S, _ = np.linalg.svd(J_c, full_matrices=False)
            F, at = pair.F[i], slice(3 * i, 3 * i + 3)
            found.append(Contact(
                place.link, p_world, place.p_link, J_c, F, float(S[-1]), U[:, -1], float(np.sqrt(F @ F)) / max(margin, 1.0),
                True, place.deviation * self.localizer.config.deviations, pair.covariance[at, at].copy()))
        # The one that was the main contact stays it unless the other is clearly stronger.
        main = self.contacts[0].link if self.contacts else 0
        return tuple(sorted(found, key=lambda c: -float(np.sqrt(c.F_world @ c.F_world)) * (MAIN if c.link == main else 1.0)))

    def _trusted(self, guess: Guess) -> bool:
        c = self.config
        return guess.seen or (self._felt > c.felt_after and guess.radius <= c.felt_radius and guess.misfit <= c.felt_misfit)

    def _follow(self, guess: Guess | None, *, keep: bool) -> None:
        if guess is None:
            self._lost += self._dt
            self._other = 0.0
            if self._lost > self.config.hold and not keep:
                self._point = None
            return
        self._lost = 0.0
        if self._point is not None and guess.link != self._point.link:
            self._other += self._dt
            if self._other <= self.config.switch:
                return
        self._other = 0.0
        self._guess = guess
        if self._point is None or self._point.link != guess.link:
            self._point = _Point(guess.link, guess.p_link)
        else:
            share = self._dt / (self._dt + self.config.smoothing)
            self._point = _Point(guess.link, self._point.p_link + share * (guess.p_link - self._point.p_link))
