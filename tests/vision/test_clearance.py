import numpy as np
import pytest
from eye_robot import PERFECT, POSTURE, contacts, depth_camera, poses, sphere_at
from eye_scenes import random_images, representable, small_camera, tied_images

from hrc.geometry import apply
from hrc.scene import load_scene
from hrc.sim.depth_camera import SensorConfig
from hrc.vision import kernels, reference
from hrc.vision.camera import Camera
from hrc.vision.localize import Localizer, VisionConfig


def in_numpy(camera, robot, link, foreground, monitor, thickness):
    return reference.clearances(camera, robot, link, np.where(foreground > 0, foreground, np.inf), monitor, thickness)


def in_warp(camera, robot, link, foreground, monitor, thickness, device="cpu"):
    grid, nothing = kernels.grid(camera), np.full(camera.shape, np.inf)
    keys, cover = (kernels.upload(kernels.pack(image, link, grid), "uint32", device) for image in (robot, nothing))
    passed = kernels.Filter(grid, cover, device)
    passed.mask(nothing)
    passed.load(foreground)
    passed.launch()
    stage = kernels.Clearances(grid, keys, passed, device)
    stage.monitor, stage.thickness = monitor, thickness
    kernels.Graph([stage.launch], device).replay()
    return {w.link: reference.Witnesses(apart(camera, w), w.robot, w.obstacle) for w in stage.result()}


def apart(camera, witnesses):
    return float(np.linalg.norm(np.subtract(camera.unproject(*witnesses.robot), camera.unproject(*witnesses.obstacle))))


both = pytest.mark.parametrize("clearances", [in_numpy, in_warp], ids=["numpy", "warp"])


@pytest.mark.parametrize("thickness", [0.12, 0.0])
@pytest.mark.parametrize("monitor", [0.5, 0.15])
@pytest.mark.parametrize("cover", [0.001, 0.01, 0.1, 0.4])
@pytest.mark.parametrize("seed", range(3))
def test_every_link_has_the_distance_and_the_pixels_of_brute_force(seed, cover, monitor, thickness):
    rng = np.random.default_rng(seed)
    camera = small_camera()
    robot, link, foreground = random_images(camera, rng, cover)
    robot, link = representable(camera, robot, link)
    brute = in_numpy(camera, robot, link, foreground, monitor, thickness)
    fast = in_warp(camera, robot, link, foreground, monitor, thickness)
    assert brute or cover < 0.01
    assert fast.keys() == brute.keys()
    for on, found in fast.items():
        assert found.distance == pytest.approx(brute[on].distance, abs=1e-6)
        (u, v, z), (ou, ov, _) = found.robot, found.obstacle
        assert (link[v, u], robot[v, u]) == (on, z)
        assert np.isfinite(foreground[ov, ou])


@pytest.mark.parametrize("seed", range(3))
def test_bodies_at_the_border_of_the_image_are_measured_too(seed):
    rng = np.random.default_rng(seed)
    camera = small_camera(seed * 3 + 101, 77)
    robot, link, foreground = random_images(camera, rng, 0.0)
    robot, link = representable(camera, robot, link)
    foreground[:3, -7:], foreground[-1, :20], foreground[30:50, 0] = 1.1, 0.7, 1.4
    brute, fast = (f(camera, robot, link, foreground, 0.8, 0.12) for f in (in_numpy, in_warp))
    assert fast.keys() == brute.keys()
    for on in brute:
        assert fast[on].distance == pytest.approx(brute[on].distance, abs=1e-6)
        assert fast[on].obstacle[:2] == brute[on].obstacle[:2]


@both
def test_of_equal_pairs_the_first_in_the_image_counts(clearances):
    camera, robot, link, foreground = tied_images(4)
    foreground[np.nonzero(link == 7)[0], np.nonzero(link == 7)[1] - 4] = 1.0  # as far on the other side
    found = clearances(camera, robot, link, foreground, 0.5, 0.0)
    assert found.keys() == {3, 4, 7}
    for on in found:
        v, u = (int(x[0]) for x in np.nonzero(link == on))
        assert found[on].robot[:2] == (u, v)
        assert found[on].obstacle[:2] == ((u - 4 if on == 7 else u + 4), v)


@both
def test_of_all_covered_pixels_the_first_counts(clearances):
    """An obstacle before the arm: distance 0 on a whole patch, to rounding."""
    camera = small_camera()
    robot, foreground = np.full(camera.shape, np.inf), np.full(camera.shape, np.inf, np.float32)
    robot[20:50, 33:70], foreground[28:40, 45:60] = 1.5, 1.45
    link = np.where(np.isfinite(robot), 5, 255).astype(np.uint8)
    robot, link = representable(camera, robot, link)
    found = clearances(camera, robot, link, foreground, 0.5, 0.12)[5]
    assert found.distance == pytest.approx(0.0, abs=1e-6)
    assert found.robot[:2] == found.obstacle[:2] == (45, 28)
    assert found.obstacle[2] == pytest.approx(robot[28, 45])


@both
@pytest.mark.parametrize("empty", ["robot", "obstacle", "zeros"])
def test_without_a_robot_or_an_obstacle_there_is_no_distance(clearances, empty):
    camera = small_camera()
    robot, link, foreground = random_images(camera, np.random.default_rng(1), 0.1)
    if empty == "robot":
        robot[:], link[:] = np.inf, 255
    else:
        foreground[:] = 0.0 if empty == "zeros" else np.inf
    assert clearances(camera, robot, link, foreground, 0.5, 0.12) == {}


@both
def test_nothing_is_found_beyond_the_range(clearances):
    camera = small_camera()
    robot, foreground = np.full(camera.shape, np.inf), np.full(camera.shape, np.inf, np.float32)
    robot[30, 40], foreground[30, 40] = 1.0, 1.3
    link = np.where(np.isfinite(robot), 2, 255).astype(np.uint8)
    gap = 0.3 * np.linalg.norm(camera.unproject(40, 30, 1.0))
    assert clearances(camera, robot, link, foreground, gap - 1e-4, 0.12) == {}
    assert clearances(camera, robot, link, foreground, gap + 1e-4, 0.12)[2].distance == pytest.approx(gap, abs=1e-5)


def test_the_same_images_give_the_same_bits():
    camera = small_camera()
    robot, link, foreground = random_images(camera, np.random.default_rng(5), 0.05)
    runs = [in_warp(camera, robot, link, foreground, 0.5, 0.12) for _ in range(3)]
    assert runs[0] == runs[1] == runs[2]


@pytest.fixture(scope="module")
def eye():
    return Localizer(Camera(), load_scene().environment, name="here")


def look(eye, T, *spheres, sensor=PERFECT, **config):
    eye.configure(VisionConfig(**config))
    camera = depth_camera(sensor)
    camera.reset()
    camera.expose(7, T, spheres)
    eye.filter(camera.latest(7), T)
    eye.localize(9, T)
    return eye.clearances()


@pytest.mark.parametrize("sensor", [PERFECT, SensorConfig()], ids=["perfect", "kinect"])
def test_a_ball_beside_the_arm_is_as_far_as_brute_force_says(eye, sensor):
    camera = eye.camera
    for shift in ([0.1, 0.32, 0.1], [0.0, 0.1, 0.25], [0.3, 0.0, 0.0]):
        T = poses(POSTURE + 0.1 * shift[1])
        found = look(eye, T, sphere_at(T[4][:3, 3] + shift), sensor=sensor)
        image = eye.robot_image
        brute = reference.clearances(camera, image.depth, image.link, eye.foreground.depth, 0.5, 0.12)
        assert {c.link: c.distance for c in found} == pytest.approx({on: w.distance for on, w in brute.items()}, abs=1e-6)
        assert [c.distance for c in found] == sorted(c.distance for c in found)
        assert len(found) >= 4
        for c in found:
            assert (c.tick, c.stamp, c.camera) == (9, 7, "here")
            assert np.linalg.norm(c.p_robot - c.p_obstacle) == pytest.approx(c.distance, abs=1e-9)
            u, v, z = camera.project(apply(camera.T_camera_world, c.p_robot))
            assert image.link[round(v), round(u)] == c.link
            assert image.depth[round(v), round(u)] == pytest.approx(z)


def test_an_obstacle_that_is_gone_is_forgotten_with_the_first_frame_without_it(eye):
    T = poses()
    near = T[4][:3, 3] + [0.1, 0.32, 0.1]
    assert look(eye, T, sphere_at(near))
    camera = depth_camera()
    camera.expose(8, T, ())
    eye.filter(camera.latest(8), T)
    assert eye.clearances() == ()
    camera.expose(9, T, [sphere_at(near)])
    eye.filter(camera.latest(9), T)
    assert eye.clearances()


def test_the_robot_stands_where_it_was_last_localized_whatever_was_asked_in_between(eye):
    T_then, T_now = poses(), poses(POSTURE + 0.1)
    look(eye, T_then, sphere_at(T_then[4][:3, 3] + [0.1, 0.32, 0.1]))
    eye.localize(10, T_now)
    first = eye.clearances()
    assert eye.robot_image is not None  # drawn at the frame's stamp
    for a, b in zip(first, eye.clearances(), strict=True):
        assert (a.tick, a.link, a.distance) == (10, b.link, b.distance)


def test_mode_paper_measures_the_true_surface_to_finite_obstacles(eye):
    T, _, centre = contacts(4, (30, 60), 1, np.random.default_rng(4))[0]
    beside = np.add(centre, [0.0, 0.2, 0.2])
    found = [{c.link: c.distance for c in look(eye, T, sphere_at(beside), mode=mode, neighbours=0)}
             for mode in ("interval", "paper")]
    assert found[0] == found[1]
    assert min(found[0].values()) > 0.05


def test_before_the_first_frame_nothing_is_near():
    eye = Localizer(Camera(), ())
    assert eye.clearances() == ()
    assert eye.touches() == ()
