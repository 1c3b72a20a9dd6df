"""Laws of the meshes: closed, outward, in place, offset without cracks, made by the script stored beside them."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from hrc import meshes
from hrc.errors import AssetError
from hrc.paths import assets
from hrc.scene import BodySpec

FOLDER = assets() / "lwr"
BUDGET = {"plant": 40_000, "perception": 10_000, "filter": 2_500}
BOUNDS_MM = {  # the arm's outlines in the link frames
    "base": ([-81, -81, 0], [81, 81, 102]),
    "link_1": ([-60, -60, -208.5], [60, 93.8, 60]),
    "link_2": ([-60, -93.8, -60], [60, 60, 191.5]),
    "link_3": ([-60, -93.8, -208.5], [60, 60, 60]),
    "link_4": ([-60, -60, -60], [60, 93.8, 191.5]),
    "link_5": ([-60, -60, -198.5], [60, 93.7, 60]),
    "link_6": ([-71.1, -79.5, -71.1], [71.1, 55.5, 57]),
    "link_7": ([-40, -40, 47], [40, 40, 78]),
}
EVERY = [(detail, part) for detail in meshes.DETAILS for part in meshes.PARTS]


def part_mesh(detail, part):
    return meshes.robot(detail)[meshes.PARTS.index(part)]


def as_trimesh(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def winding(points, mesh):
    """How often a closed surface goes around each point: 1 inside, 0 outside (Van Oosterom and Strackee, 1983)."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces][None] - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
    dot = [np.einsum("ijk,ijk->ij", *pair) for pair in ((a, b), (b, c), (c, a))]
    triple = np.einsum("ijk,ijk->ij", a, np.cross(b, c))
    return np.arctan2(triple, la * lb * lc + dot[0] * lc + dot[1] * la + dot[2] * lb).sum(1) / (2 * np.pi)


@pytest.mark.parametrize(("detail", "part"), EVERY)
def test_surfaces_are_closed_and_face_outward(detail, part):
    mesh = part_mesh(detail, part)
    surface = as_trimesh(mesh)
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.euler_number == 2                            # one piece without handles
    assert surface.volume > 0
    assert surface.area_faces.min() > 0
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("detail", meshes.DETAILS)
def test_triangle_budgets(detail):
    assert sum(len(mesh.faces) for mesh in meshes.robot(detail)) == pytest.approx(BUDGET[detail], rel=0.15)


@pytest.mark.parametrize(("detail", "part"), EVERY)
def test_bounds(detail, part):
    mesh = part_mesh(detail, part)
    low, high = BOUNDS_MM[part]
    assert 1e3 * mesh.vertices.min(0) == pytest.approx(low, abs=3.0)
    assert 1e3 * mesh.vertices.max(0) == pytest.approx(high, abs=3.0)


@pytest.mark.parametrize("part", meshes.PARTS)
def test_details_agree_in_volume(part):
    fine = as_trimesh(part_mesh("plant", part)).volume
    assert as_trimesh(part_mesh("perception", part)).volume == pytest.approx(fine, rel=0.02)
    assert as_trimesh(part_mesh("filter", part)).volume == pytest.approx(fine, rel=0.06)


@pytest.mark.parametrize("part", meshes.PARTS)
@pytest.mark.parametrize("detail", ["perception", "filter"])
def test_an_offset_of_3_cm_covers_the_true_surface(detail, part):
    mesh = part_mesh(detail, part)
    expanded = mesh.offset(0.03)
    assert as_trimesh(expanded).is_watertight
    true = part_mesh("plant", part)
    some = slice(None, None, 17)
    on, normal = true.vertices[some], true.normals[some]
    assert winding(on, expanded).min() > 0.5
    covered = winding(on + 0.02 * normal, expanded) > 0.5
    assert covered.mean() > 0.9
    assert winding(on + 0.045 * normal, expanded).min() < 0.5   # and not everything


@pytest.mark.parametrize("path", sorted((FOLDER / "meshes" / "collision").glob("*.stl")), ids=lambda path: path.stem)
def test_collision_pieces_are_convex_and_small(path):
    piece = trimesh.load_mesh(path)
    assert piece.is_watertight
    assert piece.volume == pytest.approx(piece.convex_hull.volume, rel=1e-4)
    assert len(piece.faces) < 600


@pytest.mark.parametrize("part", meshes.PARTS)
def test_collision_pieces_follow_the_shell(part):
    pieces = [trimesh.load_mesh(path) for path in sorted((FOLDER / "meshes" / "collision").glob(f"{part}_*.stl"))]
    shell = part_mesh("plant", part)
    depth = np.max([_depth(piece, shell.vertices) for piece in pieces], axis=0)
    assert depth.min() > -0.0025                                # the shell does not stick out
    limit = 0.0185 if part == "base" else 0.0115
    outer = np.concatenate([piece.triangles_center for piece in pieces])
    outer = outer[np.max([_depth(piece, outer) for piece in pieces], axis=0) < 1e-6]
    gap = KDTree(as_trimesh(shell).triangles_center).query(outer)[0]
    free = winding(outer, shell) < 0.5
    assert gap[free].max(initial=0.0) < limit + 0.004           # half a triangle of the shell


def _depth(convex, points):
    offset = np.einsum("ij,ij->i", convex.face_normals, convex.triangles[:, 0])
    return -(points @ convex.face_normals.T - offset).max(axis=1)


def test_the_script_makes_the_stored_files(tmp_path):
    subprocess.run([sys.executable, str(FOLDER / "make_meshes.py"), str(tmp_path)], check=True, capture_output=True)
    stored = sorted(path.relative_to(FOLDER / "meshes") for path in (FOLDER / "meshes").rglob("*.stl"))
    made = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*.stl"))
    assert stored == made
    for path in stored:
        was, now = trimesh.load_mesh(FOLDER / "meshes" / path), trimesh.load_mesh(tmp_path / path)
        assert now.volume == pytest.approx(was.volume, rel=1e-4), path
        assert now.bounds == pytest.approx(was.bounds, abs=1e-6), path
        assert len(now.faces) == len(was.faces), path
        assert (FOLDER / "meshes" / path).stat().st_size < 1_000_000


@given(st.lists(st.floats(0.01, 1.0), min_size=3, max_size=3))
@settings(max_examples=20, deadline=None)
def test_a_box_has_its_size(half):
    mesh = meshes.box(half)
    assert mesh.vertices.max(0) == pytest.approx(half)
    assert mesh.vertices.min(0) == pytest.approx(np.negative(half))
    assert np.abs(mesh.normals) == pytest.approx(1 / np.sqrt(3))    # a corner looks evenly along its three faces
    assert as_trimesh(mesh).volume == pytest.approx(8 * np.prod(half))


@pytest.mark.parametrize("subdivisions", [1, 2, 3])
def test_a_sphere_is_round(subdivisions):
    mesh = meshes.sphere(0.08, subdivisions)
    assert len(mesh.faces) == 20 * 4**subdivisions
    assert np.linalg.norm(mesh.vertices, axis=1) == pytest.approx(0.08)
    assert mesh.normals == pytest.approx(mesh.vertices / 0.08, abs=0.05)


def test_shading_splits_hard_edges_only():
    cube = meshes.shaded(meshes.box([1, 1, 1]))
    assert len(cube.vertices) == 24
    assert np.sort(np.abs(cube.normals), axis=1) == pytest.approx(np.tile([0.0, 0.0, 1.0], (24, 1)))
    ball = meshes.sphere(1.0)
    assert len(meshes.shaded(ball).vertices) == len(ball.vertices)
    link = part_mesh("plant", "link_3")
    shown = meshes.shaded(link)
    assert len(link.vertices) < len(shown.vertices) < 1.2 * len(link.vertices)
    assert shown.vertices[shown.faces] == pytest.approx(link.vertices[link.faces])


def test_colours_and_parts_correspond():
    assert len(meshes.COLOURS) == len(meshes.PARTS) == len(meshes.robot("filter")) == 8
    assert all(0 <= channel <= 1 for colour in meshes.COLOURS for channel in colour)


def test_arrays_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        meshes.robot("filter")[0].vertices[0] = 0.0


def test_an_unknown_detail_is_named():
    with pytest.raises(AssetError, match="perception"):
        meshes.robot("perceptive")


def test_a_capsule_is_closed_and_as_large_as_it_says():
    mesh = meshes.capsule(0.04, 0.085)
    surface = as_trimesh(mesh)
    assert surface.is_watertight
    assert surface.volume == pytest.approx(np.pi * 0.04**2 * (0.17 + 4 / 3 * 0.04), rel=0.03)
    np.testing.assert_allclose(surface.bounds, [[-0.04, -0.04, -0.125], [0.04, 0.04, 0.125]], atol=1e-9)
    with pytest.raises(AssetError, match="capsule"):
        meshes.shape("cone", (0.1,))


def test_a_figure_is_closed_and_as_tall_as_it_says():
    mesh = meshes.figure(0.8)
    assert as_trimesh(mesh).is_watertight
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(0.8, abs=0.002)
    assert mesh.vertices[:, 2].max() == pytest.approx(0.4, abs=0.002)
    body = BodySpec("figure", "figure", (0.8,))
    assert np.linalg.norm(mesh.vertices, axis=1).max() <= body.reach
    for direction in np.random.default_rng(0).normal(size=(20, 3)):
        direction /= np.linalg.norm(direction)
        assert (mesh.vertices @ direction).max() == pytest.approx(body.extent(direction), abs=0.005)
