"""A page in a process of its own."""

import contextlib
import socket
import urllib.request


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


def answers(port: int) -> bool:
    with contextlib.suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{port}/app/favicon.svg", timeout=5.0) as reply:
        return reply.status == 200
    return False
