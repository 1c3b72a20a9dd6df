"""What is freed goes back to the system. The C library keeps a hole between two pieces of memory that are still in use; images,
snapshots and messages of several threads leave such holes all the time, and in an hour they made 50 MB more of a page whose
memory in use stayed the same.
"""

import ctypes
import threading
from collections.abc import Callable

PERIOD = 30.0
"""Between two times that the holes are given back [s]: 1 to 3 ms, on a thread of its own, without the interpreter's lock."""


class Holes:
    """Gives them back from `start` to `close`; does nothing where the C library is not glibc."""

    def __init__(self) -> None:
        self._over = threading.Event()
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        self._thread: threading.Thread | None = None
        if trim is not None:
            self._thread = threading.Thread(target=self._work, args=(trim,), name="holes", daemon=True)

    def start(self) -> None:
        """From now on."""
        if self._thread is not None:
            self._thread.start()

    def close(self) -> None:
        """No more."""
        self._over.set()
        if self._thread is not None and self._thread.is_alive():
            self._thread.join()

    def _work(self, trim: Callable[[ctypes.c_size_t], int]) -> None:
        while not self._over.wait(PERIOD):
            trim(ctypes.c_size_t(0))
