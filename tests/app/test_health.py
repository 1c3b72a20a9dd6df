"""Whether the page says that it lives, and how it ends: with real cells that hang, pause or fail, and real processes."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from process import launched
from vclient import VClient, until

from app import health
from app.record.repair import look
from app.record.spool import ROWS
from app.serve import driver
from app.serve.access import Access
from app.serve.content import SECURITY_HEADERS
from app.serve.driver import Phase
from app.serve.keys import Keys
from app.serve.main import Page
from app.serve.session import Session
from hrc.messages import Snapshot


class Gate:
    """Looks on, and lets no step pass while it is shut."""

    def __init__(self) -> None:
        self.open = threading.Event()
        self.open.set()

    def on_step(self, _: Snapshot) -> None:
        self.open.wait()


def asked(port: int, host: str = "127.0.0.1") -> tuple[int, bytes, dict[str, str]]:
    request = urllib.request.Request(f"http://127.0.0.1:{port}/healthz", headers={"Host": host})
    try:
        with urllib.request.urlopen(request, timeout=5.0) as reply:
            return reply.status, reply.read(), dict(reply.headers)
    except urllib.error.HTTPError as error:
        return error.code, error.read(), dict(error.headers)


@pytest.mark.live
def test_health_follows_the_cell_and_tells_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver, "HANGS", 1.5)
    gate = Gate()
    page = Page("free", Access(port=0, keys=Keys("o" * 20, "w" * 20)), say=lambda _: None, observers=(gate,))
    port = page.server.get_port()
    url = f"http://127.0.0.1:{port}/healthz"
    try:
        status, body, headers = asked(port)
        assert (status, body) == (200, b"ok\n"), "without a token, and before the cell is there"
        assert headers.items() >= {name: value for name, value in SECURITY_HEADERS.items() if "{" not in value}.items()
        assert asked(port, "evil.example")[0] == 403, "a foreign name gets nothing"
        page.start()
        until(lambda: page.session.status.phase is Phase.RUNNING and page.session.factor > 0.0)
        assert asked(port)[:2] == (200, b"ok\n")
        assert health.main(url) == 0
        watcher = VClient(port, path=f"/?token={'w' * 20}")
        until(lambda: watcher.banner()["mode"] == "idle")
        gate.open.clear()
        until(lambda: asked(port)[:2] == (503, b""))
        assert health.main(url) == 1
        until(lambda: watcher.banner()["mode"] == "not responding")
        assert watcher.banner()["factor"] == "0.00"
        gate.open.set()
        until(lambda: asked(port)[0] == 200)
        until(lambda: watcher.banner()["mode"] == "idle")
        page.session.paused = True
        time.sleep(2.5)
        assert asked(port)[0] == 200, "a cell that is paused is well"
        page.session.paused = False
        assert isinstance(page.session, Session)
        assert page.session._cell is not None
        monkeypatch.setattr(page.session._cell, "step", None)
        until(lambda: page.session.status.phase is Phase.FAILED)
        assert asked(port)[0] == 503
        page.session.reset()
        assert asked(port)[0] == 200, "a new cell is on its way"
    finally:
        gate.open.set()
        page.close()


@pytest.fixture
def served_process(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], int, Path]]:
    """`elbowroom serve` as anybody starts it, its port and where its recordings go."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    command = [sys.executable, "-m", "app", "serve", "--port", str(port), "--recordings", str(tmp_path / "recordings")]
    surroundings = {**os.environ, "no_proxy": "", "http_proxy": "http://127.0.0.1:9"}
    with launched(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=surroundings) as process:
        yield process, port, tmp_path / "recordings"


@pytest.mark.live
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_page_that_records_closes_the_recording_when_it_is_told_to_stop(
        served_process: tuple[subprocess.Popen[str], int, Path], number: signal.Signals) -> None:
    process, port, recordings = served_process
    url = f"http://127.0.0.1:{port}/healthz"
    until(lambda: health.main(url) == 0)
    client = VClient(port)
    until(client.ready.is_set)
    until(lambda: client.banner()["mode"] == "idle")
    client.click("Record")
    until(lambda: 'data-recording="true"' in client.text())
    time.sleep(1.0)
    if number == signal.SIGTERM:
        process.send_signal(signal.SIGSTOP)
        assert health.main(url) == 1, "a process that stands still does not answer"
        process.send_signal(signal.SIGCONT)
        until(lambda: health.main(url) == 0)
    else:
        client.close()  # and the page may still be about to tell it something
    for _ in range(20):  # somebody is impatient
        process.send_signal(number)
    begin = time.monotonic()
    told, errors = process.communicate(timeout=30.0)
    assert time.monotonic() - begin < 10.0, "before whoever stops it loses patience"
    assert process.returncode == 0, errors
    assert errors == ""
    assert told.endswith("stopping ...\n")
    client.close()
    (folder,) = recordings.iterdir()
    assert not look(folder / "session.rrd").torn
    assert not (folder / ROWS).exists(), "what a killed process leaves"
    figures = json.loads((folder / "metrics.json").read_text())
    assert figures["simulated_s"] > 0.5
    assert figures["recording_problem"] == ""


def test_a_signal_while_the_page_is_loading_is_not_lost(tmp_path: Path) -> None:
    command = [sys.executable, "-u", "-m", "app", "serve", "--port", "0", "--recordings", str(tmp_path)]
    with launched(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "loading ...\n"
        process.send_signal(signal.SIGTERM)
        told, _ = process.communicate(timeout=60.0)
    assert process.returncode == 0
    assert "stopping ..." in told


def test_health_of_nothing_is_one_line() -> None:
    ask = [sys.executable, "-m", "app.health", "http://127.0.0.1:9/healthz"]
    done = subprocess.run(ask, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "refused" in done.stdout
    assert done.stderr == ""
