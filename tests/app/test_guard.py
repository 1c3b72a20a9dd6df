"""The guard against a real server: what must get in does, and each known way to misuse the page is refused."""

import contextlib
import http.client
import math
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
import viser
from vclient import VClient, until

from app.serve.address import PageError
from app.serve.guard import PATIENCE, Guard


@dataclass
class Reply:
    """An HTTP response."""

    status: int
    headers: dict[str, str]
    body: bytes


class Bench:
    """A guarded server with one widget of each kind. heard: the buttons that were pressed."""

    def __init__(self, token: str | None = None) -> None:
        self.guard = Guard(token)
        self.server = self.guard.open("127.0.0.1", 0, "test")
        self.port = self.server.get_port()
        self.heard: list[object] = []
        gui = self.server.gui
        self.gain = gui.add_slider("Gain", min=0.0, max=1.0, step=0.1, initial_value=0.5)
        self.mode = gui.add_dropdown("Mode", ("a", "b"))
        self.box = gui.add_checkbox("Box", False)
        self.locked = gui.add_slider("Locked", min=0.0, max=1.0, step=0.1, initial_value=0.5, disabled=True)
        stop, hidden = gui.add_button("STOP"), gui.add_button("Hidden", visible=False)
        self.gizmo = self.server.scene.add_transform_controls("/gizmo")

        async def on_stop(_: object) -> None:
            self.heard.append("stop")

        async def on_hidden(_: object) -> None:
            self.heard.append("hidden")

        stop.on_click(on_stop)
        hidden.on_click(on_hidden)

    def get(self, path: str = "/", *, host: str | None = None, **headers: str) -> Reply:
        """An HTTP request."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=5)
        connection.request("GET", path, headers={**({"Host": host} if host else {}), **headers})
        response = connection.getresponse()
        return Reply(response.status, dict(response.getheaders()), response.read())

    def client(self, **options: Any) -> VClient:
        """A connected client."""
        client = VClient(self.port, **options)
        until(client.ready.is_set)
        until(lambda: client.widget("STOP"))
        return client

    def admits(self, **options: Any) -> bool:
        """Whether a socket opens."""
        client = VClient(self.port, **options)
        until(lambda: client.ready.is_set() or client.closed.is_set())
        client.close()
        return client.ready.is_set()


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.server.stop()


@pytest.fixture
def client(bench: Bench) -> Iterator[VClient]:
    bench.heard.clear()
    client = bench.client()
    yield client
    client.close()


def settled(bench: Bench, client: VClient) -> None:
    """A STOP that arrives shows that everything sent before it has been handled, and that STOP still works."""
    before = len(bench.heard)
    client.click("STOP")
    until(lambda: len(bench.heard) > before)


def test_page_has_our_head_and_security_headers(bench: Bench) -> None:
    response = bench.get()
    assert response.status == 200
    assert b"<title>Elbowroom</title>" in response.body
    assert b"<title>Viser</title>" not in response.body
    assert response.headers["X-Content-Type-Options"] == "nosniff"
    assert "frame-ancestors 'none'" in response.headers["Content-Security-Policy"]
    assert bench.get("/app/favicon.svg").headers["Content-Type"] == "image/svg+xml"


@pytest.mark.parametrize("path", ["/app/../serve/main.py", "/app/..%2fserve%2fmain.py", "/app/%2e%2e/serve/main.py",
                                  "/app//etc/passwd", "/app/%00"])
def test_static_files_do_not_leave_their_folder(bench: Bench, path: str) -> None:
    assert bench.get(path).status == 404


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", ""])
def test_foreign_host_is_refused(bench: Bench, host: str) -> None:
    assert bench.get(host=host or " ").status in (400, 403)
    assert not bench.admits(headers={"Host": host})


def test_own_names_are_accepted(bench: Bench) -> None:
    for host in ("localhost", f"localhost:{bench.port}", "127.0.0.1", "[::1]:8080"):
        assert bench.get(host=host).status == 200


def test_upgrade_needs_the_same_origin(bench: Bench) -> None:
    assert bench.admits(origin=f"http://127.0.0.1:{bench.port}")
    for origin in ("http://evil.example", "null", f"http://127.0.0.1:{bench.port + 1}", f"http://localhost:{bench.port}"):
        assert not bench.admits(origin=origin)


@pytest.mark.parametrize("value", [1e9, -0.1, math.nan, math.inf, "abc", True, None, [0.5], {"a": 1}])
def test_slider_takes_only_what_it_offers(bench: Bench, client: VClient, value: object) -> None:
    client.set("Gain", value)
    settled(bench, client)
    assert bench.gain.value == 0.5


def test_slider_takes_what_it_offers(bench: Bench, client: VClient) -> None:
    client.set("Gain", 0.7)
    until(lambda: bench.gain.value == 0.7)
    client.set("Gain", 0.5)
    until(lambda: bench.gain.value == 0.5)


def test_options_types_disabled_and_hidden_hold(bench: Bench, client: VClient) -> None:
    client.set("Mode", "zzz")
    client.set("Box", 1)
    client.set("Locked", 0.9)
    client.click("Hidden")
    settled(bench, client)
    assert (bench.mode.value, bench.box.value, bench.locked.value) == ("a", False, 0.5)
    assert "hidden" not in bench.heard


@pytest.mark.parametrize("updates", [{"update_cb": []}, {"removed": True}, {"value": True, "update_cb": []}, {}, "x"])
def test_stop_button_cannot_be_killed(bench: Bench, client: VClient, updates: object) -> None:
    client.send({"type": "GuiUpdateMessage", "uuid": client.widget("STOP"), "updates": updates})
    settled(bench, client)


@pytest.mark.parametrize("position", [(math.nan, 0, 0), (1.0, 2.0), (1e300, 0, 0), ("a", "b", "c"), (True, 1, 1)])
def test_gizmo_refuses_what_is_no_place(bench: Bench, client: VClient, position: tuple[object, ...]) -> None:
    client.gizmo("/gizmo", position)
    for wxyz in ((0.0, 0.0, 0.0, 0.0), (0.95, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0)):
        client.gizmo("/gizmo", (0.1, 0.2, 0.3), wxyz=wxyz)
    settled(bench, client)
    assert bench.gizmo.position.tolist() == [0.0, 0.0, 0.0]


def test_junk_is_refused_and_the_connection_lives(bench: Bench, client: VClient) -> None:
    trigger = "CommandTriggerMessage"
    junk = ["text", b"", b"\xc1", b"\x91" * 5000 + b"\xc0", {"type": "ResetGuiMessage"}, {"type": ["x"]}, {"no": 1},
            {"type": "GuiUpdateMessage", "uuid": "unknown", "updates": {"value": 1}}, {"type": trigger},
            {"type": trigger, "uuid": "x" * 5000}, {"type": trigger, "uuid": "x", "extra": 1}]
    for message in junk:
        client.send(message)
    settled(bench, client)
    assert not client.closed.is_set()


def test_nobody_can_ask_for_a_public_tunnel(bench: Bench, client: VClient, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = threading.Event()
    monkeypatch.setattr(viser.ViserServer, "request_share_url", lambda *_: asked.set())
    client.send({"type": "ShareUrlRequest"})
    client.send({"type": "ShareUrlDisconnect"})
    settled(bench, client)
    assert not asked.is_set()


def test_flood_big_messages_and_endless_junk_close_only_that_connection(bench: Bench, client: VClient) -> None:
    flood, big, junk = bench.client(), bench.client(), bench.client()
    known = {"type": "LocalStorageGetItemResponseMessage", "value": None, "error": None, "request_uuid": "x"}
    for other, message, times in ((flood, known, 3000), (big, b"\x00" * (1 << 20), 1), (junk, b"\xc1", 100)):
        with contextlib.suppress(ConnectionError):
            for _ in range(times):
                other.send(message)
        assert other.closed.wait(5.0)
        assert other.close_code in (1006, 1008, 1009)
    settled(bench, client)


def test_token_opens_the_door_and_moves_into_a_cookie() -> None:
    bench = Bench("s3cret-token")
    try:
        assert bench.get().status == 401
        assert bench.get("/?token=wrong").status == 401
        moved = bench.get("/?token=s3cret-token&fixedDpr=1")
        assert (moved.status, moved.headers["Location"]) == (302, "/?fixedDpr=1")
        cookie = moved.headers["Set-Cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Lax" in cookie
        known = {"Cookie": cookie.split(";")[0]}
        assert bench.get(**known).status == 200
        assert bench.get(host="192.0.2.7:8080", **known).status == 200
        assert bench.get(host="arm.example:8080", **known).status == 403
        assert not bench.admits()
        assert bench.admits(headers=known)
        assert not bench.admits(headers=known, origin="http://evil.example")
    finally:
        bench.server.stop()


def test_busy_port_and_open_address_are_clear_errors(bench: Bench) -> None:
    with pytest.raises(PageError, match=f"port {bench.port} .*in use.*--port"):
        Guard().open("127.0.0.1", bench.port, "test")
    with pytest.raises(PageError, match="ELBOWROOM_TOKEN"):
        Guard().open("0.0.0.0", 0, "test")
    with pytest.raises(PageError, match="cannot serve on 192\\.0\\.2\\.1"):
        Guard("s3cret-token").open("192.0.2.1", 0, "test")


def test_refused_messages_are_forgotten_in_time(bench: Bench, client: VClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.serve.guard.FORGIVEN", 0.005)
    for _ in range(3 * PATIENCE):
        client.send(b"\xc1")
        time.sleep(0.02)
    settled(bench, client)
    assert not client.closed.is_set()
