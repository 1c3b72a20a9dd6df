"""What `bench web` counts and times, against the real page."""

import asyncio
import threading
import time
from typing import Any

import pytest
from vclient import VClient, until

from app import browser as browser_module
from app.bench.cpu import by_part
from app.bench.traffic import Metered, visit
from app.bench.web import BUDGET, Felt, judged, printed
from app.browser import opened
from app.serve.main import Page
from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.events import Pull


@pytest.mark.usefixtures("raw")
def test_every_byte_is_counted_to_a_stream(served: Page) -> None:
    client = Metered(served.server.get_port())
    until(lambda: client.ready.is_set() and len(client.late) > 3)
    client.close()
    assert sum(client.streams.values()) == pytest.approx(client.bytes, rel=1e-3)
    assert client.streams["/robot"] > 0
    assert client.streams["camera images"] > client.streams["banner and texts"] > 0
    assert all(0.0 <= late < 10.0 for late in client.late)


def test_a_browser_that_does_not_get_there_is_a_sentence(chromium: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(browser_module, "PATIENCE_MS", 1000)
    with pytest.raises(TimeoutError, match="has not drawn the page within 1 s: the machine is busy"):
        opened(chromium, "data:text/html,nothing here")


class Thin(Metered):
    """A visitor who takes RATE bytes a second, a sixth of what the page sends."""

    RATE = 4e4

    async def take_frame(self, raw: bytes) -> None:
        await super().take_frame(raw)
        if self.ready.is_set():  # what is sent once came before
            await asyncio.sleep(len(raw) / self.RATE)


@pytest.mark.usefixtures("raw")
def test_over_a_thin_line_come_fewer_pictures_and_none_that_is_old(served: Page) -> None:
    client = Thin(served.server.get_port(), ahead=1)
    until(client.ready.is_set)
    time.sleep(6.0)
    received = client.bytes
    time.sleep(2.0)
    client.close()
    assert client.bytes - received < 4 * Thin.RATE, "this line is as thin as it should be"
    assert client.late[-1] < 2.5


def test_a_visitor_that_drives_pulls_the_arm_and_says_when(served: Page, raw: VClient) -> None:
    raw.hand_back()
    begin = time.monotonic()
    seen = visit(served.server.get_port(), 2, 1.5, drive=True)
    until(lambda: "let go" in raw.text())
    assert "pulling link_4" in raw.text()
    assert len(seen.traffic) == 2
    assert 20 <= len(seen.sent) <= 31, "twenty a second"
    assert all(begin < sent < time.monotonic() for sent in seen.sent.values())
    assert len(seen.traffic[0].late) > 5


def test_a_force_is_applied_in_the_step_that_notes_it() -> None:
    felt, cell = Felt(), Cell(Config())
    pull = Pull(4, (0.0, 0.0, 0.1), (-0.3, 0.4, 0.6))
    cell.apply(pull)
    before = time.monotonic()
    snapshot = cell.step()
    felt.on_step(snapshot)
    assert snapshot.pull is not None
    assert before < felt.told().applied[pull.target] <= felt.told().at <= time.monotonic()


def test_cpu_time_goes_to_the_thread_that_spends_it() -> None:
    def spin() -> None:
        end = time.thread_time() + 0.2
        while time.thread_time() < end:
            pass

    before = by_part()
    thread = threading.Thread(target=lambda: (spin(), time.sleep(0.5)), name="publisher")
    thread.start()
    time.sleep(0.4)
    spent = by_part()
    thread.join()
    if spent["publisher"] > 0.0:  # where the system tells
        assert spent["publisher"] - before["publisher"] == pytest.approx(0.2, abs=0.05)
    assert spent["bench"] - before["bench"] < 0.1


def test_what_is_outside_the_budget_is_said() -> None:
    row = {"name": "3 clients", "seconds": 1.0, "cores": {"publisher": 0.1, "server": 0.2, "cell": 0.4}, "page_cores": 0.3,
           "pictures_per_s": 24.0, "real_time_factor": 0.995, "real_time_factor_worst_second": 0.99, "bytes_per_s": 1e6,
           "streams": {"/cloud": 1e6},
           "input_to_force": {"p50_s": 0.001, "p95_s": 0.2, "max_s": 0.3, "number": 9}}
    figures = {"conditions": {"cores": 2, "python": "3", "scenario": "free", "seconds": 1.0}, "rows": [row]}
    outside = {line.split()[0] for line, verdict in judged(figures).items() if verdict.startswith("OUTSIDE")}
    assert outside == {"page_cores", "input_to_force_p95_s"}
    assert len(judged(figures)) == len(BUDGET)
    assert "OUTSIDE THE BUDGET: page_cores 0.3 of 0.2" in "\n".join(printed(figures))
