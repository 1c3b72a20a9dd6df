"""What becomes of the page when something around it fails: an observer, the clock, the process itself."""

import contextlib
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import expect
from vclient import VClient, until

from app.serve.mailbox import Mailbox
from app.serve.main import Page
from app.serve.session import Phase, Session
from hrc.events import Reset
from hrc.messages import Snapshot

ELBOW = "/robot/link_4"


class Broken:
    """Looks on for so many steps, and then fails. seen: how many steps it was shown."""

    def __init__(self, after: int) -> None:
        self.after, self.seen = after, 0

    def on_step(self, _: Snapshot) -> None:
        self.seen += 1
        if self.seen > self.after:
            raise ValueError("the disk is on fire")


@pytest.mark.live
def test_observer_that_fails_is_left_out_and_the_cell_goes_on(capfd: pytest.CaptureFixture[str]) -> None:
    mailbox, broken, sound, said = Mailbox(), Broken(100), Broken(10**9), list[str]()
    session = Session(mailbox, observers=(broken, sound), say=said.append)
    session.start("free")
    until(lambda: mailbox.latest is not None and mailbox.latest.time > 0.5, 60.0)
    assert session.status.phase is Phase.RUNNING
    session.put(Reset())
    until(lambda: mailbox.latest is not None and mailbox.latest.time < 0.4)
    session.close()
    assert broken.seen == 101
    assert sound.seen > 500
    assert [line for line in said if "left out" in line] == [
        "Broken failed (ValueError: the disk is on fire) and is left out; the cell goes on"]
    assert "the disk is on fire" in capfd.readouterr().err, "with its traceback"


@pytest.mark.parametrize("jump", [86400.0, -86400.0])
def test_system_clock_that_is_set_by_a_day_goes_unnoticed(
        served: Page, raw: VClient, monkeypatch: pytest.MonkeyPatch, jump: float) -> None:
    point = raw.position(ELBOW) + np.array([0.06, 0.0, 0.0])
    raw.drag(ELBOW, "start", point, point)
    raw.drag(ELBOW, "update", point, point + np.array([0.0, 0.2, 0.0]))
    until(lambda: float(raw.banner()["truth"]) > 8.0)
    real, before = time.time, float(raw.banner()["time"])
    monkeypatch.setattr(time, "time", lambda: real() + jump)
    begin = time.monotonic()
    until(lambda: float(raw.banner()["time"]) > before + 1.0)
    assert time.monotonic() - begin < 10.0
    assert float(raw.banner()["time"]) - before < time.monotonic() - begin + 0.5
    assert float(raw.banner()["truth"]) > 8.0, "the hand still holds"
    raw.drag(ELBOW, "end", point, point)
    until(lambda: float(raw.banner()["truth"]) == 0.0)
    assert served.session.status.phase is Phase.RUNNING


@pytest.fixture
def serve() -> Iterator[Callable[[int], subprocess.Popen[bytes]]]:
    """Starts the page on a port, in a process of its own."""
    started: list[subprocess.Popen[bytes]] = []

    def start(port: int) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "app", "serve", "--port", str(port)]
        started.append(subprocess.Popen(command, stdout=subprocess.DEVNULL))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


def answers(port: int) -> bool:
    with contextlib.suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{port}/app/favicon.svg", timeout=5.0) as reply:
        return reply.status == 200
    return False


@pytest.mark.browser
def test_page_says_that_it_is_stale_when_its_server_is_killed_and_comes_back_by_itself(
        chromium: Any, serve: Callable[[int], subprocess.Popen[bytes]]) -> None:
    port = free_port()
    first = serve(port)
    until(lambda: answers(port), 60.0)
    context = chromium.new_context(viewport={"width": 800, "height": 500})
    tab = context.new_page()
    tab.goto(f"http://127.0.0.1:{port}/?fixedDpr=0.25", wait_until="commit")
    banner, stale = tab.locator("#eb-banner"), tab.locator(".eb-stale")
    expect(banner).to_have_attribute("data-mode", "idle", timeout=60_000)
    expect(stale).to_be_hidden()
    first.send_signal(signal.SIGKILL)
    expect(stale).to_be_visible(timeout=10_000)
    serve(port)
    until(lambda: answers(port), 60.0)
    expect(stale).to_be_hidden(timeout=60_000)
    expect(banner).to_have_attribute("data-mode", "idle", timeout=60_000)
    context.close()
