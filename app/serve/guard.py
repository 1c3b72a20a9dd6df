"""The only door to the page: who may load it, who may open a socket, and how much may come through.

viser has no hook for any of this, but it builds its server by `websockets.asyncio.server.serve`, and that one has:
`process_request` sees every request before it is answered, `create_connection` makes the object whose `recv` hands the
messages over, and `sock` takes a socket bound beforehand (viser would move on to the next port in silence). So `serve`
is wrapped while viser's constructor runs. Private names of viser are used in this file and in inbound.py only; its
version is pinned, and tests/app/test_guard.py is the tripwire.
"""

import asyncio
import contextlib
import errno
import gzip
import hmac
import http
import io
import ipaddress
import mimetypes
import re
import socket
import threading
import time
import urllib.parse
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import viser
import websockets.asyncio.server as websockets_server
from viser import _messages
from websockets import Headers
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from app.serve.inbound import RefusedError, screen
from hrc.errors import HrcError
from hrc.paths import static

LOOPBACK = frozenset({"localhost", "127.0.0.1", "[::1]"})
MAX_MESSAGE = 64 * 1024
"""Bytes of the largest inbound message; the largest that the page really sends is about 300."""
RATE, BURST = 400.0, 800.0
"""Messages per second that a client may send for long, and at once."""
PATIENCE = 20
"""Refused messages after which a client is disconnected."""
SECURITY_HEADERS = {
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "frame-ancestors 'none'; base-uri 'none'; form-action 'none'; object-src 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
}
_construction = threading.Lock()


class PageError(HrcError):
    """The page cannot be served as asked."""


def is_loopback(host: str) -> bool:
    """Whether nothing but this machine reaches an address of that name."""
    try:
        return host == "localhost" or ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class Guard:
    """Access to one server. Without a token only this machine's own pages get in; with one, whoever presents it.

    refused: how many requests and messages were turned away, by reason.
    """

    def __init__(self, token: str | None = None) -> None:
        self.token = token
        self.refused: Counter[str] = Counter()
        self.server: viser.ViserServer | None = None
        self._index: bytes | None = None

    def open(self, host: str, port: int, label: str) -> viser.ViserServer:
        """Start a guarded viser server; port 0 takes a free one.

        Raises PageError if the port is taken, the address is not this machine's, or others could reach the page
        and there is no token.
        """
        if not is_loopback(host) and not self.token:
            raise PageError(f"other machines can reach {host}: set ELBOWROOM_TOKEN to a secret, or use 127.0.0.1")
        listener = _bind(host, port)
        stock = websockets_server.serve

        def guarded(handler: Any, _host: str, _port: int, **options: Any) -> Any:
            inner = options.pop("process_request")
            options |= {"process_request": lambda connection, request: self._answer(connection, request, inner),
                        "create_connection": lambda *args, **kwargs: ScreenedConnection(self, *args, **kwargs),
                        "max_size": MAX_MESSAGE, "sock": listener}
            return stock(handler, **options)

        with _construction, contextlib.redirect_stdout(io.StringIO()):
            websockets_server.serve = guarded
            try:
                server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
            finally:
                websockets_server.serve = stock
        for tunnel in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
            server._websock_server.unregister_handler(tunnel)
        self.server = server
        return server

    def _answer(self, connection: ServerConnection, request: Request,
                inner: Callable[[ServerConnection, Request], Response | None]) -> Response | None:
        """The reply to an HTTP request; None lets a WebSocket upgrade proceed."""
        host = request.headers.get("Host", "")
        if self.token is None and _hostname(host) not in LOOPBACK:  # a foreign name that resolves here: DNS rebinding
            return self._refuse(connection, http.HTTPStatus.FORBIDDEN, "Host")
        if request.headers.get("Upgrade", "").lower() == "websocket":
            origin = request.headers.get("Origin")  # every browser sends it; a tool on this machine may not
            if origin is not None and urllib.parse.urlsplit(origin).netloc != host:
                return self._refuse(connection, http.HTTPStatus.FORBIDDEN, "Origin")
            if not self._knows_token(connection, request):
                return self._refuse(connection, http.HTTPStatus.UNAUTHORIZED, "token")
            return inner(connection, request)
        if not self._knows_token(connection, request):
            return self._refuse(connection, http.HTTPStatus.UNAUTHORIZED, "token")
        url = urllib.parse.urlsplit(request.path)
        if self.token is not None and "token" in urllib.parse.parse_qs(url.query):
            return self._keep_token(connection, url)
        if url.path.startswith("/app/"):
            response = _file(url.path.removeprefix("/app/"))
        elif url.path in ("/", "/index.html"):
            response = self._page(request)
        else:
            response = inner(connection, request)
        if response is not None:
            for name, value in SECURITY_HEADERS.items():
                response.headers[name] = value
        return response

    def _refuse(self, connection: ServerConnection, status: http.HTTPStatus, reason: str) -> Response:
        self.refused[reason] += 1
        return connection.respond(status, f"{reason} not accepted: open the address that the terminal printed\n")

    def _cookie(self, connection: ServerConnection) -> str:
        return f"elbowroom_{connection.local_address[1]}"

    def _knows_token(self, connection: ServerConnection, request: Request) -> bool:
        if self.token is None:
            return True
        pairs = (part.strip().partition("=") for part in request.headers.get("Cookie", "").split(";"))
        cookies = {name: value for name, _, value in pairs}
        query = urllib.parse.parse_qs(urllib.parse.urlsplit(request.path).query)
        presented = (cookies.get(self._cookie(connection), ""), query.get("token", [""])[0],
                     request.headers.get("Authorization", "").removeprefix("Bearer "))
        return any(hmac.compare_digest(value.encode(), self.token.encode()) for value in presented)

    def _keep_token(self, connection: ServerConnection, url: urllib.parse.SplitResult) -> Response:
        """Move the token from the address, which histories and logs keep, into a cookie that scripts cannot read."""
        rest = urllib.parse.urlencode([pair for pair in urllib.parse.parse_qsl(url.query) if pair[0] != "token"])
        cookie = f"{self._cookie(connection)}={self.token}; HttpOnly; SameSite=Strict; Path=/"
        location = url.path + (f"?{rest}" if rest else "")
        return Response(302, "Found", Headers({"Location": location, "Set-Cookie": cookie, "Content-Length": "0",
                                               "Cache-Control": "no-store"}))

    def _page(self, request: Request) -> Response:
        """viser's single-file client with our title, icon, style and script in its head."""
        if self._index is None:
            client = (Path(viser.__file__).parent / "client/build/index.html").read_text(encoding="utf-8")
            client = re.sub(r'<link\s+rel="icon".*?/>', "", client, count=1, flags=re.DOTALL)
            head = (static() / "head.html").read_text(encoding="utf-8")
            self._index = gzip.compress(client.replace("<title>Viser</title>", head, 1).encode())
        if "gzip" in request.headers.get("Accept-Encoding", ""):
            return _content(self._index, "text/html; charset=utf-8", "gzip")
        return _content(gzip.decompress(self._index), "text/html; charset=utf-8")


class ScreenedConnection(ServerConnection):
    """A WebSocket whose `recv` hands over only messages that pass the table, no faster than the rate allows."""

    def __init__(self, guard: Guard, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._guard = guard
        self._credit, self._counted = BURST, time.monotonic()
        self._strikes = 0

    async def recv(self, decode: bool | None = None) -> Any:
        """The next acceptable message. Raises ConnectionClosed, as its parent does."""
        while True:
            raw = await super().recv(decode)
            now = time.monotonic()
            self._credit = min(BURST, self._credit + (now - self._counted) * RATE)
            self._counted = now
            if self._credit < 1.0:
                self._guard.refused["rate"] += 1
                await self._hang_up("too many messages")
                continue
            self._credit -= 1.0
            if self._guard.server is None:  # still under construction: nothing to talk to yet
                continue
            try:
                screen(raw, self._guard.server)
            except RefusedError as reason:
                self._guard.refused[str(reason)] += 1
                self._strikes += 1
                if self._strikes > PATIENCE:
                    await self._hang_up("too many refused messages")
                continue
            return raw

    async def _hang_up(self, why: str) -> None:
        """Close, and do not wait for the other side: behind a flood its answer may never be read."""
        try:
            await asyncio.wait_for(self.close(1008, why), 0.5)
        except TimeoutError:
            self.transport.abort()


def _bind(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host.strip("[]"), port), family=family)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise PageError(f"port {port} of {host} is in use; choose another with --port") from None
        raise PageError(f"cannot serve on {host} port {port} ({error.strerror})") from None
    except OverflowError:
        raise PageError(f"a port is a number from 0 to 65535, not {port}") from None


def _hostname(host: str) -> str:
    """`name` of `name:port`; an IPv6 address keeps its brackets."""
    return host if host.endswith("]") else host.rsplit(":", 1)[0]


def _file(name: str) -> Response:
    """A file of the static folder, and of no other: a path that leaves it is not found."""
    name, folder = urllib.parse.unquote(name), static().resolve()
    path = (folder / name).resolve() if "\0" not in name else folder
    if not path.is_relative_to(folder) or not path.is_file():
        return Response(404, "Not Found", Headers({"Content-Length": "0"}), b"")
    return _content(path.read_bytes(), mimetypes.guess_type(path.name)[0] or "application/octet-stream")


def _content(body: bytes, kind: str, encoding: str = "identity") -> Response:
    return Response(200, "OK", Headers({"Content-Type": kind, "Content-Length": str(len(body)),
                                        "Content-Encoding": encoding, "Cache-Control": "no-cache"}), body)
