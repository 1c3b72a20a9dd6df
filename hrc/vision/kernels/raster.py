"""Meshes to a depth image by screen-space rasterisation, Eq. (8): project the vertices, then draw the triangles."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hrc.vision.kernels import native
from hrc.vision.kernels.runtime import upload, write, zeros
from hrc.vision.kernels.types import MODULE, NEAR, Grid, Ints, Keys, Points, Poses, pixels


class Surface(Protocol):
    """A triangle mesh: vertices (n, 3) [m], faces (m, 3), unit vertex normals (n, 3), in the frame it moves with."""

    @property
    def vertices(self) -> NDArray[np.float64]: ...
    @property
    def faces(self) -> NDArray[np.int32]: ...
    @property
    def normals(self) -> NDArray[np.float64]: ...


@wp.kernel(module=MODULE)
def project(points: Points, normals: Points, frame: Ints, T_camera_frame: Poses, margin: float, near: float, g: Grid,
            screen: Points):
    i = wp.tid()
    T = T_camera_frame[frame[i]]
    p = wp.transform_point(T, points[i]) + margin * wp.transform_vector(T, normals[i])
    inverse = float(-1.0)
    if p[2] > near:
        inverse = 1.0 / p[2]
    screen[i] = wp.vec3(g.fx * p[0] * inverse + g.cx, g.fy * p[1] * inverse + g.cy, inverse)


@wp.kernel(module=MODULE)
def draw(screen: Points, faces: wp.array(dtype=wp.vec3i), ids: Keys, g: Grid, keys: Keys):
    native.draw_triangle(screen, faces, ids, wp.tid(), g, keys)


class Rasteriser:
    """Draws one set of meshes, mesh i at pose i, into `keys`: per pixel the bits of 1/z with the mesh's id in the low four.

    poses: T_camera_mesh, in place, (n, 4, 4); a mesh whose pose is all zeros is not drawn. background: flat keys
    to start from, or nothing. margin [m]: every vertex moves out along its normal by this.
    """

    def __init__(self, g: Grid, meshes: Sequence[Surface], device: str, *,
                 background: np.ndarray | None = None) -> None:
        self.grid, self.device = g, device
        self._background = None if background is None else upload(background, wp.uint32, device)
        starts = np.cumsum([0] + [len(m.vertices) for m in meshes])
        self._points = upload(np.concatenate([m.vertices for m in meshes]).astype(np.float32), wp.vec3, device)
        self._normals = upload(np.concatenate([m.normals for m in meshes]).astype(np.float32), wp.vec3, device)
        owner = np.repeat(np.arange(len(meshes), dtype=np.int32), [len(m.vertices) for m in meshes])
        self._frame = upload(owner, wp.int32, device)
        faces = np.concatenate([np.asarray(m.faces, np.int32) + s for m, s in zip(meshes, starts, strict=False)])
        self._faces = upload(faces.astype(np.int32), wp.vec3i, device)
        ids = np.minimum(np.repeat(np.arange(len(meshes)), [len(m.faces) for m in meshes]), 15).astype(np.uint32)
        self._ids = upload(ids, wp.uint32, device)
        self._screen = zeros(len(owner), wp.vec3, device)
        self.poses = zeros(len(meshes), wp.mat44, device)
        self.keys = zeros(pixels(g), wp.uint32, device)
        self.margin = 0.0

    def place(self, T_camera_mesh: np.ndarray) -> None:
        """Put the meshes at these poses (n, 4, 4) from the next launch on."""
        write(self.poses, T_camera_mesh.astype(np.float32))

    def launch(self) -> None:
        """Queue the drawing."""
        vertices = [self._points, self._normals, self._frame, self.poses, self.margin, NEAR, self.grid, self._screen]
        triangles = [self._screen, self._faces, self._ids, self.grid, self.keys]
        if self._background is None:
            self.keys.zero_()
        else:
            wp.copy(self.keys, self._background)
        wp.launch(project, dim=len(self._points), inputs=vertices, device=self.device)
        wp.launch(draw, dim=len(self._faces), inputs=triangles, device=self.device)
