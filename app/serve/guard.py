"""The only door to the page: who may load it, who may open a socket, how much may come through, and from whom.

viser has no hook for any of this, but it builds its server by `websockets.asyncio.server.serve`, and that one has:
`process_request` sees every request before it is answered, `create_connection` makes the object whose `recv` hands the
messages over, and `sock` takes a socket bound beforehand (viser would move on to the next port in silence). So `serve`
is wrapped while viser's constructor runs. Private names of viser are used in this file, inbound.py, icons.py,
jpeg.py, wakeup.py, backlog.py, lean.py, pulse.py and download.py only; its version is pinned, and
tests/app/test_guard.py is the tripwire.
"""

import asyncio
import contextlib
import http
import io
import ssl
import threading
import time
import urllib.parse
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any, Literal

import viser
import websockets.asyncio.server as websockets_server
from viser import _messages
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from app.serve import backlog, content, lean, wakeup
from app.serve.address import LOOPBACK, PageError, bind, hostname, is_loopback, is_number
from app.serve.inbound import RefusedError, screen, widget_of
from app.serve.keys import Keys, Role
from app.serve.seat import Seat

MAX_MESSAGE = 64 * 1024
"""Bytes of the largest inbound message; the largest that the page really sends is about 300."""
RATE, BURST = 400.0, 800.0
"""Messages per second that a client may send for long, and at once."""
PATIENCE, FORGIVEN = 20, 5.0
"""Refused messages after which a client is disconnected, and after how long one of them is forgotten [s]: in hours an honest
one presses a button now and then that has just gone. Those that were only not its to send do not count.
"""
MAX_CLIENTS = 32
"""Sockets open at once."""
IN_FLIGHT = 4
"""Frames on their way to a visitor at once: 20 pictures a second over a line of 200 ms."""
FOR_ALL = frozenset({"ViewerCameraMessage", "LocalStorageGetItemResponseMessage"})
"""Messages that touch nothing but their own sender's view: of every visitor, whoever sits in the operator's seat."""
_construction = threading.Lock()


class Guard:
    """Access to one server. Without a token only this machine's own pages get in; with one, whoever presents it.

    keys: the tokens. names: host names beside this machine's own under which the page may be asked for, which is a matter
    of DNS rebinding; an IP address needs no permission where there is a token. tls: to serve HTTPS.
    refused: how many requests and messages were turned away, by reason. seat: who drives. healthy: what /healthz tells
    everybody who reaches the port, and nothing more.
    """

    def __init__(self, keys: Keys | str | None = None, *, names: Iterable[str] = (), tls: ssl.SSLContext | None = None,
                 healthy: Callable[[], bool] = lambda: True) -> None:
        self.keys = keys if isinstance(keys, Keys) else Keys(keys)
        self.tls = tls
        self.refused: Counter[str] = Counter()
        self.server: viser.ViserServer | None = None
        self.seat = Seat(self.role)
        self.rate, self.burst = RATE, BURST
        self._names = LOOPBACK | {name.lower() for name in names}
        self._free: set[str] = set()
        self._healthy = healthy

    def open(self, host: str, port: int | Literal["auto"], label: str) -> viser.ViserServer:
        """Start a guarded viser server; port 0 takes a free one, "auto" 8080 or the next that is free.

        Raises PageError if the port is taken, the address is not this machine's, or others could reach the page
        and there is no token.
        """
        if not is_loopback(host) and self.keys.operate is None:
            raise PageError(f"other machines can reach {host}: give a --token (or set ELBOWROOM_TOKEN), or use 127.0.0.1")
        listener = bind(host, port)
        wakeup.install()
        backlog.install()
        lean.install()
        stock = websockets_server.serve

        def guarded(handler: Any, _host: str, _port: int, **options: Any) -> Any:
            inner = options.pop("process_request")
            options |= {"process_request": lambda connection, request: self._answer(connection, request, inner),
                        "create_connection": lambda *args, **kwargs: ScreenedConnection(self, *args, **kwargs),
                        "max_size": MAX_MESSAGE, "sock": listener, "ssl": self.tls}
            return stock(handler, **options)

        self._names |= {hostname(host)}
        with _construction, contextlib.redirect_stdout(io.StringIO()):
            websockets_server.serve = guarded
            try:
                server = viser.ViserServer(host=host, port=listener.getsockname()[1], label=label, verbose=False)
            finally:
                websockets_server.serve = stock
        for tunnel in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
            server._websock_server.unregister_handler(tunnel)
        self.server = server
        return server

    def free(self, *handles: Any) -> None:
        """Let every visitor use these widgets and commands, whoever drives."""
        self._free |= {handle._impl.uuid for handle in handles}

    def bind(self, *handles: Any) -> None:
        """Let them be used by whoever drives only, as all others are."""
        self._free -= {handle._impl.uuid for handle in handles}

    def role(self, visitor: int) -> Role | None:
        """What a connected client may do at most."""
        connection = self._connection(visitor)
        return connection.role if connection is not None else None

    def round_trip(self, visitor: int) -> float | None:
        """To a connected client and back, for the last frame that it took [s]; None before the first."""
        connection = self._connection(visitor)
        return connection.round_trip if connection is not None else None

    def _connection(self, visitor: int) -> "ScreenedConnection | None":
        found = self.server._websock_server._live_connections.get(visitor) if self.server is not None else None
        return found if isinstance(found, ScreenedConnection) else None

    def admits(self, visitor: int, message: dict[str, Any]) -> bool:
        """Whether an acceptable message is this visitor's to send now. Whatever is not named as free is the operator's."""
        return message["type"] in FOR_ALL or message.get("uuid") in self._free or self.seat.admits(visitor)

    def put_back(self, visitor: int, message: dict[str, Any]) -> None:
        """Show a visitor whose message was not its to send what still holds: its own screen has moved already."""
        client = self.server._connected_clients.get(visitor) if self.server is not None else None
        if client is None or self.server is None:
            return
        tell = client._websock_connection.queue_message
        if message["type"] == "GuiUpdateMessage":
            widget = widget_of(message["uuid"], self.server, visitor)
            if widget is not None and not widget._impl.is_button:
                tell(_messages.GuiUpdateMessage(message["uuid"], {"value": widget.value}))
        elif message["type"] == "TransformControlsDragEndMessage":
            gizmo = self.server.scene._handle_from_transform_controls_name.get(message["name"])
            if gizmo is not None:
                x, y, z = map(float, gizmo.position)
                w, i, j, k = map(float, gizmo.wxyz)
                tell(_messages.SetPositionMessage(message["name"], (x, y, z)))
                tell(_messages.SetOrientationMessage(message["name"], (w, i, j, k)))

    def _answer(self, connection: ServerConnection, request: Request,
                inner: Callable[[ServerConnection, Request], Response | None]) -> Response | None:
        """The reply to an HTTP request; None lets a WebSocket upgrade proceed."""
        host = request.headers.get("Host", "")
        if not self._is_ours(hostname(host)):  # a foreign name that resolves here: DNS rebinding
            return self._refuse(connection, http.HTTPStatus.FORBIDDEN, "Host")
        path = urllib.parse.urlsplit(request.path).path
        if path == "/healthz":
            return content.secured(content.health(self.server is not None and self._healthy()), host)
        upgrade = request.headers.get("Upgrade", "").lower() == "websocket"
        origin = request.headers.get("Origin")  # every browser sends it; a tool may not
        if upgrade and origin is not None and urllib.parse.urlsplit(origin).netloc != host:
            return self._refuse(connection, http.HTTPStatus.FORBIDDEN, "Origin")
        cookie = f"elbowroom_{connection.local_address[1]}"
        role = self.keys.role(request, cookie)
        if role is None:
            return self._refuse(connection, http.HTTPStatus.UNAUTHORIZED, "token")
        if upgrade:
            assert isinstance(connection, ScreenedConnection)
            connection.role = role
            return inner(connection, request)
        moved = self.keys.keep(request, role, cookie, secure=self.tls is not None)
        if moved is not None:
            return moved
        if path.startswith("/app/"):
            response = content.file(path.removeprefix("/app/"))
        elif path in ("/", "/index.html"):
            response = content.page(request)
        else:
            response = inner(connection, request)
        return None if response is None else content.secured(response, host)

    def _is_ours(self, name: str) -> bool:
        return name in self._names or (self.keys.operate is not None and is_number(name))

    def _refuse(self, connection: ServerConnection, status: http.HTTPStatus, reason: str) -> Response:
        self.refused[reason] += 1
        return connection.respond(status, {
            "Host": "Host not accepted: open the address that the terminal printed, or start with --allow-host NAME\n",
        }.get(reason, f"{reason} not accepted: open the address that the terminal printed\n"))


class ScreenedConnection(ServerConnection):
    """A WebSocket whose `recv` hands over only messages that pass the table, no faster than the rate allows, and only
    those that its visitor may send. role: by the token it came with. round_trip: of the last frame that was taken [s]."""

    def __init__(self, guard: Guard, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.role = Role.VIEWER
        self._guard = guard
        self._credit, self._counted = guard.burst, time.monotonic()
        self._strikes, self._struck = 0.0, self._counted
        self._visitor: int | None = None
        self._taken: list[asyncio.Future[float]] = []
        self.round_trip: float | None = None

    async def recv(self, decode: bool | None = None) -> Any:
        """The next acceptable message. Raises ConnectionClosed, as its parent does."""
        guard = self._guard
        while guard.server is None:  # under construction: nothing to talk to yet
            await asyncio.sleep(0.01)
        if self._visitor is None:
            await self._enter()
        while True:
            raw = await super().recv(decode)
            now = time.monotonic()
            self._credit = min(guard.burst, self._credit + (now - self._counted) * guard.rate)
            self._counted = now
            if self._credit < 1.0:
                guard.refused["rate"] += 1
                await self._hang_up("too many messages")
                continue
            self._credit -= 1.0
            if self._passes(raw):
                return raw
            if self._strikes > PATIENCE:
                await self._hang_up("too many refused messages")

    def _passes(self, raw: bytes | str) -> bool:
        guard, visitor = self._guard, self._visitor
        if guard.server is None or visitor is None:
            return False
        try:
            message = screen(raw, guard.server, visitor)
        except RefusedError as reason:
            guard.refused[str(reason)] += 1
            now = time.monotonic()
            self._strikes = max(0.0, self._strikes - (now - self._struck) / FORGIVEN) + 1.0
            self._struck = now
            return False
        if guard.admits(visitor, message):
            return True
        guard.refused["not the operator"] += 1
        guard.put_back(visitor, message)
        return False

    async def _enter(self) -> None:
        """Find the number that viser gave this connection, and a place among the others."""
        assert self._guard.server is not None
        live = self._guard.server._websock_server._live_connections
        self._visitor = next((visitor for visitor, connection in list(live.items()) if connection is self), None)
        if len(live) > MAX_CLIENTS:
            self._guard.refused["too many clients"] += 1
            await self._hang_up("too many clients")

    async def send(self, message: Any, text: bool | None = None) -> None:
        """Send a frame, once the visitor has taken all but the last few before it. Raises ConnectionClosed, as its parent does.

        What waits here waits in viser, where a newer value replaces an older one: over a thin line fewer pictures come, and
        none of them old. Without that, seconds of them pile up in the buffers on the way.
        """
        self._taken = [taken for taken in self._taken if not taken.done()]
        if len(self._taken) >= IN_FLIGHT:
            await self._taken[-IN_FLIGHT]
        await super().send(message, text)
        taken = asyncio.ensure_future(await self.ping())
        taken.add_done_callback(self._measure)
        self._taken.append(taken)

    def _measure(self, taken: "asyncio.Future[float]") -> None:
        if not taken.cancelled() and taken.exception() is None:
            self.round_trip = taken.result()

    def connection_lost(self, exc: Exception | None) -> None:
        """The transport is gone, and whoever came by it."""
        if self._visitor is not None:
            self._guard.seat.leave(self._visitor)
        super().connection_lost(exc)

    async def _hang_up(self, why: str) -> None:
        """Close, and do not wait for the other side: behind a flood its answer may never be read."""
        try:
            await asyncio.wait_for(self.close(1008, why), 0.5)
        except TimeoutError:
            self.transport.abort()
