"""Limits below every law: joint position, velocity and acceleration, the null space giving way before the task."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BRAKE = 10.0
"""At a position limit the velocity towards it is held to BRAKE [1/s] times the distance left."""
BRAKING = 0.8
"""Part of the acceleration limit with which a joint brakes before a position limit: the arm lags behind the command."""
MARGIN = 0.05
"""Distance kept from a position limit [rad]."""


class Limited(NamedTuple):
    """dq: the command within the limits [rad/s] (7,). task: the part of the task velocity that was kept, 0..1."""

    dq: Array
    task: float


def velocity_bounds(q: Array, q_min: Array, q_max: Array, dq_max: Array, ddq_max: float) -> tuple[Array, Array]:
    """The least and the greatest joint velocity [rad/s] (7,) from which a position limit can still be kept.

    ddq_max [rad/s2]: with `BRAKING` of it a joint comes down to where BRAKE takes over.
    """
    down, up = _approach(q - q_min - MARGIN, ddq_max), _approach(q_max - MARGIN - q, ddq_max)
    return -np.minimum(dq_max, down), np.minimum(dq_max, up)


def _approach(distance: Array, ddq_max: float) -> Array:
    """The velocity at that distance [rad] from a limit [rad/s]: linear near it, then that of a constant deceleration."""
    deceleration = BRAKING * ddq_max
    linear = deceleration / BRAKE**2
    distance = np.maximum(distance, 0.0)
    return np.where(distance < linear, BRAKE * distance,
                    np.sqrt(2.0 * deceleration * np.maximum(distance - 0.5 * linear, 0.0)))


def limited(task: Array, null: Array, bounds: tuple[Array, Array], issued: Array, step: float) -> Limited:
    """task + null within velocity bounds [rad/s] (7,) and no more than `step` [rad/s] from the last command.

    The null-space part is scaled first, and as little as possible; the task only when it fits with no part of the null
    space. A position limit that has come nearer than the acceleration limit foresaw wins against it.
    """
    lower, upper = bounds
    near = _within(issued - step, lower, upper), _within(issued + step, lower, upper)
    kept = _largest_scale(task, null, *near)
    if kept is not None:
        return Limited(_within(task + kept * null, *near), 1.0)
    kept, share = _largest_scale(task, null, lower, upper), 1.0
    if kept is None:
        share = _largest_scale(np.zeros_like(task), task, lower, upper) or 0.0
        wanted = share * task
    else:
        wanted = task + kept * null
    # Too great a change: go part of the way, all joints alike, so that the motion keeps its direction.
    change = wanted - issued
    size = float(np.abs(change).max())
    return Limited(_within(issued + change * min(1.0, step / max(size, 1e-12)), lower, upper), share)


def _within(dq: Array, lower: Array, upper: Array) -> Array:
    """dq, moved into the bounds: np.clip in a third of its time."""
    return np.minimum(np.maximum(dq, lower), upper)


def _largest_scale(base: Array, direction: Array, lower: Array, upper: Array) -> float | None:
    """The largest k in 0..1 with lower <= base + k direction <= upper, None if there is none."""
    slack = 1e-12
    still = np.abs(direction) < slack
    if np.count_nonzero(still):
        if np.any(still & ((base < lower - slack) | (base > upper + slack))):
            return None
        moves = ~still
        base, direction, lower, upper = base[moves], direction[moves], lower[moves], upper[moves]
    one, other = (lower - base) / direction, (upper - base) / direction
    least = float(np.minimum(one, other).max(initial=0.0))
    most = float(np.maximum(one, other).min(initial=1.0))
    return most if least <= most + slack and most >= 0.0 else None
