"""A recording that is long, has no room left, or meets another one at its place."""

import contextlib
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rerun")

from test_record import column, recorder_of
from test_repair import ticks_of
from vclient import until

from app.headless import Job, execute
from app.output import OutputError
from app.record.recorder import RecordingError
from app.record.repair import look
from app.review import recordings
from hrc.cell import pace, scenario
from hrc.cell.cell import Cell
from hrc.cell.run import Inbox, run
from hrc.events import MoveObstacle, Reset, SetParameter

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")


def held(folder: Path) -> set[str] | None:
    """The recordings in a folder that this process has open; None where the system does not tell."""
    own = Path("/proc/self/fd")
    if not own.is_dir():
        return None
    paths = []
    for link in own.iterdir():
        with contextlib.suppress(OSError):
            paths.append(link.readlink())
    return {path.name for path in paths if path.parent == folder and path.suffix == ".rrd"}


def test_a_long_recording_goes_on_in_another_file_and_loses_nothing(tmp_path):
    cell, inbox = Cell(), Inbox(scenario.load("push"))
    inbox.put(MoveObstacle("ball", (-1.0, 0.6, 0.5)))
    with recorder_of(cell, tmp_path / "session.rrd", depth="none", rotate=1.0, wait=True) as recorder:
        run(cell, pace.FreeRun(), inbox, [recorder], until=2600)
        until(lambda: len(recorder.paths) == 3)
        until(lambda: held(tmp_path) in ({"session_3.rrd"}, None))
    assert [path.name for path in recorder.paths] == ["session.rrd", "session_2.rrd", "session_3.rrd"]
    assert recordings([tmp_path]) == recorder.paths
    assert all(look(path).finished for path in recorder.paths)
    np.testing.assert_array_equal(np.concatenate([ticks_of(path) for path in recorder.paths]), np.arange(5, 2601, 5))
    from rerun.chunk import RrdReader

    assert len({RrdReader(str(path)).recordings()[0].recording_id for path in recorder.paths}) == 1
    readers = [RrdReader(str(path)) for path in recorder.paths]
    layouts = [sorted(chunk.entity_path for chunk in reader.stream(store=reader.blueprints()[0])) for reader in readers]
    assert len(layouts[0]) > 20
    assert layouts[0] == layouts[1] == layouts[2], "each opens in the same layout"
    assert [len(reader.recordings()) for reader in readers] == [1, 1, 1]
    last = recorder.paths[2]
    assert column(last, "/state/mode", "StateChange:state")[1][0] in (["idle"], ["relax"]), "known from its start"
    assert column(last, "/world/obstacles/ball", "Ellipsoids3D:half_sizes")[1][0] != [], "there from its start"
    assert len(column(last, "/world/robot/link_5", "Mesh3D:albedo_factor")[1]) >= 1


def test_after_a_reset_its_clock_goes_on(tmp_path):
    cell, inbox, done = Cell(), Inbox(), []

    class Push:
        def on_step(self, _):
            done.append(1)
            if len(done) == 200:
                inbox.put(SetParameter("control.f_relax", 6.0))
            if len(done) == 400:
                inbox.put(Reset())

    with recorder_of(cell, tmp_path / "session.rrd", depth="full", wait=True) as recorder:
        run(cell, pace.FreeRun(), inbox, [recorder, Push()], until=10**6, stopped=lambda: len(done) >= 1000)
    assert ticks_of(tmp_path / "session.rrd").tolist() == list(range(5, 1001, 5))
    images, _ = column(tmp_path / "session.rrd", "/world/cameras/camera/depth", "EncodedDepthImage:blob")
    assert np.diff(images).min() > 30
    assert max(images) > 800
    _, curves = column(tmp_path / "session.rrd", "/plots/force", "Scalars:scalars")
    assert [curve[2] for curve in curves] == [5.0] * 40 + [6.0] * 40 + [5.0] * 120
    assert column(tmp_path / "session.rrd", "/state/mode", "StateChange:state")[0] == [1], "idle before and after"


def test_a_second_recorder_at_the_same_place_is_refused_and_the_first_goes_on(tmp_path):
    cell = Cell()
    with recorder_of(cell, tmp_path / "session.rrd", wait=True) as recorder:
        run(cell, pace.FreeRun(), Inbox(), [recorder], until=300)
        with pytest.raises(RecordingError, match="exists"):
            recorder_of(cell, tmp_path / "session.rrd")
        run(cell, pace.FreeRun(), Inbox(), [recorder], until=600)
    assert len(ticks_of(tmp_path / "session.rrd")) == 120


@pytest.fixture
def small(tmp_path):
    """A file system of 12 MB."""
    place = tmp_path / "small"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=12m", "tmpfs", str(place)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("only root may mount a small file system")
    yield place
    subprocess.run(["umount", str(place)], check=True)


@pytest.mark.parametrize(("reserve", "told"), [(0, "less than 4 MB"), (6_000_000, "less than 6 MB")])
def test_a_disk_that_fills_up_ends_the_recording_with_a_file_that_opens_and_the_robot_goes_on(small, reserve, told):
    cell = Cell()
    recorder = recorder_of(cell, small / "session.rrd", depth="full", reserve=reserve)
    stopped = []

    class Watch:
        def on_step(self, snapshot):
            if recorder.stopped and not stopped:
                stopped.append(snapshot.tick)

    run(cell, pace.FreeRun(), Inbox(scenario.load("push")), [recorder, Watch()], until=12000)
    assert cell.tick == 12000
    assert stopped, "it was known while the robot ran"
    with pytest.raises(RecordingError, match=told):
        recorder.close()
    found, ticks = look(small / "session.rrd"), ticks_of(small / "session.rrd")
    assert found.finished
    assert not found.torn
    assert len(ticks) > 50
    np.testing.assert_array_equal(ticks, np.arange(5, ticks[-1] + 1, 5), "without a gap")


def test_a_run_without_room_for_its_folder_says_so_and_leaves_nothing(small):
    (small / "else").write_bytes(bytes(12_500_000))
    with pytest.raises(OutputError, match="No space"):
        execute(Job("free", small / "out", duration=1.0, record=False, quiet=True))
    assert [path.name for path in small.iterdir()] == ["else"]


@pytest.mark.timeout(60)
def test_a_folder_that_goes_ends_the_recording_with_a_reason_and_the_run_does_not_wait_for_it(tmp_path):
    cell, place = Cell(), tmp_path / "place"
    place.mkdir()
    recorder = recorder_of(cell, place / "session.rrd", depth="none", wait=True)
    run(cell, pace.FreeRun(), Inbox(), [recorder], until=300)
    assert recorder.problem == ""
    shutil.rmtree(place)
    run(cell, pace.FreeRun(), Inbox(), [recorder], until=4000)
    assert "No such file" in recorder.problem
    with pytest.raises(RecordingError, match="No such file"):
        recorder.close()


@pytest.mark.timeout(60)
def test_a_worker_that_dies_keeps_nobody_waiting(tmp_path, monkeypatch):
    cell = Cell()
    recorder = recorder_of(cell, tmp_path / "session.rrd", depth="full", wait=True)
    run(cell, pace.FreeRun(), Inbox(), [recorder], until=300)
    monkeypatch.setattr(recorder, "_guarded", None)  # it has never been seen to die by itself
    run(cell, pace.FreeRun(), Inbox(), [recorder], until=3000)
    assert "not complete" in recorder.problem
    with pytest.raises(RecordingError, match="not complete"):
        recorder.close()
    assert look(tmp_path / "session.rrd").finished


def test_an_end_that_fails_leaves_a_file_that_opens(tmp_path, monkeypatch):
    cell = Cell()
    recorder = recorder_of(cell, tmp_path / "session.rrd", depth="none", wait=True, reserve=10**18)

    def fails():
        raise RuntimeError("flush failed")

    monkeypatch.setattr(recorder._writer, "flush", fails)
    run(cell, pace.FreeRun(), Inbox(), [recorder], until=1000)
    with pytest.raises(RecordingError, match="MB of disk are free"):
        recorder.close()
    assert look(tmp_path / "session.rrd").finished
