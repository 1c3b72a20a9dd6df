"""The robot's sensors: link-side joint torque, with the imperfections measured on a real LWR IV+, and joint encoders."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# tau_f = k + A / (1 + exp(-alpha (dq + v))): friction and offset that the sensors of an LWR IV+ show, identified at
# Sapienza (getLWRTauFriction.m in matteosodano/Residuals_and_RLS).
A = np.array([1.367179, 0.593299, 0.594340, 0.641189, 0.488523, 0.694147, 0.700856])  # [N m]
K = np.array([-0.456166, -0.056350, -0.366618, -0.103054, -0.118344, -0.469191, -0.791974])  # [N m]
V = np.array([-0.015673, 0.024814, -0.046247, -0.011594, 0.000368, 0.037110, 0.054060])  # [rad/s]
ALPHA = np.array([195.792631, 52.849323, 16.397959, 390.429474, 34.761397, 25.702041, 24.441356])  # [s/rad]
_STEEP, _ONE, _MOST = -ALPHA, np.ones(7), np.full(7, 50.0)
"""As arrays: numpy turns a plain number into one with each call, which takes a third of the time for seven."""
BLOCK = 64
"""The noise of so many readings is drawn at once: they are the numbers that would come one reading after the other."""


def friction(dq: Array) -> Array:
    """Friction and offset in the sensor's signal at joint velocity dq [rad/s] (7,); [N m] (7,)."""
    return K + A / (1.0 + np.exp(np.minimum(_STEEP * (dq + V), 50.0)))  # exp must not overflow


class TorqueSensor:
    """Adds noise and the uncompensated part of friction and offset to the true torque."""

    def __init__(self, tau_max: Array, noise: float, friction_left: float, rng: np.random.Generator) -> None:
        self._sigma = noise * tau_max
        self._height, self._offset = friction_left * A, friction_left * K
        self._rng = rng
        self._added = iter(())

    def read(self, tau: Array, dq: Array) -> Array:
        """The reading [N m] (7,) for the true link-side torque [N m] (7,) at joint velocity dq [rad/s] (7,)."""
        added = next(self._added, None)
        if added is None:
            self._added = iter(self._offset + self._sigma * self._rng.standard_normal((BLOCK, 7)))
            added = next(self._added)
        x = dq + V  # `friction`, in one array
        x *= _STEEP
        np.minimum(x, _MOST, out=x)
        np.exp(x, out=x)
        x += _ONE
        np.divide(self._height, x, out=x)
        x += tau
        x += added
        return x


class Encoder:
    """Joint positions in steps, and velocities as their differences over `ticks` of dt [s]; exact for a step of zero."""

    def __init__(self, step: float, ticks: int, dt: float) -> None:
        self._step, self._dt = step, dt
        self._readings: deque[Array] = deque(maxlen=ticks + 1)

    def read(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """What is read for the true q [rad], dq [rad/s], each (7,)."""
        if self._step == 0.0:
            return q, dq
        self._readings.append(np.round(q / self._step) * self._step)
        spans = len(self._readings) - 1
        return self._readings[-1], (self._readings[-1] - self._readings[0]) / (max(spans, 1) * self._dt)
