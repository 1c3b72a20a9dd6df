"""`elbowroom calibrate`: friction and thresholds from free motion of the simulated cell, and what they cost in delay."""

import itertools
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.settings import configured
from hrc import meshes
from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.contact.calibration import Log, fit_alarms, fit_friction, unexplained
from hrc.contact.friction import FrictionConfig
from hrc.errors import HrcError
from hrc.events import Push, Release
from hrc.parameters import replaced

Array = NDArray[np.float64]
GAINS = (10.0, 25.0, 40.0)
"""K_I of the curves [1/s]."""
RATES = tuple(float(rate) for rate in np.logspace(-3.0, 3.0, 13))
"""False alarms per hour of the curves."""
SWEEP = "-.55 0 .45\n-.55 .14 .45\n-.55 0 .45\n-.55 0 .58\n-.55 0 .45\n-.45 -.14 .38\n"
"""Waypoints along which every joint turns both ways, slowly."""
MOTIONS: tuple[tuple[str, float], ...] = (
    ("hexagon", 0.05), ("hexagon", 0.2), ("hexagon", 0.3), ("circle", 0.2), ("waypoints", 0.1), ("hold", 0.2))
"""Kind of path and speed [m/s]."""
QUIET: dict[str, Any] = {"observer.r_low": (50.0,) * 7, "friction": FrictionConfig(), "rates.camera_hz": 1,
                         "rates.localize_hz": 1, "tracker.stale": 10.0}
"""No detection, so the arm just moves; no compensation; and cameras that hardly look, because nothing is there to see."""
LINKS, FORCE, HELD, REST = (4, 5, 6, 7), 20.0, 0.4, 0.5
"""The pushes of the curve: links, force [N], how long they last and the pause after each [s]."""


@dataclass(frozen=True)
class Job:
    """What to calibrate and where to put it; the defaults of the command line."""

    out: Path
    minutes: float = 20.0
    false_alarms_per_hour: float = 0.01
    seed: int = 0
    preset: str = "default"
    robots: int = 5
    pushes: int = 100
    plot: Path | None = None
    motions: tuple[tuple[str, float], ...] = MOTIONS


def execute(job: Job) -> dict[str, Any]:
    """Move, fit, write the settings file and, if asked, the plot; returns the figures.

    Raises HrcError before anything is written for a value that cannot be.
    """
    base = configured(job.preset, seed=job.seed)
    _check(job)
    logs = list(_free_motion(base, job))
    k_i = base.observer.k_i
    friction = fit_friction(logs, k_i)
    r_low = tuple(round(float(x), 3) for x in fit_alarms(logs, k_i, friction).thresholds(job.false_alarms_per_hour))
    figures: dict[str, Any] = {
        "friction": friction, "r_low": r_low, "r_low_before": base.observer.r_low,
        "rms_before": _rms(logs, k_i, None), "rms_after": _rms(logs, k_i, friction)}
    print(_table(figures))
    _written(job.out, lambda path: path.write_text(_toml(figures, job, k_i), encoding="utf-8"))
    print(f"{job.out}: use it with elbowroom run ... --settings {job.out}")
    if job.plot is not None:
        curves = figures["curves"] = _curves(base, logs, friction, job.pushes)
        _written(job.plot, lambda path: _draw(path, curves))
        print(f"{job.plot}: detection delay against false alarms")
    return figures


def _check(job: Job) -> None:
    if not 1 <= job.robots <= 100:
        raise HrcError(f"the number of robots must be 1 to 100, not {job.robots}")
    least = len(job.motions) * job.robots * 12.0 / 60.0
    if not least <= job.minutes <= 600.0:
        raise HrcError(f"the minutes must be {least:g} (12 s for each motion of {job.robots} robots) to 600, "
                       f"not {job.minutes:g}")
    if not 1e-6 <= job.false_alarms_per_hour <= 1e3:
        raise HrcError(f"false alarms per hour must be 1e-6 to 1000, not {job.false_alarms_per_hour:g}")
    for file, suffix in ((job.out, ".toml"), (job.plot, ".png")):
        if file is not None and (file.suffix != suffix or not file.parent.is_dir()):
            raise HrcError(f"{file} cannot be written; name a {suffix} file in a folder that exists")


# -- motion -----------------------------------------------------------------------------------------------------------


def quiet(config: Config, **changes: Any) -> Config:
    """The config with detection off and cameras that hardly look, and `group__name` changes."""
    for key, value in {**QUIET, **{key.replace("__", "."): value for key, value in changes.items()}}.items():
        config = config.replace(friction=value) if key == "friction" else replaced(config, key, value)
    return config


def _free_motion(base: Config, job: Job) -> Iterator[Log]:
    """A log of each motion with each robot: the seed draws a robot's model error and its noise."""
    from tqdm import tqdm

    every = list(itertools.product(range(job.robots), job.motions))
    with tempfile.TemporaryDirectory() as folder:
        sweep = Path(folder) / "sweep.txt"
        sweep.write_text(SWEEP)
        for robot, (kind, speed) in tqdm(every, desc="free motion", disable=not sys.stderr.isatty()):
            config = quiet(base, seed=base.seed + robot, task__kind=kind, task__speed=speed, task__waypoints=str(sweep))
            yield record(Cell(config), 60.0 * job.minutes / len(every), robot)


def record(cell: Cell, seconds: float, robot: int = 0) -> Log:
    """A log of a cell's next seconds from its start."""
    rates, rows = cell.config.rates, []
    for _ in range(round(seconds * rates.base_hz)):
        snapshot = cell.step()
        if snapshot.fresh_control:
            rows.append((snapshot.state.q, snapshot.state.dq, snapshot.residual))
    q, dq, r = np.array(rows).transpose(1, 0, 2)
    dt = 1.0 / rates.control_hz
    return Log(dt, q, dq, unexplained(r, cell.config.observer.k_i, dt), robot)


def pushed(cell: Cell, number: int, rng: np.random.Generator) -> tuple[Log, Array, NDArray[np.int64]]:
    """A log with pushes, the sample (n,) each begins with, and their links (n,): inward, at points all over links 4 to 7."""
    rates, rows, starts, links = cell.config.rates, [], [], []

    def go(seconds: float) -> Array:
        T = np.empty(0)
        for _ in range(round(seconds * rates.base_hz)):
            snapshot = cell.step()
            T = snapshot.T_world_link
            if snapshot.fresh_control:
                rows.append((snapshot.state.q, snapshot.state.dq, snapshot.residual))
        return T

    T = go(1.0)
    for i in range(number):
        link = LINKS[i % len(LINKS)]
        mesh = meshes.robot("perception")[link]
        k = int(rng.integers(len(mesh.vertices)))
        force = -FORCE * T[link, :3, :3] @ mesh.normals[k]
        x, y, z = mesh.vertices[k].tolist()
        starts.append(len(rows))
        links.append(link)
        cell.apply(Push(link, (x, y, z), (float(force[0]), float(force[1]), float(force[2]))))
        go(HELD)
        cell.apply(Release())
        T = go(REST + float(rng.uniform(0.0, 0.1)))
    q, dq, r = np.array(rows).transpose(1, 0, 2)
    dt = 1.0 / rates.control_hz
    return Log(dt, q, dq, unexplained(r, cell.config.observer.k_i, dt)), np.array(starts), np.array(links)


def delays(log: Log, starts: Array, k_i: float, friction: FrictionConfig, r_low: Array) -> Array:
    """Time from the beginning of each push to its detection [s] (n,), inf for one that is missed."""
    over = np.any(np.abs(log.residual(k_i, friction)) > r_low, axis=1)
    held = round(HELD / log.dt)
    found = [over[start:start + held] for start in starts]
    return np.array([(np.argmax(part) + 1) * log.dt if part.any() else np.inf for part in found])


def _curves(base: Config, logs: list[Log], friction: FrictionConfig, number: int) -> dict[float, list[tuple[float, ...]]]:
    """For each K_I: false alarms per hour, delay p50 and p95 [s], and share of pushes missed."""
    log, starts, _ = pushed(Cell(quiet(base)), number, np.random.default_rng(base.seed))
    curves: dict[float, list[tuple[float, ...]]] = {}
    for k_i in GAINS:
        alarms = fit_alarms(logs, k_i, friction)
        curves[k_i] = []
        for rate in RATES:
            found = delays(log, starts, k_i, friction, alarms.thresholds(rate))
            p50, p95 = np.percentile(found, [50, 95], method="higher")
            curves[k_i].append((rate, float(p50), float(p95), float(np.isinf(found).mean())))
    return curves


# -- results ----------------------------------------------------------------------------------------------------------


def _rms(logs: list[Log], k_i: float, friction: FrictionConfig | None) -> tuple[float, ...]:
    r = np.concatenate([log.residual(k_i, friction) for log in logs])
    return tuple(float(x) for x in np.sqrt(np.mean(r**2, axis=0)))


def _table(figures: dict[str, Any]) -> str:
    lines = ["joint  residual in free motion [N m rms]   r_low [N m]",
             "           before     after            before     after"]
    columns = ("rms_before", "rms_after", "r_low_before", "r_low")
    for joint, row in enumerate(zip(*(figures[c] for c in columns), strict=True), 1):
        lines.append("{:>5}  {:>10.3f}{:>10.3f}        {:>10.2f}{:>10.2f}".format(joint, *row))
    return "\n".join(lines)


def _toml(figures: dict[str, Any], job: Job, k_i: float) -> str:
    def listed(values: tuple[float, ...]) -> str:
        return "[" + ", ".join(f"{x:.6g}" for x in values) + "]"

    friction = figures["friction"]
    return (f"# Calibrated from {job.minutes:g} min of free motion: preset {job.preset}, seeds {job.seed} to "
            f"{job.seed + job.robots - 1}, {job.false_alarms_per_hour:g} false alarms an hour.\n"
            f"[observer]\nk_i = {k_i:.6g}\nr_low = {listed(figures['r_low'])}\n\n[friction]\n"
            + "".join(f"{name} = {listed(getattr(friction, name))}\n" for name in ("k", "a", "alpha", "v")))


def _written(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file that appears as a whole or not at all."""
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        write(partial)
        os.replace(partial, path)
    except OSError as error:
        raise HrcError(f"{path} cannot be written: {error.strerror}") from None
    finally:
        partial.unlink(missing_ok=True)


def _draw(path: Path, curves: dict[float, list[tuple[float, ...]]]) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure  # no pyplot: it would look for a display

    image = Figure(figsize=(8, 5), layout="constrained")
    FigureCanvasAgg(image)
    axes = image.subplots()
    for i, (k_i, rows) in enumerate(curves.items()):
        rate, p50, p95, _ = np.array(rows).T
        axes.plot(rate, 1000 * p50, color=f"C{i}", label=f"K_I = {k_i:g} 1/s, median")
        axes.plot(rate, 1000 * np.where(np.isfinite(p95), p95, np.nan), color=f"C{i}", linestyle="--", label="95 %")
    axes.set_xscale("log")
    axes.set_xlabel("false alarms per hour")
    axes.set_ylabel(f"delay of the detection of {FORCE:g} N on links 4 to 7 [ms]")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    image.savefig(path, dpi=110)
