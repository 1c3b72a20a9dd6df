"""The desired posture q_d of Eq. (12): it can be changed while the arm moves, and goes to the new one at a limited rate."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Posture:
    """q_d [rad] (7,), on its way to `goal` along the straight line between the two, no joint faster than `rate` [rad/s]."""

    def __init__(self, q_d: Array, rate: float = 0.3) -> None:
        self.q_d = self.goal = q_d
        self.rate = rate

    def advance(self, dt: float) -> Array:
        """Go on for dt [s]; q_d afterwards."""
        left = self.goal - self.q_d
        far = float(np.abs(left).max())
        if far > self.rate * dt:
            self.q_d = self.q_d + left * (self.rate * dt / far)
        elif far > 0.0:
            self.q_d = self.goal
        return self.q_d
