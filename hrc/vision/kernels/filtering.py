"""Removal of the robot and the environment from the real depth image (Sec. III-B)."""

from typing import Any

import numpy as np
import warp as wp

from hrc.vision.kernels import native
from hrc.vision.kernels.runtime import Mirror, everywhere, read, tiles_per_thread, upload, write_image, zeros
from hrc.vision.kernels.types import MODULE, TILE_H, TILE_W, Floats, Grid, Ints, Keys, Ranks, pixels, to_image


@wp.kernel(module=MODULE)
def filter_depth(frame: Ranks, cover: Keys, fixed: Floats, neighbours: int, step: float, region: Ints, current: Ints,
                 run: int, g: Grid, done: Ints, foreground: Floats, nearest: Floats, farthest: Floats):
    """Those tiles of the region that are not done yet; a thread takes `run` tiles side by side."""
    runs = (g.tiles_x + run - 1) / run
    x0 = wp.tid() % runs * run
    y = wp.tid() / runs
    if y < region[1] or y >= region[3]:
        return
    for x in range(wp.max(x0, region[0]), wp.min(x0 + run, region[2])):  # pyright: ignore[reportArgumentType]
        t = y * g.tiles_x + x
        if done[t] != current[0]:
            done[t] = current[0]
            found = native.filter_tile(frame, cover, fixed, x * TILE_W, y * TILE_H, neighbours, step, g, foreground)
            nearest[t] = found[0]
            farthest[t] = found[1]


class Filter:
    """d_f from d_r, the expanded robot's raster `cover` and the environment's depth, all of the same camera.

    A tile is filtered the first time that somebody needs it: `launch` does those in `region`, `complete` all.

    neighbours, step [m]: how many of the eight around a pixel must be how near in depth for it to count; at a depth edge the
    sensor mixes front and back, and such pixels float in between, alone, and would touch anything. 0 keeps all.

    foreground: d_f [m], flat, +inf where nothing is left; nearest, farthest: its least and largest depth per tile.
    """

    def __init__(self, g: Grid, cover: Any, device: str) -> None:
        self.grid, self.device, self._cover = g, device, cover
        self.neighbours, self.step = 0, 0.03
        self._frame, self._address, self._current = None, Mirror(1, wp.uint64, device), Mirror(1, wp.int32, device)
        self._count = 0
        self.foreground, self._fixed = (zeros(pixels(g), wp.float32, device) for _ in range(2))
        tiles = g.tiles_x * g.tiles_y
        self.nearest, self.farthest = (zeros(tiles, wp.float32, device) for _ in range(2))
        self._done = zeros(tiles, wp.int32, device)
        self.region, self._everywhere = (everywhere(g, device) for _ in range(2))

    def mask(self, environment: np.ndarray) -> None:
        """Take everything at or behind this depth [m] (H, W), +inf for nothing, to be the fixed environment."""
        write_image(self._fixed, 1.0 / environment, self.grid)
        self.renew()

    def load(self, depth: np.ndarray) -> None:
        """Take this real depth image [m] (H, W) float32; 0 and +inf both mean that nothing was measured.

        On a CPU it is not copied: it must not change as long as it is looked at.
        """
        self._frame = np.ascontiguousarray(depth, np.float32)
        if self.device == "cpu":
            self._address.write(self._frame.__array_interface__["data"][0])
        else:
            self._frame = upload(self._frame.ravel(), wp.float32, self.device)
            self._address.write(self._frame.ptr)
        self.renew()

    def renew(self) -> None:
        """Filter every tile anew: frame, robot or environment have changed."""
        self._count += 1
        self._current.write(self._count)

    def launch(self, region: Any = None) -> None:
        """Queue the filter for the tiles in a region, by default in `region`."""
        self._launch(self.region if region is None else region)

    def complete(self) -> None:
        """Queue the filter for all tiles."""
        self._launch(self._everywhere)

    def _launch(self, region: Any) -> None:
        run = tiles_per_thread(self.grid, self.device)
        wp.launch(filter_depth, dim=-(-self.grid.tiles_x // run) * self.grid.tiles_y, device=self.device, inputs=[
            self._address.buffer, self._cover, self._fixed, self.neighbours, self.step, region, self._current.buffer, run,
            self.grid, self._done, self.foreground, self.nearest, self.farthest])

    def image(self) -> np.ndarray:
        """A fresh copy of d_f [m] (H, W), +inf where nothing is left."""
        self.complete()
        return to_image(read(self.foreground), self.grid).copy()
