"""Taking times: on one core, by turns, each contender through distinct frames."""

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hrc.geometry import Array

Step = Callable[[int], Any]
"""Does its part for frame k."""


class Contender:
    """Something to be timed: what it does for a frame, step by step. A subclass fills `steps` in their order."""

    steps: dict[str, Step]

    def __call__(self, k: int) -> None:
        """All steps for frame k."""
        for step in self.steps.values():
            step(k)


@dataclass(frozen=True)
class Times:
    """Times [s] of a contender, one row for each round and frame, one column for each of its steps."""

    steps: tuple[str, ...]
    seconds: Array

    def median_ms(self, *steps: str) -> float:
        """Of these steps together, by default of all."""
        return 1e3 * float(np.median(self._of(steps)))

    def p90_ms(self, *steps: str) -> float:
        """The time that one frame in ten exceeds."""
        return 1e3 * float(np.percentile(self._of(steps), 90))

    def _of(self, steps: tuple[str, ...]) -> Array:
        return self.seconds[:, [self.steps.index(step) for step in steps or self.steps]].sum(axis=1)


def by_turns(contenders: Mapping[str, Contender], frames: int, rounds: int) -> dict[str, Times]:
    """Times over so many rounds, after one more to warm up.

    In a round each contender in turn goes through all frames: a noisy neighbour on the machine meets them all, and each runs
    as in a control loop, on caches that hold its own data and not one frame's.
    """
    seconds: dict[str, list[list[float]]] = {name: [] for name in contenders}
    for i in range(rounds + 1):
        for name, contender in contenders.items():
            for k in range(frames):
                row = [_timed(step, k) for step in contender.steps.values()]
                if i > 0:
                    seconds[name].append(row)
    return {name: Times(tuple(contenders[name].steps), np.array(rows)) for name, rows in seconds.items()}


def _timed(step: Step, k: int) -> float:
    start = time.perf_counter()
    step(k)
    return time.perf_counter() - start


@contextmanager
def one_core() -> Iterator[int | None]:
    """Hold every thread of this process on one core, where the system lets a process choose; gives the core, or None.

    A library's threads inherit this when they are started, except a graphics driver's: `hold` again after that.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield None
        return
    cores = os.sched_getaffinity(0)
    hold({max(cores)})
    try:
        yield max(cores)
    finally:
        hold(cores)


def hold(cores: set[int] | None = None) -> None:
    """Let every thread of this process run on these cores only, by default on the calling thread's."""
    if not hasattr(os, "sched_setaffinity"):
        return
    tasks = Path("/proc/self/task")
    for thread in tasks.iterdir() if tasks.exists() else ():
        try:
            os.sched_setaffinity(int(thread.name), cores or os.sched_getaffinity(0))
        except ProcessLookupError:  # it has just ended
            continue
