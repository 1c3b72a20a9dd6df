"""From what the residual feels and what vision sees to a contact: where Eq. (4), (5) and (10) meet."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.contact.force import ForceConfig, estimate_force
from hrc.contact.residual import Detector
from hrc.geometry import apply, inverse
from hrc.jacobian import Terms
from hrc.messages import Contact, Nearest
from hrc.parameters import Parameters, param

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackerConfig(Parameters):
    """When the nearest point that vision sees is taken for the contact that the residual feels."""

    reach: float = param(0.08, low=0.0, high=0.5, unit="m")
    """An obstacle farther from the robot than this does not explain a contact."""
    hold: float = param(0.2, low=0.0, high=5.0, unit="s")
    """A contact point that vision loses is kept this long."""
    switch: float = param(0.15, low=0.0, high=5.0, unit="s")
    """The contact moves to another link only when vision has named that link for this long."""


@dataclass(frozen=True, eq=False, slots=True)
class _Point:
    """A point fixed to a link [m] (3,)."""

    link: int
    p_link: Array


class ContactTracker:
    """Keeps the contact's point on its link between localizations, and estimates the force there."""

    def __init__(self, config: TrackerConfig, force: ForceConfig, dt: float) -> None:
        self.config = config
        self.force = force
        self._dt = dt
        self._point: _Point | None = None
        self._lost = self._other = 0.0

    def update(self, r: Array, detector: Detector, nearest: Nearest | None, terms: Terms, *, keep: bool) -> Contact | None:
        """The contact now, or None when nothing is detected or its place is not known.

        r: residual [N m] (7,); detector: what Eq. (4) says of it. nearest: the latest localization. keep: hold on to the
        point while it is unseen, however long, because the controller still acts at it.
        """
        self._follow(nearest, terms, keep=keep and detector.detected)
        if not detector.detected or self._point is None:
            return None
        link, p_link = self._point.link, self._point.p_link
        p_world = apply(terms.T_world_link[link], p_link)
        J_c = terms.J_contact(link, p_world)  # Eq. (10)
        F, sigma_min, unobservable = estimate_force(J_c, r, self.force)  # Eq. (5)
        gate = float(np.sqrt(F @ F)) / max(detector.margin, 1.0)
        return Contact(link, p_world, p_link, J_c, F, sigma_min, unobservable, gate)

    def _follow(self, nearest: Nearest | None, terms: Terms, *, keep: bool) -> None:
        if nearest is None or nearest.distance > self.config.reach:
            self._lost += self._dt
            self._other = 0.0
            if self._lost > self.config.hold and not keep:
                self._point = None
            return
        self._lost = 0.0
        if self._point is not None and nearest.link != self._point.link:
            self._other += self._dt
            if self._other <= self.config.switch:
                return
        self._other = 0.0
        # The localization is a few ticks old, the link has moved on by less than a millimetre or two since.
        self._point = _Point(nearest.link, apply(inverse(terms.T_world_link[nearest.link]), nearest.p_world))
