"""Every stage of the eye in plain numpy: what the kernels compute, written to be read and to be tested against.

Nothing here is fast. Depth images are [m], shape (H, W), +inf where nothing is; link images are (H, W), 255 there.
"""

from collections.abc import Sequence
from typing import NamedTuple

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


def supported(foreground: Image, neighbours: int, step: float = 0.03) -> Image:
    """The foreground without the pixels that have fewer than `neighbours` of their eight in it and within `step` [m]."""
    around = np.pad(foreground, 1, constant_values=np.inf)
    rows, columns = foreground.shape
    count = np.zeros(foreground.shape, int)
    for dv, du in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
        beside = around[1 + dv : 1 + dv + rows, 1 + du : 1 + du + columns]
        with np.errstate(invalid="ignore"):
            count += np.abs(beside - foreground) < step
    return np.where(count >= neighbours, foreground, np.inf)


def depths(camera: Camera, foreground: Image, thickness: float, step: float = 0.03, longest: int = 32,
           flatness: float = 0.1) -> Array:
    """How deep [m] (H, W) the obstacle is behind each pixel, up to `thickness`, 0 where there is none.

    Of four directions the one with the least depth counts: 2 sqrt(a b), with what the pixel leaves to either side of its chord,
    or a + b if the surface between the chord's ends is flat, with a sag of less than `flatness` times the length. A chord ends
    at a step of `step` [m] in depth, or after `longest` pixels.
    """
    product = np.full(foreground.shape, np.inf)
    for dv, du in ((0, 1), (1, 0), (1, 1), (1, -1)):
        square = (du / camera.config.fx) ** 2 + (dv / camera.config.fy) ** 2
        a, b = (_run(foreground, sign * dv, sign * du, step, longest) for sign in (-1, 1))
        rows, columns = np.indices(foreground.shape)
        ends = [foreground[rows + n * dv, columns + n * du] for n in (-a, b, np.trunc((b - a) / 2).astype(int))]
        width = a + b + 1
        with np.errstate(invalid="ignore"):
            flat = 0.5 * (ends[0] + ends[1]) - ends[2] < flatness * np.sqrt(square) * width * foreground
        product = np.minimum(product, square * np.where(flat, 0.25 * width**2, (a + 0.5) * (b + 0.5)))
    seen = np.isfinite(foreground)
    return np.where(seen, np.minimum(2.0 * np.sqrt(product) * np.where(seen, foreground, 0.0), thickness), 0.0)


def _run(foreground: Image, dv: int, du: int, step: float, longest: int) -> NDArray[np.integer]:
    """How many pixels one can go from each pixel in this direction on the same surface, up to `longest`."""
    rows, columns = foreground.shape
    around = np.pad(foreground, 1, constant_values=np.inf)
    with np.errstate(invalid="ignore"):
        goes_on = np.abs(around[1 + dv : 1 + dv + rows, 1 + du : 1 + du + columns] - foreground) < step
    length = np.zeros(foreground.shape, int)
    for _ in range(longest):
        length = np.where(goes_on, 1 + np.pad(length, 1)[1 + dv : 1 + dv + rows, 1 + du : 1 + du + columns], 0)
    return length


def distance_map(camera: Camera, robot: Image, foreground: Image, reach: float, thickness: Array | float) -> Array:
    """Distance [m] (H, W) of each robot pixel to the nearest obstacle pixel, +inf off the robot and beyond `reach`.

    An obstacle pixel is the interval of depths [d_f, d_f + thickness], thickness [m] being one for all or an image (H, W); its
    point nearest in depth to the robot pixel counts. With an infinite thickness that is d_f < d_v => d_f := d_v, the rule of
    Sec. III-C.
    """
    distances = np.full(camera.shape, np.inf)
    v, u = np.nonzero(np.isfinite(robot))
    ov, ou = np.nonzero(np.isfinite(foreground))
    if not len(u) or not len(ou):
        return distances
    d_f, k = foreground[ov, ou].astype(np.float64), camera.unproject(ou, ov, 1.0)
    d_v = robot[v, u].astype(np.float64)
    points = camera.unproject(u, v, d_v)
    d_b = d_f + np.broadcast_to(thickness, foreground.shape)[ov, ou]
    least = np.empty(len(points))
    for first in range(0, len(points), BLOCK // 8):
        p = points[first : first + BLOCK // 8]
        depth = np.clip(p[:, 2, None], d_f, d_b)
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


def faces_camera(camera: Camera, u: int, v: int, depth: float, foreground: Image, thickness: Array | float, within: float,
                 facing: float) -> bool:
    """Whether the obstacle's middle, from front to back, at its pixel nearest to a robot pixel (u, v) is seen from there
    towards the camera, by a cosine of `facing` or more, and that pixel is nearer than `within` [m]."""
    ov, ou = np.nonzero(np.isfinite(foreground))
    front = foreground[ov, ou].astype(np.float64)
    back = front + np.broadcast_to(thickness, foreground.shape)[ov, ou]
    p, rays = camera.unproject(u, v, depth), camera.unproject(ou, ov, 1.0)
    off = np.linalg.norm(rays * np.clip(depth, front, back)[:, None] - p, axis=1)
    if not (off < within).any():
        return False
    nearest = int(np.argmin(off))
    towards = rays[nearest] * 0.5 * (front + back)[nearest] - p
    return bool(-towards @ p > facing * np.linalg.norm(towards) * np.linalg.norm(p))


class Witnesses(NamedTuple):
    """Of one link: its distance to the obstacles [m], the robot pixel (u, v) and its depth, the obstacle's pixel and depth."""

    distance: float
    robot: tuple[int, int, float]
    obstacle: tuple[int, int, float]


def clearances(camera: Camera, robot: Image, link: NDArray[np.uint8], foreground: Image, monitor: float,
               thickness: float) -> dict[int, Witnesses]:
    """The least distance of each link to an obstacle within `monitor` [m]; of equal ones the first robot and obstacle pixel."""
    found: dict[int, Witnesses] = {}
    ov, ou = np.nonzero(np.isfinite(foreground))
    if not len(ou):
        return found
    d_f, k = foreground[ov, ou].astype(np.float64), camera.unproject(ou, ov, 1.0)
    for on in np.unique(link[link != NO_LINK]):
        best = (monitor**2, 0, 0, 0.0)
        v, u = np.nonzero(link == on)
        d_v = robot[v, u].astype(np.float64)
        for i, p in enumerate(camera.unproject(u, v, d_v)):
            depth = np.clip(d_v[i], d_f, d_f + thickness)
            squares = ((k * depth[:, None] - p) ** 2).sum(axis=1)
            squares[squares < 1e-12] = 0.0
            j = int(squares.argmin())
            if squares[j] < best[0]:
                best = (float(squares[j]), i, j, float(depth[j]))
        square, i, j, depth = best
        if square < monitor**2:
            found[int(on)] = Witnesses(float(np.sqrt(square)), (int(u[i]), int(v[i]), float(d_v[i])),
                                       (int(ou[j]), int(ov[j]), depth))
    return found


def places(camera: Camera, robot: Image, distances: Image, foreground: Image, *, touch: float, ridge: float, step: float,
           hand: float, thickness: float, most: int = 4, level: float = 0.0005) -> NDArray[np.int64]:
    """Which separate place each robot pixel nearer than `touch` [m] belongs to, from 0, the nearest; -1 for none, (H, W).

    Pixels are visited by rising distance, in steps of `level`. One between two basins joins them, unless it lies higher than
    both their lowest pixels by `ridge` or more. Neighbours whose depths differ by `step` or more are none. Basins whose nearest
    obstacle pixels hang together within `hand` [m] are one place.
    """
    v, u = np.nonzero(distances < touch)
    levels = (distances[v, u].astype(np.float32) / np.float32(level)).astype(int)
    order = np.argsort(levels, kind="stable")
    pixels, levels = [(int(v[i]), int(u[i])) for i in order], levels[order]
    number = {pixel: i for i, pixel in enumerate(pixels)}
    basin: dict[tuple[int, int], int] = {}  # pixel to the number of the lowest pixel of its basin
    for i, pixel in enumerate(pixels):
        beside = [b for b in _around(pixel, camera.shape) if b in basin and abs(robot[pixel] - robot[b]) < step]
        own = basin[pixel] = basin[min(beside, key=lambda b: number[b])] if beside else i
        for b in beside:
            low, high = sorted((own, basin[b]))
            if low != high and levels[i] - levels[high] < round(ridge / level):
                basin.update({p: low for p, root in basin.items() if root == high})
                own = low
    place, owner, count = {}, {}, 0
    for root in sorted(set(basin.values())):
        o = _nearest_obstacle(camera, pixels[root], robot, foreground, thickness)
        if o not in owner and count < most:
            owner.update(dict.fromkeys(_hanging(camera, o, foreground, hand, step, owner), count))
            count += 1
        place[root] = owner.get(o, -1)
    out = np.full(camera.shape, -1)
    for pixel, root in basin.items():
        out[pixel] = place[root]
    return out


def _around(pixel: tuple[int, int], shape: tuple[int, int]) -> list[tuple[int, int]]:
    """The eight neighbours that are in the image, row after row."""
    beside = [(pixel[0] + dv, pixel[1] + du) for dv in (-1, 0, 1) for du in (-1, 0, 1) if dv or du]
    return [(v, u) for v, u in beside if 0 <= v < shape[0] and 0 <= u < shape[1]]


def _nearest_obstacle(camera: Camera, pixel: tuple[int, int], robot: Image, foreground: Image,
                      thickness: float) -> tuple[int, int]:
    v, u = np.nonzero(np.isfinite(foreground))
    z, d = float(robot[pixel]), foreground[v, u].astype(np.float64)
    points = camera.unproject(u, v, np.clip(z, d, d + thickness))
    best = int(np.linalg.norm(points - camera.unproject(pixel[1], pixel[0], z), axis=1).argmin())
    return int(v[best]), int(u[best])


def _hanging(camera: Camera, start: tuple[int, int], foreground: Image, hand: float, step: float,
             taken: dict[tuple[int, int], int]) -> set[tuple[int, int]]:
    """The obstacle pixels that hang together with this one, in the window that `hand` [m] covers at its depth or behind."""
    c = camera.config
    far = np.hypot(1.0, np.hypot(max(c.cx, c.width - 1 - c.cx) / c.fx, max(c.cy, c.height - 1 - c.cy) / c.fy))
    half = [int(hand * far / float(foreground[start]) * f) + 1 for f in (c.fy, c.fx)]
    found, border = {start}, [start]
    while border:
        pixel = border.pop()
        for b in _around(pixel, camera.shape):
            if (b not in found and b not in taken and all(abs(b[i] - start[i]) <= half[i] for i in (0, 1))
                    and np.isfinite(foreground[b]) and abs(foreground[b] - foreground[pixel]) < step):
                found.add(b)
                border.append(b)
    return found
