"""Nobody's hand stays behind: a closed tab says that it goes, but a frozen one, or a dead line, does not."""

import threading
import time
from collections.abc import Callable

import viser

from app.serve.pulse import answers

QUIET, PATIENCE = 0.4, 1.5
"""A mouse held still sends nothing: after QUIET its browser is asked for a sign of life, and has PATIENCE [s]."""


class Vigil:
    """Watches over whoever holds something, one at a time, from a thread of its own.

    abandoned: told whose browser does not answer, on that thread.
    """

    def __init__(self, server: viser.ViserServer, name: str, abandoned: Callable[[viser.ClientHandle], None]) -> None:
        self._server, self._abandoned = server, abandoned
        self._holder: tuple[viser.ClientHandle, float] | None = None
        self._lock = threading.Lock()
        self._held, self._closed = threading.Event(), False
        self._thread = threading.Thread(target=self._watch, name=name, daemon=True)
        self._thread.start()

    def hears(self, client: viser.ClientHandle) -> None:
        """It holds something, and has just said so."""
        with self._lock:
            self._holder = client, time.monotonic()
            self._held.set()

    def ends(self) -> None:
        """Nobody holds anything."""
        with self._lock:
            self._holder = None
            self._held.clear()

    def close(self) -> None:
        """Watch no longer."""
        self._closed = True
        self._held.set()
        self._thread.join(timeout=3.0)

    def _watch(self) -> None:
        while not self._closed:
            self._held.wait()
            time.sleep(0.1)
            holder = self._holder
            if holder is None or time.monotonic() - holder[1] < QUIET:
                continue
            alive = answers(self._server, holder[0], PATIENCE)
            with self._lock:
                if self._holder is not holder:  # it has been heard, or has let go, meanwhile
                    continue
                self._holder = (holder[0], time.monotonic()) if alive else None
                if not alive:
                    self._held.clear()
            if not alive:
                self._abandoned(holder[0])
