"""The folder of a run: what makes it run again, and its signals. docs/recording.md lists the files."""

import json
import re
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app.output import MARK
from app.record.signals import Columns, read_parquet, write_parquet
from hrc.config import Config
from hrc.errors import ConfigError, EventError, HrcError
from hrc.events import Event, Reset, from_dict, to_dict
from hrc.messages import Snapshot
from hrc.parameters import assembled, keys

EVENTS, SIGNALS, METRICS, SESSION = "events.jsonl", "signals.parquet", "metrics.json", "session.rrd"
SKIPPED = "control_ticks_before"
"""In config.json: the control ticks that the cell had taken when the recording began."""
_BLOCK = 100
"""Events that are compressed together: a quarter of a millisecond of a step."""


class SessionError(HrcError):
    """A folder is not that of a run, or of another version."""


@dataclass(frozen=True, slots=True)
class Entry:
    """An event before the step that followed `tick`. refused: why it was not taken, if so.

    A Reset stands at the tick at which it came; from there the ticks count from 0 again.
    """

    tick: int
    event: Event
    refused: str = ""


class EventLog:
    """An observer that keeps every event, as lines of events.jsonl; it must see a session from its start.

    People who drag make ten events a second for as long as a page is open. What is not of the last ten seconds or so is
    therefore kept compressed: some 50 bytes an event, where the objects themselves would be 450.
    """

    def __init__(self, before: "EventLog | None" = None) -> None:
        """before: one that has seen the session until now; this one goes on with a copy of it."""
        self._packed: list[bytes] = list(before._packed) if before is not None else []
        self._lines: list[str] = list(before._lines) if before is not None else []
        self._last = before._last if before is not None else 0
        self.taken = before.taken if before is not None else 0
        self.refused = before.refused if before is not None else 0
        """Numbers of events that were taken, and that were refused."""

    def on_step(self, snapshot: Snapshot) -> None:
        """Take the events of this step."""
        self.take(snapshot)

    def take(self, snapshot: Snapshot) -> list[str]:
        """Take the events of this step; their lines."""
        new = [line(Entry(self._last if isinstance(event, Reset) else snapshot.tick - 1, event)) for event in snapshot.events]
        new += [line(Entry(snapshot.tick - 1, event, reason)) for event, reason in snapshot.refused]
        self._last = snapshot.tick
        self.taken += len(snapshot.events)
        self.refused += len(snapshot.refused)
        self._lines += new
        if len(self._lines) >= _BLOCK:
            self._packed.append(zlib.compress("".join(self._lines).encode()))
            self._lines.clear()
        return new

    def lines(self) -> list[str]:
        """All of them."""
        return [*(row for block in self._packed for row in zlib.decompress(block).decode().splitlines(True)), *self._lines]

    def refusals(self) -> list[str]:
        """What was refused, and why."""
        found = [json.loads(row) for row in self.lines() if '"refused"' in row] if self.refused else []
        return [f"{values['event']['type']}: {values['refused']}" for values in found if "refused" in values]


@dataclass(frozen=True)
class Session:
    """A run read back. about: scenario, seed, device, versions. events: those that were taken, in order.

    columns: signals from when the recording began; the cell had taken `skipped` control ticks by then.
    """

    folder: Path
    config: Config
    about: Mapping[str, Any]
    events: tuple[Entry, ...]
    columns: Columns
    skipped: int = 0


def write(folder: Path, config: Config, about: Mapping[str, Any], columns: Columns, events: Iterable[str]) -> None:
    """Write config.json, events.jsonl and signals.parquet, which are enough to run the session again.

    config: at the start. about: goes into config.json and signals.parquet, with the `device` at least. events: their lines.
    """
    write_parquet(folder / SIGNALS, columns, about)
    write_config(folder, config, about)
    (folder / EVENTS).write_text("".join(events))


def write_config(folder: Path, config: Config, about: Mapping[str, Any]) -> None:
    """Write config.json alone."""
    write_json(folder / MARK, {**about, "parameters": keys(config)})


def line(entry: Entry) -> str:
    """A line of events.jsonl."""
    refused = {"refused": entry.refused} if entry.refused else {}
    return json.dumps({"tick": entry.tick, "event": to_dict(entry.event), **refused}) + "\n"


def files(folder: Path) -> list[Path]:
    """The files of a recording in their order: session.rrd, session_2.rrd, ..."""
    first = folder / SESSION
    numbered = {path: re.fullmatch(rf"{first.stem}_(\d+)", path.stem) for path in folder.glob(f"{first.stem}_*.rrd")}
    later = sorted((int(match[1]), path) for path, match in numbered.items() if match)
    return [first, *(path for _, path in later)] if first.is_file() else []


def read(folder: Path) -> Session:
    """The session again. Raises SessionError for what is no folder of a run, and for one of another version."""
    if not folder.is_dir():
        raise SessionError(f"there is no folder {folder}")
    for name in (MARK, EVENTS, SIGNALS):
        if not (folder / name).is_file():
            raise SessionError(f"{folder} is not the folder of a run: it has no {name}")
    try:
        about = json.loads((folder / MARK).read_text(encoding="utf-8"))
        parameters = about.pop("parameters")
        if not isinstance(parameters, dict):
            raise TypeError
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise SessionError(f"{folder / MARK} does not hold the parameters of a run") from None
    try:
        config = assembled(Config(), parameters)
    except ConfigError as error:
        raise SessionError(f"{folder / MARK} is of another version, {about.get('elbowroom', 'unknown')}: {error}") from None
    try:
        columns = read_parquet(folder / SIGNALS)
    except (OSError, ValueError) as error:  # pyarrow's own errors are among these
        raise SessionError(f"{folder / SIGNALS} cannot be read: {error}") from None
    skipped = about.get(SKIPPED, 0)
    if not isinstance(skipped, int) or skipped < 0:
        raise SessionError(f"{folder / MARK}: {SKIPPED} must be a whole number, not {skipped!r}")
    return Session(folder, config, about, tuple(_events(folder / EVENTS)), columns, skipped)


def _events(path: Path) -> list[Entry]:
    entries: list[Entry] = []
    tick = 0
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            values = json.loads(line)
            entry = Entry(values["tick"], from_dict(values["event"]), values.get("refused", ""))
        except (ValueError, KeyError, TypeError, AttributeError, EventError) as error:
            raise SessionError(f"{path}, line {number}, is no event of a run: {error}") from None
        if entry.refused:
            continue
        if not isinstance(entry.tick, int) or entry.tick < tick:
            raise SessionError(f"{path}, line {number}: tick {entry.tick} cannot follow tick {tick}")
        tick = 0 if isinstance(entry.event, Reset) else entry.tick
        entries.append(entry)
    return entries


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write a table of figures; what numpy counts is a plain number there."""
    path.write_text(json.dumps(values, indent=1, allow_nan=False, default=_plain) + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{value!r} is not JSON")
