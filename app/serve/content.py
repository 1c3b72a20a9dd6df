"""What the page is made of: viser's client with our head in it, and the files of the static folder."""

import functools
import gzip
import mimetypes
import re
import urllib.parse
from pathlib import Path

import viser
from websockets import Headers
from websockets.http11 import Request, Response

from hrc.paths import static

SECURITY_HEADERS = {
    "X-Frame-Options": "DENY",
    # The client is one file that unpacks itself into an inline script and style with a WebAssembly decoder, and shows
    # images from blobs; nothing comes from, or goes to, any other host.
    "Content-Security-Policy": "; ".join((
        "default-src 'none'", "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'", "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data: blob:", "font-src 'self' data:", "media-src 'self' blob:", "worker-src 'self' blob:",
        "connect-src 'self' data: blob:{sockets}", "frame-ancestors 'none'", "base-uri 'none'", "form-action 'none'")),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
}


def secured(response: Response, host: str) -> Response:
    """With the headers that keep other pages and hosts out. host: the request's own, for its socket.

    Not every browser counts a WebSocket of the same host as 'self', so it is named.
    """
    sockets = f" ws://{host} wss://{host}" if re.fullmatch(r"[\w.\-\[\]:]+", host) else ""
    for name, value in SECURITY_HEADERS.items():
        response.headers[name] = value.replace("{sockets}", sockets)
    return response


def page(request: Request) -> Response:
    """The page itself."""
    body = _index()
    if "gzip" in request.headers.get("Accept-Encoding", ""):
        return _content(body, "text/html; charset=utf-8", "gzip")
    return _content(gzip.decompress(body), "text/html; charset=utf-8")


def file(name: str) -> Response:
    """A file of the static folder, and of no other: a path that leaves it is not found."""
    name, folder = urllib.parse.unquote(name), static().resolve()
    path = (folder / name).resolve() if "\0" not in name else folder
    if not path.is_relative_to(folder) or not path.is_file():
        return Response(404, "Not Found", Headers({"Content-Length": "0"}), b"")
    return _content(path.read_bytes(), mimetypes.guess_type(path.name)[0] or "application/octet-stream")


def health(well: bool) -> Response:
    """One bit, for who watches over the server."""
    body = b"ok\n" if well else b""
    headers = Headers({"Content-Type": "text/plain", "Content-Length": str(len(body)), "Cache-Control": "no-store"})
    return Response(200, "OK", headers, body) if well else Response(503, "Service Unavailable", headers, body)


@functools.cache
def _index() -> bytes:
    """viser's single-file client with our title, icon, style and script in its head, compressed."""
    client = (Path(viser.__file__).parent / "client/build/index.html").read_text(encoding="utf-8")
    client = re.sub(r'<link\s+rel="icon".*?/>', "", client, count=1, flags=re.DOTALL)
    head = (static() / "head.html").read_text(encoding="utf-8")
    return gzip.compress(client.replace("<title>Viser</title>", head, 1).encode())


def _content(body: bytes, kind: str, encoding: str = "identity") -> Response:
    return Response(200, "OK", Headers({"Content-Type": kind, "Content-Length": str(len(body)),
                                        "Content-Encoding": encoding, "Cache-Control": "no-cache"}), body)
