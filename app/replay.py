"""`elbowroom replay`: run a session again from config, seed and events, and compare every bit."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.headless import versions
from app.record.folder import Session, SessionError, read
from app.record.recover import mended
from app.record.signals import Columns, SignalTable
from hrc.cell.cell import Cell
from hrc.cell.pace import FreeRun
from hrc.cell.run import Observer, Record, run

OPEN_LOOP = "open_loop_of"
"""In config.json of what an open-loop replay writes: it is no run of its own."""


@dataclass(frozen=True)
class Difference:
    """ticks: control ticks that differ, of `of`. tick, signals: the first of them, and what differs there."""

    ticks: int
    of: int
    tick: int
    signals: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.ticks} of {self.of} control ticks differ, first tick {self.tick}: {', '.join(self.signals)}"


def exact(folder: Path, device: str | None = None) -> tuple[str, bool]:
    """Run the session again and compare its signals with the recorded ones: the verdict in words, and whether all is identical.

    device: None for the one of the session. Raises SessionError for what is no session, and DeviceError.
    """
    session = opened(folder)
    cell = Cell(session.config, device or session.about.get("device", "cpu"))
    found = difference(session.columns, tail(again(cell, session), session.skipped))
    if found is None:
        return f"identical, 0 differing ticks of {len(session.columns['tick'])}", True
    return f"{found}{other_versions(session)}", False


def opened(folder: Path) -> Session:
    """The session of a folder; one that was killed is completed and mended first, and that is said.

    Raises SessionError, also for a folder that an open-loop replay has written, and OutputError for one that is not finished.
    """
    mended(folder)
    session = read(folder)
    if OPEN_LOOP in session.about:
        raise SessionError(f"{folder} is a replay, not a run; the run is {session.about[OPEN_LOOP]}")
    if not len(session.columns["tick"]):
        raise SessionError(f"{folder} has no control tick to replay")
    return session


def again(cell: Cell, session: Session, *observers: Observer) -> dict[str, NDArray[Any]]:
    """The signals of the session's control ticks, and of all before them, under its events."""
    table, rows = SignalTable(), session.skipped + len(session.columns["tick"])
    record = Record((entry.tick, entry.event) for entry in session.events)
    run(cell, FreeRun(1), record, [table, *observers], until=sys.maxsize, stopped=lambda: len(table) >= rows)
    return table.columns()


def tail(columns: Columns, skipped: int) -> Columns:
    """Without the first rows, of control ticks before the recording began."""
    return {name: values[skipped:] for name, values in columns.items()}


def difference(recorded: Columns, replayed: Columns, names: Callable[[str], bool] = lambda _: True) -> Difference | None:
    """Where two runs differ in any bit; None if nowhere. names: which signals to look at."""
    differ = {name: _rows(values, replayed[name]) for name, values in recorded.items() if names(name)}
    somewhere = np.any(list(differ.values()), axis=0)
    if not somewhere.any():
        return None
    first = int(np.argmax(somewhere))
    return Difference(int(somewhere.sum()), somewhere.size, int(recorded["tick"][first]),
                      tuple(name for name, rows in differ.items() if rows[first]))


def _rows(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    """The rows that differ in any bit: NaN is like NaN, and -0 not like 0."""
    a, b = (np.ascontiguousarray(x).view(np.uint8).reshape(len(x), -1) for x in (a, b))
    return (a != b).any(axis=1)


def other_versions(session: Session) -> str:
    """What the session was run with and is not here, to end a line with; empty if all is the same."""
    here = versions()
    then = {name: session.about.get(name, "unknown") for name in here}
    differ = [f"{name} {then[name]} (here {here[name]})" for name in here if then[name] != here[name]]
    return f"; recorded with {', '.join(differ)}" if differ else ""
