"""`elbowroom review`: recordings in Rerun's web viewer, served from the installed package on this machine alone.

The viewer's files are inside Rerun's own program, which serves them on loopback; they are taken from it once, and the program
ends. The page that comes from here asks no other host for anything: its links to fonts and statistics are taken out, and a
content security policy holds it to that.
"""

import contextlib
import os
import re
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
import webbrowser
from collections.abc import Mapping, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

from app.record.folder import SESSION, files
from app.record.recover import mend
from hrc.errors import HrcError

LOOPBACK = "127.0.0.1"
VIEWER = {"index.html": "text/html; charset=utf-8", "re_viewer.js": "text/javascript", "re_viewer_bg.wasm": "application/wasm"}
POLICY = ("default-src 'self'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:; style-src 'self' 'unsafe-inline'; "
          "connect-src 'self'; img-src 'self' data: blob:; font-src 'self' data:; worker-src 'self' blob:; "
          "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'")
_OUTSIDE = (re.compile(rb"<link\b[^>]*https?://[^>]*>"), re.compile(rb"https?://[\w.-]*rerun\.io/script\.js"))
_PATIENCE = 20.0


class ReviewError(HrcError):
    """There is nothing to review, or nothing to review it with."""


def recordings(folders: Sequence[Path]) -> list[Path]:
    """The recording of each folder with all its files, or the file itself; a torn one is repaired, and that is said.

    Raises ReviewError where there is none, RepairError for a file that is none, and OutputError for one that is not finished.
    """
    found = []
    for folder in folders:
        mend(folder, lambda line: print(line, file=sys.stderr))
        paths = files(folder) if folder.is_dir() else [folder]
        if not paths or not paths[0].is_file():
            raise ReviewError(f"{folder} has no {SESSION}; `run` writes one unless it is told --no-record")
        found += [path.resolve() for path in paths]
    return found


def program() -> Path:
    """Rerun's own program, of the installed package. Raises ReviewError if the package came without it."""
    try:
        import rerun_cli
    except ModuleNotFoundError:
        raise ReviewError('rerun\'s program is not installed; install "elbowroom[record]" (an image has none: take the '
                          "recording out and review it there)") from None
    path = Path(rerun_cli.__path__[0]) / ("rerun.exe" if sys.platform == "win32" else "rerun")
    if not path.is_file():
        raise ReviewError(f"rerun-sdk came without its program ({path.name}); install rerun-sdk again")
    return path


def native(paths: Sequence[Path]) -> None:
    """Open recordings in Rerun's native viewer; returns when it is closed. Raises ReviewError if it cannot start."""
    done = subprocess.run([program(), *map(str, paths)], check=False)
    if done.returncode:
        raise ReviewError("the native viewer did not start; leave --native out for the one in the browser")


def viewer() -> dict[str, bytes]:
    """The files of the web viewer by name, from the installed package. Raises ReviewError if they do not come."""
    port = _free_port()
    command = [program(), "--serve-web", "--bind", LOOPBACK, "--web-viewer-port", str(port), f"http://{LOOPBACK}:{port}/none.rrd"]
    quiet = {**os.environ, "TELEMETRY_ENABLED": "false", "CI": "true"}  # in a CI, Rerun's program sends no statistics
    with subprocess.Popen(command, env=quiet, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            files = {name: _fetched(f"http://{LOOPBACK}:{port}/{name}", process) for name in VIEWER}
        finally:
            process.terminate()
    for outside in _OUTSIDE:
        files["index.html"] = outside.sub(b"", files["index.html"])
    return files


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]


def _fetched(url: str, process: "subprocess.Popen[bytes]") -> bytes:
    deadline = time.monotonic() + _PATIENCE
    direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    while True:
        try:
            with direct.open(url, timeout=_PATIENCE) as answer:
                return answer.read()
        except (urllib.error.URLError, OSError) as error:
            if process.poll() is not None or time.monotonic() > deadline:
                raise ReviewError(f"rerun's program does not serve its viewer: {error}") from None
            time.sleep(0.05)


class Handler(BaseHTTPRequestHandler):
    """Gives the viewer and the recordings to this machine's browsers, and nothing else."""

    protocol_version = "HTTP/1.1"
    timeout = 60.0

    def do_GET(self) -> None:
        """Answer a request."""
        server = self.server
        assert isinstance(server, Server)
        own = {f"{name}:{server.server_port}" for name in (LOOPBACK, "localhost")}
        if self.headers.get("Host") not in own:  # another site's name for this machine is no name for it
            self.send_error(421)
            return
        path = urlsplit(self.path).path
        if path == "/" and "url=" not in self.path:
            self.send_response(302)
            self.send_header("Location", server.start)
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        name = "index.html" if path == "/" else path[1:]
        if name in server.files:
            body = server.files[name]
            self._head(VIEWER[name], len(body))
            self.wfile.write(body)
        elif name in server.recordings:
            with server.recordings[name].open("rb") as file:
                self._head("application/octet-stream", server.recordings[name].stat().st_size)
                with contextlib.suppress(ConnectionError):  # the tab was closed
                    shutil.copyfileobj(file, self.wfile)
        else:
            self.send_error(404)

    def _head(self, kind: str, size: int) -> None:
        self.send_response(200)
        for name, value in (("Content-Type", kind), ("Content-Length", str(size)), ("rerun-final-length", str(size)),
                            ("Cache-Control", "no-store"), ("Content-Security-Policy", POLICY),
                            ("Referrer-Policy", "no-referrer"), ("X-Content-Type-Options", "nosniff")):
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing."""


class Server(ThreadingHTTPServer):
    """On loopback. url: of the page; start: of the page with the recordings opened."""

    daemon_threads = True

    def __init__(self, paths: Sequence[Path], files: Mapping[str, bytes], port: int = 0) -> None:
        """Raises ReviewError if the port is taken."""
        try:
            super().__init__((LOOPBACK, port), Handler)
        except (OSError, OverflowError) as error:
            raise ReviewError(f"cannot listen on port {port}: {error}") from None
        self.files = files
        self.recordings = {f"{i}/{SESSION}": path for i, path in enumerate(paths)}
        self.url = f"http://{LOOPBACK}:{self.server_port}/"
        self.start = "/?" + "&".join(f"url={quote(self.url + name, safe='')}" for name in self.recordings)


def review(folders: Sequence[Path], *, port: int = 0, in_native: bool = False, open_browser: bool = False) -> None:
    """Show the recordings until Ctrl-C; several are laid over one another in one viewer.

    Raises ReviewError or RepairError for what cannot be shown.
    """
    paths = recordings(folders)
    if in_native:
        native(paths)
        return
    with Server(paths, viewer(), port) as server:
        print(f"The recording is at {server.url} (Ctrl-C ends it)", flush=True)
        if open_browser:
            webbrowser.open(server.url)
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever()
