"""Rigid transforms, in numpy. `T_a_b` (4, 4) maps coordinates in frame b to frame a; quaternions are wxyz."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def apply(T_a_b: Array, p_b: ArrayLike) -> Array:
    """p_a [m], shape (..., 3), from p_b [m], shape (..., 3)."""
    return np.asarray(p_b, float) @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def inverse(T_a_b: Array) -> Array:
    """T_b_a, shape (4, 4)."""
    R = T_a_b[:3, :3].T
    return transform(R, -R @ T_a_b[:3, 3])


def transform(R: ArrayLike, p: ArrayLike) -> Array:
    """T, shape (4, 4), from a rotation (3, 3) and a translation [m] (3,)."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = p
    return T


def skew(p: ArrayLike) -> Array:
    """S(p), shape (3, 3), with S(p) w = p x w."""
    x, y, z = np.asarray(p, float).tolist()  # Python's own numbers: numpy's take three times as long to put together
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def skews(p: Array) -> Array:
    """S of each of several vectors (n, 3), shape (n, 3, 3)."""
    S = np.zeros((len(p), 3, 3))
    S[:, 2, 1], S[:, 0, 2], S[:, 1, 0] = p.T
    return S - S.transpose(0, 2, 1)


def rotation_from_quaternion(wxyz: ArrayLike) -> Array:
    """R, shape (3, 3), from a quaternion wxyz of any length but zero."""
    w, x, y, z = np.asarray(wxyz, float) / np.linalg.norm(np.asarray(wxyz, float))
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def quaternion_from_rotation(R: ArrayLike) -> Array:
    """Unit quaternion wxyz (4,), w >= 0, from R (3, 3) (Shepperd's method: divides by the largest component)."""
    m = np.asarray(R, float)
    four = np.array([m.trace(), *m.diagonal()])
    k = int(np.argmax(four))
    if k == 0:
        q = np.array([1 + four[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    else:
        i, j, h = (k - 1) % 3, k % 3, (k + 1) % 3
        q = np.empty(4)
        q[0] = m[h, j] - m[j, h]
        q[1 + i] = 1 + m[i, i] - m[j, j] - m[h, h]
        q[1 + j] = m[j, i] + m[i, j]
        q[1 + h] = m[h, i] + m[i, h]
    q /= np.linalg.norm(q)
    return -q if q[0] < 0 else q


def rotation_about(axis: ArrayLike, angle: float) -> Array:
    """R, shape (3, 3), by `angle` [rad] about `axis` (3,) of any length but zero (Rodrigues)."""
    K = skew(np.asarray(axis, float) / np.linalg.norm(np.asarray(axis, float)))
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def rotation_vector(R: ArrayLike) -> Array:
    """Axis times angle [rad] (3,), of length 0 to pi, from R (3, 3)."""
    w, *xyz = quaternion_from_rotation(R)
    sine = float(np.linalg.norm(xyz))
    return np.array(xyz) * (2.0 * np.arctan2(sine, w) / sine if sine > 1e-12 else 2.0)


def look_at(eye: ArrayLike, target: ArrayLike) -> Array:
    """T_world_camera of an optical frame (+z forward, +x right, +y down) at `eye` [m] looking at `target` [m], level."""
    z = np.asarray(target, float) - np.asarray(eye, float)
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return transform(np.column_stack([x, np.cross(z, x), z]), eye)


def closest_points(a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array]:
    """The points (3,), (3,) of the segments a-b and c-d that are nearest to each other; ends are points (3,)."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv, uw, vw = float(u @ u), float(u @ v), float(v @ v), float(u @ w), float(v @ w)
    room = uu * vv - uv * uv
    s = min(max((uv * vw - vv * uw) / room, 0.0), 1.0) if room > 1e-12 * uu * vv else 0.0
    t = (uv * s + vw) / vv if vv > 0.0 else 0.0
    if not 0.0 <= t <= 1.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((uv * t - uw) / uu, 0.0), 1.0) if uu > 0.0 else 0.0
    return a + s * u, c + t * v
