"""The control laws, Eq. (6)-(7) and (11)-(15), as functions without memory.

`J#` is damped where a singular value is small; the projectors come from the SVD's row space, undamped, because
I - J#J with a damped J# is no projector.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
EYE = np.eye(7)
EPSILON, DAMPING = 0.05, 0.05
"""Singular values of a task Jacobian below EPSILON [m] are damped, by DAMPING [m] at zero."""
EPSILON_C = 0.1
"""The same for a contact Jacobian, whose directions fade near the elbow."""
ROOM = (0.1, 0.2)
"""|P J_c^T F|^2 / |J_c^T F|^2, the part of the motion along F that leaves the task alone: below the first there is too
little to make room for a push, above the second enough. The elbow has 0.25 to 0.45 sideways, the wrist 0.01."""
FULL = 0.3
"""From this much of `room` on, the null space gives everything back: the path is slow by then, so there is little to give."""
RANK = 1e-3
"""A singular value below this [m] is none: its direction belongs to the null space."""


class Inverse(NamedTuple):
    """pinv: J#, shape (7, m). projector: P = I - V V^T over J's row space, shape (7, 7)."""

    pinv: Array
    projector: Array


def inverse(J: Array, epsilon: float = EPSILON, damping: float = DAMPING) -> Inverse:
    """J# and P of a Jacobian (m, 7), from one SVD."""
    U, S, Vt = np.linalg.svd(J, full_matrices=False)
    weak = np.maximum(1.0 - (S / epsilon) ** 2, 0.0)  # of a square: never above 1
    gain = S / np.maximum(S * S + weak * damping**2, 1e-12)
    V = Vt.T if S[-1] > RANK else Vt[S > RANK].T
    return Inverse((Vt.T * gain) @ U.T, EYE - V @ V.T)


def saturated(v: Array, limit: float) -> Array:
    """v, shortened to `limit` if it is longer."""
    length = float(np.sqrt(v @ v))
    return v * (limit / length) if length > limit else v


def task_velocity(dx_d: Array, error: Array, k_p: float, v_max: float) -> Array:
    """dx_d + K_p (x_d - x) [m/s] (3,), the task's part of Eq. (11), with the feedback held to v_max [m/s]."""
    return dx_d + saturated(k_p * error, v_max)


def posture_velocity(q: Array, q_d: Array, k_0: float) -> Array:
    """dq_0 = K_0 (q_d - q) [rad/s] (7,), the first branch of Eq. (12)."""
    return k_0 * (q_d - q)


def relax_velocity(J_c: Array, P: Array, F: Array, k_f: float, threshold: float) -> Array:
    """The force term of Eq. (12) that gives way for real: (J_c P)# K_f F beyond the threshold [rad/s] (7,).

    Printed, the term is J_c# K_f F, projected by P afterwards; that projection can turn the contact point INTO the
    push. Inverting J_c P instead moves the point along F as far as the task allows, so F . v_c >= 0.
    threshold [N]: subtracted from |F|, so that the command does not jump at F_relax.
    """
    return P @ (inverse(J_c @ P, EPSILON_C).pinv @ (k_f * beyond(F, threshold)))


def not_into_the_push(task: Array, null: Array, J_c: Array, P: Array, F: Array) -> Array:
    """The null-space velocity, changed as little as it takes for F . J_c (task + null) >= 0 [rad/s] (7,).

    Task and posture move the contact point, too, and may move it into the person; the null space gives that way back
    where it can: fully where it moves the point along F well (the elbow), not at all where it hardly does (the wrist),
    since there it would swing the whole arm for millimetres. What of the null-space velocity itself goes into the push
    and is not given back is left out.
    """
    along = J_c.T @ F
    power = float(along @ (task + null))
    if power >= 0.0:
        return null
    share = min(1.0, room(J_c, P, F) / FULL)
    if share > 0.0:
        w = P @ along
        null = null - w * (share * power / float(w @ w))
    missing, own = (1.0 - share) * power, float(along @ null)
    return null * max(0.0, 1.0 - missing / own) if own < 0.0 else null


def room(J_c: Array, P: Array, F: Array) -> float:
    """How far the null space can give back what task and posture move into the push F, 0..1: by `ROOM`."""
    along = J_c.T @ F
    w = P @ along
    part = float(w @ w) / max(float(along @ along), 1e-12)
    return min(max((part - ROOM[0]) / (ROOM[1] - ROOM[0]), 0.0), 1.0)


def share_of_the_path(path: Array, rest: Array, J_c: Array, P: Array, F: Array) -> float:
    """The part 0..1 of the joint velocity `path` that need not move the contact point into the push F.

    What the null space has room to give back (`room`) may be taken; of what it has not, only so much that
    F . J_c (rest + part path) is not negative; with the rest the path waits. rest: all else that moves the arm [rad/s]
    (7,), without what the null space gives back.
    """
    along = J_c.T @ F
    taken, left = -float(along @ path), max(float(along @ rest), 0.0)
    part = 1.0 if taken <= left else left / taken
    return part + room(J_c, P, F) * (1.0 - part)


def relax_velocity_printed(J_c: Array, F: Array, k_f: float) -> Array:
    """J_c# K_f F as printed in Eq. (12) [rad/s] (7,), before the projection by P."""
    return inverse(J_c, EPSILON_C).pinv @ (k_f * F)


def beyond(F: Array, threshold: float) -> Array:
    """F with `threshold` taken off its length; zero below."""
    length = float(np.sqrt(F @ F))
    return F * (1.0 - threshold / length) if length > threshold else np.zeros(3)


def admittance_velocity(F: Array, error: Array, k_a: float, k_e: float, v_max: float) -> Array:
    """dx_c = K_a (F + K_e (x_cd - x_c)) [m/s] (3,), Eq. (6), held to v_max [m/s]."""
    return saturated(k_a * (F + k_e * error), v_max)


def with_forgetting(null: Array, P: Array, dq_issued: Array, lam: float, *, unit_gain: bool) -> Array:
    """The null-space part with memory of the last command [rad/s] (7,), Eq. (15).

    Printed, dq_0 + lambda P dq_{k-1} amplifies a constant dq_0 by 1 / (1 - lambda) = 5; with unit_gain the new part is
    weighted by (1 - lambda).
    """
    return (1.0 - lam if unit_gain else 1.0) * null + lam * (P @ dq_issued)


def blend(h: int, n_s: int) -> float:
    """alpha = h / N_s, held at 1, Eq. (14)."""
    return min(1.0, h / n_s)
