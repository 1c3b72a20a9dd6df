"""Zeroing the residual anew while nothing can be touching: what it shows then is the model's error, not a contact."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.parameters import Parameters, param

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ZeroConfig(Parameters):
    """When the residual's offset is learned, and how much of it.

    A push that no camera sees and that is too weak to be detected is learned as well, up to `most`: from then on a force the
    other way must be that much stronger to be detected, and one the same way that much weaker.
    """

    on: bool = param(False)
    """Whether the offset is learned and subtracted."""
    clear: float = param(0.3, low=0.0, high=5.0, unit="m")
    """Nothing may be nearer to the robot than this. Beyond the monitored range of vision it means: nothing in it."""
    still: float = param(0.02, low=0.0, high=1.0, unit="rad/s")
    """No joint may be faster than this."""
    steady: float = param(0.5, low=0.0, high=1.0)
    """No joint's residual may be farther from its mean of late than this part of its r_low."""
    after: float = param(1.0, low=0.0, high=60.0, unit="s")
    """All that must have been so for this long; it is also the time over which the mean is taken."""
    time_constant: float = param(3.0, low=0.1, high=600.0, unit="s")
    """Time constant with which the offset follows."""
    most: float = param(0.5, low=0.0, high=0.9)
    """The offset is never larger than this part of a joint's r_low."""


class ResidualZero:
    """The residual's offset [N m], learned while the arm stands still with nothing near it. offset: as of now (n,)."""

    def __init__(self, config: ZeroConfig, dt: float) -> None:
        self.config = config
        self._dt = dt
        self.reset()

    def reset(self) -> None:
        """Forget the offset."""
        self.offset: Array | None = None
        self._mean: Array | None = None
        self._quiet = 0.0

    def update(self, r: Array, dq: Array, r_low: Array, *, clearance: float, detected: bool) -> Array:
        """The residual without its offset [N m] (n,).

        r: of the observer [N m] (n,); dq [rad/s] (n,). r_low: thresholds of detection [N m] (n,); detected: what Eq. (4) said
        of the last one returned. clearance: of the robot [m], 0 where vision cannot tell.
        """
        c = self.config
        if not c.on:
            self.reset()
            return r
        offset = np.zeros_like(r) if self.offset is None else self.offset
        mean = r if self._mean is None else self._mean + self._dt / (self._dt + c.after) * (r - self._mean)
        quiet = (not detected and clearance > c.clear and bool((np.abs(dq) < c.still).all())
                 and bool((np.abs(r - mean) < c.steady * r_low).all()))
        self._mean = mean
        self._quiet = self._quiet + self._dt if quiet else 0.0
        if self._quiet > c.after:
            share = self._dt / (self._dt + c.time_constant)
            offset = np.clip(offset + share * (r - offset), -c.most * r_low, c.most * r_low)
        self.offset = offset
        return r - offset
