"""Processes that tests start."""

import contextlib
import socket
import subprocess
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any


@contextlib.contextmanager
def launched(command: Sequence[object], **options: Any) -> Iterator["subprocess.Popen[str]"]:
    """A running command, with the options of Popen. It ends with the block: if it stayed it would keep a core to itself."""
    with subprocess.Popen([*map(str, command)], text=True, **options) as process:
        try:
            yield process
        finally:
            process.kill()


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


def answers(port: int) -> bool:
    with contextlib.suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{port}/app/favicon.svg", timeout=5.0) as reply:
        return reply.status == 200
    return False


def children(process: int) -> list[int]:
    """The processes that a process has started, and that have not ended."""
    tasks = Path(f"/proc/{process}/task").iterdir()
    return [int(child) for task in tasks for child in (task / "children").read_text().split()]


def alive(process: int) -> bool:
    """Whether it has not ended; one that waits for its parent to be told has."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False
