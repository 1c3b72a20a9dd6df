"""Triangle meshes: the robot's eight parts in three levels of detail, and the shapes of obstacles."""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from hrc import figure as person
from hrc.errors import AssetError, unknown
from hrc.geometry import apply
from hrc.paths import assets

Array = NDArray[np.float64]

PARTS = ("base", *(f"link_{i}" for i in range(1, 8)))
"""The parts of the robot, in the order of the kinematic chain."""
DETAILS = ("plant", "perception", "filter")
"""The levels of detail: about 40,000, 10,000 and 2,500 triangles over the eight parts."""

_ORANGE, _AMBER = (1.0, 0.487, 0.0), (0.96, 0.44, 0.0)
COLOURS = ((0.16, 0.16, 0.17), _ORANGE, _AMBER, _ORANGE, _AMBER, _ORANGE, (0.7, 0.7, 0.7), (0.3, 0.3, 0.3))
"""One RGB colour a part, in 0..1."""


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh:
    """A closed surface of triangles that share their vertices, seen counter-clockwise from outside."""

    vertices: Array
    """[m], shape (n, 3), in the part's own frame."""
    faces: NDArray[np.int32]
    """Vertex indices, shape (m, 3)."""
    normals: Array
    """Outward unit vectors, shape (n, 3)."""

    def __post_init__(self) -> None:
        for name, kind in (("vertices", np.float64), ("faces", np.int32), ("normals", np.float64)):
            array = np.array(getattr(self, name), kind)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def offset(self, distance: float) -> "Mesh":
        """The surface with every vertex moved by `distance` [m] along its normal: shared vertices leave no cracks."""
        return Mesh(self.vertices + distance * self.normals, self.faces, self.normals)


@functools.cache
def robot(detail: str) -> tuple[Mesh, ...]:
    """The eight parts, `PARTS` in order: the base in the world frame, each link in its link frame.

    The normals are weighted by angle over welded vertices, so that `Mesh.offset` leaves no cracks.
    Raises AssetError for an unknown detail or a file that is missing or unreadable.
    """
    if detail not in DETAILS:
        raise AssetError(unknown("level of detail", detail, DETAILS))
    return tuple(_load(assets() / "lwr" / "meshes" / detail / f"{part}.stl") for part in PARTS)


def box(half_lengths: ArrayLike) -> Mesh:
    """A box around the origin. half_lengths: [m], shape (3,)."""
    return smooth(trimesh.creation.box(extents=2.0 * np.asarray(half_lengths, float)))


def sphere(radius: float, subdivisions: int = 3) -> Mesh:
    """A sphere [m] around the origin: 20 x 4^subdivisions triangles, its vertices on the sphere."""
    return smooth(trimesh.creation.icosphere(subdivisions, radius))


def capsule(radius: float, half_length: float, facets: int = 24) -> Mesh:
    """A cylinder along z from -half_length to half_length [m] with a half sphere at each end; facets: around its axis."""
    return smooth(trimesh.creation.capsule(height=2.0 * half_length, radius=radius, count=[facets, facets]))


def figure(height: float) -> Mesh:
    """A person from the waist up, of this height [m]: closed surfaces that reach into each other."""
    vertices, faces, normals, count = [], [], [], 0
    for part in person.parts(height):
        mesh = sphere(part.size[0], 2) if part.shape == "sphere" else capsule(*part.size, facets=16)
        vertices.append(apply(part.T_figure_part, mesh.vertices))
        normals.append(mesh.normals @ part.T_figure_part[:3, :3].T)
        faces.append(mesh.faces + count)
        count += len(mesh.vertices)
    return Mesh(np.concatenate(vertices), np.concatenate(faces), np.concatenate(normals))


def shape(kind: str, size: Sequence[float]) -> Mesh:
    """The surface of an obstacle: "sphere" (radius,), "capsule" (radius, half_length), "box" (half lengths) or "figure"
    (height,) [m].

    Raises AssetError for another kind.
    """
    if kind == "sphere":
        return sphere(size[0])
    if kind == "capsule":
        return capsule(size[0], size[1])
    if kind == "box":
        return box(size)
    if kind == "figure":
        return figure(size[0])
    raise AssetError(unknown("shape", kind, ("sphere", "capsule", "box", "figure")))


def smooth(mesh: trimesh.Trimesh) -> Mesh:
    """A mesh with normals at shared vertices: the mean of the faces' normals by the angle each face has there."""
    return _with_normals(np.asarray(mesh.vertices, float), np.asarray(mesh.faces))


def shaded(mesh: Mesh, crease_deg: float = 40.0) -> Mesh:
    """A copy for display: vertices are split along edges sharper than `crease_deg`, so that edges look sharp.

    The copy has cracks when it is offset; never expand it.
    """
    tri = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    soft = tri.face_adjacency_angles <= np.radians(crease_deg)
    corner = _smooth_corners(tri, soft)
    vertices = np.empty((corner.max() + 1, 3))
    vertices[corner] = mesh.vertices[mesh.faces]
    return _with_normals(vertices, corner)


def _with_normals(vertices: Array, faces: NDArray[np.integer]) -> Mesh:
    corners = vertices[faces]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cross = np.cross(ahead, behind)
    angle = np.arctan2(np.linalg.norm(cross, axis=-1), np.einsum("ijk,ijk->ij", ahead, behind))
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30)
    normals = np.zeros_like(vertices)
    np.add.at(normals, faces, angle[..., None] * flat[:, None])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return Mesh(vertices, faces.astype(np.int32), normals)


def _smooth_corners(tri: trimesh.Trimesh, soft: NDArray[np.bool_]) -> NDArray[np.int64]:
    """New vertex indices (m, 3): corners of neighbouring faces are one vertex where their common edge is soft."""
    faces = np.asarray(tri.faces)
    edges = np.asarray(tri.face_adjacency_edges)[soft]
    sides = []
    for side in np.asarray(tri.face_adjacency)[soft].T:
        at = (faces[side][:, None] == edges[:, :, None]).argmax(axis=2)     # where each end of the edge is in the face
        sides.append((3 * side[:, None] + at).ravel())
    label = np.arange(3 * len(faces))
    while (label[sides[0]] != label[sides[1]]).any():   # the smallest index spreads over each group of corners
        least = np.minimum(label[sides[0]], label[sides[1]])
        for side in sides:
            np.minimum.at(label, side, least)
        label = label[label]
    return np.unique(label, return_inverse=True)[1].reshape(-1, 3)


def _load(path: Path) -> Mesh:
    try:
        mesh = trimesh.load_mesh(path)
    except (OSError, ValueError) as error:
        raise AssetError(f"cannot read {path}: {error}; `python assets/lwr/make_meshes.py` writes it anew") from None
    mesh.merge_vertices()
    if not (len(mesh.faces) and mesh.is_watertight):
        raise AssetError(f"{path} is no closed surface; `python assets/lwr/make_meshes.py` writes it anew")
    return smooth(mesh)
