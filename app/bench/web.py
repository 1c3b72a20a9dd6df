"""What the page costs and how quick it is: CPU, bytes, delays and the cell's real-time factor, with one and three clients."""

import contextlib
import os
import platform
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from app.bench.cpu import by_part, cores
from app.bench.report import check, write
from app.bench.traffic import LINK, Point, Visit, visit
from app.browser import delays, launched, opened
from app.client import ELSEWHERE
from app.serve.access import Access
from app.serve.main import Page
from app.serve.remote import RemoteCell
from hrc.events import Pull
from hrc.messages import Snapshot

SECONDS, QUICK_SECONDS = 20.0, 4.0
BUDGET = {"bytes_per_s": 2e6, "page_cores": 0.20, "input_to_force_p95_s": 0.050, "real_time_factor": 0.99}
"""The most of each for the largest audience; of the real-time factor the least, for every audience."""


@dataclass(frozen=True)
class Audience:
    """Who is there: visitors without a browser, of whom the first drives if somebody does, and perhaps a Chromium.

    Visitors are at machines of their own: their process gives way to the page, and so does a Chromium that comes with them.
    One that comes alone is on the page's machine and shares its cores on equal terms.
    """

    name: str
    raw: int
    browser: bool
    drive: bool


AUDIENCES = (
    Audience("1 client, who pulls", raw=1, browser=False, drive=True),
    Audience("1 browser, who watches", raw=0, browser=True, drive=False),
    Audience("3 clients: one pulls, one a browser", raw=2, browser=True, drive=True),
)


@dataclass(frozen=True)
class Told:
    """at: when [s, monotonic]. time: how far the cell had come [s]. applied: when the pull to each place had been."""

    at: float
    time: float
    applied: dict[Point, float]


class Felt:
    """A `Witness`: when the pull towards each place had been applied [s, monotonic]; and how far time has come."""

    def __init__(self) -> None:
        self._applied: dict[Point, float] = {}
        self._time = 0.0

    def on_step(self, snapshot: Snapshot) -> None:
        """This step's events act in it."""
        self._time = snapshot.time
        for event in snapshot.events:
            if isinstance(event, Pull):
                self._applied[event.target] = time.monotonic()

    def told(self) -> Told:
        """What it has seen so far."""
        return Told(time.monotonic(), self._time, dict(self._applied))


def bench(device: str = "cpu", json: Path | None = None, quick: bool = False) -> None:
    """Measure, print a table, and write every figure with its conditions to `json`.

    Raises OutputError, before anything is measured, if `json` cannot be written.
    """
    if json is not None:
        check(json)
    figures = measure(device, QUICK_SECONDS if quick else SECONDS)
    if json is not None:
        write(json, figures)
    for line in printed(figures):
        print(line)


def measure(device: str, seconds: float) -> dict[str, Any]:
    """Every figure as it goes into the JSON; seconds: for each audience."""
    page = Page("free", Access(port=0), device=device, say=lambda _: None, witness=Felt)
    page.start()
    try:
        _until_running(page)
        with ProcessPoolExecutor(1, get_context("spawn"), os.nice, (ELSEWHERE,)) as pool:
            pool.submit(abs, 0).result()  # its start is not to be seen in the figures
            rows = [_row(audience, page, pool, seconds) for audience in AUDIENCES]
    finally:
        page.close()
    conditions = {"cores": cores(), "system": platform.platform(), "python": platform.python_version(), "seconds": seconds,
                  "scenario": "free", "pulled": LINK, "device": device}
    return {"conditions": conditions, "budget": BUDGET, "rows": rows}


def _until_running(page: Page) -> None:
    while page.session.factor < 0.9:  # kernels compile, the first window of the pacer passes
        time.sleep(0.1)


def _row(audience: Audience, page: Page, pool: ProcessPoolExecutor, seconds: float) -> dict[str, Any]:
    cell = page.session
    assert isinstance(cell, RemoteCell)
    with contextlib.ExitStack() as stack:
        tab = None
        if audience.browser:
            try:
                tab = opened(stack.enter_context(launched(aside=audience.raw > 0)), page.url)
            except (FileNotFoundError, ModuleNotFoundError, TimeoutError) as error:
                return {"name": audience.name, "missing": str(error)}
        watchers = audience.raw
        visits = pool.submit(visit, page.server.get_port(), watchers, seconds + 1.0, drive=audience.drive) if watchers else None
        if visits is not None:
            while len(page.server.get_clients()) < watchers + audience.browser:
                time.sleep(0.05)
        time.sleep(2.0)
        if tab is not None:
            delays(tab)
        before, drawn, begin, worst = by_part(cell.pid), page.tempo.beats, cell.ask("told"), np.inf
        for factor in _seconds(cell, seconds - 2.0):
            worst = min(worst, factor)
        end, spent = cell.ask("told"), by_part(cell.pid)
        passed = end.at - begin.at
        row = {"name": audience.name, "clients": audience.raw + audience.browser, "seconds": passed,
               "cores": {part: (spent[part] - before[part]) / passed for part in spent},
               "pictures_per_s": (page.tempo.beats - drawn) / passed,
               "real_time_factor": (end.time - begin.time) / passed, "real_time_factor_worst_second": worst}
        row["page_cores"] = row["cores"]["publisher"] + row["cores"]["server"]
        if tab is not None:
            row["publish_to_dom"] = _percentiles(delays(tab))
        if visits is not None:
            row |= _seen(visits.result(timeout=seconds + 60.0), cell.ask("told").applied)
        return row


def _seconds(cell: RemoteCell, seconds: float) -> Iterator[float]:
    """The real-time factor of each second."""
    end, before = time.monotonic() + seconds, cell.ask("told")
    while time.monotonic() < end:
        time.sleep(1.0)
        now = cell.ask("told")
        yield (now.time - before.time) / (now.at - before.at)
        before = now


def _seen(visit: Visit, applied: dict[Point, float]) -> dict[str, Any]:
    largest = max(visit.traffic, key=lambda traffic: traffic.rate)
    streams = {name: size / largest.seconds for name, size in sorted(largest.streams.items(), key=lambda s: -s[1])}
    lasted = [applied[place] - sent for place, sent in visit.sent.items() if place in applied]
    return {"bytes_per_s": largest.rate, "streams": streams, "publish_to_client": _percentiles(largest.late),
            "input_to_force": _percentiles(lasted), "lost_inputs": len(visit.sent) - len(lasted)}


def _percentiles(seconds: Sequence[float]) -> dict[str, float | int | None]:
    p50, p95, most = np.percentile(seconds, [50, 95, 100]).tolist() if seconds else (None, None, None)
    return {"p50_s": p50, "p95_s": p95, "max_s": most, "number": len(seconds)}


def printed(figures: dict[str, Any]) -> Iterator[str]:
    """The lines of the table."""
    c = figures["conditions"]
    yield f"{c['cores']} cores, Python {c['python']}; scenario {c['scenario']}, each row {c['seconds']:.0f} s"
    for row in figures["rows"]:
        yield f"\n{row['name']}"
        if "missing" in row:
            yield f"  missing: {row['missing']}"
            continue
        used = row["cores"]
        yield (f"  cores: page {100 * row['page_cores']:.1f} % (publisher {100 * used['publisher']:.1f}, sockets and "
               f"callbacks {100 * used['server']:.1f}); cell {100 * used['cell']:.1f} %")
        yield f"  pictures: {row['pictures_per_s']:.0f} a second"
        yield f"  real-time factor {row['real_time_factor']:.3f}, worst second {row['real_time_factor_worst_second']:.3f}"
        for key, name in (("input_to_force", "input to force"), ("publish_to_client", "publish to client"),
                          ("publish_to_dom", "publish to DOM")):
            times = row.get(key)
            if times and times["number"]:
                yield (f"  {name}: p50 {1e3 * times['p50_s']:.1f}, p95 {1e3 * times['p95_s']:.1f}, "
                       f"max {1e3 * times['max_s']:.1f} ms ({times['number']})")
        if "streams" in row:
            yield f"  to one client: {row['bytes_per_s'] / 1e6:.3f} MB/s"
            yield from (f"    {name:<20}{1e-3 * rate:9.1f} kB/s" for name, rate in row["streams"].items())
    yield ""
    yield from (f"{verdict}: {name}" for name, verdict in judged(figures).items())


def judged(figures: dict[str, Any]) -> dict[str, str]:
    """Each line of the budget, and whether it is kept; none without the browser."""
    *_, row = rows = figures["rows"]
    if any("missing" in row for row in rows):
        return {}
    got = {"bytes_per_s": row["bytes_per_s"], "page_cores": row["page_cores"],
           "input_to_force_p95_s": row["input_to_force"]["p95_s"],
           "real_time_factor": min(row["real_time_factor"] for row in rows)}
    keeps = {key: value is not None and (value >= bound if key == "real_time_factor" else value <= bound)
             for key, bound in BUDGET.items() for value in (got[key],)}
    return {f"{key} {got[key]:.4g} of {bound:g}": "within the budget" if keeps[key] else "OUTSIDE THE BUDGET"
            for key, bound in BUDGET.items()}
