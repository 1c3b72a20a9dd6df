"""Meshes to a depth image by screen-space rasterisation, Eq. (8): project the vertices, then draw the triangles."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from hrc.errors import AssetError
from hrc.vision.kernels import native, native_raster
from hrc.vision.kernels.runtime import Mirror, everywhere, read, tiles_per_thread, upload, write, zeros
from hrc.vision.kernels.types import (
    MODULE,
    NEAR,
    TILE_H,
    TILE_W,
    Floats,
    Grid,
    Ints,
    Keys,
    Poses,
    pixels,
    to_image,
)

BLOCK = 64
"""Triangles set up side by side on a CPU."""
NOWHERE = wp.constant(1 << 30)


class Surface(Protocol):
    """A triangle mesh: vertices (n, 3) [m], faces (m, 3), unit vertex normals (n, 3), in the frame it moves with."""

    @property
    def vertices(self) -> NDArray[np.float64]:
        """[m], (n, 3)."""
        ...

    @property
    def faces(self) -> NDArray[np.int32]:
        """Indices of vertices, (m, 3), counter-clockwise from outside."""
        ...

    @property
    def normals(self) -> NDArray[np.float64]:
        """Outward unit vectors, (n, 3)."""
        ...


@wp.kernel(module=MODULE)
def erase(keys: Keys, background: Keys, drawn: Ints, run: int, g: Grid):
    """Undo the last drawing; a thread takes `run` tiles side by side."""
    runs = (g.tiles_x + run - 1) / run
    x0 = wp.tid() % runs * run
    y = wp.tid() / runs
    if y >= drawn[1] and y < drawn[3]:
        for x in range(wp.max(x0, drawn[0]), wp.min(x0 + run, drawn[2])):  # pyright: ignore[reportArgumentType]
            native.erase_tile(keys, background, y * TILE_H * g.stride + x * TILE_W, g)


@wp.kernel(module=MODULE)
def begin(bounds: Ints):
    """Bounds of nothing; a thread takes a mesh."""
    at = wp.tid() * 5
    bounds[at] = NOWHERE
    bounds[at + 1] = NOWHERE
    bounds[at + 2] = -NOWHERE
    bounds[at + 3] = -NOWHERE
    bounds[at + 4] = 0


@wp.kernel(module=MODULE)
def project(points: Floats, normals: Floats, first: Ints, count: Ints, mesh: Ints, T_camera_mesh: Poses, margins: Floats,
            near: float, g: Grid, screen: Floats, bounds: Ints):
    """A thread takes a run of vertices of one mesh."""
    i = wp.tid()
    m = mesh[i]
    b = native_raster.project_run(points, normals, first[i], count[i], T_camera_mesh[m], margins[m], near, g, screen)
    wp.atomic_min(bounds, m * 5, b[0])
    wp.atomic_min(bounds, m * 5 + 1, b[1])
    wp.atomic_max(bounds, m * 5 + 2, b[2])
    wp.atomic_max(bounds, m * 5 + 3, b[3])
    wp.atomic_max(bounds, m * 5 + 4, b[4])


@wp.kernel(module=MODULE)
def enclose(bounds: Ints, meshes: int, links: wp.uint32, reach: float, more: int, g: Grid, box: Ints):
    """The tiles, from (x, y) to before (x, y), that hold every pixel within `reach` [m] and `more` pixels of the meshes in the
    set `links`."""
    left = int(NOWHERE)
    top = int(NOWHERE)
    right = int(-NOWHERE)
    bottom = int(-NOWHERE)
    for m in range(meshes):
        if ((links >> wp.uint32(wp.min(m, 15))) & wp.uint32(1)) != wp.uint32(0) and bounds[m * 5 + 4] > 0:
            # Rounded, and not more than a coordinate on the screen can be.
            away = wp.min(reach * g.ray * wp.cast(bounds[m * 5 + 4], wp.float32), 1.0e3)
            du = int(away * g.fx) + 2 + more
            dv = int(away * g.fy) + 2 + more
            left = wp.min(left, bounds[m * 5] - du)
            top = wp.min(top, bounds[m * 5 + 1] - dv)
            right = wp.max(right, bounds[m * 5 + 2] + du)
            bottom = wp.max(bottom, bounds[m * 5 + 3] + dv)
    box[0] = wp.max(left, 0) / TILE_W
    box[1] = wp.max(top, 0) / TILE_H
    box[2] = wp.min(wp.max(right, -TILE_W) / TILE_W + 1, g.tiles_x)
    box[3] = wp.min(wp.max(bottom, -TILE_H) / TILE_H + 1, g.tiles_y)


@wp.kernel(module=MODULE)
def draw(screen: Floats, faces: Ints, ids: Keys, run: int, g: Grid, keys: Keys):
    """A thread takes a run of triangles."""
    first = wp.tid() * run
    native_raster.draw_triangles(screen, faces, ids, first, wp.min(run, ids.shape[0] - first), g, keys)


@wp.kernel(module=MODULE)
def resolve(keys: Keys, g: Grid, depth: Floats, link: wp.array(dtype=wp.uint8)):
    native.resolve_row(keys, wp.tid(), g, depth, link)


class Rasteriser:
    """Draws one set of meshes, mesh i at pose i, into `keys`: per pixel the bits of 1/z with the mesh's id in the low four.

    background: flat keys to start from, or nothing. bounds: per mesh its least and largest column and row on the screen,
    and the bits of its largest 1/z. Raises AssetError for a mesh that cannot be drawn.
    """

    def __init__(self, g: Grid, meshes: Sequence[Surface], device: str, *,
                 background: np.ndarray | None = None) -> None:
        _check(meshes)
        self.grid, self.device = g, device
        self._view: np.ndarray | None = None
        self._background = zeros(0, wp.uint32, device) if background is None else upload(background, wp.uint32, device)
        sizes = np.array([len(m.vertices) for m in meshes])
        starts = np.cumsum(sizes) - sizes
        self._points = upload(_by_column([m.vertices for m in meshes]).astype(np.float32), wp.float32, device)
        self._normals = upload(_by_column([m.normals for m in meshes]).astype(np.float32), wp.float32, device)
        self._screen = zeros(len(self._points), wp.float32, device)
        # On a CPU a run is a whole mesh, on CUDA one vertex.
        run = sizes if device == "cpu" else np.ones(sizes.sum(), int)
        mesh = np.arange(len(meshes)) if device == "cpu" else np.repeat(np.arange(len(meshes)), sizes)
        self._runs = [upload(x.astype(np.int32), wp.int32, device) for x in (np.cumsum(run) - run, run, mesh)]
        faces = [np.asarray(m.faces) + start for m, start in zip(meshes, starts, strict=True)]
        ids = np.minimum(np.repeat(np.arange(len(meshes)), [len(m.faces) for m in meshes]), 15).astype(np.uint32)
        # In whole blocks: what fills the last one up has no area.
        spare = -len(ids) % BLOCK
        self._faces = upload(_by_column([*faces, np.zeros((spare, 3), int)]).astype(np.int32), wp.int32, device)
        self._ids = upload(np.pad(ids, (0, spare)), wp.uint32, device)
        self._poses, self._margins = Mirror(len(meshes), wp.mat44, device), Mirror(len(meshes), wp.float32, device)
        self.bounds = zeros(5 * len(meshes), wp.int32, device)
        self._drawn = everywhere(g, device)
        self.keys = zeros(pixels(g), wp.uint32, device)
        self._depth, self._link = zeros(pixels(g), wp.float32, device), zeros(pixels(g), wp.uint8, device)

    def place(self, T_camera_mesh: np.ndarray) -> None:
        """Put the meshes at these poses (n, 4, 4) from the next launch on; all zeros: this mesh is not drawn."""
        self._poses.write(T_camera_mesh)

    def replace_background(self, keys: np.ndarray) -> None:
        """Start from these flat keys from the next launch on; there must have been some from the beginning."""
        write(self._background, keys)
        write(self._drawn, np.array([0, 0, self.grid.tiles_x, self.grid.tiles_y], np.int32))

    def expand(self, margins: ArrayLike) -> None:
        """Move every vertex out along its normal, by one margin [m] or by one for each mesh (n,), from the next launch on."""
        self._margins.write(margins)

    def launch(self) -> None:
        """Queue the drawing."""
        g, n, device = self.grid, len(self._margins), self.device
        run = 8 * BLOCK if device == "cpu" else 1
        wide = tiles_per_thread(g, device)
        wp.launch(erase, dim=-(-g.tiles_x // wide) * g.tiles_y, device=device, inputs=[
            self.keys, self._background, self._drawn, wide, g])
        wp.launch(begin, dim=n, inputs=[self.bounds], device=device)
        wp.launch(project, dim=len(self._runs[0]), device=device, inputs=[
            self._points, self._normals, *self._runs, self._poses.buffer, self._margins.buffer, NEAR, g, self._screen,
            self.bounds])
        self.surround(0xFFFF, 0.0, self._drawn)
        wp.launch(draw, dim=-(-len(self._ids) // run), device=device, inputs=[
            self._screen, self._faces, self._ids, run, g, self.keys])

    def surround(self, links: int, reach: float, box: Any, more: int = 0) -> None:
        """Queue finding the `box` of tiles with all pixels that can be within `reach` [m] of the meshes in the set `links`,
        and `more` pixels around."""
        wp.launch(enclose, dim=1, device=self.device, inputs=[
            self.bounds, len(self._margins), wp.uint32(links), reach, more, self.grid, box])

    def key(self, u: int, v: int) -> np.uint32:
        """The key of one pixel as it is now, 0 where nothing is drawn."""
        if self._view is None or self.device != "cpu":  # there the view stays what it is
            self._view = to_image(read(self.keys), self.grid)
        return self._view[v, u]

    def image(self) -> tuple[np.ndarray, np.ndarray]:
        """Fresh copies of the depth [m] (H, W) float32, +inf where nothing is, and of the id (H, W) uint8, 255 there."""
        wp.launch(resolve, dim=self.grid.height, inputs=[self.keys, self.grid, self._depth, self._link],
                  device=self.device)
        return to_image(read(self._depth), self.grid).copy(), to_image(read(self._link), self.grid).copy()


def _by_column(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Rows of three, one after another, as all first, then all second, then all third entries."""
    return np.ascontiguousarray(np.concatenate(parts).T).ravel()


def _check(meshes: Sequence[Surface]) -> None:
    """A bad index would be read from, and a bad vertex projected to, anywhere."""
    if not meshes:
        raise AssetError("there must be at least one mesh to draw")
    for i, mesh in enumerate(meshes):
        vertices, faces, normals = (np.asarray(x) for x in (mesh.vertices, mesh.faces, mesh.normals))
        if not len(faces):
            raise AssetError(f"mesh {i} has no triangles, and {len(vertices)} vertices")
        if vertices.shape != normals.shape or vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
            raise AssetError(f"mesh {i} must have vertices (n, 3), normals (n, 3) and faces (m, 3), not {vertices.shape}, "
                             f"{normals.shape} and {faces.shape}")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise AssetError(f"mesh {i} has {len(vertices)} vertices, so its faces must index 0 to {len(vertices) - 1}, not "
                             f"{faces.min()} to {faces.max()}")
        if not (np.isfinite(vertices).all() and np.isfinite(normals).all()):
            raise AssetError(f"mesh {i} has a vertex or normal that is not finite")
