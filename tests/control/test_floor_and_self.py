"""The guard of table and self: quiet where there is room, and out of the way where there is none."""

import numpy as np
import pytest

from hrc import meshes
from hrc.control import guard
from hrc.geometry import apply, closest_points
from hrc.model import Dynamics, joint_limits, load_spec, pinocchio_model

COMPILED = load_spec().compile()
DYNAMICS = Dynamics(pinocchio_model(COMPILED, armature=False))
LIMITS = joint_limits(COMPILED)
POSTURE = np.deg2rad([0.0, 25.0, 0.0, -85.0, 0.0, 70.0, 0.0])


def postures(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(LIMITS.q_min, LIMITS.q_max, (n, 7))


def parts(q: np.ndarray) -> tuple[guard.Part, ...]:
    T, x = DYNAMICS.kinematics(q)[:2]
    shoulder, elbow, wrist = (T[link, :3, 3] for link in (2, 4, 6))
    return (guard.Part(0, np.zeros(3), shoulder, guard.COLUMN), guard.Part(3, shoulder, elbow, guard.UPPER_ARM),
            guard.Part(5, elbow, wrist, guard.FOREARM), guard.Part(7, wrist, x, guard.HAND))


def nearest(q: np.ndarray) -> float:
    column, upper, forearm, hand = parts(q)
    return min(guard.distance(hand, column)[0], guard.distance(forearm, column)[0], guard.distance(hand, upper)[0])


def lowest(q: np.ndarray) -> float:
    T, x = DYNAMICS.kinematics(q)[:2]
    return min(T[4, 2, 3], T[6, 2, 3], x[2])


def test_closest_points_are_closest():
    rng = np.random.default_rng(1)
    grid = np.linspace(0.0, 1.0, 101)
    for i in range(200):
        a, b, c, d = rng.normal(size=(4, 3))
        if i % 5 == 0:
            d = c + (b - a) * rng.normal()  # parallel
        if i % 7 == 0:
            b = a.copy()  # a point
        p, q = closest_points(a, b, c, d)
        every = (a + grid[:, None] * (b - a))[:, None] - (c + grid[:, None] * (d - c))[None]
        assert np.linalg.norm(p - q) <= np.linalg.norm(every, axis=2).min() + 1e-9
        for x, (start, end) in ((p, (a, b)), (q, (c, d))):
            assert np.linalg.norm(x - start) + np.linalg.norm(x - end) == pytest.approx(np.linalg.norm(end - start), abs=1e-9)


def test_it_is_quiet_where_there_is_room():
    assert nearest(POSTURE) > 0.1
    assert not guard.away(DYNAMICS.terms(POSTURE, np.zeros(7)), 0.08, 10.0).any()


def test_what_is_too_near_moves_away():
    """Alone, the guard brings the arm out of every posture that is too near to itself, and not too deep in it."""
    found = 0
    for q in postures(5000):
        if not -0.03 < nearest(q) < 0.02:
            continue
        found += 1
        before = nearest(q)
        for _ in range(300):
            q = q + 0.005 * guard.away(DYNAMICS.terms(q, np.zeros(7)), 0.0, 10.0)
        assert nearest(q) > before
        assert nearest(q) > guard.NEAR - 0.005
    assert found > 10


def test_elbow_and_wrist_are_kept_above_the_floor_too():
    found = 0
    for q in postures(1000, seed=3):
        if not 0.0 < lowest(q) < 0.06 or nearest(q) < 0.1:
            continue
        found += 1
        for _ in range(300):
            q = q + 0.005 * guard.away(DYNAMICS.terms(q, np.zeros(7)), 0.08, 10.0)
        assert lowest(q) > 0.075
    assert found > 10


def test_the_capsules_hold_the_shells():
    robot = meshes.robot("perception")
    T = DYNAMICS.kinematics(POSTURE)[0]
    for part, links in zip(parts(POSTURE), ((0, 1), (2, 3), (4, 5), (6, 7)), strict=True):
        for link in links:
            points = apply(T[link], robot[link].vertices)
            for p in points:
                assert np.linalg.norm(np.subtract(*closest_points(p, p, part.start, part.end))) < part.radius
