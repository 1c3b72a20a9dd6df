"""What is freed goes back to the system. The C library keeps a hole between two pieces of memory that are still in use; images,
snapshots and messages of several threads leave such holes all the time, and in an hour they made 50 MB more of a page whose
memory in use stayed the same. By default it also gives each thread a heap of its own, with holes of its own: between the second
and the seventh minute of a soak a page went from 192 to 200 MB with many, from 185 to 191 with one.
"""

import ctypes
import threading
from collections.abc import Callable

ARENA_MAX = -8
"""The number of that setting in glibc's malloc.h."""
PERIOD = 30.0
"""Between two times that the holes are given back [s]: 1 to 3 ms, on a thread of its own, without the interpreter's lock."""


class Holes:
    """Gives them back from `start` to `close`; does nothing where the C library is not glibc.

    As soon as it is there, threads that begin share a heap.
    """

    def __init__(self) -> None:
        self._over = threading.Event()
        library = ctypes.CDLL(None)
        trim = getattr(library, "malloc_trim", None)
        self._thread: threading.Thread | None = None
        if trim is not None:
            library.mallopt(ARENA_MAX, 1)
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
