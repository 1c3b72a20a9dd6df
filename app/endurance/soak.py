"""`elbowroom soak`: the page with a restless audience, two browsers and a rotating recording, for as long as is asked for.

The audience gives way to the page where both want the cores: it stands for people at machines of their own.
"""

import contextlib
import logging
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing.managers import SyncManager
from pathlib import Path
from typing import IO, Any, TextIO

from tqdm import tqdm

from app.bench.report import check, write
from app.client import ELSEWHERE
from app.endurance.crowd import riot
from app.endurance.health import SETTLED, Health, Sample, faults, summary
from app.endurance.keeper import Keeper, Recorded
from app.endurance.onlookers import watch
from app.serve.access import Access
from app.serve.main import Page
from app.serve.remote import RemoteCell
from app.serve.session import configured
from hrc.errors import HrcError

BROWSERS = 2
FILES = 6
"""Of the recording, at least: with the second the library that writes them begins four more threads, which stay. That has to be
before anything counts.
"""
ROWS = 20
"""Lines of the printed table."""
SCENARIO = "free"


@dataclass(frozen=True)
class Job:
    """What was asked for. rotate: minutes that one file of the recording holds, at most 5, and a FILES-th of the time."""

    hours: float
    out: Path | None = None
    json: Path | None = None
    seed: int = 0
    rotate: float = 5.0
    browsers: int = BROWSERS


class Errors:
    """Collects every error of the page that nobody asked for: tracebacks, logged errors, and what it says itself."""

    def __init__(self) -> None:
        self.found: list[str] = []

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Listen to the log and to standard error, which still prints."""
        handler = logging.Handler(logging.ERROR)
        handler.emit = lambda record: self.found.append(f"log: {record.getMessage()}")
        logging.getLogger().addHandler(handler)
        stream, sys.stderr = sys.stderr, _Tee(sys.stderr, self.found)
        try:
            yield
        finally:
            sys.stderr = stream
            logging.getLogger().removeHandler(handler)

    def say(self, line: str) -> None:
        """What the page says on the terminal."""
        if "failed" in line:
            self.found.append(f"page: {line}")


class _Tee:
    """Standard error that keeps the first line of each traceback's end."""

    def __init__(self, stream: TextIO | IO[str], found: list[str]) -> None:
        self._stream, self._found, self._in = stream, found, False

    def write(self, text: str) -> int:
        for line in text.splitlines():
            if line.startswith("Traceback"):
                self._in = True
            elif self._in and line and not line[0].isspace():
                self._in = False
                self._found.append(f"traceback: {line}")
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def soak(job: Job) -> list[str]:
    """Run it, print the table, write the JSON; what is not as it must be, which is nothing in the best case.

    Raises OutputError, before anything starts, if the JSON cannot be written; HrcError for a time that is none.
    """
    if not 0.0 < job.hours <= 1000.0:
        raise HrcError(f"the hours must be above 0 and at most 1000, not {job.hours:g}")
    if not job.rotate > 0.0 or job.browsers < 0:
        raise HrcError(f"--rotate must be above 0 minutes and --browsers at least 0, not {job.rotate:g} and {job.browsers}")
    if job.json is not None:
        check(job.json)
    with contextlib.ExitStack() as stack:
        folder = job.out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="elbowroom-soak-")))
        folder.mkdir(parents=True, exist_ok=True)
        stack.enter_context(_ends_well())
        found = _run(job, folder)
    found["faults"] = faults(found, found["errors"])
    for line in table(found):
        print(line)
    if job.json is not None:
        write(job.json, found)
    return found["faults"]


@contextlib.contextmanager
def _ends_well() -> Iterator[None]:
    """A SIGTERM ends it as Ctrl-C does: visitors and browsers go home, and what was seen until then is told."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _run(job: Job, folder: Path) -> dict[str, Any]:
    errors, seconds = Errors(), 3600.0 * job.hours
    with contextlib.ExitStack() as stack:
        stack.enter_context(errors.listening())
        config = configured(SCENARIO, {}, job.seed)
        page = Page(SCENARIO, Access(port=0), seed=job.seed, say=errors.say,
                    witness=partial(Keeper, config, SCENARIO, folder, min(60.0 * job.rotate, seconds / FILES, SETTLED / 2)))
        stack.callback(page.close)
        page.start()
        cell = page.session
        assert isinstance(cell, RemoteCell)
        while page.latest is None:
            time.sleep(0.1)
        context = multiprocessing.get_context("spawn")
        pool = stack.enter_context(ProcessPoolExecutor(2, context, _begin_elsewhere))
        manager = SyncManager(ctx=context)
        manager.start(_end_together)
        stack.callback(manager.shutdown)
        ready, over, rests = (manager.Event() for _ in range(3))
        stack.callback(over.set)
        stack.callback(rests.set)
        tabs = pool.submit(watch, page.url, job.browsers, ready, rests, seconds + 240.0) if job.browsers else None
        if tabs is not None:
            _await(ready, tabs)
        crowd = pool.submit(riot, page.server.get_port(), job.seed, over, seconds + 60.0)
        health = Health(cell.ask("counted"), config.rates.base_hz, cell.pid)
        try:  # whatever ends it early is an error among the others, and what was seen until then is told
            _sample(health, page, cell, seconds)
        except (Exception, KeyboardInterrupt) as error:
            errors.found.append(f"soak: {type(error).__name__}: {error}")
            with contextlib.suppress(HrcError):  # the cell may have ended, too
                health.take(cell.ask("counted"), visitors=len(page.server.get_clients()))
        over.set()
        done, failed, said = {}, {}, []
        try:
            done, failed = crowd.result(timeout=120.0)
            cell.paused = True
            rests.set()
            said = tabs.result(timeout=120.0) if tabs is not None else []
        except (Exception, KeyboardInterrupt) as error:
            errors.found.append(f"visitors: {type(error).__name__}: {error}")
        errors.found += said
        try:
            recorded = cell.ask("finish")
        except HrcError as error:
            recorded = Recorded(0, 0, str(error))
        if not health.samples:
            raise HrcError("; ".join(["it ended before there was anything to tell", *_once(errors.found)]))
        return {"conditions": {"seconds": seconds, "browsers": job.browsers, "seed": job.seed}, **summary(health.samples),
                "done": done, "failed": failed, "refused": dict(page.guard.refused), "errors": _once(errors.found),
                "recording": asdict(recorded)}


def _begin_elsewhere() -> None:
    """A process of visitors gives way to the page, as one on another machine would."""
    os.nice(ELSEWHERE)
    _end_together()


def _end_together() -> None:
    """This process ends with the one that started it, however that ended, and not before: no browser is left behind, and a
    signal to all of them at once does not take from the first one what it still has to tell.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


def _await(ready: threading.Event, tabs: "Future[list[str]]") -> None:
    """Wait until the browsers see the arm. Raises what keeps them from it, as HrcError what the user can mend."""
    while not ready.wait(0.2):
        if tabs.done():
            try:
                tabs.result()
            except (FileNotFoundError, TimeoutError) as error:  # no Chromium, or one that never gets there
                raise HrcError(str(error)) from None


def _sample(health: Health, page: Page, cell: RemoteCell, seconds: float) -> None:
    """Samples until the time is over."""
    period = min(10.0, max(1.0, seconds / 200.0))
    with tqdm(total=round(seconds), unit="s", disable=not sys.stderr.isatty()) as bar:
        while (passed := time.monotonic() - health.begin) < seconds:
            time.sleep(min(period, seconds - passed))
            health.take(cell.ask("counted"), visitors=len(page.server.get_clients()))
            bar.update(round(health.samples[-1].time) - bar.n)


def _once(errors: Sequence[str]) -> list[str]:
    """Each error once, with how often."""
    return [f"{error} ({errors.count(error)} times)" for error in dict.fromkeys(errors)]


def table(found: dict[str, Any]) -> Iterator[str]:
    """The lines of the report."""
    samples = [Sample(**sample) for sample in found["samples"]]
    yield "    time s   memory MB  descr.  threads  factor  late s  images dropped  visitors"
    for sample in samples[:: max(1, len(samples) // ROWS)]:
        yield (f"{sample.time:10.0f}{sample.memory / 1e6:12.1f}{sample.descriptors:8}{sample.threads:9}{sample.factor:8.3f}"
               f"{sample.lost:8.2f}{sample.images:16}{sample.visitors:10}")
    memory = found["memory_bytes"]
    yield (f"after {found['settled_after_s']:.0f} s: memory {memory[0] / 1e6:.1f} to {memory[1] / 1e6:.1f} MB "
           f"({100 * found['memory_growth']:+.1f} %), descriptors {found['descriptors'][0]:.0f} to "
           f"{found['descriptors'][1]:.0f}, threads {found['threads'][0]:.0f} to {found['threads'][1]:.0f}")
    yield (f"real-time factor {found['real_time_factor']:.3f}, worst sample {found['worst_factor']:.3f}; "
           f"{found['lost_s']:.1f} s not made good; {found['images_dropped']} depth images dropped")
    yield "visitors: " + ", ".join(f"{number} {name}" for name, number in sorted(found["done"].items()))
    yield from (f"  did not work out: {number} {name}" for name, number in found["failed"].items())
    yield "turned away: " + (", ".join(f"{number} {why}" for why, number in found["refused"].items()) or "nothing")
    recording = found["recording"]
    yield f"recording: {recording['files']} files; those that remain have {recording['kept_bytes'] / 1e6:.0f} MB"
    yield from found["faults"] or ["all as it must be"]
