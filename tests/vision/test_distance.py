import numpy as np
import pytest
from eye_scenes import DeviceStages, random_images, representable, small_camera

from hrc.vision import reference

INFINITE = 1e6


@pytest.mark.parametrize("thickness", [0.12, 0.0, INFINITE])
@pytest.mark.parametrize("cover", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("seed", range(4))
def test_the_map_is_that_of_brute_force(seed, cover, thickness):
    """Obstacles up to the image's border, any density: every pixel's distance, to a micrometre."""
    rng = np.random.default_rng(seed)
    camera = small_camera()
    robot, link, foreground = random_images(camera, rng, cover)
    robot, link = representable(camera, robot, link)
    fast = DeviceStages(camera).distance_map(robot, link, foreground, 0.1, thickness)
    brute = reference.distance_map(camera, robot, foreground, 0.1, thickness)
    assert np.isfinite(brute).any()
    # With what is out of reach at the reach, a pixel that only one of the two finds counts as well.
    assert np.abs(np.minimum(fast, 0.1) - np.minimum(brute, 0.1)).max() < 1e-6


def test_more_candidate_tiles_than_a_list_holds_change_nothing():
    """A camera close to the robot, and a reach as wide as the image."""
    camera = small_camera(400, 120)
    robot = np.full(camera.shape, np.inf)
    robot[50:60, 190:210] = 0.5
    link = np.where(np.isfinite(robot), 4, 255).astype(np.uint8)
    robot, link = representable(camera, robot, link)
    rng = np.random.default_rng(0)
    foreground = np.where(rng.random(camera.shape) < 0.5, rng.uniform(2.0, 2.5, camera.shape), np.inf)
    foreground = foreground.astype(np.float32)
    fast = DeviceStages(camera).distance_map(robot, link, foreground, 4.0, 0.12)
    brute = reference.distance_map(camera, robot, foreground, 4.0, 0.12)
    np.testing.assert_allclose(fast[50:60, 190:210], brute[50:60, 190:210], atol=1e-6)


@pytest.mark.parametrize("empty", ["robot", "obstacle", "zeros"])
def test_without_a_robot_or_an_obstacle_nothing_is_found(empty):
    camera = small_camera()
    robot, link, foreground = random_images(camera, np.random.default_rng(1), 0.1)
    if empty == "robot":
        robot[:], link[:] = np.inf, 255
    else:
        foreground[:] = 0.0 if empty == "zeros" else np.inf
    stages = DeviceStages(camera)
    assert not np.isfinite(stages.distance_map(robot, link, foreground, 0.1, 0.12)).any()
    assert stages.contact_point(robot, link, foreground, 0.1, 0.12) is None


def test_an_obstacle_behind_another_surface_of_the_robot_is_measured_in_depth():
    """One obstacle pixel straight behind one robot pixel: the distance is the gap along the ray."""
    camera = small_camera()
    robot, foreground = np.full(camera.shape, np.inf), np.full(camera.shape, np.inf, np.float32)
    robot[30, 40], foreground[30, 40] = 1.0, 1.05
    link = np.where(np.isfinite(robot), 5, 255).astype(np.uint8)
    ray = np.linalg.norm(camera.unproject(40, 30, 1.0))
    found = DeviceStages(camera).distance_map(robot, link, foreground, 0.1, 0.12)
    assert found[30, 40] == pytest.approx(0.05 * ray, abs=1e-5)


@pytest.mark.parametrize(("gap", "thickness", "expected"), [(0.05, 0.12, 0.0), (0.17, 0.12, 0.05), (0.5, INFINITE, 0.0)])
def test_an_obstacle_in_front_reaches_back_by_its_thickness(gap, thickness, expected):
    camera = small_camera()
    robot, foreground = np.full(camera.shape, np.inf), np.full(camera.shape, np.inf, np.float32)
    robot[35, 43], foreground[35, 43] = 1.5, 1.5 - gap
    link = np.where(np.isfinite(robot), 5, 255).astype(np.uint8)
    found = DeviceStages(camera).distance_map(robot, link, foreground, 0.1, thickness)
    ray = np.linalg.norm(camera.unproject(43, 35, 1.0))
    assert found[35, 43] == pytest.approx(expected * ray, abs=1e-5)


@pytest.mark.parametrize("stage", ["numpy", "warp"])
def test_the_first_of_equal_pixels_is_the_nearest(stage):
    """Under the paper's rule every covered robot pixel has distance 0."""
    camera = small_camera()
    robot, foreground = np.full(camera.shape, np.inf), np.full(camera.shape, np.inf, np.float32)
    robot[20:50, 33:70], foreground[28:40, 45:60] = 1.5, 0.8
    link = np.where(np.isfinite(robot), 5, 255).astype(np.uint8)
    robot, link = representable(camera, robot, link)
    if stage == "warp":
        found = DeviceStages(camera).contact_point(robot, link, foreground, 0.1, INFINITE, centred=False)
    else:
        found = reference.contact_point(
            camera, robot, link, reference.distance_map(camera, robot, foreground, 0.1, INFINITE), centred=False)
    assert found is not None
    u, v, on, depth, distance = found[:5]
    assert on == 5
    assert depth == robot[30, 40]
    if stage == "numpy":  # exact arithmetic: the very first pixel
        assert (u, v) == (45, 28)
    assert distance == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("stage", ["numpy", "warp"])
def test_the_point_of_a_patch_is_its_centre(stage):
    camera = small_camera()
    robot, foreground = np.full(camera.shape, np.inf), np.full(camera.shape, np.inf, np.float32)
    robot[20:50, 33:70], foreground[30:35, 50:55] = 0.8, 0.75
    link = np.where(np.isfinite(robot), 5, 255).astype(np.uint8)
    robot, link = representable(camera, robot, link)
    if stage == "warp":
        found = DeviceStages(camera).contact_point(robot, link, foreground, 0.1, 0.12, patch=0.2)
    else:
        found = reference.contact_point(
            camera, robot, link, reference.distance_map(camera, robot, foreground, 0.1, 0.12), patch=0.2)
    assert found is not None
    assert found[:3] == (52, 32, 5)


@pytest.mark.parametrize("seed", range(6))
def test_the_point_is_that_of_the_reference(seed):
    rng = np.random.default_rng(seed)
    camera = small_camera()
    robot, link, foreground = random_images(camera, rng, 0.03)
    robot, link = representable(camera, robot, link)
    found = DeviceStages(camera).contact_point(robot, link, foreground, 0.1, 0.02)
    distances = reference.distance_map(camera, robot, foreground, 0.1, 0.02)
    expected = reference.contact_point(camera, robot, link, distances)
    assert found is not None
    assert expected is not None
    assert found[2] == expected[2]
    assert found[4] == pytest.approx(expected[4], abs=1e-6)
    apart = camera.unproject(*found[:2], found[3]) - camera.unproject(*expected[:2], expected[3])
    assert np.linalg.norm(apart) < 0.04  # two pixels


def test_the_same_images_give_the_same_bits():
    camera = small_camera()
    robot, link, foreground = random_images(camera, np.random.default_rng(5), 0.05)
    runs = [DeviceStages(camera).contact_point(robot, link, foreground, 0.1, 0.12) for _ in range(3)]
    assert runs[0] == runs[1] == runs[2]
