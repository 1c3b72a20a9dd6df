import numpy as np
import pytest
from eye_robot import PERFECT, POSTURE, contacts, depth_camera, poses, sphere_at

from hrc.errors import DeviceError, SensorError
from hrc.geometry import apply
from hrc.messages import DepthFrame
from hrc.scene import load_scene
from hrc.sim.depth_camera import SensorConfig
from hrc.vision.camera import Camera
from hrc.vision.localize import Localizer, VisionConfig


@pytest.fixture(scope="module")
def eye():
    return Localizer(Camera(), load_scene().environment)


def look(eye, camera, T, *spheres, config=None):
    eye.configure(config or VisionConfig())
    camera.reset()
    camera.expose(7, T, spheres)
    frame = camera.latest(7)
    eye.filter(frame, T)
    return frame


@pytest.mark.parametrize("sensor", [PERFECT, SensorConfig()], ids=["perfect", "kinect"])
def test_the_robot_and_the_room_are_removed_and_the_obstacle_stays(eye, sensor):
    camera = depth_camera(sensor)
    rng = np.random.default_rng(0)
    for _ in range(4):
        T = poses(POSTURE + rng.uniform(-0.5, 0.5, 7))
        look(eye, camera, T)
        robot = np.isfinite(eye.robot_image.depth)
        left = np.isfinite(eye.foreground.depth)
        assert robot.sum() > 2000
        assert (left & robot).sum() < 0.01 * robot.sum()
        assert left.sum() < 20
        centre = T[4][:3, 3] + [0.15, 0.35, 0.2]  # away from the arm
        look(eye, camera, T, sphere_at(centre))
        p_camera = apply(Camera().T_camera_world, centre)
        u, v, z = Camera().project(p_camera)
        disc = np.pi * (0.05 * 365.456 / z) ** 2
        ball = np.isfinite(eye.foreground.depth[int(v) - 20 : int(v) + 21, int(u) - 20 : int(u) + 21]).sum()
        assert ball > 0.75 * disc


def test_without_an_obstacle_nothing_is_near(eye):
    T = poses()
    look(eye, depth_camera(), T)
    assert eye.localize(9, T) == ()


@pytest.mark.parametrize("sensor", [PERFECT, SensorConfig()], ids=["perfect", "kinect"])
@pytest.mark.parametrize("angles", [(5, 30), (60, 75)], ids=["front", "side"])
def test_a_sphere_that_touches_a_link_is_found_there(eye, angles, sensor):
    camera, errors, right = depth_camera(sensor), [], 0
    for link in (3, 4, 5, 6):
        for T, point, centre in contacts(link, angles, 4, np.random.default_rng(link)):
            look(eye, camera, T, sphere_at(centre))
            nearest = next(iter(eye.localize(9, T)), None)
            assert nearest is not None
            assert (nearest.tick, nearest.stamp) == (9, 7)
            errors.append(np.linalg.norm(nearest.p_world - point))
            right += nearest.link == link
    assert np.median(errors) < 0.025
    assert right >= 13  # of 16: at a joint, two links are as near as each other


def test_the_point_lies_on_the_true_surface_under_its_pixel(eye):
    camera, rng = depth_camera(), np.random.default_rng(4)
    T, _, centre = contacts(4, (30, 60), 1, rng)[0]
    look(eye, camera, T, sphere_at(centre))
    nearest = next(iter(eye.localize(9, T)), None)
    u, v = nearest.pixel
    assert eye.robot_image.link[v, u] == nearest.link
    p_camera = eye.camera.unproject(u, v, eye.robot_image.depth[v, u])
    np.testing.assert_allclose(apply(Camera().T_world_camera, p_camera), nearest.p_world, atol=1e-9)


def test_an_obstacle_far_in_front_is_near_only_by_the_papers_rule(eye):
    """Half a metre before the arm, on the same line of sight."""
    T = poses()
    p, eye_at = T[4][:3, 3], Camera().T_world_camera[:3, 3]
    far_in_front = p + 0.5 * (eye_at - p) / np.linalg.norm(eye_at - p)
    camera = depth_camera()
    look(eye, camera, T, sphere_at(far_in_front))
    assert eye.localize(9, T) == ()
    look(eye, camera, T, sphere_at(far_in_front), config=VisionConfig(mode="paper"))
    nearest = next(iter(eye.localize(9, T)), None)
    assert nearest is not None
    assert nearest.distance < 1e-6


def test_the_papers_point_is_on_the_expanded_surface(eye):
    camera, rng = depth_camera(), np.random.default_rng(4)
    T, _, centre = contacts(4, (0, 30), 1, rng)[0]
    look(eye, camera, T, sphere_at(centre), config=VisionConfig(mode="paper"))
    u, v = eye.localize(9, T)[0].pixel
    p_world = eye.localize(9, T)[0].p_world
    depth = apply(Camera().T_camera_world, p_world)[2]
    assert depth < eye.robot_image.depth[v, u] - 0.01


def test_the_robot_is_removed_as_it_stood_at_the_stamp_and_measured_as_it_stands_now(eye):
    camera = depth_camera()
    T_then, T_now = poses(), poses(POSTURE + np.array([0.15, 0, 0, 0, 0, 0, 0]))
    look(eye, camera, T_then)
    assert eye.localize(9, T_now) == ()
    # The paper's reading has one q for both, so the old image trails the arm.
    look(eye, camera, T_then, config=VisionConfig(mode="paper"))
    assert eye.localize(9, T_now)


def test_only_candidate_links_count(eye):
    rng = np.random.default_rng(1)
    T, _, centre = contacts(1, (5, 60), 1, rng)[0]
    camera = depth_camera()
    look(eye, camera, T, sphere_at(centre), config=VisionConfig(first_link=0))
    assert eye.localize(9, T)[0].link <= 2
    look(eye, camera, T, sphere_at(centre))
    nearest = next(iter(eye.localize(9, T)), None)
    assert nearest is None or nearest.link >= 3


def test_images_are_copies(eye):
    camera, T = depth_camera(), poses()
    look(eye, camera, T, sphere_at(T[5][:3, 3] + [0, 0.2, 0]))
    first, robot = eye.foreground, eye.robot_image
    kept, kept_robot = first.depth.copy(), robot.depth.copy()
    look(eye, camera, poses(POSTURE + 0.3))
    eye.localize(9, poses(POSTURE + 0.3))
    np.testing.assert_array_equal(first.depth, kept)
    np.testing.assert_array_equal(robot.depth, kept_robot)
    assert first.tick == 7


def test_bad_frames_and_devices_are_refused(eye):
    depth = np.ones(Camera().shape, np.float32)
    depth[3, 5] = np.nan
    with pytest.raises(SensorError, match="NaN"):
        DepthFrame(0, depth)
    with pytest.raises(SensorError, match="424, 512"):
        eye.filter(DepthFrame(0, np.ones((240, 320), np.float32)), poses())
    with pytest.raises(DeviceError, match="cpu"):
        Localizer(Camera(), (), device="cuda:9")


def test_before_the_first_frame_and_after_a_reset_there_is_nothing():
    eye = Localizer(Camera(), ())
    assert eye.foreground is None
    assert eye.robot_image is None
    assert eye.localize(0, poses()) == ()
    look(eye, depth_camera(), poses())
    assert eye.foreground is not None
    eye.reset()
    assert eye.foreground is None
    assert eye.robot_image is None
    assert eye.localize(0, poses()) == ()
