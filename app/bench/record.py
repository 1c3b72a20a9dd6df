"""What a recording costs while the robot runs in real time: the loop's time of each tick, and CPU time in all.

`core` is CPU time for each simulated second, of loop, worker and SDK: the share of a core where real time is kept. p99 is what
the loop waits, CPU p99 what of that it works.
"""

import platform
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from app.bench import report
from app.bench.cpu import cores, threads
from app.headless import versions
from app.record.recorder import Depth, Recorder
from hrc.cell import scenario
from hrc.cell.cell import Cell
from hrc.cell.eyes import rig
from hrc.cell.pace import RealTime
from hrc.cell.run import Inbox, run
from hrc.messages import Snapshot
from hrc.parameters import keys
from hrc.vision.camera import Camera

WARM_S = 2.0
"""Simulated time before anything is counted [s]: the SDK starts."""
BUDGET = {"none": {"core": 0.05, "p99_us": 50.0}, "sampled": {"core": 0.15, "p99_us": 50.0},
          "full": {"core": 0.15, "p99_us": 50.0}}
"""Of the shares of a core, and of a tick's time [us]."""


@dataclass
class _Timed:
    """Hands snapshots to a recorder, and times it [ns]: by the wall, and of this thread's own CPU time."""

    recorder: Recorder

    def __post_init__(self) -> None:
        self.wall: list[int] = []
        self.own: list[int] = []
        self.begun: tuple[float, float] | None = None

    def on_step(self, snapshot: Snapshot) -> None:
        """One step has been taken."""
        cpu, wall = time.thread_time_ns(), time.perf_counter_ns()
        self.recorder.on_step(snapshot)
        took, own = time.perf_counter_ns() - wall, time.thread_time_ns() - cpu
        if snapshot.time < WARM_S:
            return
        if self.begun is None:
            self.begun = others(), time.perf_counter()
        self.wall.append(took)
        self.own.append(own)


def bench(device: str = "cpu", json: Path | None = None, quick: bool = False) -> None:
    """Record, print the table, write it to a file. Raises HrcError, before anything runs, for a file that cannot be."""
    if json is not None:
        report.check(json)
    found = measure(device, 1.0 if quick else 20.0)
    if json is not None:
        report.write(json, found)
    for line in table(found):
        print(line)


def measure(device: str, seconds: float) -> dict[str, Any]:
    """Every figure as it goes into the JSON; seconds: of each recording."""
    with tempfile.TemporaryDirectory(prefix="elbowroom-record-") as folder:
        rows = [_row(Path(folder) / f"{depth}.rrd", depth, device, seconds) for depth in get_args(Depth)]
    return {"conditions": {"cores": cores(), "system": platform.platform(), "seconds": seconds, "scenario": "push",
                           "device": device, **versions()}, "budget": BUDGET, "rows": rows}


def _row(path: Path, depth: Depth, device: str, seconds: float) -> dict[str, Any]:
    cell = Cell(device=device)
    config = cell.config
    cameras = {setup.name: Camera(setup.camera) for setup in rig(config, cell.scene)}
    pacer, recorder = RealTime(config.rates.base_hz), Recorder(
        path, base_hz=config.rates.base_hz, scene=cell.scene, cameras=cameras, parameters=keys(config), about={}, depth=depth)
    timed = _Timed(recorder)
    run(cell, pacer, Inbox(scenario.load("push")), [timed], until=round((WARM_S + seconds) * config.rates.base_hz))
    assert timed.begun is not None
    wall = time.perf_counter() - timed.begun[1]
    spent = others() - timed.begun[0] + 1e-9 * sum(timed.own)
    recorder.close()
    each, own = np.array(timed.wall) / 1e3, np.array(timed.own) / 1e3
    return {"depth": depth, "core": spent / seconds, "p50_us": float(np.median(each)),
            "p99_us": float(np.percentile(each, 99)), "p99_cpu_us": float(np.percentile(own, 99)), "max_us": float(each.max()),
            "images": recorder.images_kept, "dropped": recorder.images_dropped,
            "bytes_per_s": path.stat().st_size / (WARM_S + seconds), "real_time_factor": seconds / wall}


def others() -> float:
    """CPU time [s] of all threads but this one: while nothing else runs, of the recorder and the SDK."""
    own = threading.get_native_id()
    return sum(seconds for number, seconds in threads() if number != own)


def table(found: dict[str, Any]) -> list[str]:
    """The figures in lines."""
    c = found["conditions"]
    lines = [f"{c['cores']} cores, {c['seconds']:g} s of the scenario {c['scenario']} in real time, rerun-sdk {c['rerun-sdk']}",
             "", "depth images     core   p50 us   p99 us  CPU p99   max us   kept  dropped  MB/min  real time"]
    for row in found["rows"]:
        lines.append(f"{row['depth']:<14}{row['core']:>7.1%}{row['p50_us']:>9.1f}{row['p99_us']:>9.1f}{row['p99_cpu_us']:>9.1f}"
                     f"{row['max_us']:>9.0f}{row['images']:>7}{row['dropped']:>9}{60e-6 * row['bytes_per_s']:>8.0f}"
                     f"{row['real_time_factor']:>11.2f}")
    over = [f"{row['depth']}: {key} {row[key]:.3g}, budget {most:g}" for row in found["rows"]
            for key, most in found["budget"][row["depth"]].items() if row[key] > most]
    return [*lines, "", "within the budget" if not over else f"over the budget: {'; '.join(over)}"]
