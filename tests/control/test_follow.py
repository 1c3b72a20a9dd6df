"""The reference while tasks are exchanged: it never jumps, it arrives, and frozen it stays."""

import numpy as np
import pytest

from hrc.control.paths import Point
from hrc.control.posture import Posture
from hrc.control.reference import PathFollower, TaskConfig, make_path, nearest

DT = 0.005
SPEED, APPROACH, ACCELERATION = 0.2, 0.25, 1.0
CORNER = 2.0
"""Acceleration of the hexagon's corners at SPEED [m/s2]: v^2 |turn| / (2 rounding), |turn| = 1."""
HEXAGON, CIRCLE = make_path(TaskConfig()), make_path(TaskConfig(kind="circle", centre=(-0.5, 0.1, 0.5), radius=0.12))


def follower(path=HEXAGON) -> PathFollower:
    return PathFollower(path, SPEED, APPROACH, ACCELERATION)


def velocities(reference: PathFollower, seconds: float, path_speed: float = 1.0) -> np.ndarray:
    return np.array([reference.advance(path_speed, DT) for _ in range(round(seconds / DT))])


def point(rng: np.random.Generator) -> Point:
    return Point(rng.uniform((-0.8, -0.5, 0.1), (-0.3, 0.5, 0.8)))


@pytest.mark.parametrize("seed", range(20))
def test_no_sequence_of_tasks_and_targets_makes_it_jump(seed):
    rng = np.random.default_rng(seed)
    reference, v = follower(), [np.zeros((0, 3))]
    for _ in range(25):
        reference.join([HEXAGON, CIRCLE, point(rng), point(rng)][rng.integers(4)])
        v.append(velocities(reference, rng.choice([0.05, 0.3, 1.0, 3.0])))
    v = np.concatenate(v)
    assert np.linalg.norm(v, axis=1).max() < APPROACH + SPEED
    acceleration = np.linalg.norm(np.diff(v, axis=0), axis=1) / DT
    assert acceleration.max() < 1.02 * (2.0 * ACCELERATION + CORNER)  # of offset and path speed, and of a corner
    assert acceleration.max() > 0.5 * ACCELERATION, "it moved"


@pytest.mark.parametrize("seed", range(5))
def test_a_target_is_reached_and_kept(seed):
    rng = np.random.default_rng(seed)
    reference, target = follower(), point(rng)
    velocities(reference, rng.uniform(0.0, 5.0))
    away = np.linalg.norm(target.at(0.0) - reference.x_d)
    reference.join(target)
    velocities(reference, float(away) / APPROACH + 2.5 * APPROACH / ACCELERATION + 1.0)
    np.testing.assert_allclose(reference.x_d, target.at(0.0), atol=1e-4)
    assert reference.joined
    velocities(reference, 3.0)
    np.testing.assert_array_equal(reference.x_d, target.at(0.0))
    assert not velocities(reference, 0.1).any()


def test_from_rest_it_goes_straight_and_not_beyond():
    reference = follower(Point(np.zeros(3)))
    velocities(reference, 0.1)
    target = np.array([0.3, -0.2, 0.1])
    reference.join(Point(target))
    left = []
    for _ in range(800):
        reference.advance(1.0, DT)
        left.append(np.linalg.norm(target - reference.x_d))
        assert np.linalg.norm(np.cross(reference.x_d, target)) < 1e-12
    assert (np.diff(left) <= 1e-15).all()


def test_a_path_is_joined_at_its_nearest_point_and_then_run_at_its_speed():
    reference = follower(Point(np.array([-0.55, 0.3, 0.5])))
    start = reference.x_d
    distances = [np.linalg.norm(HEXAGON.at(s) - start) for s in np.linspace(0.0, HEXAGON.length, 5000)]
    assert np.linalg.norm(HEXAGON.at(nearest(HEXAGON, start)) - start) == pytest.approx(min(distances), abs=1e-6)
    reference.join(HEXAGON)
    np.testing.assert_allclose(reference.x_d, start, atol=1e-15)
    velocities(reference, 6.0)
    assert np.linalg.norm(velocities(reference, 5.0), axis=1).max() == pytest.approx(SPEED)
    assert np.linalg.norm(HEXAGON.at(nearest(HEXAGON, reference.x_d)) - reference.x_d) < 1e-4


@pytest.mark.parametrize("waited", [0.0, 0.3, 0.7, 1.9])
def test_where_it_stands_it_does_not_come_back_to(waited):
    reference = follower()
    velocities(reference, waited)
    ahead = reference.velocity
    reference.join(Point(reference.stand))
    v = velocities(reference, 3.0)
    assert (v @ ahead >= -1e-9).all()
    assert np.linalg.norm(v[-1]) < 1e-6


def test_frozen_it_stays_and_slowed_it_takes_the_same_way():
    slow, fast = follower(), follower()
    for reference, path_speed in ((slow, 0.5), (fast, 1.0)):
        velocities(reference, 1.0 / path_speed, path_speed)
        reference.join(Point(np.array([-0.4, 0.3, 0.4])))
        velocities(reference, 0.5 / path_speed, path_speed)
    np.testing.assert_allclose(slow.x_d, fast.x_d, atol=2e-3)
    before = slow.x_d
    assert not velocities(slow, 1.0, path_speed=0.0).any()
    slow.join(Point(np.array([-0.6, 0.0, 0.4])))
    assert not velocities(slow, 1.0, path_speed=0.0).any()
    np.testing.assert_allclose(slow.x_d, before, atol=1e-15)


@pytest.mark.parametrize("path", [HEXAGON, Point(np.array([-0.4, 0.3, 0.4]))])
def test_what_is_ahead_is_what_comes(path):
    reference = follower()
    velocities(reference, 0.6)
    reference.join(path)
    for _ in range(300):
        expected = reference.ahead(DT)
        np.testing.assert_allclose(reference.advance(1.0, DT), expected, atol=1e-12)


def test_another_speed_is_taken_up_gradually():
    reference = follower(CIRCLE)
    velocities(reference, 0.2)
    reference.speed = 0.4
    v = np.linalg.norm(velocities(reference, 1.0), axis=1)
    assert np.diff(v).max() <= 1.01 * ACCELERATION * DT
    assert v[-1] == pytest.approx(0.4, rel=1e-3)


def test_an_arm_that_could_not_keep_up_begins_where_it_stands():
    reference, x = follower(), np.array([-0.5, 0.1, 0.4])
    reference.join(Point(np.array([-0.4, 0.1, 0.4])), x)
    np.testing.assert_allclose(reference.x_d, x)
    assert np.linalg.norm(reference.advance(1.0, DT)) <= 1.01 * ACCELERATION * DT


def test_a_posture_is_neared_at_its_rate_along_a_straight_line_and_reached():
    start, goal = np.zeros(7), np.array([0.3, -0.6, 0.0, 0.1, 0.0, 0.2, 0.0])
    posture = Posture(start, 0.3)
    assert posture.advance(DT) is start
    posture.goal = goal
    steps = [posture.advance(DT) for _ in range(420)]
    assert np.abs(np.diff([start, *steps], axis=0)).max() <= 0.3 * DT + 1e-12
    np.testing.assert_allclose(steps[200] / steps[200][1], goal / goal[1], atol=1e-12)
    np.testing.assert_array_equal(steps[-1], goal)
