"""Meshes to a depth image by screen-space rasterisation, Eq. (8): project the vertices, then draw the triangles."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hrc.vision.kernels import native
from hrc.vision.kernels.runtime import read, upload, write, zeros
from hrc.vision.kernels.types import MODULE, NEAR, Floats, Grid, Ints, Keys, Points, Poses, pixels, to_image


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
def project(points: Points, normals: Points, first: Ints, count: Ints, frame: Ints, T_camera_frame: Poses,
            margin: float, near: float, g: Grid, screen: Points):
    """A thread takes a run of vertices of one frame."""
    i = wp.tid()
    native.project_run(points, normals, first[i], count[i], T_camera_frame[frame[i]], margin, near, g, screen)


@wp.kernel(module=MODULE)
def draw(screen: Points, faces: wp.array(dtype=wp.vec3i), ids: Keys, run: int, g: Grid, keys: Keys):
    """A thread takes a run of triangles."""
    first = wp.tid() * run
    native.draw_triangles(screen, faces, ids, first, wp.min(run, faces.shape[0] - first), g, keys)


@wp.kernel(module=MODULE)
def resolve(keys: Keys, g: Grid, depth: Floats, link: wp.array(dtype=wp.uint8)):
    native.resolve_row(keys, wp.tid(), g, depth, link)


class Rasteriser:
    """Draws one set of meshes, mesh i at pose i, into `keys`: per pixel the bits of 1/z with the mesh's id in the low four.

    poses: T_camera_mesh, in place, (n, 4, 4); a mesh whose pose is all zeros is not drawn. background: flat keys
    to start from, or nothing. margin [m]: every vertex moves out along its normal by this.
    """

    def __init__(self, g: Grid, meshes: Sequence[Surface], device: str, *,
                 background: np.ndarray | None = None) -> None:
        self.grid, self.device = g, device
        self._background = None if background is None else upload(background, wp.uint32, device)
        sizes = np.array([len(m.vertices) for m in meshes])
        starts = np.cumsum(sizes) - sizes
        self._points = upload(np.concatenate([m.vertices for m in meshes]).astype(np.float32), wp.vec3, device)
        self._normals = upload(np.concatenate([m.normals for m in meshes]).astype(np.float32), wp.vec3, device)
        self._screen = zeros(len(self._points), wp.vec3, device)
        # On a CPU a run is a whole mesh, on CUDA one vertex.
        run = sizes if device == "cpu" else np.ones(sizes.sum(), int)
        frame = np.arange(len(meshes)) if device == "cpu" else np.repeat(np.arange(len(meshes)), sizes)
        self._runs = [upload(x.astype(np.int32), wp.int32, device) for x in (np.cumsum(run) - run, run, frame)]
        faces = np.concatenate([np.asarray(m.faces) + start for m, start in zip(meshes, starts, strict=True)])
        self._faces = upload(faces.astype(np.int32), wp.vec3i, device)
        ids = np.minimum(np.repeat(np.arange(len(meshes)), [len(m.faces) for m in meshes]), 15).astype(np.uint32)
        self._ids = upload(ids, wp.uint32, device)
        self.poses = zeros(len(meshes), wp.mat44, device)
        self.keys = zeros(pixels(g), wp.uint32, device)
        self._depth, self._link = zeros(pixels(g), wp.float32, device), zeros(pixels(g), wp.uint8, device)
        self.margin = 0.0

    def place(self, T_camera_mesh: np.ndarray) -> None:
        """Put the meshes at these poses (n, 4, 4) from the next launch on."""
        write(self.poses, T_camera_mesh.astype(np.float32))

    def launch(self) -> None:
        """Queue the drawing."""
        vertices = [self._points, self._normals, *self._runs, self.poses, self.margin, NEAR, self.grid, self._screen]
        run = 512 if self.device == "cpu" else 1
        triangles = [self._screen, self._faces, self._ids, run, self.grid, self.keys]
        if self._background is None:
            self.keys.zero_()
        else:
            wp.copy(self.keys, self._background)
        wp.launch(project, dim=len(self._runs[0]), inputs=vertices, device=self.device)
        wp.launch(draw, dim=-(-len(self._faces) // run), inputs=triangles, device=self.device)

    def image(self) -> tuple[np.ndarray, np.ndarray]:
        """Fresh copies of the depth [m] (H, W) float32, +inf where nothing is, and of the id (H, W) uint8, 255 there."""
        wp.launch(resolve, dim=self.grid.height, inputs=[self.keys, self.grid, self._depth, self._link],
                  device=self.device)
        return to_image(read(self._depth), self.grid).copy(), to_image(read(self._link), self.grid).copy()
