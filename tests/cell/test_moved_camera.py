"""A depth camera that is carried elsewhere while the cell runs: it sees from there what there is to see, and nothing else."""

import dataclasses

import numpy as np
import pytest

from hrc.cell import scenario
from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.errors import EventError
from hrc.events import MoveCamera, MoveObstacle, Reset, SetParameter
from hrc.geometry import apply, look_at
from hrc.messages import Snapshot
from hrc.sim.depth_camera import DepthCamera
from hrc.vision.camera import Camera

HOME = MoveCamera("camera", Config().camera.eye, Config().camera.target)
ASIDE = MoveCamera("camera", (-0.4, 1.9, 0.9), (-0.3, 0.0, 0.4))
BALL = MoveObstacle("ball", (-0.35, 0.45, 0.45))


def placed(move: MoveCamera) -> Config:
    """A cell whose camera has always stood there."""
    return Config(camera=Config().camera.replace(eye=move.eye, target=move.target))


def bits(snapshot: Snapshot) -> bytes:
    """All that vision finds, and what comes of it."""
    view = snapshot.views[0]
    images = [i.depth for i in (view.frame, view.foreground) if i is not None]
    found = [x for c in snapshot.clearances for x in (c.p_robot, c.p_obstacle)]
    return b"".join(x.tobytes() for x in (*images, *found, snapshot.residual, snapshot.command.dq, snapshot.state.q))


def steps(cell: Cell, n: int) -> list[bytes]:
    return [bits(cell.step()) for _ in range(n)]


def test_moved_before_the_first_frame_it_is_as_if_it_had_always_stood_there():
    moved, there = Cell(), Cell(placed(ASIDE))
    moved.apply(ASIDE)
    for cell in (moved, there):
        cell.apply(BALL)
    assert steps(moved, 400) == steps(there, 400)


def test_moved_to_where_it_stands_nothing_changes_and_a_reset_puts_it_back():
    moved, plain = Cell(), Cell()
    moved.apply(HOME)
    for cell in (moved, plain):
        cell.apply(BALL)
    begin = steps(plain, 500)
    assert steps(moved, 200) == begin[:200]
    moved.apply(ASIDE)
    assert steps(moved, 300) != begin[200:]
    for event in (Reset(), BALL):
        moved.apply(event)
    assert steps(moved, 500) == begin
    assert moved.step().views[0].T_world_camera is None


def test_frames_on_their_way_are_seen_from_where_they_were_taken():
    cell = Cell()
    for _ in range(300):
        cell.step()
    cell.apply(ASIDE)
    T, stood = look_at(ASIDE.eye, ASIDE.target), {}
    for _ in range(300):
        snapshot = cell.step()
        view = snapshot.views[0]
        stood[view.frame.tick] = view.T_world_camera is not None and np.array_equal(view.T_world_camera, T)
        assert not np.isfinite(view.foreground.depth).any(), "neither robot nor room is an obstacle"
        assert snapshot.clearances == ()
        assert not view.silent
    assert [stood[tick] for tick in sorted(stood)] == [tick > 300 for tick in sorted(stood)]
    assert sum(not there for there in stood.values()) == 3


@pytest.mark.parametrize("eye", [(-0.4, 1.9, 0.9), (0.3, -1.2, 2.0), (-1.6, 0.2, 0.6), (0.0, 0.0, 0.5), (-0.5, 0.01, 0.01)])
def test_from_anywhere_the_robot_and_the_room_are_no_obstacle(eye):
    """Nor from within the arm or the table, where it sees nothing."""
    cell = Cell()
    cell.apply(MoveCamera("camera", eye, (-0.3, 0.0, 0.4)))
    for _ in range(250):
        snapshot = cell.step()
    assert snapshot.views[0].frame is not None
    assert np.isfinite(snapshot.views[0].foreground.depth).sum() < 10
    assert snapshot.contact is None
    assert snapshot.command.mode == "idle"


def test_an_obstacle_is_in_the_same_place_from_everywhere():
    cell = Cell()
    cell.apply(BALL)
    for move in (HOME, ASIDE, MoveCamera("camera", (-1.9, 1.0, 1.2), (-0.3, 0.2, 0.4))):
        cell.apply(move)
        for _ in range(500):
            snapshot = cell.step()
        view, eye = snapshot.views[0], np.array(move.eye)
        assert view.T_world_camera is not None
        v, u = np.nonzero(np.isfinite(view.foreground.depth))
        points = apply(view.T_world_camera, Camera().unproject(u, v, view.foreground.depth[v, u]))
        ball = next(body for body in snapshot.bodies if body.name == "ball")
        apart = np.linalg.norm(points - ball.T_world_body[:3, 3], axis=1)
        assert len(points) > 300
        assert np.median(apart) == pytest.approx(0.08, abs=0.02), "all of it is on the ball, as well as the calibration knows"
        assert (apart < 0.12).mean() > 0.98
        assert (points - ball.T_world_body[:3, 3]).mean(axis=0) @ (eye - ball.T_world_body[:3, 3]) > 0, "on the side it sees"


def test_a_contact_hidden_from_one_place_is_seen_from_another_and_hidden_again():
    """The hand of `hidden` presses from behind; then the camera is carried to its side of the arm, and back."""
    script = scenario.load("hidden")
    cell = Cell(script.configured(Config()))
    (time, press), = script.events
    before = MoveCamera("camera", (-1.75, -1.35, 1.15), (-0.3, 0.0, 0.5))
    events = {round(1000 * time): press, 3000: before, 3600: HOME}
    firm: dict[str, list[Snapshot]] = {"before": [], "there": [], "back": []}
    for tick in range(4200):
        if tick in events:
            cell.apply(events[tick])
        snapshot = cell.step()
        if snapshot.detected and snapshot.fresh_control and tick % 600 > 200 and tick > 2400:
            firm["before" if tick < 3000 else "there" if tick < 3600 else "back"].append(snapshot)
    assert min(map(len, firm.values())) > 40
    for name, some in firm.items():
        seen = np.mean([s.contact is not None and s.contact.seen for s in some])
        assert seen > 0.9 if name == "there" else seen == 0.0
    off = [np.linalg.norm(s.contact.p_world - s.truth.p_world) for s in firm["there"] if s.contact]
    assert np.median(off) < 0.03


def test_a_silent_camera_can_be_moved_too():
    cell = Cell()
    cell.apply(SetParameter("sensor.unplugged", True))
    for _ in range(700):
        view = cell.step().views[0]
    assert (view.silent, view.T_world_camera) == (True, None)
    cell.apply(ASIDE)
    for _ in range(5):
        view = cell.step().views[0]
    np.testing.assert_array_equal(view.T_world_camera, look_at(ASIDE.eye, ASIDE.target))


def test_the_truth_about_its_place_does_not_reach_perception():
    """The calibration's error goes with the sensor: it is the same, as the sensor sees it, wherever that stands."""
    cell = Cell()
    sensor = cell._eyes._eyes[0]._sensor
    assert isinstance(sensor, DepthCamera)
    errors = []
    for move in (HOME, ASIDE):
        cell.apply(move)
        for _ in range(150):
            view = cell.step().views[0]
        assert view.T_world_camera is not None
        errors.append(np.linalg.inv(view.T_world_camera) @ sensor.true_camera.T_world_camera)
    assert np.linalg.norm(errors[0][:3, 3]) == pytest.approx(0.005)
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-12)


def test_an_unknown_camera_is_refused_and_nothing_moves():
    cell = Cell()
    with pytest.raises(EventError, match='unknown camera "cam"; did you mean camera'):
        cell.apply(dataclasses.replace(ASIDE, name="cam"))
    assert cell.step().events == ()
