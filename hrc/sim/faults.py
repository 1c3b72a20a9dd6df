"""Joint sensors that fail on purpose, to see what becomes of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.parameters import Parameters, param

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FaultConfig(Parameters):
    """Which joint's sensor fails, 1 to 7; 0 is none."""

    torque_nan: int = param(0, low=0, high=7)
    """Its torque sensor delivers what is no number."""
    torque_stuck: int = param(0, low=0, high=7)
    """Its torque sensor repeats one reading for ever."""
    position_stuck: int = param(0, low=0, high=7)
    """Its position sensor repeats one reading for ever, and says that the joint stands."""


NONE = FaultConfig()
"""Every sensor is well."""


class JointFaults:
    """Spoils readings. config: may change at any time."""

    def __init__(self, config: FaultConfig) -> None:
        self.config = config
        self._held: dict[str, float] = {}

    def spoil(self, q: Array, dq: Array, tau: Array) -> tuple[Array, Array, Array]:
        """What is delivered instead of these readings, each (7,)."""
        c = self.config
        if c is NONE or c == NONE:
            self._held.clear()
            return q, dq, tau
        q, dq, tau = q.copy(), dq.copy(), tau.copy()
        self._stick("torque", tau, c.torque_stuck)
        self._stick("position", q, c.position_stuck)
        if c.position_stuck:
            dq[c.position_stuck - 1] = 0.0
        if c.torque_nan:
            tau[c.torque_nan - 1] = np.nan
        return q, dq, tau

    def _stick(self, what: str, readings: Array, joint: int) -> None:
        if joint:
            readings[joint - 1] = self._held.setdefault(f"{what} {joint}", float(readings[joint - 1]))
