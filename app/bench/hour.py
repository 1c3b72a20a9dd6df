"""Free motion for hours, and pushes, on robots that the calibration has not seen, with the thresholds that it gave."""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app.bench.pool import spread
from app.bench.pushes import Watch, anywhere, calm, go, push
from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.parameters import replaced

ROBOTS, FIRST = 6, 200
"""Robots, each with another model error, and the seed of the first: those of the calibration begin at 0."""
LINKS, FORCE = (4, 5, 6, 7), 20.0
"""The pushes: links, and force [N], inward."""
PUSHES = 420
"""So many for each hour."""
OTHERS = "-.5 -.1 .5\n-.6 .1 .5\n-.6 .05 .36\n-.48 .12 .42\n"
"""Waypoints of a path that no calibration has run."""
MOTIONS: tuple[tuple[str, float, float], ...] = (
    ("hexagon", 0.2, 0.5), ("hexagon", 0.12, 0.1), ("circle", 0.1, 0.1), ("circle", 0.25, 0.1), ("waypoints", 0.15, 0.1),
    ("hold", 0.2, 0.1))
"""Kind of path, speed [m/s], and share of the time."""
SLOW: dict[str, float] = {"rates.camera_hz": 5, "rates.localize_hz": 5, "tracker.stale": 1.0}
"""Cameras of the free motion: with nothing to be seen, the residuals are the same to the last bit as with all images."""


@dataclass(frozen=True)
class Work:
    """One robot, so many seconds of free motion shared out to its motions, and so many pushes."""

    base: Config
    robot: int
    seconds: float
    pushes: int
    device: str = "cpu"
    motions: tuple[tuple[str, float, float], ...] = MOTIONS


@dataclass(frozen=True)
class Free:
    """One motion of one robot: how long [s], when a contact was detected [s], and each joint's highest |r_k| / r_low,k."""

    robot: int
    kind: str
    speed: float
    seconds: float
    false: tuple[float, ...]
    worst: tuple[float, ...]


@dataclass(frozen=True)
class Felt:
    """One push: delay until it was detected [s], None if it was not; before: something was felt already."""

    robot: int
    link: int
    kind: str
    delay: float | None
    before: bool


def bench(calibrated: Config, hours: float, device: str = "cpu") -> dict[str, Any]:
    """Move freely for so long, all robots together, then push them; the figures, ready for JSON."""
    number = round(PUSHES * max(hours, 0.1) / ROBOTS)
    work = [Work(calibrated, FIRST + k, 3600.0 * hours / ROBOTS, number, device) for k in range(ROBOTS)]
    done = list(spread(lived, work))
    free, felt = [f for motions, _ in done for f in motions], [f for _, pushes in done for f in pushes]
    return {"conditions": {"robots": ROBOTS, "seed": FIRST, "force_N": FORCE, "r_low": list(calibrated.observer.r_low)},
            "free": [asdict(f) for f in free], **summary(free, felt), "pushes": [asdict(f) for f in felt]}


def lived(work: Work) -> tuple[list[Free], list[Felt]]:
    """What becomes of one robot."""
    return list(free_motion(work)), list(pushed(work))


def free_motion(work: Work) -> Iterator[Free]:
    """The robot moves, the whole cell closed, with nothing near it."""
    for kind, speed, share in work.motions:
        with cell_of(work, kind, speed, SLOW) as cell:
            watch = Watch()
            for _ in go(cell, watch, share * work.seconds):
                pass
            worst = tuple(float(x) for x in watch.level / cell.config.observer.r_low)
            yield Free(work.robot, kind, speed, watch.seconds, tuple(watch.false), worst)


def pushed(work: Work) -> Iterator[Felt]:
    """The robot is pushed, half of the times at rest: points all over the links, by area."""
    for kind, number in (("hexagon", work.pushes - work.pushes // 2), ("hold", work.pushes // 2)):
        rng, watch = np.random.default_rng([work.robot, number]), Watch()
        with cell_of(work, kind, 0.2, {}) as cell:
            for i in range(number):
                link = LINKS[i % len(LINKS)]
                point, inward = anywhere(link, calm(cell, watch), rng)
                x, y, z = (FORCE * inward).tolist()
                delay = push(cell, watch, link, point, (x, y, z)).delay
                yield Felt(work.robot, link, kind, delay if delay is not None and np.isfinite(delay) else None, delay is None)


def summary(free: Sequence[Free], felt: Sequence[Felt]) -> dict[str, Any]:
    """False contacts of the free motion, and delays [s] of the pushes, with a missed one as infinitely late."""
    delays = [np.inf if f.delay is None else f.delay for f in felt if not f.before]
    p50, p95 = np.percentile(delays, [50, 95], method="higher").tolist()
    return {"seconds": sum(f.seconds for f in free), "false": sum(len(f.false) for f in free),
            "worst_ratio": max(max(f.worst) for f in free), "pushed": len(felt), "felt_before": len(felt) - len(delays),
            "missed": int(np.isinf(delays).sum()),
            "delay_median": p50 if np.isfinite(p50) else None, "delay_p95": p95 if np.isfinite(p95) else None}


@contextmanager
def cell_of(work: Work, kind: str, speed: float, changes: Mapping[str, float]) -> Iterator[Cell]:
    """The cell of a robot with a task, and with other changes."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "others.txt"
        file.write_text(OTHERS, encoding="utf-8")
        config = work.base
        for key, value in {"seed": work.robot, "task.kind": kind, "task.speed": speed, "task.waypoints": str(file),
                           **changes}.items():
            config = replaced(config, key, value)
        yield Cell(config, work.device)
