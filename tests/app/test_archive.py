"""The list of recordings: a name is a name of the list and never a path; and what ends a recording by itself."""

import gc
import json
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("rerun")

from test_record import column

from app.record import archive as module
from app.record import shelf
from app.record.archive import Archive
from app.record.folder import read
from app.record.recorder import Recorder
from app.record.shelf import ArchiveError
from app.replay import exact
from hrc.cell import pace
from hrc.cell.cell import Cell
from hrc.cell.run import Inbox, run
from hrc.events import MoveObstacle, Push, Reset, SetParameter


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """With one recording: of half a second, begun in the middle, with a Reset in it; and what is none."""
    root = tmp_path_factory.mktemp("archive") / "recordings"
    archive, cell, inbox = Archive(root), Cell(), Inbox()
    config = cell.config
    assert archive.names() == []
    inbox.put(MoveObstacle("ball", (-0.5, 0.4, 0.5)))
    run(cell, pace.FreeRun(7), inbox, [archive], until=203)
    name = archive.start("my scenario.toml", config, {}, "none")
    with pytest.raises(ArchiveError, match="being recorded"):
        archive.start("free", config, {}, "none")
    with pytest.raises(ArchiveError, match="unknown recording"):
        archive.folder(name)
    for event in (Push(4, (0.0, 0.0, 0.0), (0.0, 20.0, 0.0)), SetParameter("control.f_relax", 6.0)):
        inbox.put(event)
    run(cell, pace.FreeRun(7), inbox, [archive], until=452)
    inbox.put(Reset())
    run(cell, pace.FreeRun(7), inbox, [archive], until=10**6, stopped=lambda: archive.now.seconds >= 0.5)
    assert archive.now.seconds == pytest.approx(0.5, abs=0.01)
    assert archive.stop() == ""
    (root / "none").mkdir()
    (root.parent / "outside").mkdir()
    (root.parent / "outside" / "session.rrd").write_bytes(b"")
    (root / "link").symlink_to(root.parent / "outside")
    return archive


@pytest.fixture
def archive_of_images(tmp_path):
    """A recording that has depth images."""
    archive, cell = Archive(tmp_path / "recordings"), Cell()
    run(cell, pace.FreeRun(), Inbox(), [archive], until=50)
    name = archive.start("free", cell.config, {}, "sampled")
    run(cell, pace.FreeRun(), Inbox(), [archive], until=700)
    assert archive.stop() == ""
    return archive.folder(name)


def test_a_recording_from_the_middle_runs_again_bit_for_bit(archive):
    (name,) = archive.names()
    assert name.startswith("my-scenario-")
    session = read(archive.folder(name))
    assert session.skipped == 40
    assert exact(archive.folder(name)) == (f"identical, 0 differing ticks of {len(session.columns['tick'])}", True)
    assert archive.seconds(name) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(("reset", "then"), [(False, 6.0), (True, 5.0)])
def test_thresholds_are_drawn_as_they_are_when_the_recording_begins(tmp_path, reset, then):
    archive, cell, inbox = Archive(tmp_path / "recordings"), Cell(), Inbox()
    config = cell.config
    inbox.put(SetParameter("control.f_relax", 6.0))
    run(cell, pace.FreeRun(7), inbox, [archive], until=100)
    if reset:
        inbox.put(Reset())
        run(cell, pace.FreeRun(1), inbox, [archive], until=10**6, stopped=lambda: cell.tick == 50)
    folder = archive.root / archive.start("free", config, {}, "none")
    run(cell, pace.FreeRun(7), inbox, [archive], until=200)
    inbox.put(Reset())
    run(cell, pace.FreeRun(7), inbox, [archive], until=10**6, stopped=lambda: archive.now.seconds >= 0.3)
    assert archive.stop() == ""
    _, curves = column(folder / "session.rrd", "/plots/force", "Scalars:scalars")
    drawn = [curve[2] for curve in curves]
    assert set(drawn[:15]) == {then}
    assert set(drawn[-15:]) == {5.0}, "after a Reset all is as at the start"


def test_two_recordings_of_one_second_have_two_names(tmp_path, monkeypatch):
    archive, cell = Archive(tmp_path / "recordings"), Cell()
    monkeypatch.setattr(time, "strftime", lambda _: "20260102-030405")
    run(cell, pace.FreeRun(), Inbox(), [archive], until=10)
    for name in ("free-20260102-030405", "free-20260102-030405-2", "free-20260102-030405-3"):
        assert archive.start("free", cell.config, {}, "none") == name
        run(cell, pace.FreeRun(), Inbox(), [archive], until=cell.tick + 20)
        assert archive.stop() == ""
    assert len(archive.names()) == 3
    (archive.root.parent / "file").write_text("")
    with pytest.raises(ArchiveError, match="cannot record to"):
        Archive(archive.root.parent / "file").start("free", cell.config, {}, "none")
    (archive.root.parent / "nowhere").symlink_to(archive.root.parent / "missing" / "folder")
    with pytest.raises(ArchiveError, match="cannot record to"):
        Archive(archive.root.parent / "nowhere").start("free", cell.config, {}, "none")


def test_the_figures_say_how_many_images_were_kept(archive_of_images):
    figures = json.loads((archive_of_images / "metrics.json").read_text())
    assert figures["counts"]["depth_images"] >= 2
    assert figures["counts"]["depth_images_dropped"] == 0


def test_what_was_before_a_reset_is_not_kept_for_later(tmp_path):
    archive, cell, inbox = Archive(tmp_path / "recordings"), Cell(), Inbox()
    config = cell.config
    inbox.put(Push(4, (0.0, 0.0, 0.0), (0.0, 20.0, 0.0)))
    run(cell, pace.FreeRun(7), inbox, [archive], until=100)
    for event in (Push(3, (0.0, 0.0, 0.0), (0.0, 20.0, 0.0)), Reset(), MoveObstacle("ball", (-0.5, 0.4, 0.5))):
        inbox.put(event)
    run(cell, pace.FreeRun(1), inbox, [archive], until=10**6, stopped=lambda: cell.tick == 50)
    name = archive.start("free", config, {}, "none")
    run(cell, pace.FreeRun(7), inbox, [archive], until=300)
    assert archive.stop() == ""
    session = read(archive.folder(name))
    assert [type(entry.event) for entry in session.events] == [MoveObstacle]
    assert session.skipped == 10
    assert exact(archive.folder(name)) == (f"identical, 0 differing ticks of {len(session.columns['tick'])}", True)


@pytest.mark.parametrize("name", [
    "", ".", "..", "../outside", "none", "link", "/etc", "{}/..", "{}/../../outside", "{}\0", "{}/"])
def test_what_is_not_in_the_list_is_neither_read_nor_deleted(archive, name):
    (real,) = archive.names()
    for act in (archive.folder, archive.delete, archive.packed, archive.size):
        with pytest.raises(ArchiveError, match="unknown recording"):
            act(name.format(real))
    assert (archive.root.parent / "outside" / "session.rrd").is_file()


def test_it_is_packed_whole_and_deleted(archive, monkeypatch):
    (name,) = archive.names()
    file, size = archive.packed(name)
    assert len(file.read()) == size
    with file, zipfile.ZipFile(file) as packed:
        assert packed.testzip() is None
        assert {f"{name}/{file}" for file in ("session.rrd", "signals.parquet", "config.json", "events.jsonl",
                                              "metrics.json")} == set(packed.namelist())
    monkeypatch.setattr(shelf, "MOST_BYTES", 1000)
    with pytest.raises(ArchiveError, match="on the server"):
        archive.packed(name)
    archive.delete(name)
    assert archive.names() == []


def test_another_cell_or_the_longest_time_ends_a_recording_by_itself(tmp_path, monkeypatch):
    archive, told = Archive(tmp_path / "recordings"), []
    archive.over = told.append
    monkeypatch.setattr(module, "MOST_S", 0.1)
    cell = Cell()
    run(cell, pace.FreeRun(), Inbox(), [archive], until=100)
    archive.start("long", cell.config, {}, "none")
    run(cell, pace.FreeRun(), Inbox(), [archive], until=300)
    archive.start("short", cell.config, {}, "none")
    run(cell, pace.FreeRun(), Inbox(), [archive], until=350)
    cell = Cell()
    run(cell, pace.FreeRun(), Inbox(), [archive], until=100)
    deadline = time.monotonic() + 20.0
    while len(told) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert "h long" in told[0]
    assert "another cell" in told[1]
    assert len(archive.names()) == 2
    for name in archive.names():
        assert exact(archive.folder(name))[1]


def test_a_folder_that_cannot_be_made_is_said_and_leaves_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArchiveError, match="cannot record"):
        Archive(tmp_path / "file").start("free", Cell().config, {}, "none")


@pytest.mark.parametrize(("harm", "told"), [("taken", "exists"), ("removed", "No such file")])
def test_a_recorder_that_can_no_longer_write_ends_the_recording_at_once(tmp_path, monkeypatch, harm, told):
    """The name of its next file is taken, or its folder is removed."""
    archive, said, cell = Archive(tmp_path / "recordings"), [], Cell()
    archive.over = said.append
    monkeypatch.setitem(Recorder.__init__.__kwdefaults__, "rotate", 0.5)
    run(cell, pace.FreeRun(), Inbox(), [archive], until=100)
    folder = archive.root / archive.start("free", cell.config, {}, "none")
    run(cell, pace.FreeRun(), Inbox(), [archive], until=200)
    shutil.rmtree(folder) if harm == "removed" else (folder / "session_2.rrd").touch()
    deadline = time.monotonic() + 20.0
    while not said and time.monotonic() < deadline:
        run(cell, pace.FreeRun(), Inbox(), [archive], until=cell.tick + 100)
        time.sleep(0.01)
    assert told in said[0]
    assert archive.now is None


CLICK = """
import gc, sys, threading
from pathlib import Path
from app.record.archive import Archive, load
from hrc.config import Config

assert "rerun" not in sys.modules
loading = threading.Thread(target=load)
loading.start()
archive = Archive(Path(sys.argv[1]))
name = archive.start("free", Config(), {}, "none")
loading.join()
archive.stop()
assert gc.isenabled() and "rerun" in sys.modules
print(name)
"""


def test_a_recording_may_begin_while_what_it_needs_is_being_loaded(tmp_path):
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", CLICK, str(tmp_path)], cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / done.stdout.strip() / "session.rrd").is_file()


def test_without_the_extra_nothing_is_loaded_and_nothing_fails(monkeypatch):
    monkeypatch.delitem(sys.modules, "app.record.recorder")
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.delitem(sys.modules, "app.record.writer")
    module.load()
    assert gc.isenabled()
    assert "app.record.recorder" not in sys.modules
