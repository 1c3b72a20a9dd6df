"""A contact that the camera cannot see is said to be such, not given as a confident point."""

import numpy as np
import pytest
from eye_robot import POSTURE, SPHERE, contacts, depth_camera, poses, sphere_at

from app.bench.touches import touches
from hrc.scene import load_scene
from hrc.sim.depth_camera import SensorConfig
from hrc.vision import reference
from hrc.vision.camera import Camera
from hrc.vision.localize import Localizer, VisionConfig


@pytest.fixture(scope="module")
def eye():
    return Localizer(Camera(), load_scene().environment)


def look(eye, T, centre, sensor=None, **changes):
    camera = depth_camera(sensor) if sensor else depth_camera()
    eye.configure(VisionConfig(**changes))
    camera.reset()
    camera.expose(7, T, (sphere_at(centre),))
    eye.filter(camera.latest(7), T)
    return eye.localize(9, T)


@pytest.mark.parametrize("sensor", [None, SensorConfig()], ids=["perfect", "kinect"])
def test_what_touches_the_side_that_is_seen_is_sure(eye, sensor):
    found = [look(eye, T, centre, sensor) for link in (3, 4, 6) for T, _, centre in
             contacts(link, (10, 60), 4, np.random.default_rng(link))]
    assert sum(bool(f) and f[0].sure for f in found) >= 10  # of 12; at a joint two links may be as near


def test_a_contact_that_is_out_of_sight_gives_no_point_that_is_sure_and_wrong(eye):
    unseen = [t for t in touches(Camera(), 10, 4, [SPHERE]) if t.view in ("behind", "hidden")]
    found = [(t, look(eye, t.T_world_link, t.T_world_body[:3, 3])) for t in unseen]
    sure = [np.linalg.norm(n[0].p_world - t.point) for t, n in found if n and n[0].sure]
    assert len(unseen) == 20
    assert sum(bool(n) for _, n in found) >= 5
    assert len(sure) <= 5
    assert sum(error > 0.05 for error in sure) <= 1


def test_of_two_links_that_are_as_near_neither_is_sure(eye):
    rng = np.random.default_rng(3)
    T, _, centre = contacts(4, (10, 50), 1, rng)[0]
    found = look(eye, T, centre)
    assert found[0].sure
    everything = look(eye, T, centre, sure_apart=0.2, first_link=0, reach=0.2)
    apart = [np.linalg.norm(n.p_world - everything[0].p_world) for n in everything]
    assert max(apart) > 0.05
    assert not any(n.sure for n in everything)


def test_nothing_is_surer_than_what_is_nearer(eye):
    rng, doubted = np.random.default_rng(5), 0
    for _ in range(20):
        T = poses(POSTURE + rng.uniform(-0.6, 0.6, 7))
        sure = [n.sure for n in look(eye, T, T[rng.integers(3, 8)][:3, 3] + rng.normal(0, 0.1, 3))]
        assert sure == sorted(sure, reverse=True)
        doubted += False in sure
    assert doubted


@pytest.mark.parametrize("angles", [(10, 60), (80, 100)], ids=["front", "grazing"])
def test_the_kernel_judges_like_the_reference(eye, angles):
    config = VisionConfig(sure_apart=0.0)
    for T, _, centre in contacts(5, angles, 4, np.random.default_rng(6)):
        first = look(eye, T, centre, sure_apart=0.0)[0]
        foreground, robot = eye.foreground.depth, eye.robot_image
        distances = np.where(robot.link == first.link, eye.distances(), np.inf)
        v, u = np.unravel_index(int(np.argmin(distances)), distances.shape)
        thickness = reference.depths(eye.camera, foreground, config.thickness)
        assert first.sure == reference.faces_camera(
            eye.camera, int(u), int(v), float(robot.depth[v, u]), foreground, thickness, config.sure_within,
            float(np.cos(np.radians(config.sure_facing_deg))))


def test_the_papers_rule_knows_no_doubt(eye):
    T, _, centre = contacts(4, (95, 100), 1, np.random.default_rng(7))[0]
    assert all(n.sure for n in look(eye, T, centre, mode="paper"))
