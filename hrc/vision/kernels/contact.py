"""From the distance map to a surface point of each link: the least rank alone, or the centre of the patch around it.

In front of the robot a whole patch of pixels has the same distance 0, so that the first of them says little; the
weighted centroid of the patch does. Sums are in integers, hence equal on every device and in every order.
"""

from typing import NamedTuple

import numpy as np
import warp as wp

from hrc.vision.kernels.distance import NONE, Distance
from hrc.vision.kernels.runtime import pixels_per_thread, read, zeros
from hrc.vision.kernels.types import (
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


@wp.kernel(module=MODULE)
def report(keys: Keys, distances: Floats, nearest: Ranks, chosen: Ranks, g: Grid, result: wp.array(dtype=wp.float64)):
    """For each link u, v, depth of the chosen pixel, and the least distance; u = -1 without any."""
    link = wp.tid()
    at = 4 * link
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


class Found(NamedTuple):
    """Pixel (u, v), link and depth [m] of a surface point, and the distance [m] of its link to the obstacles."""

    u: int
    v: int
    link: int
    depth: float
    distance: float


class ContactPoints:
    """The one point of each link that stands for a contact there.

    centred: whether it is the centre of the near-minimal patch on that link (`spread` [m] of the weights, `patch` [m]
    its radius around the least pixel), or the least pixel itself, the first one in the image where several are equal.
    """

    def __init__(self, distance: Distance) -> None:
        self._distance, device = distance, distance.device
        self.centred, self.spread, self.patch = True, 0.01, 0.1
        self._sums, self._chosen = zeros(4 * LINK_COUNT, wp.int64, device), zeros(LINK_COUNT, wp.uint64, device)
        self._result = zeros(4 * LINK_COUNT, wp.float64, device)

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
        wp.launch(report, dim=LINK_COUNT, device=d.device, inputs=[
            d.keys, d.distances, d.nearest, self._chosen, d.grid, self._result])

    def result(self) -> list[Found]:
        """One for each link within reach of an obstacle, the nearest first."""
        rows = np.asarray(read(self._result)).reshape(LINK_COUNT, 4)
        found = [Found(int(row[0]), int(row[1]), link, float(row[2]), float(row[3]))
                 for link, row in enumerate(rows) if row[0] >= 0]
        return sorted(found, key=lambda f: f.distance)
