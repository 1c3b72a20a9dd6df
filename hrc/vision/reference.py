"""Every stage of the eye in plain numpy: what the kernels compute, written to be read and to be tested against.

Nothing here is fast. Depth images are [m], shape (H, W), +inf where nothing is; link images are (H, W), 255 there.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrc.geometry import Array, apply
from hrc.vision.camera import Camera
from hrc.vision.kernels import Surface

Image = NDArray[np.floating]
NO_LINK = 255
CUT = 3.0
"""Pixels whose distance exceeds the least by more than this many spreads are no part of the patch."""
BLOCK = 2048
"""Pixels handled at once, to bound the memory of the products below."""


def render(camera: Camera, meshes: Sequence[Surface], T_camera_mesh: Array,
           margin: float = 0.0) -> tuple[Array, NDArray[np.uint8]]:
    """Depth and index of the nearest mesh, Eq. (8), by casting every pixel's ray against every triangle's front face.

    T_camera_mesh: poses (n, 4, 4); margin [m]: every vertex moves out along its normal.
    """
    corners = np.concatenate([apply(T, m.vertices + margin * m.normals)[m.faces]
                              for m, T in zip(meshes, T_camera_mesh, strict=True)])
    owner = np.repeat(np.arange(len(meshes)), [len(m.faces) for m in meshes])
    # Moeller-Trumbore with the eye at the origin: each product is linear in the ray, so all pixels are one matmul.
    a, b, c = np.moveaxis(corners, 1, 0)
    volume = np.cross(b - a, c - a)
    rays = camera.rays().reshape(-1, 3)
    depth = np.full(len(rays), np.inf)
    link = np.full(len(rays), NO_LINK, np.uint8)
    for first in range(0, len(rays), BLOCK):
        block = rays[first : first + BLOCK]
        facing = block @ volume.T
        with np.errstate(divide="ignore", invalid="ignore"):
            v = block @ np.cross(c, a).T / facing
            w = block @ np.cross(a, b).T / facing
            z = np.einsum("ij,ij->i", a, volume) / facing
        # u, v, w are the barycentric weights of the point where the ray meets the plane.
        hit = (facing < 0) & (v >= 0) & (w >= 0) & (v + w <= 1) & (z > 0)
        z = np.where(hit, z, np.inf)
        best = z.argmin(axis=1)
        nearest = z[np.arange(len(block)), best]
        depth[first : first + BLOCK] = nearest
        link[first : first + BLOCK] = np.where(np.isfinite(nearest), owner[best], NO_LINK)
    return depth.reshape(camera.shape), link.reshape(camera.shape)


def filtered(real: Image, robot: Image, environment: Image) -> Image:
    """d_f: the real depth where it is before the robot's and the environment's, +inf elsewhere (Sec. III-B)."""
    measured = np.where(real > 0, real, np.inf)
    return np.where(measured < np.minimum(robot, environment), measured, np.inf)


def supported(real: Image, foreground: Image, neighbours: int, step: float = 0.03) -> Image:
    """The foreground without the pixels that have fewer than `neighbours` of their eight within `step` [m] in `real`."""
    around = np.pad(np.where(real > 0, real, np.inf), 1, constant_values=np.inf)
    rows, columns = real.shape
    count = np.zeros(real.shape, int)
    for dv, du in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
        beside = around[1 + dv : 1 + dv + rows, 1 + du : 1 + du + columns]
        with np.errstate(invalid="ignore"):
            count += np.abs(beside - foreground) < step
    return np.where(count >= neighbours, foreground, np.inf)


def distance_map(camera: Camera, robot: Image, foreground: Image, reach: float, thickness: float) -> Array:
    """Distance [m] (H, W) of each robot pixel to the nearest obstacle pixel, +inf off the robot and beyond `reach`.

    An obstacle pixel is the interval of depths [d_f, d_f + thickness]; its point nearest in depth to the robot pixel
    counts. With an infinite thickness that is d_f < d_v => d_f := d_v, the rule of Sec. III-C.
    """
    distances = np.full(camera.shape, np.inf)
    v, u = np.nonzero(np.isfinite(robot))
    ov, ou = np.nonzero(np.isfinite(foreground))
    if not len(u) or not len(ou):
        return distances
    d_f, k = foreground[ov, ou].astype(np.float64), camera.unproject(ou, ov, 1.0)
    d_v = robot[v, u].astype(np.float64)
    points = camera.unproject(u, v, d_v)
    least = np.empty(len(points))
    for first in range(0, len(points), BLOCK // 8):
        p = points[first : first + BLOCK // 8]
        depth = np.clip(p[:, 2, None], d_f, d_f + thickness)
        squares = np.zeros_like(depth)
        for axis in range(3):
            squares += (k[:, axis] * depth - p[:, axis, None]) ** 2
        least[first : first + BLOCK // 8] = np.sqrt(squares.min(axis=1))
    distances[v, u] = np.where(least < reach, least, np.inf)
    return distances


def contact_point(camera: Camera, robot: Image, link: NDArray[np.uint8], distances: Image, *, centred: bool = True,
                  spread: float = 0.01, patch: float = 0.1) -> tuple[int, int, int, float, float] | None:
    """Pixel u, v, link, depth [m] of the point that stands for the contact, and the least distance [m]; None if none.

    centred: the centre of the near-minimal pixels of that link within `patch` [m] of the first least pixel, weighted by
    exp(-((d - d_min) / spread)^2) and snapped to the nearest pixel of the link; else the first least pixel itself.
    """
    if not np.isfinite(distances).any():
        return None
    v, u = np.unravel_index(int(np.argmin(distances)), camera.shape)
    least, on = float(distances[v, u]), link[v, u]
    if centred:
        rows, columns = np.nonzero(link == on)
        points = camera.unproject(columns, rows, robot[rows, columns])
        excess = (distances[rows, columns] - least) / spread
        near = np.linalg.norm(points - camera.unproject(u, v, robot[v, u]), axis=1) < patch
        weight = np.where((excess < CUT) & near, np.exp(-np.minimum(excess, CUT) ** 2), 0.0)
        centroid = weight @ points / weight.sum()
        chosen = int(np.argmin(np.linalg.norm(points - centroid, axis=1)))
        v, u = rows[chosen], columns[chosen]
    return int(u), int(v), int(on), float(robot[v, u]), least
