"""Sensors that have stopped to measure without saying so: readings that repeat to the last bit although the arm moves."""

import numpy as np
from numpy.typing import NDArray

from hrc.messages import RobotState

Array = NDArray[np.float64]
MOVED = 0.02
"""A torque sensor that repeats its reading while a joint has turned by this is stuck [rad]."""
LED = 0.03
"""So is a position sensor while its joint was told to turn by this [rad]."""


class Watch:
    """Compares each reading of the joints with the last that differed. A noisy sensor never repeats; a perfect one of an arm
    that stands may, and that is no fault.
    """

    def __init__(self, dt: float) -> None:
        """dt: time between two updates [s]."""
        self._dt = dt
        self._before: RobotState | None = None
        self._turned = np.zeros(7)
        self._led = np.zeros(7)

    def update(self, state: RobotState, dq: Array) -> str:
        """Which sensor is stuck, if one is; else empty. dq: what the joints were told since the last update [rad/s] (7,)."""
        before, self._before = self._before, state
        if before is None:
            return ""
        self._turned = np.where(state.tau == before.tau, self._turned + np.abs(state.q - before.q).max(), 0.0)
        self._led = np.where(state.q == before.q, self._led + dq * self._dt, 0.0)
        for joint in range(7):
            if self._turned[joint] > MOVED:
                return f"the torque sensor of joint {joint + 1} repeats {state.tau[joint]:.3f} N m while the arm moves"
            if abs(self._led[joint]) > LED:
                return f"the position sensor of joint {joint + 1} repeats {state.q[joint]:.3f} rad while the joint is moved"
        return ""
