"""The momentum residual, Eq. (2), and detection by it, Eq. (4)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.errors import SensorError
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
    hard: float = param(5.0, low=0.1, high=100.0, unit="rad/s2")
    """A joint acceleration above this, as long as the residual remembers it, makes the second set of thresholds hold."""
    accelerating: float = param(1.0, low=1.0, high=10.0)
    """Then r_low is so many times as high: an error in the inertias shows in the residual. The usual r_low has room for it, so
    1 is enough; for a tight one, from motion with little acceleration, 2 is."""


class MomentumObserver:
    """r = K_I (p - integral of (tau + C^T dq - g + r)), Eq. (2): a first-order filter of the contact torque.

    Discretized by the trapezoidal rule in (C^T dq - g) and implicitly in r, so it is stable at every K_I dt; written as a
    recursion in r, so that it does not jump when K_I changes.
    """

    def __init__(self, config: ObserverConfig | float) -> None:
        """config: with its K_I; or K_I alone [1/s]. Any number of joints will do. Raises ConfigError for a K_I out of range."""
        self.config = config if isinstance(config, ObserverConfig) else ObserverConfig(k_i=config)
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next update starts from its momentum with r = 0."""
        self._r = np.zeros(0)
        self._p: Array | None = None
        self._beta = np.zeros(0)

    def update(self, p: Array, Ct_dq: Array, g: Array, tau: Array, dt: float) -> Array:
        """The residual r [N m], shape (n,), for n joints.

        p, Ct_dq, g: the model's terms now (n,); tau: mean link-side joint torque since the last update [N m] (n,);
        dt: time since then [s]. Raises SensorError when they do not belong to the same joints, or time stands still.
        """
        p, beta = np.asarray(p, np.float64), np.subtract(Ct_dq, g)
        if not p.shape == beta.shape == np.shape(tau) == (len(p) if self._p is None else len(self._p),) or not dt > 0.0:
            raise SensorError(f"p, C^T dq - g and tau must have one shape (n,) and dt be above 0, not {p.shape}, {beta.shape}, "
                              f"{np.shape(tau)} and {dt}")
        if self._p is None:
            self._r = np.zeros(len(p))
        else:
            gain = self.config.k_i
            unexplained = p - self._p - dt * (np.asarray(tau) + 0.5 * (self._beta + beta))
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

    def update(self, r: Array, acceleration: float = 0.0) -> bool:
        """Whether r [N m] (7,) says contact. acceleration: the largest of a joint, as in `Acceleration` [rad/s2]."""
        c = self.config
        ratio = float(np.max(np.abs(r) / np.asarray(c.r_low)))
        begin = c.accelerating if acceleration > c.hard else 1.0
        self.detected = ratio > (c.off if self.detected else begin)
        self.margin = ratio / c.off
        return self.detected


class Acceleration:
    """The largest commanded joint acceleration [rad/s2], fading as it fades in the residual, with the rate K_I."""

    def __init__(self, dt: float) -> None:
        """dt: time between two commands [s]."""
        self._dt = dt
        self._before: Array | None = None
        self.largest = 0.0

    def update(self, dq: Array, k_i: float) -> float:
        """The largest with the command dq [rad/s] (n,) since the one before; k_i: K_I [1/s]."""
        now = 0.0 if self._before is None else float(np.max(np.abs(dq - self._before))) / self._dt
        self._before = dq
        self.largest = max(now, self.largest * float(np.exp(-k_i * self._dt)))
        return self.largest
