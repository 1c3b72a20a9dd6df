"""MuJoCo as the ray caster that says what a camera sees: double precision, and no code in common with the eye."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from eye_exact import demand
from eye_random import Scene

from hrc import meshes
from hrc.geometry import Array, apply
from hrc.meshes import Mesh, box
from hrc.vision.camera import Camera
from hrc.vision.render import Renderer

OFF = 255
NEAR = 0.05
"""A triangle with a vertex nearer to the camera than this [m] is not drawn."""
DEPTH = 2e-5
"""Largest difference in depth [m]."""
HAIR = 1e-3
"""How near to an edge [px] a ray is ambiguous: the raster's coordinates have 24 bits, some 1e-4 px in a large image."""
RINGS = np.outer([1.0, 0.3, 0.1, 0.0], HAIR * np.exp(1j * np.arange(16) * np.pi / 8)).ravel()
"""Where to look around a pixel's centre: columns and rows as real and imaginary part."""
BEHIND = Mesh(box((0.1, 0.1, 0.1)).vertices - [0.0, 0.0, 1.0], box((0.1, 0.1, 0.1)).faces, np.zeros((8, 3)))
"""Never seen; with it a single triangle, or none, is a mesh that MuJoCo takes as well."""


class Caster:
    """Meshes as a camera sees them. T_camera_mesh: their poses (n, 4, 4)."""

    def __init__(self, camera: Camera, shapes: Sequence[Mesh], T_camera_mesh: Array) -> None:
        self._camera = camera
        spec = mujoco.MjSpec()
        for i, (mesh, T) in enumerate(zip(shapes, T_camera_mesh, strict=True)):
            vertices = np.concatenate([apply(T, mesh.vertices), BEHIND.vertices])
            faces = np.concatenate([mesh.faces, len(mesh.vertices) + BEHIND.faces])
            shape = spec.add_mesh(name=str(i), uservert=vertices.ravel(), userface=faces.ravel())
            shape.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # an open surface has no volume
            body = spec.worldbody.add_body()
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=str(i), contype=0, conaffinity=0)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        mujoco.mj_kinematics(self._model, self._data)

    def cast(self, u: np.ndarray, v: np.ndarray) -> tuple[Array, np.ndarray]:
        """Depth [m], +inf where nothing is, and index of the mesh, 255 there, along the rays of pixels u, v of any shape."""
        rays = np.ascontiguousarray(self._camera.unproject(u, v, 1.0))
        n = rays.size // 3
        depth, geom = np.empty(n), np.empty(n, np.int32)
        mujoco.mj_multiRay(self._model, self._data, np.zeros(3), rays.ravel(), None, True, -1, geom, depth, None, n, 1e9)
        hit, shape = geom >= 0, rays.shape[:-1]  # geoms are numbered like the meshes
        return np.where(hit, depth, np.inf).reshape(shape), np.where(hit, geom, OFF).astype(np.uint8).reshape(shape)

    def image(self) -> tuple[Array, np.ndarray]:
        """Depth and mesh index of every pixel, (H, W)."""
        v, u = np.mgrid[: self._camera.shape[0], : self._camera.shape[1]]
        return self.cast(u, v)


def drawable(mesh: Mesh, T_camera_mesh: Array) -> Mesh:
    """Only the triangles that a raster draws: front turned to the camera, and no vertex nearer than `NEAR`."""
    corners = apply(T_camera_mesh, mesh.vertices)[mesh.faces]
    a, b, c = np.moveaxis(corners, 1, 0)
    front = np.einsum("ij,ij->i", a, np.cross(b - a, c - a)) < 0
    kept = mesh.faces[front & (corners[:, :, 2].min(axis=1) > NEAR)]
    used, faces = np.unique(kept, return_inverse=True)
    return Mesh(mesh.vertices[used], faces.reshape(-1, 3).astype(np.int32), mesh.normals[used])


@dataclass(frozen=True)
class Sight:
    """What a comparison saw: pixels with something in them, how many were ambiguous, triangles that were not drawn because
    they cross the near plane, and the largest difference in depth elsewhere [m]."""

    pixels: int
    ambiguous: int
    cut: int
    error: float


def check_raster(s: Scene, margins: Array | None = None) -> Sight:
    """Compare the raster of the robot, now, with the ray caster: no other silhouette, no other link, depth to `DEPTH`.

    margins [m] (8,): expand the links by that.

    A pixel whose ray passes within `HAIR` pixels of where the caster itself changes its answer is ambiguous: there the
    raster must give one of the answers around. Raises NotExactError where anything differs.
    """
    parts = meshes.robot("perception" if margins is None else "filter")
    renderer, T = Renderer(s.camera, parts), s.camera.T_camera_world @ s.T_now
    if margins is not None:
        renderer.expand(margins)
        parts = tuple(part.offset(by) for part, by in zip(parts, margins, strict=True))
    found = renderer.render(s.T_now)
    depths = np.concatenate([apply(t, part.vertices)[part.faces][:, :, 2] for t, part in zip(T, parts, strict=True)])
    cut = int(np.count_nonzero((depths.min(axis=1) < NEAR) & (depths.max(axis=1) > NEAR)))
    shapes: Sequence[Mesh] = parts
    if margins is not None or cut:
        # An expanded surface may cross itself, and one that is cut lies open: there the caster must not see the back either.
        shapes = [drawable(part, t) for t, part in zip(T, parts, strict=True)]
    caster = Caster(s.camera, shapes, T)
    depth, link = caster.image()
    both = np.isfinite(depth) & np.isfinite(found.depth)
    off = np.zeros(depth.shape)
    off[both] = np.abs(depth[both] - found.depth[both])
    differ = (link != found.link) | (off > DEPTH)
    for v, u in np.argwhere(differ):
        drawn, on = float(found.depth[v, u]), int(found.link[v, u])
        demand(_ambiguous(caster, u, v, drawn, on),
               f"pixel ({u}, {v}) is {drawn:.6f} m, link {on}, instead of {depth[v, u]:.6f} m, link {link[v, u]}", s)
    return Sight(int(np.isfinite(depth).sum()), int(differ.sum()), cut, float(off[~differ].max(initial=0.0)))


def _ambiguous(caster: Caster, u: int, v: int, depth: float, link: int) -> bool:
    """Whether the caster gives this answer, too, within a hair of the pixel's centre."""
    around, on = caster.cast(u + RINGS.real, v + RINGS.imag)
    same = around[on == link]
    return len(same) > 0 and (link == OFF or bool(same.min() - DEPTH <= depth <= same.max() + DEPTH))
