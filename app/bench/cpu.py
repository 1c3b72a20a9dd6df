"""CPU time of the page, by what its threads are for, and of its cell's process."""

import contextlib
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

PROC = Path("/proc")


def by_part(cell: int | None = None) -> dict[str, float]:
    """CPU time so far [s]: cell, publisher, server (sockets, callbacks, what comes from the cell), bench (the calling thread),
    and all.

    cell: number of its process; without one, its thread's is told. Where the system does not tell a thread's time all but `all`
    is zero.
    """
    spent = {"all": time.process_time(), "cell": 0.0, "publisher": 0.0, "server": 0.0, "bench": 0.0}
    names = {thread.native_id: thread.name for thread in threading.enumerate()}
    for number, seconds in threads():
        part = "bench" if number == threading.get_native_id() else names.get(number, "")
        spent[part if part in spent else "server"] += seconds
    if cell is not None:
        there = sum(seconds for _, seconds in threads(str(cell)))
        spent["cell"] += there
        spent["all"] += there
    return spent


def threads(process: str = "self") -> Iterator[tuple[int, float]]:
    """Number and CPU time [s] of each thread of a process."""
    tasks = PROC / process / "task"
    for task in tasks.iterdir() if tasks.exists() else ():
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has just ended
            yield int(task.name), 1e-9 * int((task / "schedstat").read_text().split()[0])


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
