"""Separate places of contact (Remarks 1 and 2): the basins of the distance map.

The pixels nearer than a threshold are visited by rising distance. One that has no visited neighbour begins a basin; one
between two basins joins them, unless it lies higher than both their lowest pixels by more than a ridge. So a hand laid flat
on the arm is one place, whatever link its parts touch; two hands are two, since the distance rises between them.

This is a matter of a thousand pixels, one after another: it runs on the CPU, whatever device the map is on.
"""

from typing import Any

import numpy as np
import warp as wp

from hrc.vision.kernels.boxes import pixel_box, square
from hrc.vision.kernels.contact import ContactPoints, Found, window
from hrc.vision.kernels.distance import NONE, Distance
from hrc.vision.kernels.runtime import Graph, read, zeros
from hrc.vision.kernels.types import (
    FAR,
    LINK_COUNT,
    MODULE,
    TILE_H,
    TILE_W,
    VALUE,
    Floats,
    Grid,
    Ints,
    Keys,
    Ranks,
    depth_of,
    pixels,
    to_image,
)

PLACES = 4
"""So many places are told apart, the nearest."""
STEP = 0.0005
LEVEL = wp.constant(wp.float32(STEP))
"""Distances are sorted in steps of this [m]; within a step, the pixels are in the order of the image."""
LEVELS = 2048


@wp.func
def root_of(parent: Ints, i: int) -> int:
    r = i
    while parent[r] != r:
        parent[r] = parent[parent[r]]
        r = parent[r]
    return r


@wp.kernel(module=MODULE)
def list_near(distances: Floats, active: Ints, n_active: Ints, touch: float, g: Grid, tiles: Ints, pixel: Ints,
              histogram: Ints, n: Ints, order: Ints, at: Ints, place_keys: Keys, place_distances: Floats):
    """Forgets the last places, and sorts the near pixels by level and pixel: the i-th is order[i], and at[order[i]] is i."""
    for i in range(n[0]):
        at[order[i]] = -1
        place_keys[order[i]] = wp.uint32(0)
        place_distances[order[i]] = wp.inf
    levels = int(touch / LEVEL) + 1
    for i in range(levels + 1):
        histogram[i] = 0
    for i in range(n_active[0]):  # insertion sort: in order already, but for CUDA
        k = i
        t = active[i]
        while k > 0 and tiles[wp.max(k - 1, 0)] > t:
            tiles[k] = tiles[k - 1]
            k -= 1
        tiles[k] = t
    m = int(0)
    first = int(0)
    while first < n_active[0]:  # a row of tiles
        end = first
        while end < n_active[0] and tiles[wp.min(end, n_active[0] - 1)] / g.tiles_x == tiles[first] / g.tiles_x:
            end += 1
        for row in range(TILE_H):
            for i in range(first, end):
                start = (tiles[i] / g.tiles_x * TILE_H + row) * g.stride + tiles[i] % g.tiles_x * TILE_W
                for p in range(start, start + TILE_W):
                    if distances[p] < touch:
                        pixel[m] = p
                        m += 1
                        histogram[int(distances[p] / LEVEL) + 1] += 1
        first = end
    for i in range(levels):
        histogram[i + 1] += histogram[i]
    for i in range(m):
        level = int(distances[pixel[i]] / LEVEL)
        order[histogram[level]] = pixel[i]
        at[pixel[i]] = histogram[level]
        histogram[level] += 1
    n[0] = m


@wp.kernel(module=MODULE)
def flood(keys: Keys, distances: Floats, ridge: int, step: float, g: Grid, n: Ints, order: Ints, at: Ints, parent: Ints):
    """parent[i] leads to the lowest pixel of the basin of the i-th pixel, which is its root."""
    for i in range(n[0]):
        u = order[i] % g.stride
        v = order[i] / g.stride
        z = depth_of(keys[order[i]])
        parent[i] = i
        lowest = i
        for y in range(wp.max(v - 1, 0), wp.min(v + 2, g.height)):  # pyright: ignore
            for b in range(y * g.stride + wp.max(u - 1, 0), y * g.stride + wp.min(u + 2, g.width)):
                if at[b] >= 0 and at[b] < lowest and wp.abs(depth_of(keys[b]) - z) < step:
                    lowest = at[b]
        if lowest < i:
            root = root_of(parent, lowest)
            parent[i] = root
            level = int(distances[order[i]] / LEVEL)
            for y in range(wp.max(v - 1, 0), wp.min(v + 2, g.height)):  # pyright: ignore
                for b in range(y * g.stride + wp.max(u - 1, 0), y * g.stride + wp.min(u + 2, g.width)):
                    if at[b] >= 0 and at[b] < i:
                        other = root_of(parent, at[b])
                        if other != root and wp.abs(depth_of(keys[b]) - z) < step:
                            higher = wp.max(root, other)
                            if level - int(distances[order[higher]] / LEVEL) < ridge:
                                root = wp.min(root, other)
                                parent[higher] = root


@wp.func
def nearest_obstacle(pixel: int, z: float, depth: Floats, back: Floats, region: Ints, radius: float, thickness: float,
                     g: Grid) -> int:
    """The first of the obstacle pixels nearest to a robot pixel, all within the radius, -1 without."""
    p = pixel_box(pixel, z, g)
    w = window(pixel, z, region, radius, g)
    best = int(-1)
    least = float(wp.inf)
    for v in range(w[2], w[3] + 1):  # pyright: ignore
        for o in range(v * g.stride + w[0], v * g.stride + w[1] + 1):  # pyright: ignore
            if depth[o] < FAR:
                d = square(p, pixel_box(o, depth[o], g), wp.min(back[o] - depth[o], thickness))
                if d < least:
                    least = d
                    best = o
    return best


@wp.kernel(module=MODULE)
def tell_places(keys: Keys, depth: Floats, back: Floats, region: Ints, touch: float, thickness: float, hand: float, step: float,
                g: Grid, n: Ints, order: Ints, parent: Ints, place: Ints, stack: Ints, seen: Ints):
    """The first few basins become places; one whose obstacle hangs together with that of an earlier one is part of it.

    seen: obstacle pixels, as 1 + the place they belong to, within `hand` [m] of where the obstacle is nearest to the place.
    """
    places = int(0)
    n_seen = int(0)
    for i in range(n[0]):
        parent[i] = root_of(parent, i)
        place[i] = -1
        if parent[i] == i:
            o = nearest_obstacle(order[i], depth_of(keys[order[i]]), depth, back, region, touch, thickness, g)
            if o >= 0:
                place[i] = seen[o] - 1
                if seen[o] == 0 and places < PLACES:
                    place[i] = places
                    places += 1
                    w = window(o, depth[o] + hand, region, hand, g)
                    seen[o] = places
                    head = n_seen
                    stack[n_seen] = o
                    n_seen += 1
                    while head < n_seen:
                        q = stack[head]
                        head += 1
                        for v in range(wp.max(q / g.stride - 1, w[2]), wp.min(q / g.stride + 1, w[3]) + 1):  # pyright: ignore
                            for u in range(wp.max(q % g.stride - 1, w[0]), wp.min(q % g.stride + 1, w[1]) + 1):  # pyright: ignore
                                b = v * g.stride + u
                                if seen[b] == 0 and depth[b] < FAR and wp.abs(depth[b] - depth[q]) < step:
                                    seen[b] = places
                                    stack[n_seen] = b
                                    n_seen += 1
    for i in range(n_seen):
        seen[stack[i]] = 0


@wp.kernel(module=MODULE)
def map_places(keys: Keys, distances: Floats, g: Grid, n: Ints, order: Ints, parent: Ints, place: Ints, seen: Ints,
               place_keys: Keys, place_distances: Floats, nearest: Ranks, active: Ints, n_active: Ints):
    """The places as a map of distances, whose keys hold the number of the place instead of the link."""
    for i in range(LINK_COUNT):
        nearest[i] = NONE
    m = int(0)
    for i in range(n[0]):
        k = place[parent[i]]
        if k >= 0:
            pixel = order[i]
            place_keys[pixel] = (keys[pixel] & VALUE) | wp.uint32(k)
            place_distances[pixel] = distances[pixel]
            bits = wp.uint64(wp.cast(distances[pixel], wp.uint32))
            nearest[k] = wp.min(nearest[k], (bits << wp.uint64(32)) | wp.uint64(pixel))
            tile = pixel / (g.stride * TILE_H) * g.tiles_x + pixel % g.stride / TILE_W
            if seen[tile] == 0:
                seen[tile] = 1
                active[m] = tile
                m += 1
    n_active[0] = m
    for i in range(m):
        seen[active[i]] = 0


class Places:
    """A distance map with the number of a place instead of the link, as `ContactPoints` takes it."""

    def __init__(self, distance: Distance) -> None:
        g = distance.grid
        self.grid, self.device = g, "cpu"
        self.keys, self.distances = zeros(pixels(g), wp.uint32, "cpu"), zeros(pixels(g), wp.float32, "cpu")
        self.distances.fill_(wp.inf)
        self.nearest = zeros(LINK_COUNT, wp.uint64, "cpu")
        self.active, self.n_active = zeros(g.tiles_x * g.tiles_y, wp.int32, "cpu"), zeros(1, wp.int32, "cpu")
        self.reach, self.thickness = distance.reach, distance.thickness
        self.depth, self.back, self.region = distance.depth, distance.back, distance.region


class Touches:
    """Up to four separate places of a distance map where an obstacle is nearer than `touch` [m].

    ridge [m]: how far the distance must rise between two places; step [m]: pixels side by side whose depths differ by more
    belong to different surfaces; hand [m]: obstacle pixels that hang together within this are one hand, arm or thing, and
    touch one place. points: the rule for the point that stands for a place.
    """

    def __init__(self, distance: Distance) -> None:
        self._distance, g = distance, distance.grid
        self.touch, self.ridge, self.step, self.hand = 0.06, 0.008, 0.05, 0.2
        self._places = Places(distance)
        self.points = ContactPoints(self._places)  # pyright: ignore[reportArgumentType]
        self._histogram, self._n, self._tiles = (
            zeros(m, wp.int32, "cpu") for m in (LEVELS + 2, 1, g.tiles_x * g.tiles_y))
        self._pixel, self._order, self._at, self._parent, self._place, self._stack, self._seen = (
            zeros(pixels(g), wp.int32, "cpu") for _ in range(7))
        self._at.fill_(-1)
        self._map, self._copies = self._originals(), self._originals()

    def capture(self) -> Graph:
        """The search as a graph of the CPU; call `load` before each replay."""
        d, p = self._distance, self._places
        self._map = self._originals()
        self._copies = [x if x.device.is_cpu else zeros(len(x), x.dtype, "cpu") for x in self._map]
        p.reach, p.thickness = d.reach, d.thickness
        p.depth, p.back, p.region = self._copies[4:]
        return Graph([self._launch, self.points.launch], "cpu")

    def load(self) -> None:
        """Bring the map to the CPU, if it is not there."""
        for copy, original in zip(self._copies, self._map, strict=True):
            if copy is not original:
                wp.copy(copy, original)

    def _originals(self) -> list[Any]:
        d = self._distance
        return [d.keys, d.distances, d.active, d.n_active, d.depth, d.back, d.region]

    def _launch(self) -> None:
        p, g, near = self._places, self._places.grid, [self._n, self._order]
        keys, distances, active, n_active = self._copies[:4]
        wp.launch(list_near, dim=1, device="cpu", inputs=[
            distances, active, n_active, self.touch, g, self._tiles, self._pixel, self._histogram, *near, self._at, p.keys,
            p.distances])
        wp.launch(flood, dim=1, device="cpu", inputs=[
            keys, distances, round(self.ridge / STEP), self.step, g, *near, self._at, self._parent])
        wp.launch(tell_places, dim=1, device="cpu", inputs=[
            keys, p.depth, p.back, p.region, min(self.touch, p.reach), p.thickness, self.hand, self.step, g, *near,
            self._parent, self._place, self._stack, self._seen])
        wp.launch(map_places, dim=1, device="cpu", inputs=[
            keys, distances, g, *near, self._parent, self._place, self._seen, p.keys, p.distances, p.nearest, p.active,
            p.n_active])

    def result(self) -> list[Found]:
        """One for each place, the nearest first, with the link of its point."""
        keys, stride = read(self._copies[0]), self._places.grid.stride
        return [f._replace(link=int(keys[f.v * stride + f.u]) & 15) for f in self.points.result()]

    def image(self) -> np.ndarray:
        """The number of the place of each pixel (H, W), -1 for none."""
        keys, distances = (to_image(read(x), self._places.grid) for x in (self._places.keys, self._places.distances))
        return np.where(np.isfinite(distances), (keys & 15).astype(int), -1)
