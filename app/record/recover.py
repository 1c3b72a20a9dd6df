"""What a killed process has left of a session, put in order: signals and figures completed, recordings repaired."""

import json
from collections.abc import Callable
from pathlib import Path

from app import metrics, output
from app.record.folder import METRICS, SIGNALS, files, write_json
from app.record.repair import repair
from app.record.signals import Columns
from app.record.spool import ROWS, finish

Say = Callable[[str], None]
KILLED = "what recorded it was killed"


def complete(folder: Path, problem: str) -> Columns:
    """Write signals.parquet and metrics.json of what a spool has left; the signals. problem: goes into the figures.

    Raises SessionError if there is not even the beginning of a session, and OSError.
    """
    columns = finish(folder)
    about = json.loads((folder / output.MARK).read_text(encoding="utf-8"))
    seconds = len(columns["tick"]) / about.pop("parameters")["rates.control_hz"]
    write_json(folder / METRICS, {**about, "simulated_s": seconds, "recording_problem": problem, **metrics.compute(columns)})
    return columns


def recover(folder: Path, say: Say) -> None:
    """Complete a session whose process was killed, and say so; nothing happens to any other folder.

    A run that was killed has left its folder under another name: it gets its own. Raises OutputError while a process still
    writes it, or if the disk says no, and SessionError if there is not even the beginning of a session.
    """
    partial = output.partial(folder)
    where = partial if not folder.exists() and (partial / output.MARK).is_file() else folder
    if where is folder and not (folder / ROWS).is_file():
        return
    with output.claimed(where):
        try:
            if (where / ROWS).is_file():
                rows = len(complete(where, KILLED)["tick"])
                say(f"{folder} was not finished: {KILLED}. {SIGNALS} now holds the {rows} control ticks that it had kept")
            if where is partial:
                partial.rename(folder)
        except OSError as error:
            raise output.OutputError(f"cannot complete {where}: {error.strerror}") from None


def mend(path: Path, say: Say) -> None:
    """The same, and cut what a recording has after its last whole message. path: a session's folder, or a recording alone.

    Raises what `recover` does, and RepairError for a recording that is none.
    """
    if not path.is_file():
        recover(path, say)
    if not path.is_dir():
        _repair(path, say)
    elif recordings := files(path):
        with output.claimed(path):
            for recording in recordings:
                _repair(recording, say)


def _repair(path: Path, say: Say) -> None:
    if (found := repair(path)).torn:
        say(f"{path} was not written to the end: cut its last {found.torn} of {found.size} bytes")
