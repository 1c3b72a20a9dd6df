"""Equal distances and equal depths have one answer, whatever order they are looked at in."""

import numpy as np
import pytest
from eye_random import name_of, scene
from eye_scenes import DeviceStages, random_images, random_meshes, random_poses, representable, small_camera, tied_images

from hrc.meshes import Mesh
from hrc.messages import DepthFrame
from hrc.vision import kernels
from hrc.vision.localize import Localizer


@pytest.mark.parametrize("seed", range(4))
def test_the_order_of_triangles_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    stages, shapes, poses = DeviceStages(small_camera()), random_meshes(9, rng), random_poses(9, rng)
    shuffled = [Mesh(m.vertices, m.faces[rng.permutation(len(m.faces))], m.normals) for m in shapes]
    for a, b in zip(stages.render(shapes, poses), stages.render(shuffled, poses), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("one", [2, 6])
def test_of_two_surfaces_at_the_same_depth_the_higher_link_is_seen(one):
    rng = np.random.default_rng(0)
    shapes, poses = random_meshes(8, rng), random_poses(8, rng)
    other = 8 - one
    shapes[other], poses[other] = shapes[one], poses[one]
    _, link = DeviceStages(small_camera()).render(shapes, poses)
    assert (link == 6).sum() > 10
    assert not (link == 2).any()


@pytest.mark.parametrize("number", [1, 8, 30, 49], ids=name_of)
def test_a_second_run_gives_the_same_bits(number):
    s, runs = scene(number), []
    for _ in range(2):
        eye = Localizer(s.camera, s.environment, s.config)
        for _ in range(2):  # nothing of the first frame may remain in the buffers
            eye.filter(DepthFrame(3, s.real.copy()), s.T_stamp)
            nearest = [(n.link, n.pixel, n.distance, *n.p_world) for n in eye.localize(5, s.T_now)]
            runs.append((nearest, eye.foreground.depth, eye.distances()))
    assert runs[0][0]
    for run in runs[1:]:
        assert run[0] == runs[0][0]
        np.testing.assert_array_equal(run[1], runs[0][1])
        np.testing.assert_array_equal(run[2], runs[0][2])


@pytest.mark.parametrize("pixels", [0, 4])
def test_of_equal_distances_the_first_pixel_in_the_image_counts(pixels):
    """Also where its tile is not the first that is looked at: every distance is exactly the same number."""
    camera, robot, link, foreground = tied_images(pixels)
    stages = DeviceStages(camera)
    distances = stages.distance_map(robot, link, foreground, 0.1, 0.12)
    assert set(np.unique(distances)) == {pixels / 64, np.inf}
    points = stages.points(robot, link, foreground, centred=False)
    assert [p.link for p in points] == [3, 4, 7]
    for p in points:
        v, u = np.argwhere(link == p.link)[0]
        assert (p.u, p.v, p.distance) == (u, v, pixels / 64)


@pytest.mark.parametrize("seed", range(4))
def test_the_order_of_tiles_changes_no_point(seed):
    rng, camera = np.random.default_rng(seed), small_camera()
    robot, link, foreground = random_images(camera, rng, 0.1)
    robot, link = representable(camera, robot, link)
    distance = DeviceStages(camera).distance(robot, link, foreground, 0.1, 0.12)
    results, n = [], kernels.read(distance.n_active)[0]
    for _ in range(3):
        point = kernels.ContactPoints(distance)
        point.launch()
        results.append(point.result())
        order = kernels.read(distance.active).copy()
        order[:n] = rng.permutation(order[:n])
        kernels.write(distance.active, order)
    assert n > 5
    assert results[0]
    assert results[0] == results[1] == results[2]


def test_an_eye_that_has_seen_much_sees_what_a_new_one_sees():
    """Nothing of an earlier frame, pose or setting shows: scenes of all kinds through one camera, asked in any order."""
    camera, rng = scene(8).camera, np.random.default_rng(0)
    old = Localizer(camera, ())
    for number in rng.permutation(56)[:24]:
        s = scene(int(number), camera)
        new, answers = Localizer(camera, (), s.config), []
        old.configure(s.config)
        for eye in (old, new):
            eye.filter(DepthFrame(3, s.real.copy()), s.T_stamp)
            if eye is old and rng.random() < 0.5:
                assert eye.robot_image.depth.shape == eye.foreground.depth.shape
            nearest = [(n.link, n.pixel, n.distance, *n.p_world) for n in eye.localize(5, s.T_now)]
            touches = [(n.link, n.pixel, n.distance) for n in eye.touches()]
            asked = [lambda eye=eye: [(c.link, c.distance, *c.p_robot, *c.p_obstacle) for c in eye.clearances()],
                     lambda eye=eye: eye.robot_image.depth.tobytes(), lambda eye=eye: eye.foreground.depth.tobytes(),
                     lambda eye=eye: eye.distances().tobytes()]
            order = rng.permutation(len(asked)) if eye is old else range(len(asked))
            given = {int(i): asked[i]() for i in order}
            answers.append((nearest, touches, [given[i] for i in range(len(asked))]))
        assert answers[0] == answers[1], s.name
