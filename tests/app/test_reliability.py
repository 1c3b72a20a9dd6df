"""What becomes of the page when something around it fails: an observer, the clock, the process itself."""

import queue
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import expect
from process import answers, free_port
from test_page_explain import upload
from vclient import VClient, until

from app.serve.access import Access
from app.serve.driver import Phase
from app.serve.mailbox import Mailbox
from app.serve.main import Page
from app.serve.session import PageInbox, Session
from hrc.cell import scenario
from hrc.events import Event, MoveObstacle, MoveTarget, Pull, Release, Reset, Resume, SetParameter, Stop
from hrc.messages import Mode, Snapshot

ELBOW = "/robot/link_4"
WITHOUT_FOCUS = "Document.prototype.hasFocus = () => false"
"""As of a page on a second screen: who drives a browser from outside is told that every page has the focus."""
NOTES_STALE = """() => {
  new MutationObserver(() => {
    const {beat, sent} = document.querySelector("#eb-banner")?.dataset ?? {};
    if (beat === undefined || beat === window.beat) return;
    [window.beat, window.told] = [beat, Date.now() / 1000];
    window.timely = window.told - sent < 0.3 ? (window.timely ?? 0) + 1 : 0;
  }).observe(document, {subtree: true, childList: true, attributes: true});
  setInterval(() => {
    const seen = document.querySelector(".eb-stale");
    if (seen && getComputedStyle(seen).visibility === "visible") window.stale ??= Date.now() / 1000;
  }, 10);
}"""
"""When the last new banner was there, and when first it was called stale [s since the epoch]; how many of the last were there
within 0.3 s of being sent. All clocks are this machine's."""
STALE, FRAME, BUSY = 1.5, 0.3, 1.0
"""How long after the last banner the page is stale [s]: from the begin of a frame, and a busy machine draws it later."""


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
    until(lambda: mailbox.latest is not None and mailbox.latest.time > 0.5)
    assert session.status.phase is Phase.RUNNING
    session.put(Reset())
    until(lambda: mailbox.latest is not None and mailbox.latest.time < 0.4)
    session.close()
    assert broken.seen == 101
    assert sound.seen > 500
    assert [line for line in said if "left out" in line] == [
        "Broken failed (ValueError: the disk is on fire) and is left out; the cell goes on"]
    assert "the disk is on fire" in capfd.readouterr().err, "with its traceback"


class Late(queue.Queue[Any]):
    """Who puts something in comes back late, when it has long been taken out."""

    def put(self, item: Any, block: bool = True, timeout: float | None = None) -> None:
        super().put(item, block, timeout)
        time.sleep(0.3)


@pytest.mark.live
def test_a_cell_that_failed_is_made_anew_however_slow_who_asks_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    mailbox = Mailbox()
    session = Session(mailbox, say=lambda _: None)
    monkeypatch.setattr(session, "_wanted", Late())
    session.start("free")
    until(lambda: mailbox.latest is not None and mailbox.latest.time > 0.2)
    monkeypatch.setattr(session._cell, "step", None)
    until(lambda: session.status.phase is Phase.FAILED)
    session.reset()
    until(lambda: session.status.phase is Phase.RUNNING and mailbox.latest is not None and mailbox.latest.time > 0.5)
    session.close()


@pytest.mark.live
def test_a_stop_while_the_cell_is_built_finds_the_arm_at_its_first_step() -> None:
    cycles = list[Snapshot]()

    class Cycles:
        def on_step(self, snapshot: Snapshot, /) -> None:
            if snapshot.fresh_control:
                cycles.append(snapshot)

    session = Session(Mailbox(), say=lambda _: None, observers=(Cycles(),))
    session.start("free")
    session.put(Stop())
    assert "stand still" in session.status.text
    until(lambda: len(cycles) > 50)
    assert {cycle.command.mode for cycle in cycles} == {Mode.STOP}
    np.testing.assert_allclose(cycles[-1].state.q, cycles[0].state.q, atol=1e-4)
    session.put(Resume())
    until(lambda: cycles[-1].command.mode is Mode.IDLE and np.abs(cycles[-1].state.q - cycles[0].state.q).max() > 0.01)
    session.close()


@pytest.fixture
def lone() -> Iterator[Page]:
    """A page of its own, to be broken, with its cell where a test can reach it."""
    page = Page("free", Access(port=0), say=lambda _: None, observers=())
    page.start()
    yield page
    page.close()


@pytest.mark.live
def test_an_exception_in_a_running_cell_stops_it_with_the_last_events_in_the_log(
        lone: Page, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    client = VClient(lone.server.get_port())
    until(lambda: client.ready.is_set() and client.banner()["mode"] == "idle" and float(client.banner()["time"]) > 0.3)
    client.set("F_relax [N]", 9.0)
    until(lambda: "control.f_relax = 9" in client.text())

    def breaks(event: Event) -> None:
        raise ZeroDivisionError(f"{type(event).__name__} by zero")

    assert isinstance(lone.session, Session)
    monkeypatch.setattr(lone.session._cell, "apply", breaks)
    client.set("Task", "circle")
    until(lambda: client.banner()["mode"] == "failed")
    told = ("SetTask by zero. Reset or choose", "task: circle", "the cell failed (ZeroDivisionError", "control.f_relax = 9")
    until(lambda: all(line in client.text() for line in told))
    stood, beat = client.banner()["time"], int(client.banner()["beat"])
    until(lambda: int(client.banner()["beat"]) > beat + 5)
    assert client.banner()["time"] == stood, "nothing moves"
    upload(client, "control.f_abort = 40.0")
    until(lambda: "the cell is not running" in client.text())
    beat = int(client.banner()["beat"])
    until(lambda: int(client.banner()["beat"]) > beat + 3)
    assert "mine.toml" not in client.text(), "nothing was changed"
    assert "Traceback" in capfd.readouterr().err
    client.set("Simulation", "Reset")
    until(lambda: client.banner()["mode"] == "idle" and float(client.banner()["time"]) > 0.3)
    assert "task: circle" in client.text(), "what had happened is still there to be read"
    client.close()


def test_a_pause_while_a_cell_is_built_holds_for_it(served: Page, raw: VClient) -> None:
    served.session.open("push")
    raw.set("Simulation", "Pause")
    until(lambda: served.session.status.phase is Phase.RUNNING and raw.banner()["paused"] == "true")
    begun = float(raw.banner()["time"])
    time.sleep(0.5)
    assert float(raw.banner()["time"]) == begun < 0.1
    until(lambda: "Play" in raw.gui[raw.widget("Simulation")]["props"]["options"])
    raw.set("Simulation", "Play")
    until(lambda: float(raw.banner()["time"]) > 0.3)
    served.session.open("free")
    until(lambda: served.session.status.phase is Phase.RUNNING and float(raw.banner()["time"]) > 0.3)


def test_a_drag_that_time_waits_for_is_one_event_when_it_goes_on() -> None:
    inbox = PageInbox(scenario.load("free"), 1000)
    drag = [Pull(4, (0.0, 0.0, 0.0), (0.01 * i, 0.0, 0.5)) for i in range(200)]
    for event in (*drag, Release(), *drag, Pull(5, (0.0, 0.0, 0.0), (0.0, 0.0, 0.5)), MoveTarget((-0.5, 0.0, 0.4)),
                  MoveTarget((-0.5, 0.1, 0.4)), MoveObstacle("ball", (0.1, 0.0, 0.5), (1.0, 0.0, 0.0, 0.0)),
                  MoveObstacle("ball", (0.2, 0.0, 0.5)), MoveObstacle("ball", (0.3, 0.0, 0.5)),
                  MoveObstacle("slab", (0.3, 0.0, 0.5)), SetParameter("task.speed", 0.1), SetParameter("task.speed", 0.2)):
        inbox.put(event)
    assert inbox.take(1) == [
        drag[-1], Release(), drag[-1], Pull(5, (0.0, 0.0, 0.0), (0.0, 0.0, 0.5)), MoveTarget((-0.5, 0.1, 0.4)),
        MoveObstacle("ball", (0.1, 0.0, 0.5), (1.0, 0.0, 0.0, 0.0)), MoveObstacle("ball", (0.3, 0.0, 0.5)),
        MoveObstacle("slab", (0.3, 0.0, 0.5)), SetParameter("task.speed", 0.1), SetParameter("task.speed", 0.2)]


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


@pytest.mark.browser
def test_page_says_that_it_is_stale_when_its_server_is_killed_and_comes_back_without_the_focus(
        new_tab: Callable[..., Any], serve: Callable[[int], subprocess.Popen[bytes]]) -> None:
    port = free_port()
    first = serve(port)
    until(lambda: answers(port))
    tab = new_tab(viewport={"width": 800, "height": 500})
    tab.add_init_script(WITHOUT_FOCUS)
    tab.goto(f"http://127.0.0.1:{port}/?fixedDpr=0.25", wait_until="commit")
    banner, stale = tab.locator("#eb-banner"), tab.locator(".eb-stale")
    expect(banner).to_have_attribute("data-mode", "idle")
    tab.evaluate(NOTES_STALE)
    tab.wait_for_function("() => window.timely > 10")  # it has caught up with all that it had to load
    expect(stale).to_be_hidden()
    cut = time.time()
    first.send_signal(signal.SIGKILL)
    tab.wait_for_function("() => window.stale")
    told, said = tab.evaluate("() => [window.told, window.stale]")
    assert STALE - FRAME < said - told < STALE + BUSY
    assert said - cut < STALE + BUSY
    serve(port)
    until(lambda: answers(port))
    tab.wait_for_function(f"() => window.told > {said}")
    expect(stale).to_be_hidden()
    expect(banner).to_have_attribute("data-mode", "idle")
