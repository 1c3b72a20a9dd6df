"""From the distance map to one surface point: the least rank alone, or the centre of the near-minimal patch around it.

In front of the robot a whole patch of pixels has the same distance 0, so that the first of them says little; the
weighted centroid of the patch does. Sums are in integers, hence equal on every device and in every order.
"""

import numpy as np
import warp as wp

from hrc.vision.kernels.distance import NONE, Distance
from hrc.vision.kernels.runtime import pixels_per_thread, read, zeros
from hrc.vision.kernels.types import (
    ID, MODULE, TILE, TILE_H, TILE_W, Floats, Grid, Ints, Keys, Longs, Ranks, depth_of,
)

MICRO = wp.constant(wp.float32(1.0e6))
UNIT = wp.constant(wp.float32(65536.0))
CUT = wp.constant(wp.float32(3.0))
"""Pixels whose distance exceeds the least by more than this many spreads weigh nothing (e^-9)."""


@wp.func
def surface_point(pixel: int, key: wp.uint32, g: Grid) -> wp.vec3:
    z = depth_of(key)
    return wp.vec3((float(pixel % g.stride) - g.cx) / g.fx * z, (float(pixel / g.stride) - g.cy) / g.fy * z, z)


@wp.func
def same_link(a: wp.uint32, b: wp.uint32) -> bool:
    return a != wp.uint32(0) and (a & ID) == (b & ID)


@wp.kernel(module=MODULE)
def start(nearest: Ranks, sums: Longs, chosen: Ranks):
    for i in range(4):
        sums[i] = wp.int64(0)
    chosen[0] = NONE


@wp.kernel(module=MODULE)
def gather(keys: Keys, distances: Floats, nearest: Ranks, spread: float, patch: float, g: Grid, active: Ints,
           n_active: Ints, grain: int, sums: Longs):
    """Weights exp(-((d - d_min) / spread)^2) and weighted points [um] over the patch around the least pixel."""
    i = wp.tid() * grain
    if i / TILE >= n_active[0] or nearest[0] == NONE:
        return
    t = active[i / TILE]
    best = int(nearest[0] & wp.uint64(0xFFFFFFFF))
    least = distances[best]
    centre = surface_point(best, keys[best], g)
    for j in range(i % TILE, i % TILE + grain):
        pixel = ((t / g.tiles_x) * TILE_H + j / TILE_W) * g.stride + (t % g.tiles_x) * TILE_W + j % TILE_W
        excess = (distances[pixel] - least) / spread
        if excess < CUT and same_link(keys[pixel], keys[best]):
            p = surface_point(pixel, keys[pixel], g)
            if wp.length(p - centre) < patch:
                w = wp.int64(UNIT * wp.exp(-excess * excess))
                wp.atomic_add(sums, 0, w)
                wp.atomic_add(sums, 1, w * wp.int64(MICRO * p[0]))
                wp.atomic_add(sums, 2, w * wp.int64(MICRO * p[1]))
                wp.atomic_add(sums, 3, w * wp.int64(MICRO * p[2]))


@wp.kernel(module=MODULE)
def snap(keys: Keys, nearest: Ranks, g: Grid, active: Ints, n_active: Ints, grain: int, sums: Longs, chosen: Ranks):
    """The pixel of the same link whose surface point is nearest to the centroid."""
    i = wp.tid() * grain
    if i / TILE >= n_active[0] or nearest[0] == NONE:
        return
    t = active[i / TILE]
    key = keys[int(nearest[0] & wp.uint64(0xFFFFFFFF))]
    centroid = wp.vec3(float(sums[1] / sums[0]), float(sums[2] / sums[0]), float(sums[3] / sums[0])) / MICRO
    for j in range(i % TILE, i % TILE + grain):
        pixel = ((t / g.tiles_x) * TILE_H + j / TILE_W) * g.stride + (t % g.tiles_x) * TILE_W + j % TILE_W
        if same_link(keys[pixel], key):
            off = wp.length_sq(surface_point(pixel, keys[pixel], g) - centroid)
            wp.atomic_min(chosen, 0, (wp.uint64(wp.cast(off, wp.uint32)) << wp.uint64(32)) | wp.uint64(pixel))


@wp.kernel(module=MODULE)
def report(keys: Keys, distances: Floats, nearest: Ranks, chosen: Ranks, g: Grid, result: wp.array(dtype=wp.float64)):
    """u, v, link, depth of the chosen pixel, and the least distance; u = -1 without any."""
    if nearest[0] == NONE:
        result[0] = wp.float64(-1.0)
        return
    best = int(nearest[0] & wp.uint64(0xFFFFFFFF))
    pixel = best
    if chosen[0] != NONE:
        pixel = int(chosen[0] & wp.uint64(0xFFFFFFFF))
    result[0] = wp.float64(pixel % g.stride)
    result[1] = wp.float64(pixel / g.stride)
    result[2] = wp.float64(int(keys[pixel] & ID))
    result[3] = wp.float64(depth_of(keys[pixel]))
    result[4] = wp.float64(distances[best])


class ContactPoint:
    """The one point of a distance map that stands for a contact.

    centred: whether it is the centre of the near-minimal patch on that link (`spread` [m] of the weights, `patch` [m]
    its radius around the least pixel), or the least pixel itself, the first one in the image where several are equal.
    """

    def __init__(self, distance: Distance) -> None:
        self._distance, device = distance, distance.device
        self.centred, self.spread, self.patch = True, 0.01, 0.1
        self._sums, self._chosen = zeros(4, wp.int64, device), zeros(1, wp.uint64, device)
        self._result = zeros(5, wp.float64, device)

    def launch(self) -> None:
        """Queue the search."""
        d = self._distance
        grain = pixels_per_thread(d.device)
        threads, tiles = d.grid.tiles_x * d.grid.tiles_y * TILE // grain, [d.active, d.n_active, grain]
        wp.launch(start, dim=1, inputs=[d.nearest, self._sums, self._chosen], device=d.device)
        if self.centred:
            wp.launch(gather, dim=threads, device=d.device, inputs=[
                d.keys, d.distances, d.nearest, self.spread, self.patch, d.grid, *tiles, self._sums])
            wp.launch(snap, dim=threads, device=d.device, inputs=[
                d.keys, d.nearest, d.grid, *tiles, self._sums, self._chosen])
        wp.launch(report, dim=1, device=d.device, inputs=[
            d.keys, d.distances, d.nearest, self._chosen, d.grid, self._result])

    def result(self) -> tuple[int, int, int, float, float] | None:
        """Pixel u, v, link, depth [m] of the point and its distance [m] to the obstacle; None if nothing is in reach."""
        values: np.ndarray = read(self._result)
        if values[0] < 0:
            return None
        return int(values[0]), int(values[1]), int(values[2]), float(values[3]), float(values[4])
