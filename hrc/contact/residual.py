"""The momentum residual, Eq. (2), and detection by it, Eq. (4)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.parameters import Parameters, param

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ObserverConfig(Parameters):
    """Momentum observer and detection thresholds."""

    k_i: float = param(25.0, low=0.1, high=200.0, unit="1/s")
    """K_I: bandwidth of the residual. Stiff contacts limit-cycle in closed loop from about 50 1/s on."""
    r_low: tuple[float, ...] = param((1.5, 2.5, 1.0, 1.2, 0.8, 0.5, 0.5), low=0.01, high=50.0, unit="N m")
    """r_low,k: a joint's residual above this is a contact, Eq. (4). Holds without false alarm at 5 % inertial error."""
    off: float = param(0.5, low=0.1, high=1.0)
    """Detection ends when every residual is below this fraction of its threshold (hysteresis)."""


class MomentumObserver:
    """r = K_I (p - integral of (tau + C^T dq - g + r)), Eq. (2): a first-order filter of the contact torque.

    Discretized by the trapezoidal rule in (C^T dq - g) and implicitly in r, so it is stable at every K_I dt; written as a
    recursion in r, so that it does not jump when K_I changes.
    """

    def __init__(self, config: ObserverConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next update starts from its momentum with r = 0."""
        self._r = np.zeros(7)
        self._p: Array | None = None
        self._beta = np.zeros(7)

    def update(self, p: Array, Ct_dq: Array, g: Array, tau: Array, dt: float) -> Array:
        """The residual r [N m], shape (7,).

        p, Ct_dq, g: the model's terms now (7,); tau: mean link-side joint torque since the last update [N m] (7,);
        dt: time since then [s].
        """
        beta = Ct_dq - g
        if self._p is not None:
            gain = self.config.k_i
            unexplained = p - self._p - dt * (tau + 0.5 * (self._beta + beta))
            self._r = (self._r + gain * unexplained) / (1.0 + gain * dt)
        self._p, self._beta = p, beta
        return self._r


class Detector:
    """CD = max |r_k| / r_low,k > 1, Eq. (4), with hysteresis so that a contact near the threshold does not blink.

    detected: as of the last update. margin: how many times the residual exceeds the level where detection ends.
    """

    def __init__(self, config: ObserverConfig) -> None:
        self.config = config
        self.detected = False
        self.margin = 0.0

    def update(self, r: Array) -> bool:
        """Whether r [N m] (7,) says contact."""
        ratio = float(np.max(np.abs(r) / np.asarray(self.config.r_low)))
        self.detected = ratio > (self.config.off if self.detected else 1.0)
        self.margin = ratio / self.config.off
        return self.detected
