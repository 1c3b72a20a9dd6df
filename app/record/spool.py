"""What it takes to run a session again, on the disk while the session goes on: a process that is killed leaves it there.

Events go to events.jsonl as they come, and signals to signals.arrows, an Arrow stream, in blocks, each after the events before
it. At the end, or after a kill, `gather` makes signals.parquet of that; the stream goes last, when nothing else is missing.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from app.output import MARK
from app.record.folder import EVENTS, SIGNALS, EventLog, SessionError, write_config
from app.record.signals import WIDTH, Columns, arrow, columns_of, row, typed, write_parquet
from hrc.config import Config
from hrc.messages import Snapshot

ROWS = "signals.arrows"
_BLOCK = 50
"""Rows a block: a quarter of a second of signals, which a kill may cost."""


class Spool:
    """An observer that keeps a session in a folder, from its first step on; its methods raise OSError where the disk does.

    config: at the start of the session. about: goes into config.json. before: the events until now, for a session that is kept
    from its middle on.
    """

    def __init__(self, folder: Path, config: Config, about: Mapping[str, Any], before: EventLog | None = None) -> None:
        self._folder, self._config, self._about = folder, config, dict(about)
        self.log = EventLog(before)
        self._block, self._n = np.empty((_BLOCK, WIDTH)), 0
        self._files: tuple[BinaryIO, BinaryIO] | None = None

    def on_step(self, snapshot: Snapshot) -> None:
        """Take one step."""
        events, _ = self._files or self._open()
        if new := self.log.take(snapshot):
            events.write("".join(new).encode())
            events.flush()  # what the system has, outlives this process
        if snapshot.fresh_control:
            self._block[self._n] = row(snapshot)
            self._n += 1
            if self._n == _BLOCK:
                self._deliver()

    def close(self) -> None:
        """Write what is left."""
        try:
            self._deliver()
        finally:
            for file in self._files or ():
                file.close()

    def _open(self) -> tuple[BinaryIO, BinaryIO]:
        write_config(self._folder, self._config, self._about)
        self._files = (self._folder / EVENTS).open("wb"), (self._folder / ROWS).open("wb")
        self._files[0].write("".join(self.log.lines()).encode())
        self._files[1].write(arrow(typed(self._block[:0])).schema.serialize())
        return self._files

    def _deliver(self) -> None:
        _, rows = self._files or self._open()
        n, self._n = self._n, 0  # what the disk does not take now is not written again behind a torn block
        if n:
            rows.write(arrow(typed(self._block[:n])).serialize())
            rows.flush()


def gather(folder: Path) -> Columns:
    """Make signals.parquet of what a spool has left, whole or torn, and give its columns. Call `done` when all is written.

    Raises SessionError if there is not even the beginning of a session.
    """
    import pyarrow as pa

    try:
        about = json.loads((folder / MARK).read_text(encoding="utf-8"))
        del about["parameters"]
        with (folder / ROWS).open("rb") as file:
            stream, batches = pa.ipc.open_stream(file), []
            while (batch := _next(stream)) is not None:
                batches.append(batch)
            columns = columns_of(pa.Table.from_batches(batches, stream.schema))
    except (OSError, ValueError, KeyError):  # pyarrow's own errors are among these
        raise SessionError(f"{folder} was left before anything of a session was in it") from None
    events = (folder / EVENTS).read_bytes()
    os.truncate(folder / EVENTS, events.rfind(b"\n") + 1)
    write_parquet(folder / SIGNALS, columns, about)
    return columns


def done(folder: Path) -> None:
    """Remove the stream: from here on the folder is that of a finished session."""
    (folder / ROWS).unlink()


def _next(stream: Any) -> Any:
    """The next block of a stream; None at its end, be it torn."""
    try:
        return stream.read_next_batch()
    except (StopIteration, OSError, ValueError):
        return None
