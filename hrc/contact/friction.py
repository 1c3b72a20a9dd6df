"""The torque sensors' friction and offset: what their signal holds that no contact and no motion of the links explains."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.parameters import Parameters, param

Array = NDArray[np.float64]
NONE = (0.0,) * 7
STEEPEST = 50.0
"""Beyond this exponent the step of friction is complete."""


@dataclass(frozen=True)
class FrictionConfig(Parameters):
    """Friction and offset in the joint torque signals, k + A / (1 + exp(-alpha (dq + v))), which the observer subtracts."""

    k: tuple[float, ...] = param(NONE, low=-20.0, high=20.0, unit="N m")
    """Torque of each joint's sensor when the joint runs fast in its negative direction."""
    a: tuple[float, ...] = param(NONE, low=0.0, high=20.0, unit="N m")
    """A: how much more it is when the joint runs fast in its positive direction, twice its Coulomb friction."""
    alpha: tuple[float, ...] = param(NONE, low=0.0, high=1000.0, unit="s/rad")
    """How steeply friction turns over with velocity."""
    v: tuple[float, ...] = param(NONE, low=-0.5, high=0.5, unit="rad/s")
    """Friction turns over at minus this velocity."""


def friction(config: FrictionConfig, dq: Array) -> Array:
    """Friction and offset [N m], shape (..., 7), at joint velocity dq [rad/s] (..., 7)."""
    if config.a == config.k == NONE:  # nothing is known of it: asked at every control cycle
        return np.zeros(np.shape(dq))
    return np.asarray(config.k) + np.asarray(config.a) * turned(dq, np.asarray(config.alpha), np.asarray(config.v))


def turned(dq: Array, alpha: Array | float, v: Array | float) -> Array:
    """How far friction has turned over, 0 to 1: 1 / (1 + exp(-alpha (dq + v)))."""
    return 1.0 / (1.0 + np.exp(np.minimum(np.maximum(-alpha * (dq + v), -STEEPEST), STEEPEST)))
