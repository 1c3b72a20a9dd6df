"""What becomes of this process over time: samples of it, and whether it is still as it was."""

import os
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hrc.errors import HrcError
from hrc.messages import Snapshot

PROC = Path("/proc/self")
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

    lost: simulated time that was dropped since then [s]. images: of depth that the recording dropped so far. visitors: now.
    """

    time: float
    memory: int
    descriptors: int
    threads: int
    factor: float
    lost: float
    images: int
    visitors: int


class Steps:
    """Observes a cell: counts its steps, over every reset."""

    def __init__(self) -> None:
        self.number = 0

    def on_step(self, _: Snapshot) -> None:
        """One more."""
        self.number += 1


class Health:
    """Takes samples. Raises HrcError where the system does not tell what a process holds."""

    def __init__(self, steps: Steps, base_hz: int) -> None:
        if not (PROC / "statm").exists():
            raise HrcError("a soak reads /proc/self, which this system has not; run it on Linux")
        self._steps, self._base_hz = steps, base_hz
        self.begin = self._last = time.monotonic()
        self._number = steps.number
        self.samples: list[Sample] = []

    def take(self, *, visitors: int, images: int) -> Sample:
        """One more sample, now."""
        now, number = time.monotonic(), self._steps.number
        passed, simulated = now - self._last, (number - self._number) / self._base_hz
        self._last, self._number = now, number
        memory = int((PROC / "statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        sample = Sample(now - self.begin, memory, _count("fd"), _count("task"), simulated / passed,
                        max(0.0, passed - simulated), images, visitors)
        self.samples.append(sample)
        return sample


def _failures(failed: Mapping[str, int]) -> Counter[str]:
    """How often each act failed, for whatever reason."""
    acts: Counter[str] = Counter()
    for why, number in failed.items():
        acts[why.partition(":")[0]] += number
    return acts


def _count(what: str) -> int:
    """How many of these the process has: of its "task"s some are threads that Python knows nothing of."""
    return len(list((PROC / what).iterdir()))


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
    return {
        "settled_after_s": settle, "memory_bytes": memory, "memory_growth": memory[1] / memory[0] - 1.0,
        "descriptors": descriptors, "threads": threads,
        "real_time_factor": float(np.average([sample.factor for sample in samples], weights=seconds)),
        "worst_factor": min(sample.factor for sample in samples), "lost_s": sum(sample.lost for sample in samples),
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
