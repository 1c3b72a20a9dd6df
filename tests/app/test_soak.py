"""The soak tool: it sees what grows and what goes wrong; a short real run shows that all its parts act."""

import logging
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from process import alive, children, launched
from vclient import until

from app.endurance.health import GROWTH, Counted, Health, Sample, faults, summary
from app.endurance.soak import FILES, Errors, Job, soak
from hrc.errors import HrcError

CALM = Sample(0.0, 500_000_000, 30, 10, 1.0, 0.0, 0, 3)


def run(minutes: int, **growth: float) -> list[Sample]:
    """Samples of so many minutes, in which some figures grow by so much a minute."""
    return [replace(CALM, time=60.0 * i, **{name: round(getattr(CALM, name) + by * i) for name, by in growth.items()})
            for i in range(1, minutes + 1)]


def judged(samples: list[Sample], *errors: str, **failed: int) -> list[str]:
    done = {"join": 3, "push": 1, "stop": 40}
    return faults({**summary(samples), "recording": {"trouble": ""}, "done": done, "failed": failed}, errors)


def test_a_calm_run_has_no_faults() -> None:
    assert judged(run(60)) == []


@pytest.mark.parametrize(("name", "by"), [("memory", 400_000), ("descriptors", 0.1), ("threads", 0.1)])
def test_what_grows_is_found(name: str, by: float) -> None:
    found = judged(run(60, **{name: by}))
    assert len(found) == 1
    assert name in found[0]


def test_memory_that_grows_only_at_first_is_forgiven() -> None:
    samples = [replace(sample, memory=CALM.memory - 100_000_000 if sample.time < 590.0 else CALM.memory) for sample in run(60)]
    assert summary(samples)["memory_growth"] == 0.0
    assert summary(run(60, memory=0.9 * GROWTH * CALM.memory / 50))["memory_growth"] < GROWTH


def test_lost_time_and_errors_are_faults() -> None:
    samples = [replace(sample, factor=0.9) for sample in run(10)]
    assert judged(samples, "log: x") == ["the real-time factor is 0.900, of 0.97 at least", "error: log: x"]


def test_a_soak_that_nobody_came_to_is_none() -> None:
    found = {**summary(run(10)), "recording": {"trouble": ""}, "done": {"join": 3}, "failed": {}}
    assert faults(found, ()) == ["no visitor managed to push"]


def test_visitors_who_do_not_get_what_they_want_are_a_fault_unless_it_is_rare() -> None:
    assert judged(run(10), **{"stop: TimeoutError never": 1, "stop: KeyError x": 1}) == []
    found = judged(run(10), **{"stop: TimeoutError never": 2, "stop: KeyError x": 1})
    assert found == ["what visitors did failed: stop, 3 times beside 40 that worked out"]
    assert "vanish" in judged(run(10), **{"vanish: KeyError": 1})[0]


def test_threads_are_counted_that_python_does_not_know_of() -> None:
    health = Health(Counted(1.0, 100), 1000)
    sample = health.take(Counted(2.0, 1050, 7), visitors=3)
    assert sample.threads == len(list(Path("/proc/self/task").iterdir()))
    assert (sample.factor, sample.images, sample.visitors) == (0.95, 7, 3)
    assert sample.lost == pytest.approx(0.05)


def test_the_cells_process_counts_too() -> None:
    with launched(["sleep", 60]) as other:
        own, both = (Health(Counted(1.0, 0), 1000, pid).take(Counted(2.0, 0), visitors=0) for pid in (None, other.pid))
    assert both.threads == own.threads + 1
    assert both.descriptors >= own.descriptors + 3
    assert both.memory > own.memory


def test_tracebacks_and_logged_errors_are_collected(capsys: pytest.CaptureFixture[str]) -> None:
    errors = Errors()
    with errors.listening():
        print('Traceback (most recent call last):\n  File "x.py", line 1\nValueError: bad', file=sys.stderr)
        logging.getLogger("websockets.server").error("lost %s", "it")
        print("a warning", file=sys.stderr)
    logging.getLogger().error("later")
    errors.say("the cell failed (ValueError: bad); the page lives on")
    errors.say('"free" is running')
    assert errors.found == ["traceback: ValueError: bad", "log: lost it",
                            "page: the cell failed (ValueError: bad); the page lives on"]
    assert "a warning" in capsys.readouterr().err, "it is printed all the same"


@pytest.mark.live
def test_a_few_seconds_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is said about its speed: others use the machine."""
    told = soak(Job(hours=12.0 / 3600.0, out=tmp_path / "out", json=tmp_path / "soak.json", seed=1, browsers=1))
    assert [line for line in told if line.startswith("error")] == []
    printed = capsys.readouterr().out
    assert "join" in printed
    assert " push" in printed
    assert int(printed.split("recording: ")[1].split()[0]) >= FILES / 2, "whatever a file holds in an hour"
    assert 1 <= len(list((tmp_path / "out").glob("*.rrd"))) <= 4
    assert (tmp_path / "soak.json").stat().st_size > 1000


@pytest.mark.live
@pytest.mark.parametrize(("end", "to_all"), [(signal.SIGTERM, False), (signal.SIGTERM, True), (signal.SIGKILL, False)])
def test_who_ends_it_early_leaves_nobody_behind(tmp_path: Path, end: signal.Signals, to_all: bool) -> None:
    out = tmp_path / "soak.json"
    command = [sys.executable, "-m", "app", "soak", "--hours", "1", "--browsers", "0", "--json", str(out)]
    with launched(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True) as running:
        until(lambda: len(children(running.pid)) >= 4)  # cell, visitors, and what they need
        time.sleep(14.0 if to_all else 3.0)  # nobody but the cell, which ends too, could take the first sample later
        started = children(running.pid)
        os.killpg(running.pid, end) if to_all else running.send_signal(end)
        running.wait(120.0)
        until(lambda: not any(alive(process) for process in started))
        assert running.stdout is not None
        assert running.stderr is not None
        told, said = running.stdout.read(), running.stderr.read()
    assert "Traceback" not in said
    if end is signal.SIGTERM:
        assert running.returncode == 1
        assert "error: soak: " in told
        assert out.exists()


def test_a_time_that_is_none_is_refused() -> None:
    with pytest.raises(HrcError, match="hours must be above 0"):
        soak(Job(hours=0.0))
