"""The real page under attack: a stalled socket, a crowd, and fuzzed messages from an operator leave it well."""

import math
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from fuzz import COUNT, damaged, message
from target import TOKEN, WATCH, authorized
from vclient import VClient, until

from app.serve.main import Page

ELBOW, BALL = "/robot/link_4", "/gizmos/ball"


@pytest.fixture
def onlooker(keyed: Page) -> Iterator[VClient]:
    """Somebody who watches, and sees whether the page is well."""
    client = join(keyed, WATCH)
    until(lambda: client.banner()["mode"] == "idle" and float(client.banner()["time"]) > 0.3)
    yield client
    client.close()


def join(page: Page, token: str = TOKEN) -> VClient:
    client = VClient(page.server.get_port(), headers=authorized(token))
    until(client.ready.is_set)
    until(lambda: client.seat() and client.banner() and client.position(ELBOW) is not None)
    return client


def runs(client: VClient) -> bool:
    """Whether simulated time goes on."""
    before = float(client.banner()["time"])
    time.sleep(0.3)
    return before < float(client.banner()["time"]) < before + 1.0


def grab(client: VClient) -> None:
    point = client.position(ELBOW) + np.array([0.06, 0.0, 0.0])
    client.drag(ELBOW, "start", point, point)
    client.drag(ELBOW, "update", point, point + np.array([0.0, 0.2, 0.0]))


def test_socket_that_stalls_in_mid_drag_lets_go_and_slows_nobody(
        keyed: Page, onlooker: VClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keyed.seat_box, "answer", 1e9)
    stalled, thawed = join(keyed), threading.Event()
    grab(stalled)
    until(lambda: float(onlooker.banner()["truth"]) > 8.0)
    stalled.freeze(thawed)
    beat, begin = int(onlooker.banner()["beat"]), time.monotonic()
    until(lambda: float(onlooker.banner()["truth"]) == 0.0, 15.0)  # after 20 s the socket itself would be given up
    until(lambda: "the browser that held the arm does not answer" in onlooker.text())
    until(lambda: time.monotonic() > begin + 4.0)
    rate = (int(onlooker.banner()["beat"]) - beat) / (time.monotonic() - begin)
    assert rate > 5.0, "of the ten banners a second"
    other = join(keyed)
    other.click("Take control")
    until(other.drives, 15.0)
    thawed.set()
    other.close()
    stalled.close()


def test_line_that_is_torn_in_mid_drag_lets_go_and_frees_the_seat(keyed: Page, onlooker: VClient) -> None:
    torn = join(keyed)
    grab(torn)
    until(lambda: float(onlooker.banner()["truth"]) > 8.0)
    torn.tear()
    until(lambda: float(onlooker.banner()["truth"]) == 0.0 and keyed.guard.seat.operator is None)
    until(lambda: onlooker.banner()["mode"] == "idle")


def test_an_obstacle_stays_where_it_is_when_who_drags_it_into_the_arm_is_torn_off(keyed: Page, onlooker: VClient) -> None:
    torn = join(keyed)
    beside = torn.position(ELBOW) + np.array([0.0, 0.25, 0.0])
    torn.gizmo(BALL, beside.tolist())
    until(lambda: np.linalg.norm(onlooker.position("/obstacles/ball") - beside) < 0.02)
    torn.gizmo(BALL, (beside - np.array([0.0, 0.6, 0.0])).tolist())
    until(lambda: float(onlooker.banner()["truth"]) > 8.0)
    assert distance(onlooker) > 0.1
    torn.tear()
    until(lambda: keyed.guard.seat.operator is None and distance(onlooker) < 0.03)
    keyed.session.reset()
    until(lambda: onlooker.banner()["mode"] == "idle" and float(onlooker.banner()["time"]) < 5.0)


def test_an_obstacle_stays_where_it_is_when_the_browser_that_drags_it_freezes(keyed: Page, onlooker: VClient) -> None:
    stalled, thawed = join(keyed), threading.Event()
    beside = stalled.position(ELBOW) + np.array([0.0, 0.25, 0.0])
    stalled.gizmo(BALL, beside.tolist())
    until(lambda: np.linalg.norm(onlooker.position("/obstacles/ball") - beside) < 0.02)
    stalled.gizmo(BALL, (beside - np.array([0.0, 0.6, 0.0])).tolist())
    until(lambda: float(onlooker.banner()["truth"]) > 8.0)
    stalled.freeze(thawed)
    until(lambda: distance(onlooker) < 0.03)
    until(lambda: "the browser that held the ball does not answer" in onlooker.text())
    thawed.set()
    stalled.close()
    keyed.session.reset()
    until(lambda: onlooker.banner()["mode"] == "idle" and float(onlooker.banner()["time"]) < 5.0)


def distance(client: VClient) -> float:
    """Of the ball from where it is asked to go."""
    return float(np.linalg.norm(client.position(BALL) - client.position("/obstacles/ball")))


def test_twenty_visitors_come_and_go_and_leave_nothing_behind(keyed: Page, onlooker: VClient) -> None:
    until(lambda: len(keyed.server.get_clients()) == 1)
    threads, free = threading.active_count(), len(keyed.guard._free)
    visitors = [VClient(keyed.server.get_port(), headers=authorized(TOKEN)) for _ in range(20)]
    for visitor in visitors:
        until(visitor.ready.is_set)
    until(lambda: all(visitor.seat() for visitor in visitors))
    for visitor in visitors[:10]:
        visitor.click("Take control")
    until(lambda: keyed.guard.seat.operator is not None)
    for visitor in visitors[::2]:
        visitor.tear()
    for visitor in visitors[1::2]:
        visitor.close()
    until(lambda: len(keyed.server.get_clients()) == 1)
    until(lambda: keyed.guard.seat.operator is None and keyed.guard.seat.asking is None)
    until(lambda: len(keyed.guard._free) == free)
    until(lambda: threading.active_count() <= threads + 2)
    beat = int(onlooker.banner()["beat"])
    until(lambda: int(onlooker.banner()["beat"]) > beat + 5)
    assert onlooker.seat()["operator"] == ""


def test_page_takes_fuzzed_messages_from_an_operator_and_stays_well(
        keyed: Page, onlooker: VClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture,
        capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(keyed.guard, "rate", 1e9)
    monkeypatch.setattr(keyed.guard, "burst", 1e9)
    monkeypatch.setattr("app.serve.guard.PATIENCE", 10**9)
    fuzzer = join(keyed)
    fuzzer.click("Take control")
    until(fuzzer.drives)
    banned = {fuzzer.widget("Scenario"), fuzzer.widget("Release control")}
    uuids = tuple(uuid for uuid in fuzzer.gui if uuid not in banned)
    refused = sum(keyed.guard.refused.values())
    for raw, _ in zip(damaged(2, uuids), range(COUNT // 50), strict=False):
        fuzzer.send(raw)
    fuzzer.send(message("GuiUpdateMessage", uuid=fuzzer.widget("Simulation"), updates={"value": "Reset"}))
    until(lambda: sum(keyed.guard.refused.values()) > refused + COUNT // 100)
    fuzzer.close()
    until(lambda: keyed.guard.seat.operator is None)
    mender = join(keyed)
    beat = int(mender.banner()["beat"])
    until(lambda: int(mender.banner()["beat"]) > beat + 3)  # what the last of the messages did is on the screen
    if mender.banner()["paused"] == "true":
        mender.set("Simulation", "Play")
    mender.set("Simulation", "Reset")
    mender.set("Speed", 1.0)
    if mender.banner()["mode"] == "stop":
        mender.click("Resume")
    until(lambda: onlooker.banner()["mode"] == "idle" and onlooker.banner()["paused"] == "false")
    until(lambda: runs(onlooker))
    assert all(math.isfinite(float(onlooker.banner()[key])) for key in ("force", "truth", "time", "factor"))
    assert not onlooker.closed.is_set()
    assert "Traceback" not in capfd.readouterr().err
    assert [record for record in caplog.records if record.levelname == "ERROR"] == []
    mender.close()
