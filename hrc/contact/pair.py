"""Two contacts at once: where vision sees two touches and one force does not explain the residual, two may."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.contact.force import (
    Doubt,
    ForceConfig,
    estimate_forces,
    estimate_pushes,
    force_covariance,
    place_covariance,
)
from hrc.contact.proprioception import ProprioceptionConfig, SurfaceSamples
from hrc.geometry import apply
from hrc.jacobian import Terms
from hrc.messages import Nearest
from hrc.parameters import Parameters, param

Array = NDArray[np.float64]
BLOCKS = (slice(0, 3), slice(3, 6))
UNSURE = 2.0
"""A contact that is likely to be at a hidden place may be so many times as far from the touch that vision sees."""
TURNS = 2
"""How often the noise that the places' uncertainty makes is computed anew from the forces."""


@dataclass(frozen=True)
class PairConfig(Parameters):
    """When two contacts are told from one."""

    evidence: float = param(3.0, low=0.0, high=1000.0)
    """Two contacts must explain the residual so much better than either of them alone (difference of the log likelihoods)."""
    after: float = param(0.1, low=0.0, high=5.0, unit="s")
    """And for this long."""
    hold: float = param(0.2, low=0.0, high=5.0, unit="s")
    """Two contacts become one again when the residual has been explained as well by one, or one was not seen, for this long."""
    smoothing: float = param(0.1, low=0.0, high=2.0, unit="s")
    """Time constant with which each place moves over its link."""
    place: float = param(0.02, low=0.005, high=0.2, unit="m")
    """How far along the surface a contact may be from the touch that vision sees (standard deviation)."""


@dataclass(frozen=True, eq=False, slots=True)
class Place:
    """Where on a link a touch may be, in the link's frame.

    p_link: most likely [m] (3,). inward: unit normal into the link (3,). spread: covariance of the place [m^2] (3, 3).
    pushes: second moment (3, 3) of the forces of a unit normal force there, over the places, with friction.
    """

    link: int
    p_link: Array
    inward: Array
    spread: Array
    pushes: Array

    @property
    def deviation(self) -> float:
        """Standard deviation of the place in each direction [m], on average."""
        return float(np.sqrt(np.trace(self.spread) / 3.0))

    def turned(self, T: Array) -> tuple[Array, Array, Array, Array]:
        """Place, normal, spread and pushes in the world, the link being at T (4, 4)."""
        R = T[:3, :3]
        return apply(T, self.p_link), R @ self.inward, R @ self.spread @ R.T, R @ self.pushes @ R.T


@dataclass(frozen=True, eq=False, slots=True)
class Pair:
    """Two forces at two places.

    F: on the robot [N] (2, 3), in the world, and their covariance [N^2] (6, 6). evidence: how much better they explain the
    residual than either alone. doubt: why the joints alone do not tell the two, so that only the belief that hands push, and
    do not pull or drag, makes them known.
    """

    places: tuple[Place, Place]
    F: Array
    covariance: Array
    evidence: float
    doubt: Doubt


class PairFinder:
    """Finds two contacts, and keeps them while they last."""

    def __init__(self, config: PairConfig, samples: SurfaceSamples, dt: float) -> None:
        self.config = config
        self._samples = samples
        self._dt = dt
        self.reset()

    def reset(self) -> None:
        """Forget the contacts."""
        self._places: tuple[Place, Place] | None = None
        self._seen = self._lost = 0.0
        self._sure = False

    def update(self, r: Array, touches: Sequence[Nearest], terms: Terms, force: ForceConfig,
               known: ProprioceptionConfig) -> Pair | None:
        """The two contacts now, or None where there is one, or none, or it is too early to tell.

        r: residual [N m] (7,), in a contact. touches: separate places where vision sees an obstacle touch.
        """
        fresh = max((self._explained(r, places, terms, force, known) for places in self._choices(touches, known.friction)),
                    key=lambda pair: pair.evidence, default=None)
        if fresh is not None and fresh.evidence > (0.0 if self._sure else self.config.evidence):
            if self._places is None or _links(self._places) != _links(fresh.places):
                self._seen, self._sure = 0.0, False
            self._places = fresh.places
            self._seen, self._lost = self._seen + self._dt, 0.0
            self._sure = self._sure or self._seen > self.config.after
            return fresh if self._sure else None
        self._lost += self._dt
        if self._places is None or not self._sure or self._lost > self.config.hold:
            self.reset()
            return None
        return self._explained(r, self._places, terms, force, known)

    def _choices(self, touches: Sequence[Nearest], friction: float) -> Iterator[tuple[Place, Place]]:
        touches = [n for n in touches if n.link > 0]
        if len({n.link for n in touches}) < 2:  # as a rule: one touch, or none
            return
        places = sorted((self._place(n, friction) for n in touches), key=lambda place: place.link)
        for pair in itertools.combinations(places, 2):
            links = _links(pair)
            kept = not self._sure or self._places is None or links == _links(self._places)
            if kept and links[0] != links[1]:  # on one link the joints feel one wrench, which one contact explains
                yield pair

    def _place(self, n: Nearest, friction: float) -> Place:
        p_link = n.p_link
        for before in self._places or ():
            if before.link == n.link:
                p_link = before.p_link + self._dt / (self._dt + self.config.smoothing) * (n.p_link - before.p_link)
        return self._around(n.link, p_link, self.config.place * (1.0 if n.sure else UNSURE), friction)

    def _around(self, link: int, p_link: Array, deviation: float, friction: float) -> Place:
        """The samples around a point, near ones before far ones, stand for where the contact may be."""
        s, part = self._samples, self._samples.of_link[link]
        off, n = s.p[part] - p_link, s.inward[part]
        apart2 = (off**2).sum(axis=1)
        w = s.area[part] * np.exp(-0.5 * (apart2 - apart2.min()) / deviation**2)
        w /= w.sum()
        along = (w[:, None] * n).T @ n
        pushes = along + friction**2 * (np.eye(3) - along)
        inward = w @ n
        return Place(link, p_link, inward / np.linalg.norm(inward), (w[:, None] * off).T @ off, pushes)

    def _explained(self, r: Array, places: tuple[Place, Place], terms: Terms, force: ForceConfig,
                   known: ProprioceptionConfig) -> Pair:
        there = [place.turned(terms.T_world_link[place.link]) for place in places]
        Js = [terms.J_contact(place.link, p) for place, (p, _, _, _) in zip(places, there, strict=True)]
        J, prior = np.vstack(Js), np.zeros((6, 6))
        for at, (_, _, _, pushes) in zip(BLOCKS, there, strict=True):
            prior[at, at] = known.f_typical**2 * pushes
        stacked = estimate_forces(Js, r, force)
        F, inverse = stacked.F.ravel(), stacked.inverse
        noise = R = np.diag(np.square(known.sigma))
        for _ in range(TURNS):
            if stacked.doubt:
                F, inverse = estimate_pushes(J, r, R, prior)
            R = noise + sum(place_covariance(terms.J_link(place.link)[3:], F[at], spread)
                            for at, place, (_, _, spread, _) in zip(BLOCKS, places, there, strict=True))
        alone = max(_log_likelihood(r, R + J_i.T @ prior[at, at] @ J_i) for at, J_i in zip(BLOCKS, Js, strict=True))
        evidence = _log_likelihood(r, R + J.T @ prior @ J) - alone
        pushing = all(F[at] @ inward > 0.0 for at, (_, inward, _, _) in zip(BLOCKS, there, strict=True))
        return Pair(places, F.reshape(2, 3), force_covariance(inverse, J, R, prior), evidence if pushing else -np.inf,
                    stacked.doubt)


def _links(places: tuple[Place, Place]) -> tuple[int, int]:
    return places[0].link, places[1].link


def _log_likelihood(r: Array, S: Array) -> float:
    """Of a residual r (7,) that is Gaussian with covariance S (7, 7), but for a constant."""
    return -0.5 * float(r @ np.linalg.solve(S, r) + np.linalg.slogdet(S)[1])
