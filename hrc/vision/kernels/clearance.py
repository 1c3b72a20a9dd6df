"""The least distance of each link to any obstacle within a wide range, with both witness points: coarse by tiles, then exact.

An upper bound for each link comes first: one pixel of each tile of the robot against one of each obstacle tile, then in turn
the obstacle pixel nearest to that robot pixel, and the robot pixel nearest to that obstacle pixel. Boxes around the
tiles then rule out almost all pairs, and what is left is compared pixel by pixel. Nothing is ruled out that is as near as
the bound, so the result is the least in the order of (distance, robot pixel, obstacle pixel) on every device.
"""

from typing import Any, NamedTuple

import warp as wp

from hrc.vision.kernels.boxes import (
    ROUNDING,
    Box,
    Boxes,
    least_square,
    load_pixels,
    obstacle_extent,
    pixel_box,
    pixel_gaps,
    pixel_in,
    robot_extent,
    square,
    square_gap,
    tile_box,
)
from hrc.vision.kernels.distance import NONE
from hrc.vision.kernels.filtering import Filter
from hrc.vision.kernels.runtime import Mirror, everywhere, zeros
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
    Ranks,
    depth_of,
)

ROUNDS = 2
"""How often the upper bounds are improved; each round walks from a robot pixel to an obstacle pixel and back."""
PROBES = 32
"""Obstacle tiles that one robot tile is compared with for the first bound."""
MICROMETRE = wp.constant(wp.float32(1.0e-12))
"""Its square [m^2]."""


@wp.func
def rank(square: float, pixel: int) -> wp.uint64:
    """Orders by distance, then by pixel. What is nearer than a micrometre is 0: rounding is not to order such pixels."""
    if square < MICROMETRE:
        return wp.uint64(pixel)
    return (wp.uint64(wp.cast(square, wp.uint32)) << wp.uint64(32)) | wp.uint64(pixel)


@wp.func
def square_of(r: wp.uint64) -> float:
    return wp.cast(wp.uint32(r >> wp.uint64(32)), wp.float32)


@wp.func
def allowed(r: wp.uint64) -> float:
    """The square of a rank, with room for the same distance rounded in another order."""
    return square_of(r) * 1.0001 + 2.0 * MICROMETRE


@wp.func
def pixel_of(r: wp.uint64) -> int:
    return int(r & wp.uint64(0xFFFFFFFF))


@wp.func
def counts_for(key: wp.uint32, links: wp.uint32) -> bool:
    """Whether this is a robot pixel of one of the links."""
    return key != wp.uint32(0) and ((links >> (key & ID)) & wp.uint32(1)) != wp.uint32(0)


@wp.kernel(module=MODULE)
def begin_clearance(monitor: float, counts: Ints, bound: Ranks, best: Ranks, seed: Ranks):
    counts[0] = 0
    counts[1] = 0
    for link in range(LINK_COUNT):
        bound[link] = rank(monitor * monitor, 0)
        best[link] = NONE
        for i in range(ROUNDS + 1):
            seed[i * LINK_COUNT + link] = NONE


@wp.kernel(module=MODULE)
def list_obstacles(depth: Floats, near: Floats, far: Floats, region: Ints, g: Grid, threads: int, boxes: Boxes, counts: Ints):
    """The tiles of the region with obstacle pixels, and a box around each."""
    wide = region[2] - region[0]
    for k in range(wp.tid(), wide * (region[3] - region[1]), threads):  # pyright: ignore
        x = region[0] + k % wide
        y = region[1] + k / wide
        t = y * g.tiles_x + x
        if far[t] > 0.0:
            e = obstacle_extent(depth, x * TILE_W, y * TILE_H, g)
            boxes[wp.atomic_add(counts, 0, 1)] = tile_box(x * TILE_W, y * TILE_H, e, near[t], far[t], g)


@wp.kernel(module=MODULE)
def list_robot(keys: Keys, links: wp.uint32, region: Ints, g: Grid, threads: int, boxes: Boxes, counts: Ints):
    """The tiles of the region with robot pixels, and a box around each."""
    if counts[0] == 0:
        return
    wide = region[2] - region[0]
    for k in range(wp.tid(), wide * (region[3] - region[1]), threads):  # pyright: ignore
        u = (region[0] + k % wide) * TILE_W
        v = (region[1] + k / wide) * TILE_H
        e = robot_extent(keys, u, v, links, g)
        if e[6] > 0.0:
            boxes[wp.atomic_add(counts, 1, 1)] = tile_box(u, v, e, e[4], e[5], g)


@wp.kernel(module=MODULE)
def guess(keys: Keys, depth: Floats, thickness: float, g: Grid, threads: int, robot: Boxes, obstacles: Boxes, counts: Ints,
          bound: Ranks):
    """A first bound: one pixel of each link in each robot tile against one pixel of some obstacle tiles."""
    step = 1 + counts[0] / PROBES
    for i in range(wp.tid(), counts[1], threads):  # pyright: ignore
        for link in range(LINK_COUNT):
            if ((robot[i].links >> wp.uint32(link)) & wp.uint32(1)) != wp.uint32(0):
                pixel = robot[i].pixel
                j = int(0)
                while keys[pixel] == wp.uint32(0) or int(keys[pixel] & ID) != link:
                    pixel = pixel_in(robot[i], j, g)
                    j += 1
                p = pixel_box(pixel, depth_of(keys[pixel]), g)
                least = float(FAR)
                for k in range(i % step, counts[0], step):
                    o = obstacles[k].pixel
                    least = wp.min(least, square(p, pixel_box(o, depth[o], g), thickness))
                wp.atomic_min(bound, link, rank(least, pixel))


@wp.kernel(module=MODULE)
def witness(keys: Keys, depth: Floats, thickness: float, g: Grid, lanes: int, turn: int, boxes: Boxes, counts: Ints,
            nearest: Ranks, seed: Ranks):
    """For each link, the obstacle pixel nearest to the robot pixel in `nearest`; `lanes` threads share the obstacles."""
    link = wp.tid() / lanes
    pixel = pixel_of(nearest[link])
    key = keys[pixel]
    if nearest[link] == NONE or counts[1] == 0 or key == wp.uint32(0) or int(key & ID) != link:
        return
    p = pixel_box(pixel, depth_of(key), g)
    least = NONE
    most = allowed(nearest[link])
    for i in range(wp.tid() % lanes, counts[0], lanes):
        if square_gap(p, boxes[i], thickness) <= wp.min(most, square_of(least)):
            for j in range(TILE):
                o = pixel_in(boxes[i], j, g)
                if depth[o] < FAR:
                    least = wp.min(least, rank(square(p, pixel_box(o, depth[o], g), thickness), o))
    wp.atomic_min(seed, turn * LINK_COUNT + link, least)  # pyright: ignore


@wp.kernel(module=MODULE)
def approach(keys: Keys, depth: Floats, thickness: float, g: Grid, threads: int, turn: int, boxes: Boxes, counts: Ints,
             seed: Ranks, bound: Ranks):
    """A better bound: the robot pixel nearest to the obstacle pixel found for its link."""
    for i in range(wp.tid(), counts[1], threads):  # pyright: ignore
        for link in range(LINK_COUNT):
            found = seed[turn * LINK_COUNT + link]
            if ((boxes[i].links >> wp.uint32(link)) & wp.uint32(1)) != wp.uint32(0) and found != NONE:
                o = pixel_box(pixel_of(found), depth[pixel_of(found)], g)
                least = bound[link]
                if square_gap(boxes[i], o, thickness) < square_of(least):
                    for j in range(TILE):
                        pixel = pixel_in(boxes[i], j, g)
                        key = keys[pixel]
                        if key != wp.uint32(0) and int(key & ID) == link:
                            p = pixel_box(pixel, depth_of(key), g)
                            least = wp.min(least, rank(square(p, o, thickness), pixel))
                    wp.atomic_min(bound, link, least)


@wp.kernel(module=MODULE)
def clear(keys: Keys, links: wp.uint32, depth: Floats, monitor: float, thickness: float, g: Grid, threads: int, grain: int,
          robot: Boxes, boxes: Boxes, counts: Ints, bound: Ranks, limits: Floats, points: Floats, best: Ranks):
    """The least rank of each link, over all pairs of pixels that are not ruled out; a thread takes `grain` pixels."""
    at = wp.tid() * grain * 5
    mine = wp.tid() * LINK_COUNT
    for item in range(wp.tid(), counts[1] * TILE / grain, threads):  # pyright: ignore
        r = robot[item * grain / TILE]
        first = item * grain % TILE
        most = float(-1.0)
        for link in range(LINK_COUNT):
            limits[mine + link] = wp.min(allowed(bound[link]), square_of(best[link]))
            if ((r.links >> wp.uint32(link)) & wp.uint32(1)) != wp.uint32(0):
                most = wp.max(most, limits[mine + link])
        loaded = bool(False)
        for k in range(counts[0]):
            o = boxes[k]
            if square_gap(r, o, thickness) <= most:
                if not loaded:
                    load_pixels(keys, r.u, r.v, first, grain, links, limits, mine, g, points, at)
                    loaded = True
                if pixel_gaps(points, at, grain, o, thickness, ROUNDING) > 0:
                    for i in range(at, at + grain):  # pyright: ignore
                        if points[i + 4 * grain] <= points[i + 3 * grain]:
                            pixel = pixel_in(r, first + i - at, g)
                            link = int(keys[pixel] & ID)
                            if rank(points[i + 4 * grain], pixel) <= best[link]:
                                least = least_square(depth, o.u, o.v, points[i], points[i + grain], points[i + 2 * grain],
                                                     thickness, g)
                                if least < monitor * monitor:
                                    wp.atomic_min(best, link, rank(least, pixel))


@wp.kernel(module=MODULE)
def report_clearance(keys: Keys, depth: Floats, thickness: float, g: Grid, best: Ranks, seed: Ranks,
                     result: wp.array(dtype=wp.float64)):
    """For each link u, v, depth on the robot and on the obstacle; u = -1 where nothing is in range."""
    link = wp.tid()
    at = 6 * link
    obstacle = seed[ROUNDS * LINK_COUNT + link]
    if best[link] == NONE or obstacle == NONE:
        result[at] = wp.float64(-1.0)
        return
    p = pixel_of(best[link])
    o = pixel_of(obstacle)
    z = depth_of(keys[p])
    result[at] = wp.float64(p % g.stride)
    result[at + 1] = wp.float64(p / g.stride)
    result[at + 2] = wp.float64(z)
    result[at + 3] = wp.float64(o % g.stride)
    result[at + 4] = wp.float64(o / g.stride)
    result[at + 5] = wp.float64(wp.clamp(z, depth[o], depth[o] + thickness))


class Witnesses(NamedTuple):
    """Of one link, the robot pixel (u, v) and its depth [m], the obstacle pixel nearest to it and the depth that counts."""

    link: int
    robot: tuple[int, int, float]
    obstacle: tuple[int, int, float]


class Clearances:
    """The least distance of each link to the obstacles that a filter left.

    keys: the robot's raster; links: bit set of those measured; monitor [m]: the range; thickness [m]: of obstacles.
    region, robot_region: the tiles, from (x, y) to before (x, y), with all obstacles in range, and with the robot.
    """

    def __init__(self, g: Grid, keys: Any, foreground: Filter, device: str) -> None:
        self.grid, self.device, self.keys, self._foreground = g, device, keys, foreground
        self.links, self.monitor, self.thickness = 0xFF, 0.5, 0.12
        self.region, self.robot_region = (everywhere(g, device) for _ in range(2))
        n = g.tiles_x * g.tiles_y
        self._robot, self._obstacles = (zeros(n, Box, device) for _ in range(2))
        threads = 1 if device == "cpu" else n * TILE
        self._points, self._limits = (zeros(m, wp.float32, device) for m in (5 * max(threads, TILE), LINK_COUNT * threads))
        self._counts = zeros(2, wp.int32, device)
        self._bound, self._best = (zeros(LINK_COUNT, wp.uint64, device) for _ in range(2))
        self._seed = zeros((ROUNDS + 1) * LINK_COUNT, wp.uint64, device)
        self._result = Mirror(6 * LINK_COUNT, wp.float64, device)

    def launch(self) -> None:
        """Queue the search."""
        g, f, links, device = self.grid, self._foreground, wp.uint32(self.links), self.device
        threads, grain, lanes = (1, TILE, 1) if device == "cpu" else (g.tiles_x * g.tiles_y, 1, 64)
        scene = [self.keys, f.foreground, self.thickness, g]
        wp.launch(begin_clearance, dim=1, device=device, inputs=[
            self.monitor, self._counts, self._bound, self._best, self._seed])
        wp.launch(list_obstacles, dim=threads, device=device, inputs=[
            f.foreground, f.nearest, f.farthest, self.region, g, threads, self._obstacles, self._counts])
        wp.launch(list_robot, dim=threads, device=device, inputs=[
            self.keys, links, self.robot_region, g, threads, self._robot, self._counts])
        wp.launch(guess, dim=threads, device=device, inputs=[
            *scene, threads, self._robot, self._obstacles, self._counts, self._bound])
        for turn in range(ROUNDS):
            wp.launch(witness, dim=LINK_COUNT * lanes, device=device, inputs=[
                *scene, lanes, turn, self._obstacles, self._counts, self._bound, self._seed])
            wp.launch(approach, dim=threads, device=device, inputs=[
                *scene, threads, turn, self._robot, self._counts, self._seed, self._bound])
        threads *= TILE // grain
        wp.launch(clear, dim=threads, device=device, inputs=[
            self.keys, links, f.foreground, self.monitor, self.thickness, g, threads, grain, self._robot, self._obstacles,
            self._counts, self._bound, self._limits, self._points, self._best])
        wp.launch(witness, dim=LINK_COUNT * lanes, device=device, inputs=[
            *scene, lanes, ROUNDS, self._obstacles, self._counts, self._best, self._seed])
        wp.launch(report_clearance, dim=LINK_COUNT, device=device, inputs=[*scene, self._best, self._seed, self._result.buffer])

    def result(self) -> list[Witnesses]:
        """One for each link with an obstacle in range, by link."""
        rows = self._result.read().reshape(LINK_COUNT, 6).tolist()
        return [Witnesses(link, (int(u), int(v), depth), (int(u_o), int(v_o), depth_o))
                for link, (u, v, depth, u_o, v_o, depth_o) in enumerate(rows) if u >= 0]
