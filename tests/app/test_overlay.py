"""A replay's own recording: the viewer lays it over the session's, so its id, clock and numbers must be the right ones."""

import numpy as np
import pytest

pytest.importorskip("rerun")

from rerun.chunk import RrdReader
from test_record import column

from app.headless import Job, execute
from app.open_loop import Job as Again
from app.open_loop import execute as replay
from app.record.archive import Archive
from app.record.overlay import GIVEN
from app.record.signals import read_parquet
from app.record.writer import PLOTTED
from app.review import SESSION, recordings
from hrc.cell import pace
from hrc.cell.cell import Cell
from hrc.cell.run import Inbox, run
from hrc.events import Reset


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("overlay")
    execute(Job("push", folder / "run", duration=2.5, depth="none", quiet=True))
    replay(Again(folder / "run", ("control.f_relax=12",), folder / "again"))
    return folder / "run", folder / "again"


def test_it_belongs_to_the_same_recording_and_repeats_nothing_of_it(folders):
    (run,), (again,) = (RrdReader(str(folder / SESSION)).recordings() for folder in folders)
    assert (again.application_id, again.recording_id) == (run.application_id, run.recording_id)
    entities = [{c.entity_path for c in RrdReader(str(folder / SESSION)).store().stream()} for folder in folders]
    assert not entities[0] & entities[1]
    curves = {f"/replay/{s.name}" for s in PLOTTED if s.name not in GIVEN} | {"/replay/plots/force"}
    assert {e for e in entities[1] if e.startswith("/replay/")} == curves
    assert recordings(folders) == [(folder / SESSION).resolve() for folder in folders]


def test_its_curves_are_the_replayed_signals_on_the_clock_of_the_session(folders):
    run, again = folders
    columns, recorded = read_parquet(again / "signals.parquet"), read_parquet(run / "signals.parquet")
    assert (columns["state"] != recorded["state"]).any(), "it was worth it"
    for name in ("residual", "force_est", "clearance_5", "contact_seen"):
        ticks, values = column(again / SESSION, f"/replay/{name}", "Scalars:scalars")
        assert ticks == recorded["tick"].tolist()
        expected = columns[name].astype(float).reshape(len(ticks), -1)
        np.testing.assert_array_equal(values, np.where(np.isinf(expected), np.nan, expected))
    mode = columns["state"]
    changed = np.flatnonzero(np.r_[True, mode[1:] != mode[:-1]])
    ticks, states = column(again / SESSION, "/state/replayed", "StateChange:state")
    assert ticks == columns["tick"][changed].tolist()
    assert [state[0] for state in states] == mode[changed].tolist()


def test_its_clock_goes_on_after_a_reset_as_the_recording_does(tmp_path):
    archive, cell, inbox = Archive(tmp_path / "recordings"), Cell(), Inbox()
    run(cell, pace.FreeRun(7), inbox, [archive], until=53)
    name = archive.start("free", cell.config, {}, "none")
    run(cell, pace.FreeRun(7), inbox, [archive], until=303)
    inbox.put(Reset())
    run(cell, pace.FreeRun(7), inbox, [archive], until=10**6, stopped=lambda: archive.now.seconds >= 0.5)
    archive.stop()
    replay(Again(archive.folder(name), ("control.f_relax=12",), tmp_path / "again"))
    ticks, _ = column(archive.folder(name) / SESSION, "/signals/residual", "Scalars:scalars")
    assert column(tmp_path / "again" / SESSION, "/replay/residual", "Scalars:scalars")[0] == ticks
    assert np.all(np.diff(ticks) > 0)
