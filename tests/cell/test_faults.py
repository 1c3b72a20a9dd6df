"""Sensors that fail on purpose: each fault has its outcome, and none is taken for a contact or goes unnoticed."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from hrc.cell.cell import Cell
from hrc.config import Config, ideal
from hrc.events import MoveObstacle, Reset, Resume, SetParameter
from hrc.messages import Mode, Snapshot
from hrc.sim.depth_camera import SensorConfig

AWAY = MoveObstacle("ball", (-0.2, -0.7, 0.6))


def go(cell: Cell, seconds: float) -> list[Snapshot]:
    return [cell.step() for _ in range(round(1000 * seconds))]


def until(cell: Cell, true: Callable[[Snapshot], bool], seconds: float) -> float:
    """How long it takes [s]; fails if it does not come true in time."""
    begin = cell.tick
    for snapshot in (cell.step() for _ in range(round(1000 * seconds))):
        if true(snapshot):
            return (cell.tick - begin) / 1000.0
    raise AssertionError("it did not come true")


@cache
def made(config: Config) -> Cell:
    return Cell(config)


def running(config: Config | None = None) -> Cell:
    """A cell on its path."""
    cell = made(config or Config())
    cell.apply(Reset())
    go(cell, 0.6)
    assert cell.command.mode is Mode.IDLE
    return cell


def test_a_frozen_camera_is_silent_before_the_arm_has_moved_far() -> None:
    cell = running()
    cell.apply(SetParameter("sensor.frozen", True))
    before = cell.command.x
    took = until(cell, lambda s: s.command.mode is Mode.BLIND, 1.0)
    assert 0.2 < took < 0.5
    assert "repeats one image although the robot has moved" in cell.command.reason
    go(cell, 0.5)
    assert np.linalg.norm(cell.command.x - before) < 0.1
    assert all(view.silent for view in cell.views)
    assert cell.step().command.mode is Mode.BLIND, "while it stands, too"
    cell.apply(SetParameter("sensor.frozen", False))
    until(cell, lambda s: s.command.mode is Mode.IDLE and s.command.path_speed > 0.5, 5.0)


def test_a_frozen_camera_is_no_reason_to_flee_from_the_robots_own_old_image() -> None:
    cell = running()
    cell.apply(SetParameter("sensor.frozen", True))
    assert {s.command.mode for s in go(cell, 2.0)} == {Mode.IDLE, Mode.BLIND}


def test_a_perfect_camera_of_an_arm_that_stands_is_not_frozen() -> None:
    config = ideal().replace(task=Config().task.replace(kind="hold"), sensor=Config().sensor.replace(
        noise=0.0, flying=0.0, dropout=0.0))
    cell = running(config)
    snapshots = go(cell, 1.0)
    frames = {view.frame.depth.tobytes() for s in snapshots if s.fresh_frame for view in s.views if view.frame is not None}
    assert len(frames) < 5, "it repeats itself indeed"
    assert {s.command.mode for s in snapshots} == {Mode.IDLE}


def test_one_frozen_camera_of_two_leaves_the_other() -> None:
    cell = running(Config(scene="two_cameras"))
    cell._eyes._eyes[0]._sensor.configure(SensorConfig(frozen=True))
    go(cell, 1.0)
    assert [view.silent for view in cell.views] == [True, False]
    assert cell.command.mode is Mode.IDLE


def test_images_that_come_300_ms_late_say_nothing_about_now() -> None:
    cell = running()
    cell.apply(SetParameter("sensor.latency", 9))
    until(cell, lambda s: s.command.mode is Mode.BLIND, 1.0)
    snapshots = go(cell, 1.0)
    assert {s.command.mode for s in snapshots} == {Mode.BLIND}
    assert "0.30 s old when they arrive" in cell._eyes.blindness(cell.tick)
    assert all(s.clearances == () for s in snapshots[500:]), "no distance of then is taken for one of now"
    cell.apply(SetParameter("sensor.latency", 2))
    until(cell, lambda s: s.command.mode is Mode.IDLE, 2.0)


@pytest.mark.parametrize(("preset", "key", "joint", "told"), [
    (Config, "fault.torque_nan", 3, "not finite"), (Config, "fault.torque_stuck", 2, "torque sensor of joint 2"),
    (ideal, "fault.torque_stuck", 6, "torque sensor of joint 6"),
    (ideal, "fault.position_stuck", 2, "position sensor of joint 2"),
    (Config, "fault.position_stuck", 4, "position sensor of joint 4")])
def test_a_joint_sensor_that_fails_stops_the_arm_until_it_is_well(
        preset: Callable[[], Config], key: str, joint: int, told: str) -> None:
    cell = running(preset())
    cell.apply(AWAY)
    cell.apply(SetParameter(key, joint))
    assert until(cell, lambda s: s.command.mode is Mode.STOP, 3.0) < 2.0
    assert told in cell.command.reason
    cell.apply(Resume())
    until(cell, lambda s: s.command.mode is Mode.STOP, 3.0)
    go(cell, 0.3)
    assert np.abs(cell.command.dq).max() == 0.0
    assert np.isfinite(cell.residual).all()
    cell.apply(SetParameter(key, 0))
    go(cell, 0.1)
    cell.apply(Resume())
    snapshots = go(cell, 1.5)
    assert snapshots[-1].command.mode is Mode.IDLE
    assert Mode.STOP not in {s.command.mode for s in snapshots[10:]}


@pytest.mark.parametrize("preset", [Config, ideal])
def test_no_sound_sensor_is_called_stuck(preset: Callable[[], Config]) -> None:
    config = preset()
    cell = running(config.replace(plant=config.plant.replace(encoder_step=5e-5)))
    assert Mode.STOP not in {s.command.mode for s in go(cell, 5.0)}
