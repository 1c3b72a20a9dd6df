"""Who drives: the rules of the seat, and that the server holds every visitor to them."""

from collections.abc import Iterator

import numpy as np
import pytest
from target import TOKEN, WATCH
from vclient import VClient, until

from app.serve.keys import Role
from app.serve.main import Page
from app.serve.seat import Seat

A, B, V = 1, 2, 9
ELBOW = "/robot/link_4"


class Room:
    """A seat with visitors A and B who may drive, and V who may not. left: who was made to let go, in order."""

    def __init__(self) -> None:
        self.roles: dict[int, Role] = {A: Role.OPERATOR, B: Role.OPERATOR, V: Role.VIEWER}
        self.seat = Seat(self.roles.get)
        self.left: list[int] = []
        self.seat.on_left(self.left.append)


@pytest.fixture
def room() -> Room:
    return Room()


def test_empty_seat_is_taken_by_the_first_who_acts_and_may(room: Room) -> None:
    assert not room.seat.admits(V)
    assert room.seat.operator is None
    assert room.seat.admits(A)
    assert not room.seat.admits(B)
    assert room.seat.operator == A


def test_asked_for_the_seat_the_operator_keeps_it_or_hands_it_over(room: Room) -> None:
    room.seat.admits(A)
    assert room.seat.take(B)
    room.seat.answer(B, consent=True)  # the asker's own word does not count
    room.seat.answer(V, consent=True)
    room.seat.answer(A, consent=False)
    assert (room.seat.operator, room.seat.asking) == (A, None)
    room.seat.yield_to(B)  # the time of a question that has been answered runs out
    assert room.seat.operator == A
    assert room.seat.take(B)
    room.seat.answer(A, consent=True)
    assert (room.seat.operator, room.seat.asking, room.left) == (B, None, [A])
    assert not room.seat.admits(A)


def test_silence_is_consent(room: Room) -> None:
    room.seat.admits(A)
    room.seat.take(B)
    room.seat.yield_to(B)
    assert (room.seat.operator, room.left) == (B, [A])


def test_release_and_leaving_give_it_to_whoever_asked(room: Room) -> None:
    room.seat.admits(A)
    room.seat.release(B)  # not B's to release
    assert room.seat.operator == A
    room.seat.release(A)
    assert (room.seat.operator, room.left) == (None, [A])
    room.seat.admits(A)
    room.seat.take(B)
    room.seat.leave(A)
    assert (room.seat.operator, room.left) == (B, [A, A])


def test_viewer_can_neither_take_nor_ask(room: Room) -> None:
    assert not room.seat.take(V)
    assert room.seat.operator is None
    room.seat.admits(A)
    assert not room.seat.take(V)
    assert room.seat.asking is None


def test_who_is_gone_neither_sits_nor_asks(room: Room) -> None:
    room.seat.admits(A)
    room.seat.take(B)
    del room.roles[A], room.roles[B]
    room.roles[3] = Role.OPERATOR
    assert room.seat.admits(3)


# -- on the server

def visitor(page: Page, token: str = TOKEN) -> VClient:
    client = VClient(page.server.get_port(), headers={"Authorization": f"Bearer {token}"})
    until(client.ready.is_set)
    until(lambda: client.seat() and client.banner()["mode"] not in ("starting", "failed"))
    until(lambda: float(client.banner()["time"]) > 0.3 and client.position(ELBOW) is not None)
    return client


@pytest.fixture
def operator(keyed: Page) -> Iterator[VClient]:
    """Somebody who drives."""
    until(lambda: keyed.guard.seat.operator is None)
    keyed.session.paused = False
    client = visitor(keyed)
    if client.banner()["mode"] == "stop":
        client.click("Resume")
    client.set("Simulation", "Reset")
    until(client.drives)
    until(lambda: client.banner()["mode"] == "idle")
    yield client
    client.close()


def test_every_visitor_is_told_how_long_his_own_line_takes(keyed: Page, operator: VClient) -> None:
    other = visitor(keyed)
    try:
        for client in (operator, other):
            until(lambda client=client: client.seat()["trip"] != "")
            assert 0 <= int(client.seat()["trip"]) < 2000
    finally:
        other.close()


def grab(client: VClient) -> None:
    point = client.position(ELBOW) + np.array([0.06, 0.0, 0.0])
    client.drag(ELBOW, "start", point, point)
    client.drag(ELBOW, "update", point, point + np.array([0.0, 0.2, 0.0]))


def felt(client: VClient) -> float:
    return float(client.banner()["truth"])


def everything(client: VClient) -> int:
    """Send one of every kind of message that would change something; how many."""
    before = keyed_state(client)
    point = client.position(ELBOW)
    sent = 0
    for phase in ("start", "update", "end"):
        client.drag(ELBOW, phase, point, point + 0.1)
        sent += 1
    for kind in ("TransformControlsDragStartMessage", "TransformControlsDragEndMessage"):
        client.send({"type": kind, "name": "/gizmos/ball", "owner": ""})
        sent += 1
    client.gizmo("/gizmos/ball", (-0.3, 0.3, 0.5))
    client.set("F_relax [N]", 11.0)
    client.set("Speed", 0.5)
    client.set("Unplug the cameras", True)
    client.set("Scenario", "push")
    client.set("Forces", False)
    client.set("Block", True)
    for choice in ("Reset", "Step", "Pause"):
        client.set("Simulation", choice)
    sent += 10
    assert keyed_state(client) == before
    return sent


def keyed_state(client: VClient) -> tuple[str, ...]:
    banner = client.banner()
    return (banner["paused"], banner["silent"])


@pytest.mark.parametrize("token", [TOKEN, WATCH])
def test_who_does_not_drive_changes_nothing_and_is_counted(keyed: Page, operator: VClient, token: str) -> None:
    other = visitor(keyed, token)
    before, values = keyed.guard.refused["not the operator"], dict(keyed_values(operator))
    sent = everything(other)
    until(lambda: keyed.guard.refused["not the operator"] == before + sent)
    time = float(operator.banner()["time"])
    until(lambda: float(operator.banner()["time"]) > time + 0.5)
    assert keyed_values(operator) == values
    assert felt(operator) == 0.0
    assert not other.closed.is_set(), "watching is no offence"
    until(lambda: other.value("F_relax [N]") == values["F_relax [N]"])  # its own screen is put right
    assert keyed_values(other) == values
    other.close()


def keyed_values(client: VClient) -> dict[str, object]:
    labels = ("F_relax [N]", "Speed", "Unplug the cameras", "Scenario", "Forces", "Block")
    return {label: client.value(label) for label in labels}


@pytest.mark.parametrize("token", [TOKEN, WATCH])
def test_stop_is_for_everybody_and_resume_is_not(keyed: Page, operator: VClient, token: str) -> None:
    other = visitor(keyed, token)
    other.click("STOP (Esc)")
    until(lambda: operator.banner()["mode"] == "stop")
    until(lambda: other.gui[other.widget("Resume")]["props"]["visible"])
    before = keyed.guard.refused["not the operator"]
    other.click("Resume")
    until(lambda: keyed.guard.refused["not the operator"] == before + 1)
    operator.click("Resume")
    until(lambda: operator.banner()["mode"] == "idle")
    other.send({"type": "CommandTriggerMessage", "uuid": other.commands["Stop the arm"]})
    until(lambda: operator.banner()["mode"] == "stop")
    other.set("Look from", "Top")
    assert "Not a safety function" in other.text()
    other.close()


def test_viewer_is_told_so_and_is_offered_nothing(keyed: Page, operator: VClient) -> None:
    viewer = visitor(keyed, WATCH)
    assert viewer.seat()["role"] == "viewer"
    assert viewer.seat()["operator"] == operator.seat()["visitor"]
    assert not viewer.gui[viewer.widget("Take control")]["props"]["visible"]
    viewer.click("Take control")  # hidden, and pressed all the same
    operator.hand_back()
    grab(viewer)
    time = float(operator.banner()["time"])
    until(lambda: float(operator.banner()["time"]) > time + 0.5)
    assert operator.seat()["operator"] == "", "an empty seat is not for a viewer"
    assert felt(operator) == 0.0
    viewer.close()


def offers(client: VClient, label: str) -> bool:
    """Whether a visitor can press this button, as its own screen shows it; the server may be ahead of the screen."""
    props = client.gui[client.widget(label)]["props"]
    return props["visible"] and not props["disabled"]


def ask(client: VClient, operator: VClient) -> None:
    """Ask for the seat, and wait until both screens show it."""
    until(lambda: offers(client, "Take control"))
    client.click("Take control")
    until(lambda: offers(operator, "Hand over") and offers(operator, "Keep control"))
    until(lambda: client.seat()["asking"] == client.seat()["visitor"])


def test_handing_over_lets_go_what_the_operator_held(keyed: Page, operator: VClient) -> None:
    other = visitor(keyed)
    grab(operator)
    until(lambda: felt(operator) > 8.0)
    ask(other, operator)
    operator.click("Keep control")
    until(lambda: other.seat()["asking"] == "" and not offers(operator, "Hand over"))
    assert operator.drives()
    assert felt(operator) > 8.0
    ask(other, operator)
    operator.click("Hand over")
    until(lambda: other.drives() and not operator.drives())
    until(lambda: felt(other) == 0.0)
    grab(operator)
    grab(other)
    until(lambda: felt(other) > 8.0)
    other.close()
    until(lambda: felt(operator) == 0.0)


def test_browser_that_does_not_answer_loses_the_seat_at_once(
        keyed: Page, operator: VClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keyed.seat_box, "answer", 1e9)  # else its silence would be consent before long
    other = visitor(keyed)
    operator.alive = False
    other.click("Take control")
    until(other.drives)
    other.close()


def test_operator_that_says_nothing_loses_the_seat_in_time(
        keyed: Page, operator: VClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keyed.seat_box, "answer", 1.0)
    other = visitor(keyed)
    other.click("Take control")
    until(lambda: operator.seat()["asking"] == other.seat()["visitor"])
    assert operator.drives()
    until(other.drives)
    other.close()
