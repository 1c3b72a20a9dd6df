"""A recording survives the death of its writer: what is on the disk opens again, and little is missing."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rerun")

from process import launched
from rerun.chunk import RrdReader

from app.__main__ import main
from app.record.recorder import Depth, Recorder
from app.record.repair import RepairError, look, repair
from hrc.cell import pace, scenario
from hrc.cell.cell import Cell
from hrc.cell.eyes import rig
from hrc.cell.run import Inbox, run
from hrc.parameters import keys
from hrc.vision.camera import Camera

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")
KILLS = int(os.environ.get("ELBOWROOM_KILLS", "20"))
LOST = 0.5
"""What a kill may cost [s]."""
LIVE = """
import os, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from hrc.cell import pace
from hrc.cell.cell import Cell
from hrc.cell.run import Inbox, run
from hrc.config import PRESETS

class Tell:
    def on_step(self, snapshot):
        if snapshot.fresh_control:
            os.write(1, b"%d\\n" % snapshot.tick)

cell = Cell(PRESETS["two_cameras"]())
for path in sys.stdin:
    recording = os.fork()  # the SDK and its threads come to life in the child
    if not recording:
        from test_repair import recorder_of
        recorder = recorder_of(cell, Path(path.strip()))
        os.write(1, b"recording %d\\n" % os.getpid())
        run(cell, pace.RealTime(), Inbox(), [recorder, Tell()], until=10**9)
    os.waitpid(recording, 0)
    os.write(1, b"over\\n")
"""


def recorder_of(cell, path, depth: Depth = "full"):
    cameras = {setup.name: Camera(setup.camera) for setup in rig(cell.config, cell.scene)}
    return Recorder(path, base_hz=cell.config.rates.base_hz, scene=cell.scene, cameras=cameras,
                    parameters=keys(cell.config), about={}, depth=depth)


def ticks_of(path):
    """The ticks of the control cycles that a recording holds."""
    found = [np.asarray(chunk.to_record_batch().column("step"))
             for chunk in RrdReader(str(path)).stream().filter(content=["/signals/q"])
             if chunk.entity_path == "/signals/q" and not chunk.is_static]
    return np.sort(np.concatenate(found)) if found else np.zeros(0, int)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "session.rrd"
    cell = Cell()
    with recorder_of(cell, path, "sampled") as recorder:
        run(cell, pace.FreeRun(), Inbox(scenario.load("push")), [recorder], until=1500)
    return path


def test_a_whole_recording_stays_as_it_is(whole, capsys):
    before = whole.read_bytes()
    main(["repair", str(whole)])
    assert "is whole" in capsys.readouterr().out
    assert whole.read_bytes() == before
    assert len(ticks_of(whole)) == 300


@pytest.mark.parametrize("share", [0.3, 0.77, 0.999])
def test_cut_anywhere_it_opens_again_with_what_came_before(whole, tmp_path, share, capsys):
    data, cut = whole.read_bytes(), tmp_path / "cut.rrd"
    cut.write_bytes(data[: int(share * len(data))])
    assert look(cut).torn
    main(["repair", str(cut)])
    assert "cut" in capsys.readouterr().out
    assert cut.read_bytes() == data[: cut.stat().st_size], "nothing but cut"
    kept = ticks_of(cut)
    np.testing.assert_array_equal(kept, ticks_of(whole)[: len(kept)])
    assert len(kept) > (0 if share < 0.5 else 100)
    assert not repair(cut).torn


def test_cut_in_its_last_bytes_it_opens_with_everything(whole, tmp_path):
    data, cut, end = whole.read_bytes(), tmp_path / "cut.rrd", look(whole).end
    for size in (end, end + 1, end + 15, end + 16, end + 40, len(data) - 33, len(data) - 32, len(data) - 31, len(data) - 1):
        cut.write_bytes(data[:size])
        repair(cut)
        assert cut.stat().st_size == end
        np.testing.assert_array_equal(ticks_of(cut), ticks_of(whole))


def test_what_is_no_recording_is_left_alone(tmp_path, capsys):
    file = tmp_path / "thesis.rrd"
    file.write_bytes(b"years of work")
    with pytest.raises(SystemExit) as exit_:
        main(["repair", str(file)])
    assert exit_.value.code == 2
    assert "no recording" in capsys.readouterr().err
    assert file.read_bytes() == b"years of work"
    with pytest.raises(RepairError, match="cannot be read"):
        repair(tmp_path / "nothing.rrd")
    file.write_bytes(b"RRF2\0\0\0\0\0\0\0\0" + b"\1" * 10)
    with pytest.raises(RepairError, match="no whole message"):
        repair(file)


@pytest.mark.timeout(60 + 30 * KILLS)
def test_a_killed_recorder_leaves_a_recording_that_opens_and_misses_half_a_second_at_most(tmp_path):
    """Two cameras, every image. ELBOWROOM_KILLS: how often."""
    rng, torn, missing = np.random.default_rng(), 0, []
    command = [sys.executable, "-c", LIVE, str(Path(__file__).parent)]
    with launched(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=1) as process:
        for kill in range(KILLS):
            path = tmp_path / f"{kill}.rrd"
            process.stdin.write(f"{path}\n")
            recording = int(process.stdout.readline().removeprefix("recording "))
            deadline, last = time.monotonic() + rng.uniform(0.3, 1.2), 0
            while time.monotonic() < deadline:
                last = int(process.stdout.readline())
            os.kill(recording, signal.SIGKILL)
            while (line := process.stdout.readline()) != "over\n":
                last = int(line)
            torn += repair(path).torn > 0
            kept = ticks_of(path)
            np.testing.assert_array_equal(kept, 5 * np.arange(1, len(kept) + 1), "without a gap")
            missing.append((last - 5 * len(kept)) / 1000.0)
            path.unlink()
        process.stdin.close()
    print(f"{KILLS} kills, {torn} torn; missing [s]: {' '.join(f'{m:.2f}' for m in sorted(missing))}")
    assert max(missing) <= LOST
