"""Removal of the robot and the environment from the real depth image (Sec. III-B)."""

from typing import Any

import numpy as np
import warp as wp

from hrc.vision.kernels import native
from hrc.vision.kernels.runtime import read, write_image, zeros
from hrc.vision.kernels.types import MODULE, TILE_H, TILE_W, Floats, Grid, Keys, pixels, to_image


@wp.kernel(module=MODULE)
def filter_depth(raw: Floats, cover: Keys, fixed: Floats, run: int, g: Grid, foreground: Floats, nearest: Floats,
                 farthest: Floats):
    """A thread takes `run` tiles side by side."""
    runs = (g.tiles_x + run - 1) / run
    x = wp.tid() % runs * run
    y = wp.tid() / runs
    native.filter_tiles(raw, cover, fixed, y * TILE_H * g.stride + x * TILE_W, y * g.tiles_x + x,
                        wp.min(run, g.tiles_x - x), g, foreground, nearest, farthest)


class Filter:
    """d_f from d_r, the expanded robot's raster `cover` and the environment's depth, all of the same camera.

    foreground: d_f [m], flat, +inf where nothing is left; nearest, farthest: its least and largest depth per tile.
    """

    def __init__(self, g: Grid, cover: Any, device: str) -> None:
        self.grid, self.device, self._cover = g, device, cover
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

    def image(self) -> np.ndarray:
        """A fresh copy of d_f [m] (H, W), +inf where nothing is left."""
        return to_image(read(self.foreground), self.grid).copy()
