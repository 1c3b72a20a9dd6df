"""The hexagon is closed, continuous with its tangent, and run at constant speed."""

import numpy as np
import pytest

from hrc.control.reference import Hexagon, PathFollower, TaskConfig


def test_it_is_closed_and_smooth():
    path = Hexagon(TaskConfig())
    s = np.linspace(0.0, path.length, 20_001)
    x = np.array([path.at(v) for v in s])
    np.testing.assert_allclose(x[0], x[-1], atol=1e-9)
    steps = np.linalg.norm(np.diff(x, axis=0), axis=1) / np.diff(s)
    assert steps.max() <= 1.0 + 1e-6
    tangents = np.diff(x, axis=0) / np.linalg.norm(np.diff(x, axis=0), axis=1, keepdims=True)
    assert np.linalg.norm(np.diff(tangents, axis=0), axis=1).max() < 0.02  # a sharp corner would turn by 1


def test_it_lies_on_its_plane_and_keeps_its_size():
    config = TaskConfig()
    path = Hexagon(config)
    x = np.array([path.at(v) for v in np.linspace(0.0, path.length, 500)])
    np.testing.assert_allclose(x[:, 0], config.centre[0])
    radii = np.linalg.norm(x - np.asarray(config.centre), axis=1)
    assert config.radius * np.sqrt(0.75) - 1e-9 <= radii.min()
    assert radii.max() < config.radius


def test_a_frozen_path_stays_and_a_running_one_has_the_speed():
    follower = PathFollower(Hexagon(TaskConfig()), 0.2)
    follower.s = 0.05
    before = follower.x_d
    np.testing.assert_allclose(follower.advance(0.0, 0.005), 0.0)
    np.testing.assert_allclose(follower.x_d, before)
    assert np.linalg.norm(follower.advance(1.0, 0.005)) == pytest.approx(0.2)
