"""Campaigns on real worker processes: here and behind a scheduler, with some of them killed in the middle."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from process import launched

from app.__main__ import main
from app.campaign import command as command_module
from app.campaign import engine as engine_module
from app.campaign.cluster import Cluster
from app.campaign.command import STAMP
from app.campaign.engine import engine
from app.campaign.episode import play
from app.campaign.plan import Campaign, CampaignError, load
from app.campaign.store import RECORDS
from app.campaign.versions import versions
from app.replay import exact

FILE = """
title = "Tiny"
metrics = ["missed", "force_error_N"]
worst = "force_peak_N"

[set]
task.kind = "hold"
camera = { width = 128, height = 106, fx = 91.0, fy = 91.0, cx = 63.0, cy = 51.0 }
situation = { settle = 0.2, held = 0.1, after = 0.05, judged_from = 0.05, profile = "step", contacts = 2 }

[sweep]
plant.friction_left = [0.0, 0.3]
situation.shape = ["sphere", "capsule"]
situation.by = ["obstacle"]
"""
EPISODES = 3
"""At each of four points; the scene has two spheres and one capsule, so half of all episodes fail."""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tiny") / "tiny.toml"
    path.write_text(FILE)
    return path


@pytest.fixture(scope="module")
def campaign(file: Path) -> Campaign:
    return load(file, EPISODES)


@pytest.fixture(scope="module")
def expected(campaign: Campaign) -> dict[int, Any]:
    """The records of an undisturbed run, by index, played in this process."""
    return {e.index: json.loads(json.dumps(play(e))) for e in campaign.chosen(lambda _: True)}


class Lethal(Mapping[str, Any]):
    """Values that end every process that looks at them but the one that has made them."""

    def __init__(self) -> None:
        self.home = os.getpid()

    def __iter__(self) -> Iterator[str]:
        if os.getpid() != self.home:
            os._exit(1)
        return iter(())

    def __len__(self) -> int:
        return 0

    def __getitem__(self, key: str) -> Any:
        raise KeyError(key)


def pids() -> list[int]:
    from distributed import default_client

    found: Any = default_client().run(os.getpid)
    return list(found.values())


def test_killed_workers_cost_nothing_and_only_an_episode_that_kills_them_is_blamed(
        campaign: Campaign, expected: dict[int, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine_module, "ATTEMPTS", 1)
    monkeypatch.setattr(engine_module, "FETCH", 4.0)
    found: dict[int, Any] = {}
    with engine(Cluster(workers=2)) as workers:
        victim, other = pids()
        os.kill(other, signal.SIGINT)  # Ctrl-C in a terminal reaches the workers, too
        for record in workers.play(campaign.chosen(lambda _: True), lambda: len(found) >= 6):
            found[record["index"]] = record
            if len(found) == 3:
                os.kill(victim, signal.SIGKILL)
        assert len(found) < len(expected), "it stops when it is told to"
        assert other in pids()
        rest = list(campaign.chosen(lambda i: i not in found))
        found |= {r["index"]: r for r in workers.play([replace(rest[0], index=99, values=Lethal()), *rest])}
    assert "WorkerDied" in found.pop(99)["error"]
    assert found == expected
    assert sum(r["error"] is not None for r in found.values()) == len(expected) / 2, "only those that really fail"


def command(file: Path, out: Path, *more: object) -> list[str]:
    return [sys.executable, "-m", "app", "campaign", str(file), "--episodes", str(EPISODES), "--out", str(out), *map(str, more)]


def records(out: Path) -> dict[int, Any]:
    return {r["index"]: r for r in map(json.loads, (out / RECORDS).read_text().splitlines())}


def lines(out: Path) -> int:
    return (out / RECORDS).read_bytes().count(b"\n") if (out / RECORDS).exists() else 0


def test_killed_halfway_and_begun_again_it_has_the_records_of_an_undisturbed_run(
        file: Path, expected: dict[int, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    with launched(command(file, out, "--workers", 1), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL):
        wait(lambda: lines(out) >= len(expected) / 2)
    before = lines(out)
    assert before < len(expected)
    main(command(file, out, "--workers", 2, "--record", 1)[3:])
    assert lines(out) == len(expected), "nothing was played twice"
    assert records(out) == expected
    said = capsys.readouterr().out
    assert f"{len(expected)} episodes, {before} of them there" in said
    assert "6 of 12 episodes failed" in said
    assert {p.name for p in out.iterdir()} == {"campaign.json", RECORDS, "records.parquet", "summary.parquet", "report.html",
                                               STAMP, "worst"}
    (session,) = (out / "worst").iterdir()
    assert exact(session)[1], "the worst episode can be replayed to the last bit"
    html = (out / "report.html").read_text()
    assert html.count("data:image/png;base64,") >= 2
    assert "http" not in html.replace("http-equiv", "")
    main(command(file, out)[3:])
    assert f"{len(expected)} of them there" in capsys.readouterr().out
    assert (out / "report.html").read_text() == html, "nothing missing, nothing written"


# -- a scheduler and workers of their own -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cluster(pem: tuple[Path, Path]) -> Iterator[tuple[str, list[int]]]:
    """Address of a scheduler with two workers behind TLS, and the process ids of all three."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tls://127.0.0.1:{port}"
    tls = ["--tls-ca-file", pem[0], "--tls-cert", pem[0], "--tls-key", pem[1]]
    environment = {**os.environ, "DASK_DISTRIBUTED__SCHEDULER__WORKER_SATURATION": "1.0",
                   "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1", "DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "true"}
    dask = [sys.executable, "-c", "import sys; from distributed.cli import dask_{0}; sys.exit(dask_{0}.main())"]

    def start(what: str, *more: object) -> "subprocess.Popen[bytes]":
        return subprocess.Popen([*dask[:2], dask[2].format(what), *map(str, more), *map(str, tls)], env=environment,
                                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    processes = [start("scheduler", "--host", address, "--no-dashboard")]
    processes += [start("worker", address, "--nthreads", 1, "--no-nanny", "--no-dashboard") for _ in range(2)]
    yield address, [p.pid for p in processes]
    for process in processes:
        process.kill()
        process.wait()


def test_a_cluster_behind_tls_plays_everything_although_a_worker_is_killed(
        campaign: Campaign, expected: dict[int, Any], cluster: tuple[str, list[int]], pem: tuple[Path, Path],
        monkeypatch: pytest.MonkeyPatch) -> None:
    address, processes = cluster
    here, found = Cluster(address, None, pem[0], *pem), dict[int, Any]()
    monkeypatch.setattr(engine_module, "FETCH", 4.0)
    with engine(here) as workers:
        wait(lambda: len(workers.workers) == 2)
        for record in workers.play(campaign.chosen(lambda _: True)):
            found[record["index"]] = record
            if len(found) == 4:
                os.kill(processes[1], signal.SIGKILL)
        assert len(workers.workers) == 1
    assert found == expected

    monkeypatch.setattr(engine_module, "PATIENCE", 2.0)
    with pytest.raises(CampaignError, match="no scheduler that answers"), engine(Cluster(address.replace("tls", "tcp"))):
        pass
    with monkeypatch.context() as other:
        other.setitem(versions(), "mujoco", "3.0.0")
        with pytest.raises(CampaignError, match=r"the worker tls://\S+ has mujoco \S+ \(here 3\.0\.0\)"), engine(here):
            pass
    with engine(here) as workers:
        playing = workers.play(campaign.chosen(lambda _: True))
        assert next(playing)["index"] in expected
        os.kill(processes[0], signal.SIGKILL)
        with pytest.raises(CampaignError, match="the scheduler is gone"):
            list(playing)


def test_a_scheduler_without_tls_is_none_for_who_asks_for_it(pem: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine_module, "PATIENCE", 2.0)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    code = "import sys; from distributed.cli import dask_scheduler; sys.exit(dask_scheduler.main())"
    plain = subprocess.Popen([sys.executable, "-c", code, "--host", f"tcp://127.0.0.1:{port}", "--no-dashboard"],
                             stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait(lambda: _listens(port))
        with (pytest.raises(CampaignError, match=f"no scheduler that answers with TLS at tls://127.0.0.1:{port}"),
              engine(Cluster(f"tls://127.0.0.1:{port}", None, pem[0], *pem))):
            pass
    finally:
        plain.kill()
        plain.wait()


def _listens(port: int) -> bool:
    with socket.socket() as door:
        return door.connect_ex(("127.0.0.1", port)) == 0


def test_an_address_without_a_port_is_said_at_once() -> None:
    with pytest.raises(CampaignError, match="missing port number in address tcp:"), engine(Cluster("tcp://127.0.0.1")):
        pass


def test_an_unreachable_scheduler_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine_module, "PATIENCE", 1.0)
    before = set(threading.enumerate())
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{closed.getsockname()[1]}"
        with pytest.raises(CampaignError, match=f"no scheduler that answers at {address}"), engine(Cluster(address)):
            pass
    assert set(threading.enumerate()) <= before


@pytest.mark.parametrize(("cluster", "told"), [
    (Cluster("tcp://a:1", tls_ca=Path("ca.pem")), "tls://a:1"),
    (Cluster("tls://a:1"), "--tls-ca, --tls-cert, --tls-key"),
    (Cluster("tls://a:1", None, Path("x"), Path("y"), Path("z")), "no file x"),
    (Cluster("a:8786"), "tcp://host:port"),
    (Cluster("http://a:8786"), "tcp://host:port"),
    (Cluster(tls_ca=Path("ca.pem")), "--address"),
    (Cluster(workers=0), "at least one"),
    (Cluster("tcp://a:1", workers=2), "--workers is for this machine"),
])
def test_what_cannot_be_a_cluster_says_what_would_be_right(cluster: Cluster, told: str) -> None:
    with pytest.raises(CampaignError) as refusal:
        cluster.check()
    assert told in str(refusal.value)


def wait(done: Any, patience: float = 90.0) -> None:
    end = time.monotonic() + patience
    while not done():
        assert time.monotonic() < end, "nothing came of it"
        time.sleep(0.05)


def test_scaling_is_measured_on_what_the_campaign_plays_anyway_and_not_on_too_few(
        short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("BLOCK", "TURNS", "WARM"):
        monkeypatch.setattr(command_module, name, 1)
    out = str(tmp_path / "out")
    play_all = ["campaign", str(short), "--workers", "2", "--scaling", "--quiet", "--out", out]
    assert not main([*play_all, "--episodes", "1"])
    assert "the scaling was not measured: too few episodes were left" in capsys.readouterr().out
    assert not main([*play_all, "--episodes", "4"])
    told = capsys.readouterr().out
    found = re.search(r"scaling ([0-9.]+) = ([0-9.]+) x 2", told)
    assert found is not None, told
    assert float(found[1]) == pytest.approx(2.0 * float(found[2]), abs=0.011)
    assert "8 of 8 records" in told
