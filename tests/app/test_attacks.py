"""Attacks on the page: what each would gain, behind the guard and with the guard switched off.

The table of the two is printed. Without the guard, which is viser as it comes, every one of them succeeds: so none is refused
by accident, and the suite would notice a guard that does nothing. With ELBOWROOM_GUARD=off in the environment it runs as if
there were none, and fails with the list of what gets through.
"""

import contextlib
import math
import os
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from fuzz import VALID, message, spoiled
from target import TOKEN, WATCH, Target, authorized
from vclient import VClient, until

from app.serve.guard import MAX_CLIENTS, PATIENCE


def update(label: str, **updates: Any) -> Callable[[VClient], None]:
    return lambda client: client.send(message("GuiUpdateMessage", uuid=client.widget(label), updates=updates))


def kills_stop(**updates: Any) -> Callable[[Target], bool]:
    def attack(target: Target) -> bool:
        client = target.client()
        update("STOP", **updates)(client)
        time.sleep(0.2)
        client.close()
        return target.stop_is_dead()

    return attack


def drag_to(*position: Any) -> Callable[[VClient], None]:
    def act(client: VClient) -> None:
        client.send(message("SceneNodeDragMessage", name="/box", phase="start", owner=""))
        client.send(message("SceneNodeDragMessage", name="/box", end_position=list(position), owner=""))

    return act


def gizmo_to(*position: Any) -> Callable[[VClient], None]:
    return lambda client: client.send(message("TransformControlsUpdateMessage", position=list(position), owner=""))


def uploads(client: VClient) -> None:
    client.send({"type": "FileTransferStartUpload", "source_component_uuid": client.widget("Upload"), "transfer_uuid": "t",
                 "filename": "f", "mime_type": "x", "part_count": 40, "size_bytes": 40 << 20})
    for part in range(4):
        client.send({"type": "FileTransferPart", "source_component_uuid": client.widget("Upload"), "transfer_uuid": "t",
                     "part_index": part, "content": b"\0" * (1 << 20)})


def stored(target: Target) -> int:
    transfers = list(target.server.gui._current_file_upload_states.values())
    return sum(len(part) for transfer in transfers for part in transfer["parts"].values())


def floods(target: Target) -> bool:
    def act(client: VClient) -> None:
        click = msgspec.msgpack.encode(message("GuiUpdateMessage", uuid=client.widget("STOP"), updates={"value": True}))
        for _ in range(2000):
            client.send(click)

    return target.gained(act, lambda: target.heard.count("stop") >= 2000)


def fills_up(target: Target) -> bool:
    clients = [VClient(target.port, headers=authorized(TOKEN)) for _ in range(MAX_CLIENTS + 8)]
    until(lambda: all(client.ready.is_set() or client.closed.is_set() for client in clients))
    time.sleep(0.3)
    inside = sum(not client.closed.is_set() for client in clients)
    for client in clients:
        client.close()
    return inside > MAX_CLIENTS


def junk(target: Target) -> bool:
    """Endless refused messages of a patient client: is it ever shown the door?"""
    client = target.client()
    with contextlib.suppress(ConnectionError):
        for _ in range(PATIENCE + 5):
            client.send({"type": "FileTransferPart", "source_component_uuid": "", "transfer_uuid": "", "part_index": 0,
                         "content": b""})
    kept = not client.closed.wait(1.0)
    client.close()
    return kept


def viewer(act: Callable[[VClient], None], harm: Callable[[Target], Any]) -> Callable[[Target], bool]:
    def attack(target: Target) -> bool:
        client = target.client(WATCH)
        act(client)
        try:
            until(lambda: harm(target), target.patience)
        except TimeoutError:
            return False
        finally:
            client.close()
        return True

    return attack


def second(target: Target) -> bool:
    """Somebody who may drive, while somebody else does."""
    first = target.client()
    update("Mode", value="b")(first)
    until(lambda: target.mode.value == "b")
    done = target.gained(update("Gain", value=0.7), lambda: target.gain.value == 0.7)
    first.close()
    return done


def effect(act: Callable[[VClient], None], harm: Callable[[Target], Any]) -> Callable[[Target], bool]:
    return lambda target: target.gained(act, lambda: harm(target))


ATTACKS: dict[str, Callable[[Target], bool]] = {
    "a page of another origin opens a socket": lambda t: t.lets_in(origin="http://evil.example", headers=authorized(TOKEN)),
    "a page without origin (sandboxed) opens one": lambda t: t.lets_in(origin="null", headers=authorized(TOKEN)),
    "DNS rebinding: a foreign name loads the page": lambda t: t.get(Host="evil.example", **authorized(TOKEN)).status == 200,
    "DNS rebinding: a foreign name opens a socket": lambda t: t.lets_in(
        origin="http://evil.example", headers={"Host": "evil.example", **authorized(TOKEN)}),
    "no token, the page": lambda t: t.get().status == 200,
    "no token, a socket": lambda t: t.lets_in(),
    "wrong token, the page": lambda t: t.get("/?token=operate-tokem").status == 200,
    "wrong token, a socket": lambda t: t.lets_in(headers=authorized("operate-tokem")),
    "a token that is no text": lambda t: t.get(Cookie="elbowroom=\xff").status == 200,
    "another page frames this one": lambda t: "frame-ancestors 'none'" not in t.get(
        **authorized(TOKEN)).headers.get("Content-Security-Policy", ""),
    "an injected script loads from another host": lambda t: "default-src 'none'" not in t.get(
        **authorized(TOKEN)).headers.get("Content-Security-Policy", ""),
    "smuggled property: the callbacks of STOP": kills_stop(value=True, update_cb=[]),
    "smuggled property: STOP removed": kills_stop(removed=True),
    "slider far out of its range": effect(update("Gain", value=1e9), lambda t: t.gain.value == 1e9),
    "slider to NaN": effect(update("Gain", value=math.nan), lambda t: math.isnan(t.gain.value)),
    "slider to a text": effect(update("Gain", value="0.9"), lambda t: t.gain.value == 0.9),
    "an option that is not offered": effect(update("Mode", value="zzz"), lambda t: t.mode.value == "zzz"),
    "a disabled widget": effect(update("Locked", value=True), lambda t: t.locked.value),
    "a hidden button": effect(update("Hidden", value=True), lambda t: "hidden" in t.heard),
    "gizmo to NaN": effect(gizmo_to(math.nan, 0.0, 0.0), lambda t: math.isnan(t.gizmo.position[0])),
    "gizmo of two coordinates": effect(gizmo_to(1.0, 2.0), lambda t: len(t.gizmo.position) == 2),
    "gizmo to 1e300": effect(gizmo_to(1e300, 0.0, 0.0), lambda t: t.gizmo.position[0] == 1e300),
    "drag to NaN": effect(drag_to(math.nan, 0.0, 0.0), lambda t: any(x[0] != x[0] for x in t.heard if isinstance(x, tuple))),
    "drag of two coordinates": effect(drag_to(1.0, 2.0), lambda t: (1.0, 2.0) in t.heard),
    "a public tunnel": effect(lambda c: c.send({"type": "ShareUrlRequest"}), lambda t: "tunnel" in t.heard),
    "a huge upload": effect(uploads, lambda t: stored(t) >= 4 << 20),
    "a message of 10 MB": effect(update("Mode", value="x" * (10 << 20)), lambda t: len(t.mode.value) == 10 << 20),
    "a flood": floods,
    "forty sockets": fills_up,
    "endless junk": junk,
    "a viewer moves a slider": viewer(update("Gain", value=0.7), lambda t: t.gain.value == 0.7),
    "a viewer drags a gizmo": viewer(gizmo_to(0.1, 0.2, 0.3), lambda t: t.gizmo.position[0] == 0.1),
    "a viewer drags a body": viewer(drag_to(0.1, 0.2, 0.3), lambda t: (0.1, 0.2, 0.3) in t.heard),
    "a second operator moves a slider": second,
}
"""What is tried -> whether it had its effect. A visitor has the token, unless the attack is about it."""


GUARD = os.environ.get("ELBOWROOM_GUARD") != "off"


def outcomes(*, guarded: bool) -> dict[str, bool]:
    gained = {}
    for name, attack in ATTACKS.items():
        target = Target(guarded=guarded and GUARD)
        try:
            gained[name] = attack(target)
        finally:
            with contextlib.redirect_stdout(None):
                target.server.stop()
    return gained


@pytest.mark.live
def test_no_attack_succeeds_and_all_would_without_the_guard(capsys: pytest.CaptureFixture[str]) -> None:
    guarded, open_ = outcomes(guarded=True), outcomes(guarded=False)
    word = {True: "succeeds", False: "refused"}
    with capsys.disabled():
        print(f"\n  {'attack':<48}{'guard on':<12}guard off")
        for name in ATTACKS:
            print(f"  {name:<48}{word[guarded[name]]:<12}{word[open_[name]]}")
    assert [name for name, gained in guarded.items() if gained] == []
    assert [name for name, gained in open_.items() if not gained] == [], "an attack that proves nothing"


@pytest.mark.live
def test_no_message_with_a_spoiled_field_gets_in(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """NaN, out of range, of a wrong type or length, missing, or one too many: for every field of every kind of message."""
    monkeypatch.setattr("app.serve.guard.PATIENCE", 10**9)
    target = Target(guarded=GUARD)
    if target.guard is not None:
        target.guard.rate = target.guard.burst = 1e9
    refused, sent = target.guard.refused if target.guard is not None else Counter[str](), Counter[str]()
    client = target.client()
    with capsys.disabled():
        print(f"\n  {'spoiled messages':<48}{'sent':<12}refused")
        for kind in VALID:
            before = refused.total()
            for bad in spoiled(kind, uuid=client.widget("Gain"), source_component_uuid=client.widget("Upload")):
                sent[kind] += 1
                with contextlib.suppress(ConnectionError):
                    client.send(bad)
            with contextlib.suppress(TimeoutError):
                until(lambda kind=kind, before=before: refused.total() - before == sent[kind], 20.0)
            print(f"  {kind:<48}{sent[kind]:<12}{refused.total() - before}")
    assert refused.total() == sent.total() > 500
    assert (target.gain.value, target.heard, target.gizmo.position.tolist()) == (0.5, [], [0.0, 0.0, 0.0])
    client.close()
    with contextlib.redirect_stdout(None):
        target.server.stop()
