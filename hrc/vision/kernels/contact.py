"""From the distance map to a surface point of each link: the least rank alone, or the centre of the patch around it.

In front of the robot a whole patch of pixels has the same distance 0, so that the first of them says little; the
weighted centroid of the patch does. Sums are in integers, hence equal on every device and in every order.
"""

from typing import NamedTuple

import numpy as np
import warp as wp

from hrc.vision.kernels.distance import NONE, Distance
from hrc.vision.kernels.runtime import Mirror, pixels_per_thread, upload, zeros
from hrc.vision.kernels.types import (
    FAR,
    ID,
    LINK_COUNT,
    MODULE,
    TILE,
    TILE_H,
    TILE_W,
    Floats,
    Grid,
    Ints,
    Keys,
    Longs,
    Ranks,
    depth_of,
)

MICRO = wp.constant(wp.float32(1.0e6))
UNIT = wp.constant(wp.float32(65536.0))
CUT = wp.constant(wp.float32(3.0))
"""Pixels whose distance exceeds the least by more than this many spreads weigh nothing (e^-9)."""


@wp.func
def surface_point(pixel: int, key: wp.uint32, g: Grid) -> wp.vec3:
    z = depth_of(key)
    return wp.vec3((float(pixel % g.stride) - g.cx) / g.fx * z, (float(pixel / g.stride) - g.cy) / g.fy * z, z)


@wp.kernel(module=MODULE)
def start(sums: Longs, chosen: Ranks):
    link = wp.tid()
    for i in range(4):
        sums[4 * link + i] = wp.int64(0)
    chosen[link] = NONE


@wp.kernel(module=MODULE)
def gather(keys: Keys, distances: Floats, nearest: Ranks, spread: float, patch: float, g: Grid, active: Ints,
           n_active: Ints, grain: int, sums: Longs):
    """Weights exp(-((d - d_min) / spread)^2) and weighted points [um], for each link over the patch around its least pixel."""
    i = wp.tid() * grain
    if i / TILE >= n_active[0]:
        return
    t = active[i / TILE]
    for j in range(i % TILE, i % TILE + grain):
        pixel = ((t / g.tiles_x) * TILE_H + j / TILE_W) * g.stride + (t % g.tiles_x) * TILE_W + j % TILE_W
        if distances[pixel] < wp.inf:
            link = int(keys[pixel] & ID)
            best = int(nearest[link] & wp.uint64(0xFFFFFFFF))
            excess = (distances[pixel] - distances[best]) / spread
            if excess < CUT:
                p = surface_point(pixel, keys[pixel], g)
                if wp.length(p - surface_point(best, keys[best], g)) < patch:
                    w = wp.int64(UNIT * wp.exp(-excess * excess))
                    wp.atomic_add(sums, 4 * link, w)
                    for axis in range(3):
                        wp.atomic_add(sums, 4 * link + 1 + axis, w * wp.int64(MICRO * p[axis]))


@wp.kernel(module=MODULE)
def snap(keys: Keys, nearest: Ranks, g: Grid, active: Ints, n_active: Ints, grain: int, sums: Longs, chosen: Ranks):
    """For each link, its pixel whose surface point is nearest to the centroid."""
    i = wp.tid() * grain
    if i / TILE >= n_active[0]:
        return
    t = active[i / TILE]
    for j in range(i % TILE, i % TILE + grain):
        pixel = ((t / g.tiles_x) * TILE_H + j / TILE_W) * g.stride + (t % g.tiles_x) * TILE_W + j % TILE_W
        link = int(keys[pixel] & ID)
        if keys[pixel] != wp.uint32(0) and link < LINK_COUNT and nearest[link] != NONE:
            n = sums[4 * link]
            centroid = wp.vec3(float(sums[4 * link + 1] / n), float(sums[4 * link + 2] / n), float(sums[4 * link + 3] / n))
            off = wp.length_sq(surface_point(pixel, keys[pixel], g) - centroid / MICRO)
            wp.atomic_min(chosen, link, (wp.uint64(wp.cast(off, wp.uint32)) << wp.uint64(32)) | wp.uint64(pixel))


@wp.func
def window(pixel: int, z: float, region: Ints, radius: float, g: Grid) -> wp.vec4i:
    """First and last column, first and last row of what a ball [m] around a point at depth z covers, in the filtered region."""
    u = pixel % g.stride
    v = pixel / g.stride
    size = radius * g.ray / wp.max(z - radius, 0.01)
    x = int(size * g.fx) + 1
    y = int(size * g.fy) + 1
    return wp.vec4i(wp.max(u - x, region[0] * TILE_W), wp.min(u + x, wp.min(region[2] * TILE_W, g.width) - 1),
                    wp.max(v - y, region[1] * TILE_H), wp.min(v + y, wp.min(region[3] * TILE_H, g.height) - 1))


@wp.func
def middle(pixel: int, p: wp.vec3, radius: float, depth: Floats, back: Floats, thickness: float, region: Ints,
           g: Grid) -> wp.vec3:
    """The middle, from front to back, of the obstacle at the first of its pixels nearest to a robot pixel's point p."""
    w = window(pixel, p[2], region, radius, g)
    least = float(wp.inf)
    found = p
    for v in range(w[2], w[3] + 1):  # pyright: ignore[reportArgumentType]
        for u in range(w[0], w[1] + 1):  # pyright: ignore[reportArgumentType]
            front = depth[v * g.stride + u]
            if front < FAR:
                end = wp.min(back[v * g.stride + u], front + thickness)
                ray = wp.vec3((float(u) - g.cx) / g.fx, (float(v) - g.cy) / g.fy, 1.0)
                off = wp.length_sq(ray * wp.clamp(p[2], front, end) - p)
                if off < least:
                    least = off
                    found = ray * (0.5 * (front + end))
    return found


@wp.kernel(module=MODULE)
def judge(keys: Keys, distances: Floats, nearest: Ranks, depth: Floats, back: Floats, thickness: float, region: Ints,
          within: float, facing: float, g: Grid, sure: Ints):
    """Whether a contact at each link's least pixel would be on the side that the camera sees: the middle of the obstacle
    lies on the camera's side of the surface, by a cosine of `facing` or more, and no farther than `within` [m]."""
    link = wp.tid()
    sure[link] = 0
    if nearest[link] != NONE:
        pixel = int(nearest[link] & wp.uint64(0xFFFFFFFF))
        if distances[pixel] < within:
            p = surface_point(pixel, keys[pixel], g)
            towards = middle(pixel, p, within, depth, back, thickness, region, g) - p
            if -wp.dot(towards, p) > facing * wp.length(towards) * wp.length(p):
                sure[link] = 1


@wp.kernel(module=MODULE)
def report(keys: Keys, distances: Floats, nearest: Ranks, chosen: Ranks, sure: Ints, g: Grid,
           result: wp.array(dtype=wp.float64)):
    """For each link u, v, depth of the chosen pixel, the least distance and whether it is sure; u = -1 without any."""
    link = wp.tid()
    at = 5 * link
    if nearest[link] == NONE:
        result[at] = wp.float64(-1.0)
        return
    best = int(nearest[link] & wp.uint64(0xFFFFFFFF))
    pixel = best
    if chosen[link] != NONE:
        pixel = int(chosen[link] & wp.uint64(0xFFFFFFFF))
    result[at] = wp.float64(pixel % g.stride)
    result[at + 1] = wp.float64(pixel / g.stride)
    result[at + 2] = wp.float64(depth_of(keys[pixel]))
    result[at + 3] = wp.float64(distances[best])
    result[at + 4] = wp.float64(sure[link])


class Found(NamedTuple):
    """Pixel (u, v), link and depth [m] of a surface point, the distance [m] of its link to the obstacles, and whether the
    place of a contact there is one that the camera sees."""

    u: int
    v: int
    link: int
    depth: float
    distance: float
    sure: bool


class ContactPoints:
    """The one point of each link that stands for a contact there.

    centred: whether it is the centre of the near-minimal patch on that link (`spread` [m] of the weights, `patch` [m]
    its radius around the least pixel), or the least pixel itself, the first one in the image where several are equal, and
    sure. within [m], facing [cosine]: how near an obstacle must be, and how far on the camera's side, for a sure point.
    """

    def __init__(self, distance: Distance) -> None:
        self._distance, device = distance, distance.device
        self.centred, self.spread, self.patch = True, 0.01, 0.1
        self.within, self.facing = 0.035, 0.17
        self._sums, self._chosen = zeros(4 * LINK_COUNT, wp.int64, device), zeros(LINK_COUNT, wp.uint64, device)
        self._sure = upload(np.ones(LINK_COUNT), wp.int32, device)
        self._result = Mirror(5 * LINK_COUNT, wp.float64, device)

    def launch(self) -> None:
        """Queue the search."""
        d = self._distance
        grain = pixels_per_thread(d.device)
        threads, tiles = d.grid.tiles_x * d.grid.tiles_y * TILE // grain, [d.active, d.n_active, grain]
        wp.launch(start, dim=LINK_COUNT, inputs=[self._sums, self._chosen], device=d.device)
        if self.centred:
            wp.launch(gather, dim=threads, device=d.device, inputs=[
                d.keys, d.distances, d.nearest, self.spread, self.patch, d.grid, *tiles, self._sums])
            wp.launch(snap, dim=threads, device=d.device, inputs=[
                d.keys, d.nearest, d.grid, *tiles, self._sums, self._chosen])
            wp.launch(judge, dim=LINK_COUNT, device=d.device, inputs=[
                d.keys, d.distances, d.nearest, d.depth, d.back, d.thickness, d.region, min(self.within, d.reach), self.facing,
                d.grid, self._sure])
        else:
            self._sure.fill_(1)
        wp.launch(report, dim=LINK_COUNT, device=d.device, inputs=[
            d.keys, d.distances, d.nearest, self._chosen, self._sure, d.grid, self._result.buffer])

    def result(self) -> list[Found]:
        """One for each link within reach of an obstacle, the nearest first."""
        rows = self._result.read().reshape(LINK_COUNT, 5).tolist()
        found = [Found(int(u), int(v), link, depth, distance, sure > 0)
                 for link, (u, v, depth, distance, sure) in enumerate(rows) if u >= 0]
        return sorted(found, key=lambda f: f.distance)
