"""CPU time of this process, by what its threads are for."""

import os
import threading
import time
from pathlib import Path

TASKS = Path("/proc/self/task")


def by_part() -> dict[str, float]:
    """CPU time so far [s]: cell, publisher, server (sockets and callbacks), bench (the calling thread), and all.

    Where the system does not tell a thread's time all but `all` is zero.
    """
    spent = {"all": time.process_time(), "cell": 0.0, "publisher": 0.0, "server": 0.0, "bench": 0.0}
    names = {thread.native_id: thread.name for thread in threading.enumerate()}
    for task in TASKS.iterdir() if TASKS.exists() else ():
        try:
            seconds = 1e-9 * int((task / "schedstat").read_text().split()[0])
        except (FileNotFoundError, ProcessLookupError):  # it has just ended
            continue
        number = int(task.name)
        part = "bench" if number == threading.get_native_id() else names.get(number, "")
        spent[part if part in spent else "server"] += seconds
    return spent


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
