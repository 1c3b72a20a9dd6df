"""From what the residual feels and what vision sees to a contact: where Eq. (4), (5) and (10) meet."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.contact.force import ForceConfig, estimate_force
from hrc.contact.proprioception import Guess, ResidualLocalizer
from hrc.contact.residual import Detector
from hrc.geometry import apply
from hrc.jacobian import Terms
from hrc.messages import Contact, Nearest
from hrc.parameters import Parameters, param

Array = NDArray[np.float64]


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

    def __init__(self, config: TrackerConfig, force: ForceConfig, localizer: ResidualLocalizer, dt: float) -> None:
        self.config = config
        self.force = force
        self.localizer = localizer
        self._dt = dt
        self.reset()

    def reset(self) -> None:
        """Forget the contact."""
        self.localizer.reset()
        self._point: _Point | None = None
        self._guess: Guess | None = None
        self._felt = self._lost = self._other = 0.0

    def update(self, r: Array, detector: Detector, seen: Sequence[Nearest], terms: Terms, *, keep: bool) -> Contact | None:
        """The contact now, or None when nothing is detected or its place is not known.

        r: residual [N m] (7,); detector: what Eq. (4) says of it. seen: the latest localization, a point for each link near
        an obstacle. keep: hold on to a place that is lost, however long, because the controller still acts at it.
        """
        if not detector.detected:
            self.reset()
            return None
        near = [n for n in seen if n.distance <= self.config.reach]
        guess = self.localizer.update(r, terms, self._dt, near)
        self._felt += self._dt
        self._follow(guess if guess is not None and self._trusted(guess) else None, keep=keep)
        if self._point is None or self._guess is None:
            return None
        link, p_link = self._point.link, self._point.p_link
        p_world = apply(terms.T_world_link[link], p_link)
        J_c = terms.J_contact(link, p_world)  # Eq. (10)
        F, sigma_min, unobservable = estimate_force(J_c, r, self.force)  # Eq. (5)
        gate = float(np.sqrt(F @ F)) / max(detector.margin, 1.0)
        return Contact(link, p_world, p_link, J_c, F, sigma_min, unobservable, gate, self._guess.seen, self._guess.radius)

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
