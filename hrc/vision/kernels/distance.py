"""Distance of every robot pixel to the obstacles, in depth space (Sec. III-C), exact and pruned by tiles.

Whatever depth an obstacle pixel o is taken to have, it lies on its ray k_o = ((u-c_x)/f, (v-c_y)/f, 1). So its distance
to P = d_v k_p is at least that of P to the ray, |P x k_o| / |k_o| >= d_v |k_o - k_p| / |k_o|: a bound that holds for every
occlusion rule, and gives the window S around the robot's pixel.
"""

from typing import Any

import numpy as np
import warp as wp

from hrc.vision.kernels import native, native_distance
from hrc.vision.kernels.chords import endless
from hrc.vision.kernels.filtering import Filter
from hrc.vision.kernels.runtime import pixels_per_thread, read, tiles_per_thread, upload, zeros
from hrc.vision.kernels.types import (
    LINK_COUNT,
    MAX_CANDIDATES,
    MODULE,
    TILE,
    TILE_H,
    TILE_W,
    Floats,
    Grid,
    Ints,
    Keys,
    Ranks,
    pixels,
    to_image,
)

NONE = wp.constant(wp.uint64(0x7F7FFFFFFFFFFFFF))
"""Rank of no pixel: the largest finite distance."""
SLACK = wp.constant(wp.float32(0.9999))
"""Bounds give way by this, so that rounding never prunes the nearest pixel."""


@wp.kernel(module=MODULE)
def reset(n_active: Ints, nearest: Ranks):
    n_active[0] = 0
    for link in range(LINK_COUNT):
        nearest[link] = NONE


@wp.func
def gap(a: int, a_end: int, b: int, b_end: int) -> float:
    """Pixels between the ranges [a, a_end) and [b, b_end), 0 where they touch or overlap."""
    return float(wp.max(0, wp.max(b - a_end + 1, a - b_end + 1)))


@wp.kernel(module=MODULE)
def list_candidates(keys: Keys, links: wp.uint32, near: Floats, far: Floats, reach: float, thickness: float, region: Ints,
                    run: int, squares: Floats, g: Grid, lists: Ints, counts: Ints, active: Ints, n_active: Ints):
    """For each tile with robot pixels: the obstacle tiles that may hold a point within reach.

    A thread takes `run` tiles side by side. The region holds all robot pixels and all obstacles within reach of them.
    """
    runs = (g.tiles_x + run - 1) / run
    x0 = wp.tid() % runs * run
    ty = wp.tid() / runs
    if ty < region[1] or ty >= region[3]:
        return
    for tx in range(wp.max(x0, region[0]), wp.min(x0 + run, region[2])):  # pyright: ignore[reportArgumentType]
        t = ty * g.tiles_x + tx
        depth = native.robot_range(keys, ty * TILE_H * g.stride + tx * TILE_W, links, g)
        if depth[1] > 0.0:
            n = int(0)
            rx = int(reach * g.ray * g.fx / depth[0] / float(TILE_W)) + 1
            ry = int(reach * g.ray * g.fy / depth[0] / float(TILE_H)) + 1
            for y in range(wp.max(region[1], ty - ry), wp.min(region[3], ty + ry + 1)):  # pyright: ignore[reportArgumentType]
                dy = gap(ty * TILE_H, ty * TILE_H + TILE_H, y * TILE_H, y * TILE_H + TILE_H) / g.fy
                for x in range(wp.max(region[0], tx - rx), wp.min(region[2], tx + rx + 1)):  # pyright: ignore[reportArgumentType]
                    o = y * g.tiles_x + x
                    if far[o] > 0.0 and near[o] < depth[1] + reach and far[o] + thickness > depth[0] - reach:
                        dx = gap(tx * TILE_W, tx * TILE_W + TILE_W, x * TILE_W, x * TILE_W + TILE_W) / g.fx
                        if SLACK * depth[0] * depth[0] * (dx * dx + dy * dy) < reach * reach * squares[o]:
                            if n < MAX_CANDIDATES:
                                lists[t * MAX_CANDIDATES + n] = o
                            n += 1
            counts[t] = n
            if n > 0:
                active[wp.atomic_add(n_active, 0, 1)] = t


@wp.kernel(module=MODULE)
def measure(keys: Keys, links: wp.uint32, depth: Floats, back: Floats, near: Floats, far: Floats, reach: float,
            thickness: float, region: Ints, squares: Floats, g: Grid, lists: Ints, counts: Ints, active: Ints, n_active: Ints,
            grain: int, distances: Floats, nearest: Ranks):
    """Distance of the pixels of the active tiles, `grain` of them a thread, +inf off the robot and beyond reach."""
    i = wp.tid() * grain
    if i / TILE >= n_active[0]:
        return
    t = active[i / TILE]
    native_distance.measure_pixels(keys, links, depth, back, near, far, reach, thickness, region, squares, g, lists,
                                   MAX_CANDIDATES, counts[t], t, i % TILE, grain, SLACK, distances, nearest)


class Distance:
    """The distance map between a robot raster and what a filter left.

    keys: the robot's raster; links: bit set of the links that count; reach [m]: rho; thickness [m]: of obstacles, at most;
    back: how far back each of their pixels reaches, or nothing for `thickness` everywhere.
    distances: the map, flat, valid in the first n_active tiles of `active`; nearest: its least rank on each link.
    """

    def __init__(self, g: Grid, keys: Any, foreground: Filter, device: str) -> None:
        self.grid, self.device, self.keys, self._foreground = g, device, keys, foreground
        self.links, self.reach, self.thickness = 0xFF, 0.1, 0.12
        self.depth, self.back, self.region = foreground.foreground, endless(g, device), foreground.region
        tiles = g.tiles_x * g.tiles_y
        self._lists, self._counts, self.active = (zeros(n, wp.int32, device) for n in
                                                  (tiles * MAX_CANDIDATES, tiles, tiles))
        self._squares = upload(_ray_squares(g), wp.float32, device)
        self.n_active = zeros(1, wp.int32, device)
        self.nearest = zeros(LINK_COUNT, wp.uint64, device)
        self.distances = zeros(pixels(g), wp.float32, device)

    def launch(self) -> None:
        """Queue the search."""
        g, f, links = self.grid, self._foreground, wp.uint32(self.links)
        tiles, grain, run = g.tiles_x * g.tiles_y, pixels_per_thread(self.device), tiles_per_thread(g, self.device)
        wp.launch(reset, dim=1, inputs=[self.n_active, self.nearest], device=self.device)
        wp.launch(list_candidates, dim=-(-g.tiles_x // run) * g.tiles_y, device=self.device, inputs=[
            self.keys, links, f.nearest, f.farthest, self.reach, self.thickness, f.region, run, self._squares, g, self._lists,
            self._counts, self.active, self.n_active])
        wp.launch(measure, dim=tiles * TILE // grain, device=self.device, inputs=[
            self.keys, links, f.foreground, self.back, f.nearest, f.farthest, self.reach, self.thickness, f.region,
            self._squares, g, self._lists, self._counts, self.active, self.n_active, grain, self.distances, self.nearest])

    def image(self) -> np.ndarray:
        """A fresh copy of the distance map [m] (H, W), +inf off the robot and beyond reach."""
        g, out = self.grid, np.full(pixels(self.grid), np.inf, np.float32)
        values = read(self.distances)
        tiles = read(self.active)[: read(self.n_active)[0]]
        first = (tiles // g.tiles_x) * TILE_H * g.stride + (tiles % g.tiles_x) * TILE_W
        index = first[:, None, None] + np.arange(TILE_H)[:, None] * g.stride + np.arange(TILE_W)
        out[index] = values[index]
        return to_image(out, g).copy()


def _ray_squares(g: Grid) -> np.ndarray:
    """Largest |k|^2 over each tile, flat."""
    x, y = (TILE_W * np.arange(g.tiles_x) - g.cx) / g.fx, (TILE_H * np.arange(g.tiles_y) - g.cy) / g.fy
    x = np.maximum(np.abs(x), np.abs(x + (TILE_W - 1) / g.fx))
    y = np.maximum(np.abs(y), np.abs(y + (TILE_H - 1) / g.fy))
    return (1.0 + x**2 + y[:, None] ** 2).ravel()
