"""Builds the meshes of the arm from the numbers in profiles.json: `python assets/lwr/make_meshes.py [folder]`.

Eight parts in three levels of detail, in the link frames of lwr.xml (the base in the world frame), and convex pieces of
every part for contact. Deterministic: the same numbers give the same bytes. Prints sizes and deviations.
"""

import json
import struct
import sys
from itertools import pairwise
from pathlib import Path

import manifold3d
import numpy as np
import trimesh
from lofting import Array, outward, resampled, revolve, rounded_corners, stack
from scipy.spatial import KDTree
from shells import Resolution, shells, surface

HERE = Path(__file__).resolve().parent
PARTS = ("base", *(f"link_{i}" for i in range(1, 8)))
DETAILS = {
    "plant": Resolution(around=64, along=38, rim=3, tolerance=0.05, longest=7.0),
    "perception": Resolution(around=32, along=19, rim=1, tolerance=0.5, longest=14.0),
    "filter": Resolution(around=16, along=9, rim=0, tolerance=1.5, longest=45.0),
}
CUTS = {  # where the convex pieces of a part begin and end, [m] along z of its link frame
    "base": (0.0, 0.012, 0.06, 0.102),
    "link_1": (-0.2085, -0.10, -0.06, 0.06),
    "link_2": (-0.06, 0.06, 0.10, 0.1915),
    "link_3": (-0.2085, -0.10, -0.06, 0.06),
    "link_4": (-0.06, 0.06, 0.10, 0.1915),
    "link_5": (-0.1985, -0.10, -0.065, 0.06),
    "link_6": (-0.072, 0.058),
    "link_7": (0.047, 0.078),
}
SPIGOT = 17.0
"""How far [mm] the stubs of links 2 and 4 reach out of their hubs, into the hubs of the links before them."""
WRIST_TOP = 57.0
"""Height [mm] above the wrist centre at which link 6 is cut flat."""
FLANGE = 78.0
"""Height [mm] of the flange's face above the wrist centre."""


def parts(detail: Resolution) -> dict[str, trimesh.Trimesh]:
    """The eight closed surfaces [mm] in their link frames."""
    profiles = json.loads((HERE / "profiles.json").read_text())
    a, b = shells(profiles)
    with_collar = surface(a, detail, collar=True, spigot=0.0)
    with_spigot = surface(a, detail, collar=False, spigot=SPIGOT)
    forearm = surface(b, detail, collar=True, spigot=0.0)
    built = {
        "base": base(profiles, detail),
        "link_1": placed(with_collar, -1, 1, -a.hub_z),
        "link_2": placed(with_spigot, 1, -1, a.hub_z),
        "link_3": placed(with_collar, 1, 1, -a.hub_z),
        "link_4": placed(with_spigot, -1, -1, a.hub_z),
        "link_5": placed(forearm, -1, 1, -b.hub_z),
        "link_6": wrist(profiles, detail),
        "link_7": flange(profiles, detail),
    }
    assert tuple(built) == PARTS
    return built


def placed(mesh: trimesh.Trimesh, y: int, z: int, lift: float) -> trimesh.Trimesh:
    """A mirror image: y times `y`, z times `z` plus `lift` (the shells are symmetric in x, so nothing is lost)."""
    return outward(trimesh.Trimesh(mesh.vertices * [1, y, z] + [0, 0, lift], mesh.faces, process=False))


def profile(points: list[list[float]], detail: Resolution, radius: float) -> Array:
    """A profile of revolution with rounded corners at the resolution asked for; its ends lie on the axis."""
    return resampled(rounded_corners(points, radius, detail.rim), detail.tolerance, detail.longest)


def base(profiles: dict[str, list[list[float]]], detail: Resolution) -> trimesh.Trimesh:
    """The foot and its connector box, which points to +x."""
    foot = revolve(profile(profiles["base_profile_r_z"], detail, 2.0), detail.around + detail.around // 4)
    return united(foot, connector_box(detail))


def connector_box(detail: Resolution) -> trimesh.Trimesh:
    """A box with rounded vertical edges, x 31..81, |y| <= 59, z 14..60."""
    half, edge, rim = np.array([25.0, 59.0]), 8.0, 3.0

    def level(inset: float, z: float) -> Array:
        inner, r = half - edge, max(edge - inset, 1.0)
        steps = 2 * detail.rim + 1
        sides = []
        for k, corner in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            angle = k * np.pi / 2 + np.linspace(0, np.pi / 2, steps + 1)
            sides.append(inner * corner + r * np.column_stack([np.cos(angle), np.sin(angle)]))
        xy = np.concatenate(sides) + np.array([56.0, 0.0])
        return np.column_stack([xy, np.full(len(xy), z)])

    middle = max(1, int(np.ceil(40.0 / (2 * detail.longest))))
    levels = [(rim, 14.0), (0.0, 14.0 + rim), *((0.0, 17.0 + 40.0 * i / middle) for i in range(1, middle + 1)),
              (rim, 60.0)]
    return stack([np.array([[56.0, 0, 14.0]]), *(level(*at) for at in levels), np.array([[56.0, 0, 60.0]])])


def wrist(profiles: dict[str, list[list[float]]], detail: Resolution) -> trimesh.Trimesh:
    """Link 6: a ball-like body of revolution about y, cut flat on top."""
    ball = revolve(profile(profiles["link6_profile_r_y"], detail, 1.5), detail.around + detail.around // 4)
    ball = outward(trimesh.Trimesh(ball.vertices[:, [0, 2, 1]] * [1, -1, 1], ball.faces, process=False))
    return outward(from_manifold(manifold(ball).trim_by_plane((0.0, 0.0, -1.0), -WRIST_TOP)))


def flange(profiles: dict[str, list[list[float]]], detail: Resolution) -> trimesh.Trimesh:
    """Link 7: the disc that carries the tool, with its centring bore."""
    points = profiles["link7_profile_r_z"][:-1]
    bore = [[15.75, 0.0], [15.75, -6.0], [0.0, -6.0]] if detail.rim else [[0.0, 0.0]]
    return placed(revolve(profile([*points, *bore], detail, 1.0), detail.around // 4 * 3), 1, 1, FLANGE)


def united(a: trimesh.Trimesh, b: trimesh.Trimesh) -> trimesh.Trimesh:
    """The union of two closed surfaces."""
    return from_manifold(manifold(a) + manifold(b))


def manifold(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    """The solid within a closed surface."""
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
    return manifold3d.Manifold(manifold3d.Mesh(vertices, faces))


def from_manifold(solid: manifold3d.Manifold, tolerance: float = 0.05) -> trimesh.Trimesh:
    """The surface of a solid, its slivers collapsed within `tolerance` [mm]."""
    mesh = solid.simplify(tolerance).to_mesh()
    return trimesh.Trimesh(mesh.vert_properties[:, :3].astype(float), mesh.tri_verts, process=False)


def convex_pieces(mesh: trimesh.Trimesh, cuts: tuple[float, ...]) -> list[trimesh.Trimesh]:
    """The convex hulls of the slices of a surface [m] between successive heights."""
    solid, hulls = manifold(mesh), []
    for low, high in pairwise(cuts):
        part = solid.trim_by_plane((0.0, 0.0, 1.0), low - 1e-6).trim_by_plane((0.0, 0.0, -1.0), -high - 1e-6)
        hulls.append(from_manifold(part.hull().simplify(0.002).hull(), 1e-5))
    return hulls


def in_metres(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """From mm, on a grid of a micrometre, which survives the single precision of the file."""
    return trimesh.Trimesh(np.round(mesh.vertices, 3) / 1000.0, mesh.faces, process=False)


def write(mesh: trimesh.Trimesh, path: Path) -> None:
    """A binary STL file [m]: 80 bytes of header, the count, then normal, corners and two spare bytes a triangle."""
    records = np.zeros(len(mesh.faces), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")]))
    records["corners"] = mesh.vertices[mesh.faces]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(records)) + records.tobytes())


def make(folder: Path) -> None:
    """Writes all files below `folder` and prints what they are."""
    for detail, resolution in DETAILS.items():
        built = {name: in_metres(mesh) for name, mesh in parts(resolution).items()}
        for name, mesh in built.items():
            write(mesh, folder / detail / f"{name}.stl")
        print(f"{detail}: {sum(len(m.faces) for m in built.values())} triangles =",
              " + ".join(f"{name} {len(m.faces)}" for name, m in built.items()))
    fine = {name: in_metres(mesh) for name, mesh in parts(DETAILS["plant"]).items()}
    for name, mesh in fine.items():
        pieces = convex_pieces(mesh, CUTS[name])
        for k, piece in enumerate(pieces):
            write(piece, folder / "collision" / f"{name}_{k + 1}.stl")
        out, off = gaps(pieces, mesh)
        print(f"{name}: {len(pieces)} convex pieces, triangles {[len(p.faces) for p in pieces]}; they reach out of the "
              f"shell by {1e3 * out.max():.1f} mm at most, the shell out of them by {1e3 * off.max():.1f} mm")


def gaps(pieces: list[trimesh.Trimesh], shell: trimesh.Trimesh) -> tuple[Array, Array]:
    """How far [m] the union of the pieces reaches out of the shell (where it does), and the shell out of the pieces."""
    excess = manifold3d.Manifold.batch_boolean([manifold(piece) for piece in pieces], manifold3d.OpType.Add)
    points = (excess - manifold(shell)).refine_to_length(0.003).to_mesh().vert_properties[:, :3]
    nearest = KDTree(trimesh.sample.sample_surface(shell, 200_000, seed=0)[0])
    out = nearest.query(points)[0] if len(points) else np.zeros(1)
    off = -np.max([clearance(piece, shell.vertices) for piece in pieces], axis=0)
    return out, np.maximum(off, 0.0)


def clearance(convex: trimesh.Trimesh, points: Array) -> Array:
    """How deep [m] points (n, 3) lie within a convex piece; negative outside, by no more than their distance."""
    return -(points @ convex.face_normals.T - np.einsum("ij,ij->i", convex.face_normals, convex.triangles[:, 0])).max(1)


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "meshes")
