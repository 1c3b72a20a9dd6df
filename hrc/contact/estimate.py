"""From what the residual feels and what vision sees to a contact: where Eq. (4), (5) and (10) meet."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.contact.force import ForceConfig, estimate_force
from hrc.contact.residual import Detector
from hrc.geometry import apply
from hrc.jacobian import Terms
from hrc.messages import Contact, Nearest
from hrc.parameters import Parameters, param

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackerConfig(Parameters):
    """When a point that vision sees is taken for the contact that the residual feels."""

    reach: float = param(0.1, low=0.0, high=0.5, unit="m")
    """An obstacle farther from the robot than this does not explain a contact."""
    unexplained: float = param(0.5, low=0.0, high=1.0)
    """A point is refused when it leaves more than this part of the residual unexplained, and enough to be a contact itself."""
    stale: float = param(0.25, low=0.05, high=10.0, unit="s")
    """A depth image older than this says nothing: contacts then count as not seen."""
    hold: float = param(0.2, low=0.0, high=5.0, unit="s")
    """A contact point that vision loses is kept this long."""
    smoothing: float = param(0.1, low=0.0, high=2.0, unit="s")
    """Time constant with which the point moves over its link: vision may jump from side to side of an obstacle."""
    switch: float = param(0.15, low=0.0, high=5.0, unit="s")
    """The contact moves to another link only when that one has been the nearest for this long."""


@dataclass(frozen=True, eq=False, slots=True)
class _Point:
    """A point fixed to a link [m] (3,)."""

    link: int
    p_link: Array


class ContactTracker:
    """Takes the nearest of the points that vision offers and the residual allows, keeps it on its link, estimates the force."""

    def __init__(self, config: TrackerConfig, force: ForceConfig, dt: float) -> None:
        self.config = config
        self.force = force
        self._dt = dt
        self._point: _Point | None = None
        self._felt = False
        self._lost = self._other = 0.0

    def update(self, r: Array, detector: Detector, seen: Sequence[Nearest], terms: Terms, *, keep: bool) -> Contact | None:
        """The contact now, or None when nothing is detected or its place is not known.

        r: residual [N m] (7,); detector: what Eq. (4) says of it. seen: the latest localization, a point for each link near
        an obstacle. keep: hold on to the point while it is unseen, however long, because the controller still acts at it.
        """
        near = [n for n in seen if n.distance <= self.config.reach]
        if detector.detected:
            r_low = np.asarray(detector.config.r_low)
            near = [n for n in near if self._explains(n, r, r_low, terms)]
        self._follow(near, keep=keep and detector.detected)
        self._felt = detector.detected
        if not detector.detected or self._point is None:
            return None
        link, p_link = self._point.link, self._point.p_link
        p_world = apply(terms.T_world_link[link], p_link)
        J_c = terms.J_contact(link, p_world)  # Eq. (10)
        F, sigma_min, unobservable = estimate_force(J_c, r, self.force)  # Eq. (5)
        gate = float(np.sqrt(F @ F)) / max(detector.margin, 1.0)
        return Contact(link, p_world, p_link, J_c, F, sigma_min, unobservable, gate)

    def _explains(self, n: Nearest, r: Array, r_low: Array, terms: Terms) -> bool:
        """Whether a force at this point could have caused the residual, Eq. (3): what it leaves must not be a contact itself.

        Else somebody who merely stands near the robot would be taken for the one who pushes it, out of sight.
        """
        J_c = terms.J_contact(n.link, apply(terms.T_world_link[n.link], n.p_link))
        felt = r / r_low
        U, S, _ = np.linalg.svd(J_c.T / r_low[:, None], full_matrices=False)
        U = U[:, 1e-3 * S[0] < S]
        left = felt - U @ (U.T @ felt)
        return float(np.abs(left).max()) <= max(1.0, self.config.unexplained * float(np.abs(felt).max()))

    def _follow(self, near: Sequence[Nearest], *, keep: bool) -> None:
        if not near:
            self._lost += self._dt
            self._other = 0.0
            if self._lost > self.config.hold and not keep:
                self._point = None
            return
        self._lost = 0.0
        best = near[0]
        if self._felt and self._point is not None and best.link != self._point.link:
            self._other += self._dt
            if self._other <= self.config.switch:
                best = next((n for n in near if n.link == self._point.link), None)
        else:
            self._other = 0.0
        if best is not None:
            self._point = self._moved(best)

    def _moved(self, n: Nearest) -> _Point:
        """The new point; while a contact is felt, it moves there gradually."""
        if not self._felt or self._point is None or self._point.link != n.link:
            return _Point(n.link, n.p_link)
        share = self._dt / (self._dt + self.config.smoothing)
        return _Point(n.link, self._point.p_link + share * (n.p_link - self._point.p_link))
