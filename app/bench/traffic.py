"""Visitors of the page in a process of their own: what is sent to each, how late, and a hand that never lets go."""

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from app.client import Client, unpack, until

LINK = "/robot/link_4"
UPDATE = 0.05
"""Between two messages of a drag [s], as a browser sends them."""
PULL, PERIOD = 0.15, 2.0
"""How far the hand pulls [m], to and fro once in so long [s]."""
Point = tuple[float, float, float]


@dataclass
class Traffic:
    """What one visitor received. streams: bytes by what they were for. late: of each banner since it was published [s]."""

    seconds: float = 0.0
    streams: dict[str, int] = field(default_factory=dict)
    late: list[float] = field(default_factory=list)

    @property
    def rate(self) -> float:
        """Bytes a second."""
        return sum(self.streams.values()) / self.seconds


@dataclass
class Visit:
    """What the visitors saw. sent: when each place of the hand was sent [s, monotonic]; nobody's if it only watched."""

    traffic: list[Traffic]
    sent: dict[Point, float]


class Metered(Client):
    """A client that counts what it gets. A frame's compressed part is shared out by the messages' sizes in it."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.streams: Counter[str] = Counter()
        self.late: list[float] = []
        self._beat = ""
        super().__init__(*args, **kwargs)

    async def take_frame(self, raw: bytes) -> None:
        """Count, then take."""
        messages, lengths, compressed = unpack(raw)
        packed = [len(msgspec.msgpack.encode(message)) for message in messages]
        for message, size in zip(messages, packed, strict=True):
            self.streams[self._stream(message)] += round(compressed * size / sum(packed) + sum(_buffers(message, lengths)))
        await super().take_frame(raw)
        self._note()

    def clear(self) -> None:
        """Count anew."""
        self.streams.clear()
        self.late.clear()

    def _note(self) -> None:
        try:
            banner = self.banner()
        except KeyError:
            return
        if banner["beat"] != self._beat:
            self._beat = banner["beat"]
            self.late.append(time.time() - float(banner["sent"]))

    def _stream(self, message: Mapping[str, Any]) -> str:
        """Of the scene the first part of a node's name; of widgets their kind."""
        name = message.get("name")
        if isinstance(name, str) and name.startswith("/"):
            return "/" + name.split("/")[1]
        if message["type"] == "GuiUpdateMessage":
            kind = self.gui.get(message["uuid"], {}).get("type", "")
            return {"GuiImageMessage": "camera images", "GuiUplotMessage": "plots", "GuiHtmlMessage": "banner and texts"}.get(
                kind, "other widgets")
        return "other"


def _buffers(value: Any, lengths: list[int]) -> list[int]:
    """The sizes of the arrays that a message refers to."""
    if isinstance(value, dict):
        if "__binary_index" in value:
            return [lengths[value["__binary_index"]]]
        return [size for entry in value.values() for size in _buffers(entry, lengths)]
    return [size for entry in value for size in _buffers(entry, lengths)] if isinstance(value, list) else []


def visit(port: int, visitors: int, seconds: float, *, drive: bool) -> Visit:
    """Be so many visitors for so long; the first drives, if somebody does: it holds the elbow and pulls it to and fro."""
    clients = [Metered(port) for _ in range(visitors)]
    try:
        for client in clients:
            until(lambda client=client: client.ready.is_set() and LINK in client.nodes and client.banner())
        time.sleep(1.0)  # what is sent once is through
        begin = time.monotonic()
        for client in clients:
            client.clear()
        sent = _pull(clients[0], begin + seconds) if drive else {}
        time.sleep(max(0.0, begin + seconds - time.monotonic()))
        passed = time.monotonic() - begin
        return Visit([Traffic(passed, dict(client.streams), list(client.late)) for client in clients], sent)
    finally:
        for client in clients:
            client.close()


def _pull(client: Client, until_then: float) -> dict[Point, float]:
    """Drag until then; when each place was sent. No two are the same, so that each can be found again."""
    sent: dict[Point, float] = {}
    grabbed = client.position(LINK) + np.array([0.06, 0.0, 0.0])
    client.drag(LINK, "start", grabbed, grabbed)
    due = begin = time.monotonic()
    while due < until_then:
        offset = PULL * np.sin(2.0 * np.pi * (due - begin) / PERIOD)
        x, y, z = (grabbed + np.array([1e-7 * len(sent), offset, 0.0])).tolist()
        sent[x, y, z] = time.monotonic()
        client.drag(LINK, "update", grabbed, (x, y, z))
        due += UPDATE
        time.sleep(max(0.0, due - time.monotonic()))
    client.drag(LINK, "end", grabbed, grabbed)
    return sent
