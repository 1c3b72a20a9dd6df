"""Steering the end effector while the cell runs: it arrives, it never jumps, and a contact is answered as ever."""

import hashlib

import numpy as np
import pytest

from hrc.cell.cell import Cell
from hrc.cell.task import plan
from hrc.config import Config, ideal
from hrc.errors import HrcError
from hrc.events import (
    Event,
    MoveTarget,
    Push,
    Release,
    Reset,
    Resume,
    SetParameter,
    SetPosture,
    SetTask,
    Stop,
    from_dict,
    to_dict,
)
from hrc.messages import Mode, Snapshot
from hrc.model import Dynamics, joint_limits, load_spec, pinocchio_model
from hrc.parameters import replaced
from hrc.scene import load_scene

BOUND = 4.5
"""Acceleration of the reference [m/s2]: joining, path speed, corners and the path's own ramp together."""
LIMITS = joint_limits(load_spec().compile())
TARGET = (-0.45, 0.25, 0.5)


def quick(kind: str) -> Cell:
    """A cell that looks seldom: nothing is there to be seen."""
    config = replaced(replaced(ideal(), "task.kind", kind), "rates.camera_hz", 20)
    return Cell(replaced(config, "rates.localize_hz", 20))


def following() -> Cell:
    return quick("follow")


def run(cell: Cell, seconds: float) -> list[Snapshot]:
    """The control cycles of so many seconds."""
    snapshots = (cell.step() for _ in range(round(1000 * seconds)))
    return [s for s in snapshots if s.fresh_control]


def off(s: Snapshot, x) -> float:
    """How far the end effector is from x [m]."""
    return float(np.linalg.norm(s.command.x - x))


def accelerations(snapshots: list[Snapshot]) -> np.ndarray:
    x_d = np.array([s.command.x_d for s in snapshots])
    return np.linalg.norm(np.diff(x_d, n=2, axis=0), axis=1) / 0.005**2


def test_the_arm_begins_where_it_is_and_arrives_at_its_target():
    cell = following()
    first = run(cell, 0.5)
    assert first[-1].aim.kind == "follow"
    assert max(off(s, cell.config.task.centre) for s in first) < 1e-3
    cell.apply(MoveTarget(TARGET))
    snapshots = run(cell, 3.0)
    assert off(snapshots[-1], TARGET) < 1e-3
    assert (snapshots[-1].aim.target == np.array(TARGET)).all()
    assert (snapshots[-1].aim.goal == np.array(TARGET)).all()
    assert snapshots[-1].aim.arrived
    assert not snapshots[10].aim.arrived
    assert {s.command.mode for s in snapshots} == {Mode.IDLE}
    assert max(np.linalg.norm(s.command.x - s.command.x_d) for s in snapshots) < 5e-3


def test_tasks_are_exchanged_while_the_arm_moves_without_a_jump():
    rng = np.random.default_rng(3)
    cell = quick("hexagon")
    snapshots = run(cell, 0.8)
    for k in range(10):
        kind = ("follow", "circle", "hexagon", "follow", "hold")[k % 5]
        cell.apply(SetTask(kind))
        snapshots += run(cell, float(rng.choice([0.1, 0.4, 0.8])))
        if kind == "follow":
            x, y, z = (np.array(cell.config.task.centre) + rng.uniform(-0.15, 0.15, 3)).tolist()
            cell.apply(MoveTarget((x, y, z)))
            snapshots += run(cell, 0.6)
    assert accelerations(snapshots[10:]).max() < BOUND
    jumps = np.abs(np.diff([s.command.dq for s in snapshots], axis=0)).max()
    assert jumps <= cell.config.control.ddq_max * 0.005 + 1e-9
    assert {s.command.mode for s in snapshots} == {Mode.IDLE}
    assert max(np.linalg.norm(s.command.x - s.command.x_d) for s in snapshots[10:]) < 5e-3
    cell.apply(SetTask("hexagon"))
    last = run(cell, 3.5)[-1]
    assert (last.aim.kind, last.aim.target, last.aim.goal, last.aim.arrived) == ("hexagon", None, None, True)
    assert last.command.path_speed > 0.99


def test_a_task_that_is_set_is_the_one_that_the_config_would_give():
    cell = quick("hexagon")
    cell.apply(SetTask("circle"))
    snapshots = run(cell, 4.5)
    circle = plan(cell.config.task.replace(kind="circle"), Dynamics(pinocchio_model(load_spec().compile(), armature=False)),
                  LIMITS, load_scene()).path
    ring = np.array([circle.at(s) for s in np.linspace(0.0, circle.length, 2000)])
    for s in snapshots[-200::40]:
        assert np.linalg.norm(ring - s.command.x, axis=1).min() < 1e-3


@pytest.mark.parametrize("interruption", ["abort", "stop"])
def test_after_an_interruption_in_mid_motion_the_arm_goes_on_to_its_target(interruption):
    cell = following()
    run(cell, 0.3)
    cell.apply(MoveTarget(TARGET))
    run(cell, 0.6)
    cell.apply(Push(4, (0.06, 0.0, 0.05), (0.0, -60.0, 0.0)) if interruption == "abort" else Stop())
    held = run(cell, 1.0)
    assert held[-1].command.mode is (Mode.ABORT if interruption == "abort" else Mode.STOP)
    assert off(held[-1], TARGET) > 0.05
    waiting = [s.command.x_d for s in held if s.command.mode is held[-1].command.mode]
    np.testing.assert_array_equal(waiting[0], waiting[-1])
    cell.apply(Release() if interruption == "abort" else Resume())
    after = run(cell, 6.0)
    assert after[-1].command.mode is Mode.IDLE
    assert off(after[-1], TARGET) < 5e-3
    assert accelerations(after).max() < BOUND


def test_a_push_while_following_is_answered_in_the_null_space():
    cell = following()
    run(cell, 0.3)
    cell.apply(MoveTarget(TARGET))
    cell.apply(Push(4, (0.06, 0.0, 0.05), (0.0, -15.0, 0.0)))
    snapshots = run(cell, 4.0)
    assert Mode.RELAX in {s.command.mode for s in snapshots}
    assert Mode.ABORT not in {s.command.mode for s in snapshots}
    assert off(snapshots[-1], TARGET) < 5e-3


def refused(cell: Cell, event: Event) -> str:
    before = cell.aim
    with pytest.raises(HrcError) as error:
        cell.apply(event)
    assert not any(cell.step().events for _ in range(10))
    assert cell.aim.kind == before.kind
    assert (cell.aim.target is None) == (before.target is None)
    if cell.aim.target is not None and before.target is not None:
        np.testing.assert_array_equal(cell.aim.target, before.target)
    return str(error.value)


def test_what_cannot_be_done_says_what_can_and_changes_nothing():
    cell = following()
    assert "the arm is 0." in refused(cell, MoveTarget((-0.9, 0.9, 0.9)))
    assert "leads through the table" in refused(cell, MoveTarget((-0.5, 0.1, 0.005)))
    assert "unknown task" in refused(cell, SetTask("hexagone"))
    assert "task.waypoints names no file" in refused(cell, SetTask("waypoints"))
    assert "joint 4 of the posture must be from -120 to 120 deg" in refused(cell, SetPosture((0, 0, 0, 2.4, 0, 0, 0)))
    assert 'the task is "hexagon"' in refused(quick("hexagon"), MoveTarget(TARGET))


@pytest.mark.parametrize(("kind", "values", "complaint"), [
    (MoveTarget, ((0.0, float("nan"), 0.5),), "3 finite numbers"),
    (MoveTarget, ((0.0, 0.5),), "3 finite numbers"),
    (MoveTarget, ((0.0, 0.5, 1e9),), "up to 5"),
    (MoveTarget, ("abc",), "3 numbers"),
    (SetPosture, ((0.0,) * 6,), "7 finite numbers"),
    (SetPosture, ((0.0,) * 6 + (float("inf"),),), "7 finite numbers"),
    (SetTask, (3,), "must be text"),
])
def test_a_value_that_is_none_is_refused_where_it_is_made(kind, values, complaint):
    with pytest.raises(HrcError, match=complaint):
        kind(*values)


@pytest.mark.parametrize("event", [SetTask("circle"), MoveTarget(TARGET), SetPosture((0.1,) * 7)])
def test_events_come_back_from_their_dict(event):
    assert from_dict(to_dict(event)) == event


@pytest.mark.parametrize("target", [(0.25, -0.41, 0.2), (-0.15, 0.0, 0.35)])
def test_an_arm_that_cannot_get_there_stands_still_as_near_as_it_comes(target):
    """Behind the base, and too near to it."""
    cell = following()
    run(cell, 0.2)
    cell.apply(MoveTarget(target))
    snapshots = run(cell, 5.5)
    end = snapshots[-1]
    assert off(end, target) > 0.02
    assert off(end, end.aim.goal) < 5e-3
    assert np.abs([s.command.dq for s in snapshots[-200:]]).max() < 5e-3
    assert (end.state.q > LIMITS.q_min).all()
    assert (end.state.q < LIMITS.q_max).all()
    assert {s.command.mode for s in snapshots} == {Mode.IDLE}
    cell.apply(MoveTarget(TARGET))
    assert off(run(cell, 5.0)[-1], TARGET) < 5e-3, "it comes away from there"


def test_a_posture_is_taken_without_leaving_the_target():
    cell = following()
    q = run(cell, 0.5)[-1].state.q
    cell.apply(SetPosture(tuple(q + np.array([0.5, 0, -0.5, 0, 0, 0, 0.5]))))
    snapshots = run(cell, 4.0)
    assert max(off(s, cell.config.task.centre) for s in snapshots) < 1e-3
    assert np.abs([s.command.dq for s in snapshots]).max() < 1.0
    assert abs(snapshots[-1].state.q[6] - q[6] - 0.5) < 0.1
    np.testing.assert_allclose(snapshots[-1].aim.q_d, q + np.array([0.5, 0, -0.5, 0, 0, 0, 0.5]))


def test_speeds_are_live_and_reset_forgets_the_steering():
    cell = following()
    cell.apply(SetParameter("task.approach", 0.05))
    cell.apply(MoveTarget(TARGET))
    x_d = np.array([s.command.x_d for s in run(cell, 1.5)])
    assert np.linalg.norm(np.diff(x_d, axis=0), axis=1).max() < 1.01 * 0.05 * 0.005
    cell.apply(Reset())
    assert (cell.aim.target == np.array(cell.config.task.centre)).all()


def test_same_seed_and_events_same_bits():
    events = {200: MoveTarget(TARGET), 700: SetPosture((0.2, 0.5, 0.0, -1.4, 0.0, 1.2, 0.0)), 900: SetTask("hexagon"),
              1300: SetTask("follow"), 1350: MoveTarget((-0.6, 0.0, 0.4))}
    digests = []
    for _ in range(2):
        cell, sha = Cell(replaced(Config(), "task.kind", "follow")), hashlib.sha256()
        for tick in range(1700):
            if tick in events:
                cell.apply(events[tick])
            s = cell.step()
            for part in (s.state.q, s.command.dq, s.command.x_d):
                assert np.isfinite(part).all()
                sha.update(part.tobytes())
        digests.append(sha.hexdigest())
    assert digests[0] == digests[1]
