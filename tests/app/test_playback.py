"""A replay with other parameters plays what the robot measured: it moves no robot, and without a change no bit is another."""

import shutil
import threading

import numpy as np
import pytest

pytest.importorskip("rerun")

from app.__main__ import main
from app.headless import Job as Run
from app.headless import execute as run
from app.open_loop import Job, execute
from app.record.folder import SessionError
from app.record.tape import EXPOSURES, ROBOT
from hrc.messages import Mode
from hrc.sim.depth_camera import DepthCamera
from hrc.sim.robot import SimulatedRobot


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("playback") / "out"
    run(Run("push", out, duration=5.6, depth="full", quiet=True))
    return out


def never(real):
    """Fails where the replay runs; the page of other tests goes on in a thread of its own."""
    here = threading.get_ident()

    def call(*arguments):
        assert threading.get_ident() != here, "not in a replay"
        return real(*arguments)

    return call


@pytest.mark.parametrize("depth", ["rendered", "recorded"])
def test_from_either_depth_it_gives_every_bit_and_moves_no_robot(folder, depth, monkeypatch):
    monkeypatch.setattr(SimulatedRobot, "step", never(SimulatedRobot.step))
    if depth == "recorded":
        monkeypatch.setattr(DepthCamera, "keep", never(DepthCamera.keep))
    replay = execute(Job(folder, depth=depth))
    assert (replay.columns["state"] == Mode.RELAX).any()
    assert replay.changed is None


def test_another_image_is_seen(folder, monkeypatch):
    monkeypatch.setattr("app.record.images.MILLIMETRE", np.float32(0.00101))
    monkeypatch.setattr("app.open_loop._in_millimetres", lambda _: True)
    assert execute(Job(folder, depth="recorded")).changed.signals


def test_an_abort_ends_although_the_arm_does_not_move_as_commanded(folder):
    mode = execute(Job(folder, ("control.f_abort=6",))).columns["state"]
    assert (mode == Mode.ABORT).sum() > 100
    assert mode[-1] == Mode.IDLE


def test_without_a_tape_the_session_runs_again_first(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "copy")
    (copy / EXPOSURES).unlink()
    with pytest.raises(SessionError, match="cannot be read"):
        execute(Job(copy))
    (copy / ROBOT).unlink()
    assert execute(Job(copy)).changed is None


@pytest.mark.parametrize("depth", ["rendered", "recorded"])
def test_each_camera_gets_its_own_images(depth, tmp_path):
    run(Run("free", tmp_path / "out", duration=0.5, preset="two_cameras", depth="full", quiet=True))
    assert execute(Job(tmp_path / "out", depth=depth)).changed is None


def test_images_that_were_not_kept_are_said_to_be_missing(tmp_path, capsys):
    run(Run("free", tmp_path / "out", duration=0.4, quiet=True))
    with pytest.raises(SystemExit) as exit_:
        main(["replay", str(tmp_path / "out"), "--depth", "recorded"])
    assert exit_.value.code == 2
    assert "--depth full" in capsys.readouterr().err
    run(Run("free", tmp_path / "fine", duration=0.4, quiet=True, depth="full", settings=("sensor.quantum=0.0005",)))
    assert execute(Job(tmp_path / "fine")).changed is None
    with pytest.raises(SessionError, match="whole mm"):
        execute(Job(tmp_path / "fine", depth="recorded"))
