"""How well contacts are felt: force, place, delay, missed and false ones, on the whole cell, at rest and moving."""

import itertools
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from app import calibrate
from app.bench import hour, report
from app.bench.contact_report import plot, printed
from app.bench.contact_rows import rows
from app.bench.pool import spread
from app.bench.pushes import CONE, DECAYED, HELD, OBSERVABLE, SETTLED, Outcome, Watch, calm, place, push
from app.settings import configured
from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.errors import HrcError
from hrc.parameters import replaced

LINKS, FORCES = (3, 4, 5, 6, 7), (10.0, 20.0, 40.0)
"""Of the pushes; forces in [N]."""
DIRECTIONS = {sign + axis: float(f"{sign}1") * np.eye(3)["xyz".index(axis)] for sign in "+-" for axis in "xyz"}
"""Of the force on the robot, in the world."""
PRESETS = ("ideal", "realistic", "harsh")
TASKS = {"rest": "hold", "moving": "hexagon"}
ROBOTS = 3
"""The grid of each preset and task is dealt out to so many robots, each with a model error of its own."""
FIRST = 100
"""Their first seed: calibration begins at 0."""
CALIBRATED = "calibrated"
"""What the preset realistic is called with the settings of a calibration."""


class Push(NamedTuple):
    """One of the grid: link, direction ("+x") and force [N]."""

    link: int
    direction: str
    force: float


@dataclass(frozen=True)
class Series:
    """Pushes on one robot, one after another."""

    preset: str
    task: str
    config: Config
    pushes: tuple[Push, ...]
    device: str = "cpu"


@dataclass(frozen=True, eq=False)
class Done:
    """A series and what came of it; false: contacts detected with nothing touching, in so many seconds; felt: of these [s]."""

    series: Series
    outcomes: tuple[Outcome, ...]
    false: int
    seconds: float
    felt: float


def bench(device: str = "cpu", json: Path | None = None, quick: bool = False, hours: float = 0.0,
          settings: Path | None = None) -> None:
    """Push the cell about, print the table, and write it to a file with a plot beside it.

    settings: of a calibration; with them the grid is run on calibrated robots, too. hours: of free motion and pushes on more of
    these; without settings they are calibrated first, with default arguments, into a file beside the figures.
    Raises HrcError, before anything moves, for a file that cannot be read or written, or hours out of range.
    """
    if not 0.0 <= hours <= 100.0:
        raise HrcError(f"the hours must be 0 to 100, not {hours:g}")
    if json is not None:
        report.check(json)
    with tempfile.TemporaryDirectory() as folder:
        if hours and settings is None:
            settings = (json or Path(folder) / "calibrated").with_suffix(".toml")
            calibrate.execute(calibrate.Job(settings))
        configs = {name: configured(name) for name in (PRESETS[:2] if quick else PRESETS)}
        if settings is not None:
            configs[CALIBRATED] = configured("realistic", file=settings)
    pushes = tuple(Push(*each) for each in itertools.product(LINKS, DIRECTIONS, FORCES))
    if quick:
        pushes = (Push(5, "+z", 20.0), Push(6, "+x", 20.0))
    done = list(spread(run, list(deal(configs, pushes, 1 if quick else ROBOTS, device)), alone=quick))
    every = [(d.series.preset, d.series.task, o) for d in done for o in d.outcomes]
    figures: dict[str, Any] = {
        "conditions": {"robots": 1 if quick else ROBOTS, "seed": FIRST, "held_s": HELD, "judged_from_s": SETTLED,
                       "observable_m": OBSERVABLE, "cone_deg": CONE, "decayed_s": DECAYED,
                       "r_low": {name: list(config.observer.r_low) for name, config in configs.items()}},
        "rows": [asdict(row) for row in rows(every)], "calm": [calm_of(done, name) for name in configs]}
    if hours:
        figures["hour"] = hour.bench(configs[CALIBRATED], hours, device)
    print("\n".join(printed(figures)))
    if json is not None:
        report.write(json, figures)
        plot(figures, json.with_suffix(".png"))


def deal(configs: dict[str, Config], pushes: Sequence[Push], robots: int, device: str = "cpu") -> Iterator[Series]:
    """The pushes of every config and task in random order, dealt out to the robots."""
    for name, config in configs.items():
        for task, kind in TASKS.items():
            order = np.random.default_rng(FIRST).permutation(len(pushes))
            for k in range(robots):
                robot = replaced(replaced(config, "task.kind", kind), "seed", FIRST + k)
                yield Series(name, task, robot, tuple(pushes[i] for i in order[k::robots]), device)


def run(series: Series) -> Done:
    """Push the robot, each time when it has calmed down."""
    cell, watch, rng = Cell(series.config, series.device), Watch(), np.random.default_rng(series.config.seed)
    outcomes = []
    for link, name, size in series.pushes:
        T, direction = calm(cell, watch), DIRECTIONS[name]
        x, y, z = (size * direction).tolist()
        outcomes.append(push(cell, watch, link, place(link, direction, T, rng), (x, y, z)))
    return Done(series, tuple(outcomes), len(watch.false), watch.seconds, watch.felt)


def calm_of(done: Sequence[Done], preset: str) -> dict[str, Any]:
    """False contacts of one preset, how long they lasted, and the time in which they might have been [s]."""
    chosen = [d for d in done if d.series.preset == preset]
    return {"preset": preset, **{name: sum(getattr(d, name) for d in chosen) for name in ("false", "felt", "seconds")}}
