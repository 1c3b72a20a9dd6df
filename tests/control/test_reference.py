"""Every path is closed, continuous with its tangent, and run at constant speed."""

import numpy as np
import pytest

from hrc.control.reference import PathFollower, TaskConfig, make_path
from hrc.errors import ConfigError


@pytest.fixture
def waypoints(tmp_path):
    file = tmp_path / "points.txt"
    file.write_text("# x y z [m]\n-0.5, -0.2, 0.4\n-0.6 0.1 0.5  # blanks do as well\n\n-0.45, 0.2, 0.35\n")
    return str(file)


@pytest.fixture(params=["hexagon", "circle", "waypoints", "line"])
def path(request, waypoints, tmp_path):
    if request.param == "line":
        file = tmp_path / "line.txt"
        file.write_text("-0.5 -0.2 0.4\n-0.5 0.2 0.4\n")
        return make_path(TaskConfig(kind="waypoints", waypoints=str(file)))
    return make_path(TaskConfig(kind=request.param, waypoints=waypoints))


def test_it_is_closed_and_smooth(path):
    s = np.linspace(0.0, path.length, 20_001)
    x = np.array([path.at(v) for v in s])
    np.testing.assert_allclose(x[0], x[-1], atol=1e-9)
    step = s[1] - s[0]
    velocity = np.diff(x, axis=0) / step
    assert np.linalg.norm(velocity, axis=1).max() <= 1.0 + 1e-6
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() < 0.02  # a sharp corner would change it by 1
    np.testing.assert_allclose(path.at(0.3 * path.length), path.at(1.3 * path.length), atol=1e-12)


def test_the_hexagon_lies_on_its_plane_and_keeps_its_size():
    config = TaskConfig()
    path = make_path(config)
    x = np.array([path.at(v) for v in np.linspace(0.0, path.length, 500)])
    np.testing.assert_allclose(x[:, 0], config.centre[0])
    radii = np.linalg.norm(x - np.asarray(config.centre), axis=1)
    assert config.radius * np.sqrt(0.75) - 1e-9 <= radii.min()
    assert radii.max() < config.radius


def test_the_circle_keeps_its_radius_and_the_hold_its_place():
    config = TaskConfig(kind="circle")
    path, centre = make_path(config), np.asarray(config.centre)
    x = np.array([path.at(v) for v in np.linspace(0.0, path.length, 100)])
    np.testing.assert_allclose(np.linalg.norm(x - centre, axis=1), config.radius)
    hold = make_path(TaskConfig(kind="hold"))
    np.testing.assert_allclose([hold.at(s) for s in (0.0, 0.3, 7.0)], [centre] * 3)


def test_a_path_passes_near_every_waypoint(waypoints):
    path = make_path(TaskConfig(kind="waypoints", waypoints=waypoints))
    x = np.array([path.at(v) for v in np.linspace(0.0, path.length, 2000)])
    for point in ([-0.5, -0.2, 0.4], [-0.6, 0.1, 0.5], [-0.45, 0.2, 0.35]):
        assert np.linalg.norm(x - point, axis=1).min() < TaskConfig().corner / 2


def test_a_frozen_path_stays_and_a_running_one_has_the_speed():
    follower = PathFollower(make_path(TaskConfig()), 0.2)
    follower.advance(1.0, 0.25)
    before = follower.x_d
    np.testing.assert_allclose(follower.advance(0.0, 0.005), 0.0)
    np.testing.assert_allclose(follower.x_d, before)
    assert np.linalg.norm(follower.advance(1.0, 0.005)) == pytest.approx(0.2)


@pytest.mark.parametrize(("text", "complaint"), [
    ("-0.5 0.1\n0 0 0", "line 1: a waypoint is x, y, z in metres, not '-0.5 0.1'"),
    ("0 0 0\n1 2 nan", "line 2: a waypoint is x, y, z"),
    ("a b c", "line 1"),
    ("-0.5 0.1 0.4", "at least two"),
    ("-0.5 0.1 0.4\n-0.5 0.1 0.4\n-0.4 0.1 0.4", "1 mm or more from the next"),
    ("", "holds 0 waypoint"),
])
def test_bad_waypoints_are_one_clear_error(tmp_path, text, complaint):
    file = tmp_path / "bad.txt"
    file.write_text(text)
    with pytest.raises(ConfigError, match=complaint):
        make_path(TaskConfig(kind="waypoints", waypoints=str(file)))


def test_a_missing_file_of_waypoints_is_one_clear_error():
    with pytest.raises(ConfigError, match=r"nowhere.txt cannot be read"):
        make_path(TaskConfig(kind="waypoints", waypoints="nowhere.txt"))
