"""A recording that never grows too large: one file after another, the oldest are deleted."""

import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path

from app.record.recorder import Recorder
from hrc.errors import HrcError
from hrc.messages import Snapshot

KEPT = 3
"""Finished files that stay."""


class Rotation:
    """Observes a cell with one recorder after another, from `begin` on. Files are opened and closed on a thread of its own.

    every: seconds of wall time for each file. files: finished so far. trouble: why a file is not whole, if any is not.
    """

    def __init__(self, folder: Path, every: float) -> None:
        self._folder, self._every = folder, every
        self._lock = threading.Lock()  # a recorder must not be closed in the middle of a step
        self._kept: deque[Path] = deque()
        self.files = self.bytes = self._begun = self._dropped = 0
        self.trouble = ""
        self._recording: tuple[Path, Recorder] | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="rotation", daemon=True)

    def begin(self, opened: Callable[[Path], Recorder]) -> None:
        """Record from now on. opened: makes the recorder of a file."""
        self._open = opened
        self._recording = self._next()
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Depth images that were not recorded, so far."""
        return self._dropped + (self._recording[1].images_dropped if self._recording is not None else 0)

    def on_step(self, snapshot: Snapshot) -> None:
        """Hand it to the recorder of now."""
        with self._lock:
            if self._recording is not None:
                self._recording[1].on_step(snapshot)

    def close(self) -> None:
        """Finish the last file."""
        self._closing.set()
        self._thread.join()
        self._exchange(None)

    def _loop(self) -> None:
        while not self._closing.wait(self._every):
            self._exchange(self._next())

    def _exchange(self, recording: tuple[Path, Recorder] | None) -> None:
        with self._lock:
            old, self._recording = self._recording, recording
        if old is not None:
            self._finish(*old)

    def _next(self) -> tuple[Path, Recorder]:
        path = self._folder / f"part-{self._begun:04d}.rrd"
        self._begun += 1
        return path, self._open(path)

    def _finish(self, path: Path, recorder: Recorder) -> None:
        try:
            recorder.close()
        except HrcError as error:
            self.trouble = str(error)
        self.files += 1
        self._dropped += recorder.images_dropped
        self.bytes += path.stat().st_size
        self._kept.append(path)
        while len(self._kept) > KEPT:
            self._kept.popleft().unlink(missing_ok=True)
