import functools

import numpy as np
import pytest
from eye_robot import PERFECT, POSTURE, RADIUS, depth_camera, poses, sphere_at
from eye_scenes import random_images, representable, small_camera

from hrc import meshes
from hrc.geometry import apply, transform
from hrc.messages import Body
from hrc.scene import BodySpec, load_scene
from hrc.sim.depth_camera import DepthCamera, SensorConfig
from hrc.vision import kernels, reference
from hrc.vision.camera import Camera
from hrc.vision.localize import Localizer, VisionConfig

RULE = {"touch": 0.05, "ridge": 0.008, "step": 0.05, "hand": 0.2}


def stages(camera, robot, link, foreground, thickness=0.12, reach=0.1):
    grid, nothing = kernels.grid(camera), np.full(camera.shape, np.inf)
    keys, cover = (kernels.upload(kernels.pack(image, link, grid), "uint32", "cpu") for image in (robot, nothing))
    passed = kernels.Filter(grid, cover, "cpu")
    passed.mask(nothing)
    passed.load(foreground)
    passed.launch()
    distance = kernels.Distance(grid, keys, passed, "cpu")
    distance.reach, distance.thickness = reach, thickness
    kernels.Graph([distance.launch], "cpu").replay()
    return distance


def in_numpy(camera, robot, link, foreground, thickness=0.12, **rule):
    distances = stages(camera, robot, link, foreground, thickness).image()
    return reference.places(camera, robot, distances, foreground, thickness=thickness, **{**RULE, **rule})


def in_warp(camera, robot, link, foreground, thickness=0.12, **rule):
    touches = kernels.Touches(stages(camera, robot, link, foreground, thickness))
    for name, value in {**RULE, **rule}.items():
        setattr(touches, name, value)
    touches.capture().replay()
    return touches.image()


both = pytest.mark.parametrize("places", [in_numpy, in_warp], ids=["numpy", "warp"])


@pytest.mark.parametrize("thickness", [0.12, 0.02])
@pytest.mark.parametrize("cover", [0.002, 0.02, 0.4])
@pytest.mark.parametrize("seed", range(4))
def test_the_places_are_those_of_the_reference(seed, cover, thickness):
    camera = small_camera()
    robot, link, foreground = random_images(camera, np.random.default_rng(seed), cover)
    robot, link = representable(camera, robot, link)
    rule = {"touch": 0.08, "ridge": 0.002 * (1 + seed), "hand": 0.05 * (1 + seed), "step": 0.03}
    np.testing.assert_array_equal(in_warp(camera, robot, link, foreground, thickness, **rule),
                                  in_numpy(camera, robot, link, foreground, thickness, **rule))


def arm(camera):
    """A flat arm across the image, 30 pixels high: link 4 to the left of column 45, link 5 to the right, 1 m away."""
    robot, link = np.full(camera.shape, np.inf), np.full(camera.shape, 255, np.uint8)
    robot[20:50], link[20:50, :45], link[20:50, 45:] = 1.0, 4, 5
    return *representable(camera, robot, link), np.full(camera.shape, np.inf, np.float32)


@both
def test_one_hand_over_two_links_is_one_place_and_two_hands_on_one_link_are_two(places):
    camera = small_camera()
    robot, link, foreground = arm(camera)
    foreground[30:36, 35:55] = 0.95
    assert set(np.unique(places(camera, robot, link, foreground))) == {-1, 0}
    foreground[30:36, 43:47] = np.inf
    found = places(camera, robot, link, foreground)
    assert set(np.unique(found)) == {-1, 0, 1}
    assert (found[30:36, 35:43] == 0).all()
    assert (found[30:36, 47:55] == 1).all()
    foreground[:, 45:], foreground[30:36, 2:20] = np.inf, 0.95
    assert set(np.unique(places(camera, robot, link, foreground))) == {-1, 0, 1}


@both
def test_fingers_of_one_hand_are_one_place_and_two_hands_of_one_person_are_two(places):
    """They hang together above the arm: within a hand's size, or a body away."""
    camera = small_camera()
    robot, link, foreground = arm(camera)
    foreground[5:30, 30:34] = foreground[5:30, 42:46] = foreground[5:9, 30:46] = 0.95
    assert set(np.unique(places(camera, robot, link, foreground))) == {-1, 0}
    assert set(np.unique(places(camera, robot, link, foreground, hand=0.1))) == {-1, 0, 1}


def test_two_places_are_one_from_the_same_ridge_on_for_numpy_and_warp():
    camera = small_camera()
    robot, link, foreground = arm(camera)
    foreground[30:36, 35:42], foreground[30:36, 48:55] = 0.95, 0.98
    counts = [[f(camera, robot, link, foreground, ridge=0.0005 * rise).max() + 1 for rise in range(60, 120)]
              for f in (in_numpy, in_warp)]
    assert counts[0] == counts[1]
    assert set(counts[0]) == {1, 2}
    assert counts[0] == sorted(counts[0], reverse=True)


@both
def test_links_that_only_overlap_in_the_image_are_not_one_surface(places):
    camera = small_camera()
    robot, link, foreground = arm(camera)
    robot[:, 45:] += 0.3
    robot, link = representable(camera, robot, link)
    foreground[30:36, 35:45], foreground[30:36, 45:55] = 0.95, 1.25
    assert set(np.unique(places(camera, robot, link, foreground))) == {-1, 0, 1}
    assert set(np.unique(places(camera, robot, link, foreground, step=1.0))) == {-1, 0}


@both
def test_of_more_places_the_four_nearest_are_told_apart(places):
    camera = small_camera()
    robot, link, foreground = arm(camera)
    for i, gap in enumerate((0.03, 0.01, 0.04, 0.02, 0.0, 0.025)):
        foreground[34, 5 + 15 * i] = 1.0 + gap  # behind the visible surface: no depth that counts is nearer
    found = places(camera, robot, link, foreground, touch=0.045)
    assert [found[34, 5 + 15 * i] for i in range(6)] == [-1, 1, -1, 2, 0, 3]


@both
def test_nothing_near_is_no_place(places):
    camera = small_camera()
    robot, link, foreground = arm(camera)
    assert (places(camera, robot, link, foreground) == -1).all()
    foreground[34, 40] = 1.06
    assert (places(camera, robot, link, foreground) == -1).all()
    assert (places(camera, np.full(camera.shape, np.inf), link, foreground) == -1).all()


def test_the_point_of_each_place_lies_in_it_with_the_least_distance_of_the_place():
    camera = small_camera()
    robot, link, foreground = arm(camera)
    foreground[30:35, 10:15], foreground[30:35, 70:75] = 0.95, 1.02
    distance = stages(camera, robot, link, foreground)
    touches = kernels.Touches(distance)
    touches.capture().replay()
    first, second = touches.result()
    assert (first.u, first.v, first.link, first.distance) == (12, 32, 4, 0.0)
    assert (second.v, second.link) == (32, 5)
    assert 70 <= second.u < 75
    assert second.distance == distance.image()[touches.image() == 1].min() > 0.02


BODIES = [BodySpec("a", "sphere", (RADIUS,)), BodySpec("b", "sphere", (RADIUS,)), BodySpec("palm", "box", (0.02, 0.05, 0.09)),
          BodySpec("forearm", "capsule", (0.04, 0.1))]


@pytest.fixture(scope="module")
def eye():
    return Localizer(Camera(), load_scene().environment)


@pytest.fixture(scope="module", params=[PERFECT, SensorConfig()], ids=["perfect", "kinect"])
def sensor(request):
    return DepthCamera(Camera(), load_scene().environment, BODIES, request.param, seed=3, latency=0)


def look(eye, sensor, T, *bodies):
    sensor.reset()
    sensor.expose(7, T, bodies)
    eye.configure(VisionConfig())
    eye.filter(sensor.latest(7), T)
    eye.localize(9, T)
    return eye.touches()


def visible(T, link):
    """Points (n, 3) and normals (n, 3) of a link, those that face the camera, are seen and are not low on the table."""
    mesh, bare = meshes.robot("plant")[link], depth_camera()
    points, normals = apply(T[link], mesh.vertices), mesh.normals @ T[link][:3, :3].T
    sight = Camera().T_world_camera[:3, 3] - points
    facing = (sight * normals).sum(axis=1) > 0.4 * np.linalg.norm(sight, axis=1)
    bare.reset()
    bare.expose(0, T, ())
    chosen = [i for i in np.nonzero(facing & (points[:, 2] > 0.2))[0] if bare.sees(points[i])]
    return points[chosen], normals[chosen]


def shown(T, centre):
    """Whether the camera sees the front of a sphere there."""
    towards, bare = Camera().T_world_camera[:3, 3] - centre, depth_camera()
    bare.reset()
    bare.expose(0, T, [sphere_at(centre)])
    return bare.sees(centre + RADIUS * towards / np.linalg.norm(towards))


def hands(T, links, rng):
    """A sphere that touches each of these links, farther than 3 cm from the others and 3 cm from each other; or None."""
    parts = [apply(t, m.vertices) for t, m in zip(T, meshes.robot("plant"), strict=True)]
    centres = []
    for link in links:
        points, normals = visible(T, link)
        for i in rng.permutation(len(points))[:200]:
            centre = points[i] + RADIUS * normals[i]
            gaps = [np.linalg.norm(p - centre, axis=1).min() - RADIUS for p in parts]
            if (gaps[link] > -1e-3 and min(g for k, g in enumerate(gaps) if k != link) > 0.03
                    and all(np.linalg.norm(centre - c) > 0.13 for c in centres) and shown(T, centre)):
                centres.append(centre)
                break
    if len(centres) < len(links):
        return None
    return [Body(name, "sphere", (RADIUS,), transform(np.eye(3), c)) for name, c in zip("ab", centres, strict=True)]


@functools.cache
def scenes(links, number, seed):
    """So many poses with two hands at the arm."""
    rng, found = np.random.default_rng(seed), []
    while len(found) < number:
        T = poses(POSTURE + rng.uniform(-1, 1, 7) * [0.8, 0.4, 0.8, 0.5, 0.8, 0.8, 0.8])
        bodies = hands(T, links, rng)
        if bodies is not None:
            found.append((T, bodies))
    return found


def test_two_hands_on_two_links_are_two_touches_on_these_links(eye, sensor):
    right = [sorted(n.link for n in look(eye, sensor, T, *bodies)) == [4, 6] for T, bodies in scenes((4, 6), 20, 0)]
    assert np.mean(right) >= 0.95


def test_two_hands_on_one_link_are_two_touches(eye, sensor):
    counts = [len(look(eye, sensor, T, *bodies)) for T, bodies in scenes((4, 4), 10, 1)]
    assert counts.count(2) >= 8


@pytest.mark.parametrize("body", BODIES[2:], ids=["palm", "forearm"])
def test_a_palm_or_a_forearm_laid_along_the_arm_is_one_touch(eye, sensor, body):
    rng, counts = np.random.default_rng(2), []
    while len(counts) < 8:
        T = poses(POSTURE + rng.uniform(-0.4, 0.4, 7))
        points, normals = visible(T, 4)
        i = rng.integers(len(points))
        along = T[5][:3, 3] - T[3][:3, 3]
        along -= (along @ normals[i]) * normals[i]
        along /= np.linalg.norm(along)
        R_body = np.column_stack([normals[i], np.cross(along, normals[i]), along])
        pose = transform(R_body, points[i] + body.size[0] * normals[i])
        touches = look(eye, sensor, T, Body(body.name, body.shape, body.size, pose))
        if np.isfinite(eye.foreground.depth).sum() > 100:  # else the robot hides it
            counts.append(len(touches))
    assert counts == [1] * 8


def test_a_hand_that_is_gone_is_forgotten_with_the_first_frame_without_it(eye, sensor):
    T, bodies = scenes((4, 6), 1, 5)[0]
    assert len(look(eye, sensor, T, *bodies)) == 2
    sensor.expose(8, T, bodies[:1])
    eye.filter(sensor.latest(8), T)
    assert eye.touches() == ()  # of a map before this frame nothing is said
    eye.localize(10, T)
    (touch,) = eye.touches()
    assert (touch.tick, touch.stamp) == (10, 8)
    sensor.expose(9, T, ())
    eye.filter(sensor.latest(9), T)
    eye.localize(11, T)
    assert eye.touches() == ()


def test_the_point_lies_on_the_true_surface_whatever_was_asked_in_between(eye, sensor):
    T, bodies = scenes((4, 6), 1, 6)[0]
    first = look(eye, sensor, T, *bodies)
    eye.localize(12, T + 0.0)
    assert eye.robot_image is not None
    eye.clearances()
    for a, b in zip(first, eye.touches(), strict=True):
        assert (a.link, a.pixel, a.distance) == (b.link, b.pixel, b.distance)
        u, v = b.pixel
        p_camera = eye.camera.unproject(u, v, eye.robot_image.depth[v, u])
        np.testing.assert_allclose(apply(Camera().T_world_camera, p_camera), b.p_world, atol=1e-9)
        np.testing.assert_allclose(apply(T[b.link], b.p_link), b.p_world, atol=1e-9)
