"""A session outlives the process that recorded it: what a kill leaves is completed, runs again bit for bit, lacks little."""

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rerun")

from process import children, launched
from test_repair import recorder_of
from vclient import VClient, until

from app import headless, output
from app.__main__ import main
from app.headless import Job, execute
from app.output import OutputError
from app.record.folder import SessionError, read
from app.record.recover import mend, recover
from app.record.repair import look
from app.record.signals import read_parquet
from app.record.spool import ROWS, Spool
from app.replay import exact
from hrc.cell import pace, scenario
from hrc.cell.cell import Cell
from hrc.cell.run import Inbox, run

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")
ROOT = Path(__file__).parents[2]
LOST = 0.5
"""What a kill may cost [s]."""


def given_back(folder: Path) -> bool:
    """Whether nobody writes there any more."""
    try:
        with output.claimed(folder):
            return True
    except OutputError:
        return False


@pytest.mark.live
def test_a_page_that_is_killed_leaves_a_session_that_runs_again(tmp_path, capsys):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    command = [sys.executable, "-m", "app", "serve", "--port", str(port), "--scenario", "push", "--recordings", str(tmp_path)]
    with launched(command, cwd=ROOT, stdout=subprocess.PIPE) as process:
        try:
            assert str(port) in next(line for line in process.stdout or () if "http://" in line), "it listens"
            client = VClient(port)
            until(lambda: client.ready.is_set() and client.banner()["mode"] == "idle" and client.seat(), 120.0)
            client.set("Images", "full")
            client.click("Record")
            until(lambda: 'data-recording="true"' in client.text())
            client.set("f_relax [N]", 6.0)
            (folder,) = tmp_path.iterdir()
            begun = float(client.banner()["time"])
            until(lambda: float(client.banner()["time"]) > begun + 3.0)
            with pytest.raises(OutputError, match="still being written"):
                mend(folder, print)
            last = float(client.banner()["time"])
        finally:
            for number in (*children(process.pid), process.pid):  # the cell's, which records, at the same time
                os.kill(number, signal.SIGKILL)
    until(lambda: given_back(folder))  # only its parent, which is dead, could wait for the cell's process
    with pytest.raises(SystemExit) as exit_:
        main(["replay", str(folder), "--exact"])
    told = capsys.readouterr()
    assert exit_.value.code == 0, told
    assert "identical" in told.out
    assert "was killed" in told.err
    session = read(folder)
    assert "SetParameter" in {type(entry.event).__name__ for entry in session.events}
    missing = last - session.columns["t"][-1]
    print(f"{missing:.2f} s missing")
    assert missing <= LOST
    mend(folder, lambda _: None)
    assert look(folder / "session.rrd").messages
    assert json.loads((folder / "metrics.json").read_text())["simulated_s"] == pytest.approx(len(session.columns["t"]) / 200)


def test_a_run_that_is_killed_is_completed_under_its_own_name(tmp_path, capsys):
    out = tmp_path / "out"
    command = [sys.executable, "-m", "app", "run", "push", "--out", str(out), "--depth", "none", "--duration", "600"]
    rows = output.partial(out) / ROWS
    with launched(command, cwd=ROOT, stderr=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + 120.0
        while not (rows.exists() and rows.stat().st_size > 500_000) and time.monotonic() < deadline:
            time.sleep(0.01)
        with pytest.raises(OutputError, match="still being written"):
            execute(Job("push", out, duration=1.0, quiet=True))
        process.send_signal(signal.SIGKILL)
    main(["repair", str(out)])
    assert "was killed" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert {path.name for path in out.iterdir()} == {
        "session.rrd", "signals.parquet", "metrics.json", "config.json", "events.jsonl"}
    main(["repair", str(out)])
    assert "is whole" in capsys.readouterr().out
    verdict, identical = exact(out)
    assert identical, verdict


def test_a_run_that_dies_while_it_writes_its_results_is_not_taken_for_a_whole_one(tmp_path, monkeypatch):
    def dies(*_):
        raise RuntimeError("killed here")

    out = tmp_path / "out"
    monkeypatch.setattr(headless, "_draw", dies)
    with pytest.raises(RuntimeError, match="killed here"):
        execute(Job("free", out, duration=0.5, record=False, quiet=True))
    recover(out, lambda _: None)
    assert json.loads((out / "metrics.json").read_text())["recording_problem"]
    assert not (out / ROWS).exists()


@pytest.fixture(scope="module")
def spooled(tmp_path_factory):
    """What a process leaves that is killed 1.3 s into the scenario `push`, and the signals until then."""
    folder, cell = tmp_path_factory.mktemp("spooled"), Cell()
    spool = Spool(folder, cell.config, {"scenario": "push", "device": "cpu"})
    run(cell, pace.FreeRun(7), Inbox(scenario.load("push")), [spool], until=1300)
    spool.close()
    whole = shutil.copytree(folder, tmp_path_factory.mktemp("whole") / "out")
    recover(whole, lambda _: None)
    return folder, read_parquet(whole / "signals.parquet")


@pytest.mark.parametrize("share", [1.0, 0.99, 0.7, 0.31])
def test_torn_anywhere_it_has_the_rows_before(spooled, tmp_path, share):
    folder, whole = shutil.copytree(spooled[0], tmp_path / "out"), spooled[1]
    data = (folder / ROWS).read_bytes()
    (folder / ROWS).write_bytes(data[: int(share * len(data))])
    with (folder / "events.jsonl").open("a") as events:
        events.write('{"tick": 1300, "ev')
    said = []
    recover(folder, said.append)
    columns = read_parquet(folder / "signals.parquet")
    kept = len(columns["tick"])
    assert len(whole["tick"]) * share - 50 <= kept <= len(whole["tick"]) == 260
    for name, values in columns.items():
        assert values.tobytes() == whole[name][:kept].tobytes()
    assert str(kept) in said[0]
    assert exact(folder) == (f"identical, 0 differing ticks of {kept}", True)
    assert not (folder / ROWS).exists()


def test_what_was_killed_before_it_began_is_said(spooled, tmp_path):
    folder = shutil.copytree(spooled[0], tmp_path / "out")
    (folder / ROWS).write_bytes(b"")
    with pytest.raises(SessionError, match="before anything"):
        recover(folder, print)
    np.testing.assert_equal((folder / "signals.parquet").exists(), False)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded") / "whole"
    execute(Job("push", folder, duration=1.0, depth="none", quiet=True))
    return folder


@pytest.fixture
def torn(whole, tmp_path):
    """A session whose recording ends in the middle of a message."""
    folder = shutil.copytree(whole, tmp_path / "torn")
    recording = folder / "session.rrd"
    recording.write_bytes(recording.read_bytes()[: look(recording).end - 10])
    return folder


@pytest.mark.parametrize("command", [
    ("replay", "--set", "control.f_relax=12"), ("replay", "--exact"), ("report", "--out", "report.html"),
    ("export", "--out", "session.mcap")], ids=" ".join)
def test_whatever_reads_a_session_mends_its_recording(torn, tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    if command[0] == "export":
        pytest.importorskip("mcap")
    with contextlib.suppress(SystemExit):
        main([command[0], str(torn), *command[1:]])
    assert "cut its last" in capsys.readouterr().err
    assert not look(torn / "session.rrd").torn


def test_a_continuation_that_was_not_begun_does_not_keep_the_session_from_anybody(torn):
    for number, left in ((2, b""), (3, b"RRF2\0\0\0\0\0\0\0\0" + b"\1" * 10)):
        (torn / f"session_{number}.rrd").write_bytes(left)
    said = []
    mend(torn, said.append)
    assert not look(torn / "session.rrd").torn
    assert [path.name for path in torn.glob("*.rrd")] == ["session.rrd"]
    assert len(said) == 3


def test_a_recording_beyond_repair_is_said_and_the_signals_are_read_all_the_same(torn, capsys):
    (torn / "session.rrd").write_bytes(b"years of work")
    assert exact(torn)[1]
    assert "is no recording" in capsys.readouterr().err


def test_a_file_that_a_recorder_writes_is_not_cut_under_it(tmp_path):
    path, cell = tmp_path / "session.rrd", Cell()
    with recorder_of(cell, path, "none") as recorder:
        run(cell, pace.FreeRun(), Inbox(), [recorder], until=1000)
        with path.open("ab") as file:
            file.write(b"\1" * 10)  # it is in the middle of a message
        size = path.stat().st_size
        for what in (path, tmp_path):
            with pytest.raises(OutputError, match="still being written"):
                mend(what, print)
        assert path.stat().st_size >= size
    mend(path, print)
