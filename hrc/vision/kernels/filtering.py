"""Removal of the robot and the environment from the real depth image (Sec. III-B)."""

from typing import Any

import numpy as np
import warp as wp

from hrc.vision.kernels import native
from hrc.vision.kernels.runtime import read, write_image, zeros
from hrc.vision.kernels.types import FAR, MODULE, TILE_H, TILE_W, Floats, Grid, Keys, pixels, to_image


@wp.kernel(module=MODULE)
def filter_depth(raw: Floats, cover: Keys, fixed: Floats, run: int, g: Grid, foreground: Floats, nearest: Floats,
                 farthest: Floats):
    """A thread takes `run` tiles side by side."""
    runs = (g.tiles_x + run - 1) / run
    x = wp.tid() % runs * run
    y = wp.tid() / runs
    native.filter_tiles(raw, cover, fixed, y * TILE_H * g.stride + x * TILE_W, y * g.tiles_x + x,
                        wp.min(run, g.tiles_x - x), g, foreground, nearest, farthest)


@wp.kernel(module=MODULE)
def drop_unsupported(raw: Floats, neighbours: int, step: float, g: Grid, foreground: Floats, nearest: Floats,
                     farthest: Floats):
    """Keep a foreground pixel only if at least `neighbours` of its eight are within `step` [m] of it in d_r.

    At a depth edge the sensor mixes front and back: such pixels float in between, alone, and would touch anything.
    """
    t = wp.tid()
    if farthest[t] == 0.0:
        return
    least = float(FAR)
    most = float(0.0)
    u0 = t % g.tiles_x * TILE_W
    v0 = t / g.tiles_x * TILE_H
    for v in range(v0, wp.min(v0 + TILE_H, g.height)):  # pyright: ignore[reportArgumentType]
        for u in range(u0, wp.min(u0 + TILE_W, g.width)):  # pyright: ignore[reportArgumentType]
            z = foreground[v * g.stride + u]
            if z < FAR:
                count = int(-1)  # the pixel itself
                for y in range(wp.max(v - 1, 0), wp.min(v + 2, g.height)):
                    for x in range(wp.max(u - 1, 0), wp.min(u + 2, g.width)):
                        if wp.abs(raw[y * g.stride + x] - z) < step:
                            count += 1
                if count < neighbours:
                    foreground[v * g.stride + u] = wp.inf
                else:
                    least = wp.min(least, z)
                    most = wp.max(most, z)
    nearest[t] = least
    farthest[t] = most


class Filter:
    """d_f from d_r, the expanded robot's raster `cover` and the environment's depth, all of the same camera.

    neighbours, step [m]: how many of the eight around a pixel must be how near in depth for it to count; 0 keeps all.

    foreground: d_f [m], flat, +inf where nothing is left; nearest, farthest: its least and largest depth per tile.
    """

    def __init__(self, g: Grid, cover: Any, device: str) -> None:
        self.grid, self.device, self._cover = g, device, cover
        self.neighbours, self.step = 0, 0.03
        self._raw, self.foreground, self._fixed = (zeros(pixels(g), wp.float32, device) for _ in range(3))
        tiles = g.tiles_x * g.tiles_y
        self.nearest, self.farthest = (zeros(tiles, wp.float32, device) for _ in range(2))

    def mask(self, environment: np.ndarray) -> None:
        """Take everything at or behind this depth [m] (H, W), +inf for nothing, to be the fixed environment."""
        write_image(self._fixed, 1.0 / environment, self.grid)

    def load(self, depth: np.ndarray) -> None:
        """Take this real depth image [m] (H, W); 0 and +inf both mean that nothing was measured."""
        write_image(self._raw, depth, self.grid)

    def launch(self) -> None:
        """Queue the filter."""
        # On a CPU long runs read memory in order; CUDA wants many threads.
        run = 64 if self.device == "cpu" else 1
        threads = -(-self.grid.tiles_x // run) * self.grid.tiles_y
        inputs = [self._raw, self._cover, self._fixed, run, self.grid, self.foreground, self.nearest, self.farthest]
        wp.launch(filter_depth, dim=threads, inputs=inputs, device=self.device)
        if self.neighbours > 0:
            inputs = [self._raw, self.neighbours, self.step, self.grid, self.foreground, self.nearest, self.farthest]
            wp.launch(drop_unsupported, dim=self.grid.tiles_x * self.grid.tiles_y, inputs=inputs, device=self.device)

    def image(self) -> np.ndarray:
        """A fresh copy of d_f [m] (H, W), +inf where nothing is left."""
        return to_image(read(self.foreground), self.grid).copy()
