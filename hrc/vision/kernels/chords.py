"""How deep an obstacle is behind its visible surface, from how wide it looks: the chords of a pixel in four directions.

Through a point of a disc of radius R, at distance s from its centre, every chord is cut into two parts a and b of the same
product, a b = R^2 - s^2; a ball with this outline is 2 sqrt(a b) deep there. Across a forearm the shortest chord says the same
of a cylinder. Where the surface is flat from end to end it is that of a box, taken to be as deep as it is wide, a + b, up to
its edges. The least of four directions is a fair guess of what the camera cannot see. A chord ends where the depth steps, or so
many pixels away: what a pixel is taken for depends on nothing farther.
"""

import numpy as np
import warp as wp

from hrc.vision.kernels import native
from hrc.vision.kernels.filtering import Filter
from hrc.vision.kernels.runtime import tiles_per_thread, upload, zeros
from hrc.vision.kernels.types import MODULE, TILE_H, TILE_W, Floats, Grid, Ints, pixels

LONGEST = 32
"""Pixels that a chord is followed to either side."""
ENDLESS = 1e6
"""Depth [m] that nothing is behind."""
DIRECTIONS = ((1, 0), (0, 1), (1, 1), (-1, 1))
BEYOND = wp.constant(1 << 30)


@wp.kernel(module=MODULE)
def begin_chords(box: Ints):
    box[0] = BEYOND
    box[1] = BEYOND
    box[2] = 0
    box[3] = 0


@wp.kernel(module=MODULE)
def box_obstacles(far: Floats, region: Ints, run: int, g: Grid, box: Ints):
    """The pixels, from (x, y) to before (x, y), of the tiles with obstacles in the region; a thread takes `run` tiles."""
    runs = (g.tiles_x + run - 1) / run
    x0 = wp.tid() % runs * run
    y = wp.tid() / runs
    if y < region[1] or y >= region[3]:
        return
    first = int(BEYOND)
    last = int(-1)
    for x in range(wp.max(x0, region[0]), wp.min(x0 + run, region[2])):
        if far[y * g.tiles_x + x] > 0.0:
            first = wp.min(first, x)
            last = x
    if last >= 0:
        wp.atomic_min(box, 0, first * TILE_W)
        wp.atomic_min(box, 1, y * TILE_H)
        wp.atomic_max(box, 2, (last + 1) * TILE_W)
        wp.atomic_max(box, 3, (y + 1) * TILE_H)


@wp.kernel(module=MODULE)
def follow_chords(depth: Floats, box: Ints, dx: int, dy: int, square: float, first: int, last: int, longest: int, step: float,
                  flatness: float, thickness: float, g: Grid, back: Floats):
    """The chords along one line of the box; after the last direction, how far back the obstacle reaches at each pixel."""
    i = wp.tid()
    w = box[2] - box[0]
    h = box[3] - box[1]
    if w <= 0:
        return
    x = box[0]
    y = box[1]
    n = int(0)
    if dy == 0:
        if i < h:
            y += i
            n = w
    elif dx == 0:
        if i < w:
            x += i
            n = h
    elif i < w + h - 1:
        if dx > 0:
            x += wp.max(0, i - h + 1)
            y += wp.max(0, h - 1 - i)
            n = wp.min(box[2] - x, box[3] - y)
        else:
            x += wp.min(i, w - 1)
            y += wp.max(0, i - w + 1)
            n = wp.min(x - box[0] + 1, box[3] - y)
    if n > 0:
        native.chord_line(depth, y * g.stride + x, dy * g.stride + dx, n, square, first, last, longest, step, flatness,
                          thickness, back)


class Chords:
    """How far back [m] the obstacles that a filter left reach: `back`, flat, valid where they are in the filter's region.

    thickness [m]: the most that they are taken to be deep; step [m]: pixels whose depths differ by more are not of one surface.
    flatness: a chord whose ends lie behind its middle by less than this part of its length is flat; a ball's do by half.
    """

    MORE = LONGEST + 2
    """Pixels around those whose `back` is wanted, which the filter's region must hold as well."""

    def __init__(self, foreground: Filter) -> None:
        self._filter, self.thickness, self.step = foreground, 0.12, 0.03
        self.flatness = 0.1
        g, device = foreground.grid, foreground.device
        self.back, self._box = zeros(pixels(g), wp.float32, device), zeros(4, wp.int32, device)

    def launch(self) -> None:
        """Queue the measurement."""
        f, g, device = self._filter, self._filter.grid, self._filter.device
        run = tiles_per_thread(g, device)
        wp.launch(begin_chords, dim=1, inputs=[self._box], device=device)
        wp.launch(box_obstacles, dim=-(-g.tiles_x // run) * g.tiles_y, device=device, inputs=[
            f.farthest, f.region, run, g, self._box])
        for k, (dx, dy) in enumerate(DIRECTIONS):
            square = (dx / g.fx) ** 2 + (dy / g.fy) ** 2
            wp.launch(follow_chords, dim=g.stride + g.tiles_y * TILE_H, device=device, inputs=[
                f.foreground, self._box, dx, dy, square, k == 0, k == len(DIRECTIONS) - 1, LONGEST, self.step, self.flatness,
                self.thickness, g, self.back])


def endless(g: Grid, device: str) -> wp.array:
    """`Chords.back` of obstacles that reach back without an end."""
    return upload(np.full(pixels(g), ENDLESS), wp.float32, device)
