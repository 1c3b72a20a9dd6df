"""Independent jobs on all cores."""

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def spread(work: Callable[[Job], Result], jobs: Sequence[Job], *, alone: bool = False) -> Iterator[Result]:
    """The results in order; on all cores unless alone. Each job is seeded by itself, so the results do not depend on that."""
    from tqdm import tqdm

    def shown(results: Iterator[Result]) -> Iterable[Result]:
        return tqdm(results, total=len(jobs), desc=work.__name__, disable=alone or not sys.stderr.isatty())

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if alone or cores == 1:
        yield from shown(map(work, jobs))
        return
    with ProcessPoolExecutor(cores, get_context("spawn")) as pool:
        yield from shown(pool.map(work, jobs))
