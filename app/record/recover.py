"""What a killed process has left of a session, put in order: signals and figures completed, recordings repaired."""

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from app import metrics, output
from app.record.folder import METRICS, SIGNALS, files, write_json
from app.record.repair import RepairError, look, repair
from app.record.signals import Columns
from app.record.spool import ROWS, done, gather

Say = Callable[[str], None]
KILLED = "what recorded it was killed"


def complete(folder: Path, problem: str = "", counts: Mapping[str, int] | None = None) -> Columns:
    """Write signals.parquet and metrics.json of what a spool has left; the signals. problem, counts: go into the figures.

    Raises SessionError if there is not even the beginning of a session, and OSError.
    """
    columns = gather(folder)
    about = json.loads((folder / output.MARK).read_text(encoding="utf-8"))
    seconds = len(columns["tick"]) / about.pop("parameters")["rates.control_hz"]
    write_json(folder / METRICS, {**about, "simulated_s": seconds, "recording_problem": problem, **metrics.compute(columns),
                                  **({"counts": counts} if counts else {})})
    done(folder)
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

    Raises what `recover` does, also for a recording alone, and RepairError for one that is none.
    """
    if not path.is_file():
        recover(path, say)
    for number, recording in enumerate(files(path) if path.is_dir() else [path]):
        _repair(recording, say, later=number > 0)


def mended(folder: Path) -> None:
    """The same, said on stderr, for those who read the signals: a recording beyond repair is said, too, and stops nobody."""
    def say(line: str) -> None:
        print(line, file=sys.stderr)

    try:
        mend(folder, say)
    except RepairError as error:
        if folder.is_dir():
            say(str(error))


def _repair(path: Path, say: Say, *, later: bool = False) -> None:
    """later: the session goes on in it; killed right there, it may hold nothing yet."""
    found = look(path)
    if found.messages and not found.torn:
        return
    try:
        with output.claimed(path):
            if later and not found.messages:
                path.unlink()
                say(f"{path} had nothing in it yet: removed")
            else:
                found = repair(path)
                say(f"{path} was not written to the end: cut its last {found.torn} of {found.size} bytes")
    except OSError as error:  # a folder that cannot be written
        raise RepairError(f"{path} cannot be mended: {error.strerror}") from None
