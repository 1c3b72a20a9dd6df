"""How deep an obstacle is taken to be: what holds for balls and cylinders, and that the kernel does what the reference says."""

import numpy as np
import pytest
from eye_scenes import small_camera

from hrc.geometry import rotation_about, transform
from hrc.meshes import box, capsule, sphere
from hrc.vision import kernels, reference
from hrc.vision.camera import Camera, CameraConfig

CAMERA = Camera(CameraConfig(width=120, height=100, fx=365.0, fy=365.0, cx=60.0, cy=50.0))


def measured(camera, foreground, thickness):
    """By the kernel, 0 where there is no obstacle."""
    grid, nothing = kernels.grid(camera), np.full(camera.shape, np.inf)
    keys = kernels.upload(kernels.pack(nothing, np.zeros(camera.shape, np.uint8), grid), "uint32", "cpu")
    passed = kernels.Filter(grid, keys, "cpu")
    passed.mask(nothing)
    passed.load(foreground)
    chords = kernels.Chords(passed)
    chords.thickness = thickness
    kernels.Graph([passed.launch, chords.launch], "cpu").replay()
    back = kernels.to_image(kernels.read(chords.back), grid)
    seen = np.isfinite(foreground)
    return np.where(seen, back - np.where(seen, foreground, 0), 0)


def blobs(camera, rng):
    """Slanted patches at various depths that overlap, touch the border and have holes."""
    v, u = np.mgrid[: camera.shape[0], : camera.shape[1]]
    depth = np.full(camera.shape, np.inf)
    for _ in range(rng.integers(1, 8)):
        cu, cv = rng.uniform(0, camera.shape[1]), rng.uniform(0, camera.shape[0])
        inside = np.hypot(u - cu, v - cv) < rng.uniform(1, 45)
        depth = np.where(inside, np.minimum(depth, rng.uniform(0.6, 1.8) + rng.uniform(-0.03, 0.03) * (u - cu)), depth)
    depth[(rng.random(camera.shape) < rng.choice([0.0, 0.02])) | (depth < 0.3)] = np.inf
    return depth.astype(np.float32)


@pytest.mark.parametrize("seed", range(12))
def test_the_kernel_measures_what_the_reference_says(seed):
    rng = np.random.default_rng(seed)
    camera = small_camera(150, 110) if seed % 2 else small_camera()
    foreground, thickness = blobs(camera, rng), float(rng.choice([0.0, 0.12, 0.5]))
    found = measured(camera, foreground, thickness)
    assert np.isfinite(foreground).any()
    np.testing.assert_allclose(found, reference.depths(camera, foreground, thickness), atol=1e-6)


@pytest.mark.parametrize("where", [(0.011, 0.023), (0.08, -0.05)])
def test_a_ball_is_as_deep_as_it_is(where):
    centre, radius = np.array([*where, 1.5]), 0.06
    foreground, _ = reference.render(CAMERA, [sphere(radius, 4)], np.array([transform(np.eye(3), centre)]))
    rays = CAMERA.rays()
    along, square = rays @ centre, (rays**2).sum(axis=-1)
    under = along**2 - square * (centre @ centre - radius**2)
    true = 2.0 * np.sqrt(np.maximum(under, 0.0)) / square
    inner = np.isfinite(foreground) & (true > 0.5 * 2 * radius)
    assert inner.sum() > 400
    assert np.abs(reference.depths(CAMERA, foreground, 1.0) - true)[inner].max() < 0.013  # three pixels


@pytest.mark.parametrize("turn_deg", [0, 20, 45, 67, 90, 135])
def test_a_forearm_is_as_deep_as_it_is_thick_whichever_way_it_lies(turn_deg):
    radius, forearm = 0.04, capsule(0.04, 0.15)
    R = rotation_about((0.0, 0.0, 1.0), np.radians(turn_deg)) @ rotation_about((1.0, 0.0, 0.0), np.pi / 2)
    foreground, _ = reference.render(CAMERA, [forearm], np.array([transform(R, [0.0, 0.0, 1.5])]))
    found = reference.depths(CAMERA, foreground, 1.0)[50, 60]
    assert 2 * radius - 0.009 < found < 2 * radius * 1.09 + 0.009  # the directions are 45 degrees apart


@pytest.mark.parametrize("turn_deg", [0, 30])
def test_a_box_that_faces_the_camera_is_as_deep_as_it_is_wide_up_to_its_edges(turn_deg):
    pose = transform(rotation_about((0.0, 0.0, 1.0), np.radians(turn_deg)), [0.003, 0.002, 1.5])
    foreground, _ = reference.render(CAMERA, [box((0.04, 0.09, 0.04))], np.array([pose]))
    found = reference.depths(CAMERA, foreground, 1.0)
    v, u = np.nonzero(np.isfinite(foreground))
    local = (CAMERA.unproject(u, v, foreground[v, u]) - pose[:3, 3]) @ pose[:3, :3]
    middle = np.abs(local[:, 1]) < 0.03  # away from its short sides, where the diagonals are short
    assert middle.sum() > 200
    assert found[v, u][middle] == pytest.approx(0.08, abs=0.016)  # four pixels


def test_nothing_far_away_changes_how_deep_a_pixel_is():
    rng, camera = np.random.default_rng(0), small_camera(150, 110)
    foreground = blobs(camera, rng)
    v, u = np.argwhere(np.isfinite(foreground))[np.isfinite(foreground).sum() // 2]
    rows, columns = np.mgrid[: camera.shape[0], : camera.shape[1]]
    far = np.maximum(np.abs(rows - v), np.abs(columns - u)) > 32
    other = np.where(far, np.float32(np.inf), foreground)
    assert (other != foreground).any()
    assert measured(camera, other, 0.5)[v, u] == measured(camera, foreground, 0.5)[v, u]


def test_a_sliver_is_no_obstacle_and_a_finger_is():
    depth = np.full((40, 40), np.inf, np.float32)
    depth[5:35, 10] = 1.0
    depth[5:35, 20:22] = 1.0
    left = np.isfinite(reference.supported(depth, 4))
    assert not left[:, 10].any()
    assert left[6:34, 20:22].all()
