"""Structured surfaces: grids of rings around an axis or along a bent spine, all lengths in mm.

Rings carry the same number of points each, so the triangles stay well shaped, the surface is closed by
construction, and its resolution is a choice rather than the outcome of a decimation.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Inside = Callable[[Array], NDArray[np.bool_]]
"""Whether points (..., 3) lie inside a solid, shape (...,)."""


def ring_angles(n: int) -> Array:
    """n angles around a ring, shape (n,); n is even, so that a ring is symmetric in its second axis."""
    return np.linspace(0.0, 2 * np.pi, n, endpoint=False)


def circle(centre: ArrayLike, first: ArrayLike, second: ArrayLike, n: int) -> Array:
    """n points of the ellipse centre + cos first + sin second, shape (n, 3)."""
    theta = ring_angles(n)[:, None]
    centre, first, second = (np.asarray(v, float) for v in (centre, first, second))
    return centre + np.cos(theta) * first + np.sin(theta) * second


def first_exit(inside: Inside, origin: Array, direction: Array, reach: float, samples: int = 96) -> Array:
    """Where rays from inside a solid first leave it, shape (n, 3).

    origin, direction: shape (n, 3), the direction not of unit length: it is followed up to `reach` times itself.
    Raises ValueError where a ray starts outside or never leaves.
    """
    t = np.linspace(0.0, reach, samples)
    within = inside(origin[:, None] + t[None, :, None] * direction[:, None])
    if not within[:, 0].all() or within.all(axis=1).any():
        raise ValueError("every ray must start inside the solid and leave it within its reach")
    leave = np.argmin(within, axis=1)
    low, high = t[leave - 1], t[leave]
    for _ in range(40):
        middle = 0.5 * (low + high)
        still = inside(origin + middle[:, None] * direction)
        low, high = np.where(still, middle, low), np.where(still, high, middle)
    return origin + low[:, None] * direction


def stack(rows: list[Array]) -> trimesh.Trimesh:
    """The closed surface over rings (n, 3) from a pole (1, 3) to a pole (1, 3), oriented outward.

    Quads are split along their shorter diagonal.
    """
    vertices = np.concatenate(rows)
    start = np.concatenate([[0], np.cumsum([len(row) for row in rows])])
    n = len(rows[1])
    k = np.arange(n)
    after = (k + 1) % n
    faces = [np.column_stack([np.full(n, start[0]), start[1] + k, start[1] + after])]
    for low, high in pairwise(start[1:-2]):
        a, b, c, d = low + k, low + after, high + after, high + k
        ac = np.linalg.norm(vertices[a] - vertices[c], axis=1)
        bd = np.linalg.norm(vertices[b] - vertices[d], axis=1)
        along_ac = (ac < bd - 1e-9)[:, None]
        faces.append(np.where(along_ac, np.column_stack([a, c, b]), np.column_stack([a, d, b])))
        faces.append(np.where(along_ac, np.column_stack([a, d, c]), np.column_stack([b, d, c])))
    faces.append(np.column_stack([np.full(n, start[-2]), start[-3] + after, start[-3] + k]))
    return outward(trimesh.Trimesh(vertices, np.concatenate(faces), process=False))


def outward(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same surface with its normals pointing outward."""
    if mesh.volume < 0:
        return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)
    return mesh


def revolve(profile: ArrayLike, n: int) -> trimesh.Trimesh:
    """The solid of revolution about z of a profile (radius, z), shape (k, 2), whose ends lie on the axis."""
    points = np.asarray(profile, float)
    rows = [np.array([[0.0, 0.0, points[0, 1]]])]
    rows += [circle([0, 0, z], [r, 0, 0], [0, r, 0], n) for r, z in points[1:-1]]
    return stack([*rows, np.array([[0.0, 0.0, points[-1, 1]]])])


def resampled(profile: ArrayLike, tolerance: float, longest: float) -> Array:
    """A profile (k, 2) without the points that matter less than `tolerance`, its long segments divided.

    Ramer-Douglas-Peucker, then every segment but the first and the last, which meet the axis, is cut into equal parts
    of at most `longest`.
    """
    points = np.asarray(profile, float)
    kept = points[_matters(points, tolerance)]
    out = [kept[0], kept[1]]
    for a, b in pairwise(kept[1:-1]):
        parts = max(1, int(np.ceil(np.linalg.norm(b - a) / longest)))
        out += [a + (b - a) * (i + 1) / parts for i in range(parts)]
    return np.array([*out, kept[-1]])


def _matters(points: Array, tolerance: float) -> list[int]:
    """Indices that a polyline within `tolerance` keeps, ends included."""
    chord = points[-1] - points[0]
    rel = points[1:-1] - points[0]
    if not len(rel):
        return [0, len(points) - 1]
    length = np.linalg.norm(chord)
    along = np.clip(rel @ chord / length**2, 0, 1) if length else np.zeros(len(rel))
    off = np.linalg.norm(rel - along[:, None] * chord, axis=1)
    far = int(np.argmax(off)) + 1
    if off[far - 1] <= tolerance:
        return [0, len(points) - 1]
    return _matters(points[:far + 1], tolerance)[:-1] + [far + i for i in _matters(points[far:], tolerance)]


def rounded_corners(profile: ArrayLike, radius: float, steps: int, corner_deg: float = 50.0) -> Array:
    """A polyline (k, 2) whose sharp corners become arcs of `steps` segments, cut back by at most a third of a side."""
    points = np.asarray(profile, float)
    if steps < 1:
        return points
    out = [points[0]]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        u, w = before - corner, after - corner
        lu, lw = np.linalg.norm(u), np.linalg.norm(w)
        turn = np.degrees(np.pi - np.arccos(np.clip(u @ w / (lu * lw), -1, 1)))
        if turn < corner_deg:
            out.append(corner)
            continue
        cut = min(radius, lu / 3, lw / 3)
        a, b = corner + u / lu * cut, corner + w / lw * cut
        s = np.linspace(0, 1, steps + 1)[:, None]
        out += list((1 - s) ** 2 * a + 2 * s * (1 - s) * corner + s**2 * b)
    return np.array([*out, points[-1]])
