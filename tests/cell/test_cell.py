"""One cell, one clock: the same seed and events give the same bits, and nothing stops it but a stop."""

import hashlib
from typing import Any

import numpy as np
import pytest

from hrc.cell.cell import Cell
from hrc.cell.eyes import Sighting
from hrc.cell.pace import FreeRun, RealTime
from hrc.cell.run import Inbox, run
from hrc.cell.scenario import load
from hrc.config import PRESETS, Config
from hrc.errors import ConfigError, DeviceError, HrcError
from hrc.events import MoveObstacle, Pull, Release, Reset, Resume, SetParameter, Stop
from hrc.messages import Mode, Snapshot
from hrc.parameters import replaced


class Hash:
    """Everything a run measured, estimated and commanded, as one number."""

    def __init__(self) -> None:
        self._sha = hashlib.sha256()

    def on_step(self, s: Snapshot) -> None:
        parts: list[np.ndarray] = [s.state.q, s.state.tau, s.command.dq, s.residual, s.truth.F_world]
        if s.nearest is not None:
            parts += [s.nearest.p_world, np.array([s.nearest.distance])]
        parts += [np.array([c.distance, *c.p_robot, *c.p_obstacle]) for c in s.clearances]
        for part in parts:
            assert np.isfinite(part).all()
            self._sha.update(np.ascontiguousarray(part).tobytes())
        for view in s.views:
            if s.fresh_frame and view.frame is not None:
                self._sha.update(view.frame.depth.tobytes())
        self._sha.update(s.command.mode.encode())

    @property
    def value(self) -> str:
        return self._sha.hexdigest()


EVENTS = {
    300: [MoveObstacle("ball", (-0.35, 0.4, 0.6))],
    500: [MoveObstacle("ball", (-0.35, -0.1, 0.6))],
    900: [SetParameter("control.f_abort", 20.0)],
    1000: [Pull(3, (0.0, -0.08, -0.07), (-0.2, 0.2, 0.6))],
    1400: [Release()],
}


class Timed(Inbox):
    def take(self, tick: int):
        return [*EVENTS.get(tick, ()), *super().take(tick)]


def hashed(config: Config, pacer, *, until: int = 1500, extra=()) -> str:
    digest = Hash()
    run(Cell(config), pacer, Timed(), [digest, *extra], until=until)
    return digest.value


def test_same_seed_same_bits_headless_or_live_observed_or_not():
    first = hashed(Config(), FreeRun(50))
    assert hashed(Config(), FreeRun(7), extra=[Hash()]) == first
    assert hashed(Config(), RealTime(1000, speed=4.0)) == first
    assert hashed(Config(seed=1), FreeRun(50)) != first


def test_a_reset_is_a_fresh_start():
    cell, digests = Cell(), []
    for _ in range(2):
        digest = Hash()
        run(cell, FreeRun(), Inbox(load("push")), [digest], until=1200)
        digests.append(digest.value)
        cell.apply(Reset())
        assert cell.tick == 0
    assert digests[0] == digests[1]


def test_a_reset_replays_the_script_from_its_very_beginning(tmp_path):
    file = tmp_path / "early.toml"
    file.write_text('duration = 1\n[[event]]\nt = 0\ntype = "MoveObstacle"\nname = "ball"\nposition = [0.0, 0.6, 0.3]\n')
    cell, inbox, events = Cell(), Inbox(load(file)), []

    class Watch:
        def on_step(self, s: Snapshot) -> None:
            events.extend(map(type, s.events))

    run(cell, FreeRun(), inbox, [Watch()], until=20)
    inbox.put(Reset())
    run(cell, FreeRun(7), inbox, [Watch()], until=27)
    assert events == [MoveObstacle, Reset, MoveObstacle]
    assert any(body.present for body in cell.step().bodies)


def test_an_event_that_cannot_be_is_refused_and_changes_nothing():
    cell, inbox = Cell(), Inbox()
    before = cell.config
    refused = []

    class Watch:
        def on_step(self, s: Snapshot) -> None:
            refused.extend(reason for _, reason in s.refused)

    for event in (SetParameter("control.f_abort", -1.0), SetParameter("control.f_abrt", 1.0), SetParameter("seed", 3),
                  MoveObstacle("balloon", (0.0, 0.0, 1.0))):
        inbox.put(event)
    run(cell, FreeRun(), inbox, [Watch()], until=5)
    assert cell.config == before
    assert len(refused) == 4
    assert "from 1 to 150 N" in refused[0]
    assert "did you mean control.f_abort" in refused[1]
    assert "cannot change while the cell runs" in refused[2]
    assert 'unknown obstacle "balloon"; did you mean ball' in refused[3]


def test_a_live_parameter_reaches_the_part_that_uses_it():
    cell = Cell()
    cell.apply(SetParameter("control.f_abort", 33.0))
    cell.apply(SetParameter("push.stiffness", 400.0))
    assert cell.config.control.f_abort == 33.0
    point = (0.0, 0.0, -0.07)
    cell.step()
    here = cell._robot.point(3, np.array(point))
    cell.apply(Pull(3, point, (float(here[0]), float(here[1]) + 0.02, float(here[2]))))
    for _ in range(5):
        snapshot = cell.step()
    assert np.linalg.norm(snapshot.truth.F_world) == pytest.approx(8.0, rel=0.15)


def test_nan_from_the_robot_stops_it_and_keeps_the_last_second(monkeypatch):
    cell = Cell()
    for _ in range(1200):
        cell.step()
    real = cell._robot._sensor.read
    monkeypatch.setattr(cell._robot._sensor, "read", lambda *_: np.full(7, np.nan))
    for _ in range(20):
        snapshot = cell.step()
    assert snapshot.command.mode is Mode.STOP
    assert "not finite" in snapshot.command.reason
    assert "tau" in snapshot.command.reason
    assert np.isfinite(snapshot.residual).all()
    assert len(cell.history) == 200
    monkeypatch.setattr(cell._robot._sensor, "read", real)
    cell.apply(Resume())
    worst = 0.0
    for _ in range(400):
        snapshot = cell.step()
        worst = max(worst, float(np.abs(snapshot.residual / np.array(cell.config.observer.r_low)).max()))
    assert snapshot.command.mode is Mode.IDLE
    assert worst < 1.0, "the gap must not look like a contact"


def test_a_frame_with_nan_is_dropped_and_the_next_one_used(monkeypatch):
    cell = Cell()
    for _ in range(300):
        cell.step()
    sensor: Any = cell._eyes._eyes[0]._sensor  # a DepthCamera
    real, spoiled = sensor._noise.image, []

    def broken():
        image = real()
        if len(spoiled) < 2:
            image[100, 100] = np.nan
            spoiled.append(1)
        return image

    monkeypatch.setattr(sensor._noise, "image", broken)
    modes = {cell.step().command.mode for _ in range(500)}
    assert len(spoiled) == 2
    assert modes == {Mode.IDLE}


def test_a_camera_that_delivers_only_nan_is_silent_and_the_path_waits(monkeypatch):
    cell = Cell()
    for _ in range(300):
        cell.step()
    sensor: Any = cell._eyes._eyes[0]._sensor  # a DepthCamera
    real = sensor._noise.image
    monkeypatch.setattr(sensor._noise, "image", lambda: np.full_like(real(), np.nan))
    for _ in range(600):
        snapshot = cell.step()
    assert snapshot.command.mode is Mode.BLIND
    assert "the depth image holds NaN" in snapshot.command.reason
    assert snapshot.views[0].silent
    monkeypatch.setattr(sensor._noise, "image", real)
    for _ in range(600):
        snapshot = cell.step()
    assert snapshot.command.mode is Mode.IDLE
    assert not snapshot.views[0].silent


def test_without_a_camera_the_arm_waits_on_its_path_and_yields_in_its_joints():
    """Frames stop coming: what the last one showed says nothing any more, and a contact counts as not seen."""
    cell = Cell()
    cell.apply(MoveObstacle("ball", (-0.2, -0.7, 0.6)))
    for _ in range(400):
        cell.step()
    cell.apply(SetParameter("sensor.unplugged", True))
    for _ in range(900):
        snapshot = cell.step()
    assert snapshot.command.mode is Mode.BLIND
    assert snapshot.command.path_speed == 0.0
    assert np.abs(snapshot.command.dq).max() < 0.01
    assert snapshot.clearances == ()
    assert snapshot.nearest is None
    cell.apply(MoveObstacle("ball", (-0.2, 0.3, 0.6)))
    snapshots = [cell.step() for _ in range(2500)]
    assert {s.command.mode for s in snapshots} & {Mode.UNSEEN, Mode.RELAX}
    assert not any(s.contact.seen for s in snapshots if s.contact is not None)
    cell.apply(MoveObstacle("ball", (-0.2, -0.7, 0.6)))
    cell.apply(SetParameter("sensor.unplugged", False))
    for _ in range(5000):
        snapshot = cell.step()
    assert snapshot.command.mode is Mode.IDLE
    assert snapshot.command.path_speed > 0.0


def test_a_path_out_of_reach_is_refused():
    config = Config()
    with pytest.raises(ConfigError, match="cannot reach"):
        Cell(config.replace(task=config.task.replace(centre=(1.2, 1.2, 1.2))))


def test_stop_and_resume_are_events():
    cell = Cell()
    for _ in range(500):
        cell.step()
    cell.apply(Stop("by hand"))
    for _ in range(500):
        snapshot = cell.step()
    assert snapshot.command.mode is Mode.STOP
    np.testing.assert_allclose(snapshot.state.dq, 0.0, atol=0.01)
    cell.apply(Resume())
    for _ in range(20):
        snapshot = cell.step()
    assert snapshot.command.mode is Mode.IDLE


def test_presets_are_built_and_differ():
    trees = {name: make() for name, make in PRESETS.items()}
    assert trees["paper"].control.k_f == 0.05
    assert trees["paper"].vision.mode == "paper"
    assert trees["literal"].control.law == "printed"
    assert trees["ideal"].plant.torque_noise == 0.0
    assert trees["harsh"].plant.payload > 0.0
    assert trees["two_cameras"].scene == "two_cameras"
    assert trees["realistic"] == trees["default"]
    assert len(set(map(repr, trees.values()))) == len(trees) - 1


def test_an_unknown_device_is_one_clear_error():
    with pytest.raises(DeviceError, match="cpu"):
        Cell(device="cuda:7")
    assert issubclass(DeviceError, HrcError)
    assert issubclass(ConfigError, HrcError)


@pytest.mark.parametrize("felt_radius", [0.0, 0.2], ids=["reflex", "felt"])
def test_an_arm_that_sees_nothing_does_not_keep_pressing(monkeypatch, felt_radius):
    """A ball that no camera sees stands in the wrist's way: one bump, then a wary touch now and then."""
    cell = Cell(replaced(Config(), "tracker.felt_radius", felt_radius))
    for _ in range(1500):
        cell.step()
    monkeypatch.setattr(cell._eyes, "localize", lambda *_: Sighting())
    cell.apply(MoveObstacle("ball", (-0.55, -0.23, 0.53)))
    snapshots = [cell.step() for _ in range(8000)]
    force = np.array([np.linalg.norm(s.truth.F_world) for s in snapshots])
    touched = int(np.argmax(force > 1.0))
    modes = {s.command.mode for s in snapshots}
    assert (Mode.UNSEEN if felt_radius == 0.0 else Mode.RELAX) in modes
    assert 5.0 < force.max() < 60.0
    assert force[touched + 2000:].max() < (20.0 if felt_radius == 0.0 else 30.0)
    assert force[touched + 2000:].max() > 1.0, "the ball still stands there"
