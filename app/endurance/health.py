"""What becomes of the page over time, with its cell's process: samples of both, and whether they are still as they were."""

import os
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hrc.errors import HrcError

PROC = Path("/proc")
SETTLED = 600.0
"""Memory counts from here on [s], or from a third of a shorter time."""
GROWTH, FACTOR = 0.03, 0.97
"""The most that memory may grow by, and the least real-time factor."""
ACTS = ("join", "push")
"""What visitors must have managed, or nothing was tried."""
RARE = 0.05
"""Of what visitors do no more than this part of what works out may fail: all of them may be frozen when one is to act."""
SPARE = 2
"""Descriptors and threads that the end may have more than the beginning: whoever is just there has some."""


@dataclass(frozen=True)
class Sample:
    """time: since the start [s]. memory: resident [bytes]. factor: real-time factor since the sample before.

    lost: what simulated time fell behind by since then [s]; some of it is made good later. images: of depth that the recording
    dropped so far. visitors: now.
    """

    time: float
    memory: int
    descriptors: int
    threads: int
    factor: float
    lost: float
    images: int
    visitors: int


@dataclass(frozen=True)
class Counted:
    """What was counted beside the cell. at: when [s, monotonic]. steps: over every reset. images_dropped: by the recording."""

    at: float
    steps: int
    images_dropped: int = 0


class Health:
    """Takes samples of this process and another. Raises HrcError where the system does not tell what a process holds."""

    def __init__(self, counted: Counted, base_hz: int, other: int | None = None) -> None:
        """other: number of the process that the cell runs in."""
        self._processes = [PROC / "self", *([PROC / str(other)] if other is not None else [])]
        if not all((process / "statm").exists() for process in self._processes):
            raise HrcError("a soak reads /proc, which this system has not; run it on Linux")
        self._base_hz, self._last = base_hz, counted
        self.begin = time.monotonic()
        self.samples: list[Sample] = []

    def take(self, counted: Counted, *, visitors: int) -> Sample:
        """One more sample, now."""
        passed, simulated = counted.at - self._last.at, (counted.steps - self._last.steps) / self._base_hz
        self._last = counted
        pages = sum(int((process / "statm").read_text().split()[1]) for process in self._processes)
        memory = pages * os.sysconf("SC_PAGE_SIZE")
        sample = Sample(time.monotonic() - self.begin, memory, self._count("fd"), self._count("task"), simulated / passed,
                        max(0.0, passed - simulated), counted.images_dropped, visitors)
        self.samples.append(sample)
        return sample

    def _count(self, what: str) -> int:
        """How many of these they have: of its "task"s some are threads that Python knows nothing of."""
        return sum(len(list((process / what).iterdir())) for process in self._processes)


def _failures(failed: Mapping[str, int]) -> Counter[str]:
    """How often each act failed, for whatever reason."""
    acts: Counter[str] = Counter()
    for why, number in failed.items():
        acts[why.partition(":")[0]] += number
    return acts


def summary(samples: Sequence[Sample]) -> dict[str, Any]:
    """The figures of a soak. The first and the last tenth of what has settled are compared by their medians."""
    settle = min(SETTLED, samples[-1].time / 3.0)
    settled = [sample for sample in samples if sample.time >= settle]
    tenth = max(1, len(settled) // 10)
    first, last = settled[:tenth], settled[-tenth:]

    def medians(name: str) -> tuple[float, float]:
        return tuple(float(np.median([getattr(sample, name) for sample in part])) for part in (first, last))  # type: ignore

    memory, descriptors, threads = medians("memory"), medians("descriptors"), medians("threads")
    seconds = np.diff([0.0, *(sample.time for sample in samples)])
    factor = float(np.average([sample.factor for sample in samples], weights=seconds))
    return {
        "settled_after_s": settle, "memory_bytes": memory, "memory_growth": memory[1] / memory[0] - 1.0,
        "descriptors": descriptors, "threads": threads,
        "real_time_factor": factor, "worst_factor": min(sample.factor for sample in samples),
        "lost_s": max(0.0, 1.0 - factor) * float(seconds.sum()),
        "images_dropped": samples[-1].images, "samples": [asdict(sample) for sample in samples]}


def faults(found: dict[str, Any], errors: Sequence[str]) -> list[str]:
    """What is not as it must be; none is a pass."""
    told = []
    if found["memory_growth"] >= GROWTH:
        told.append(f"memory grew by {100 * found['memory_growth']:.1f} %, of {100 * GROWTH:.0f} % at most")
    for name in ("descriptors", "threads"):
        before, after = found[name]
        if after > before + SPARE:
            told.append(f"{name} grew from {before:.0f} to {after:.0f}")
    if found["real_time_factor"] < FACTOR:
        told.append(f"the real-time factor is {found['real_time_factor']:.3f}, of {FACTOR} at least")
    told += [f"no visitor managed to {act}" for act in ACTS if not found["done"].get(act)]
    told += [f"what visitors did failed: {act}, {number} times beside {found['done'].get(act, 0)} that worked out"
             for act, number in _failures(found["failed"]).items() if number > RARE * found["done"].get(act, 0)]
    if found["recording"]["trouble"]:
        told.append(f"recording: {found['recording']['trouble']}")
    return [*told, *(f"error: {error}" for error in errors)]
