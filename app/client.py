"""A client that speaks the page's wire format without a browser: for measurements, soaks and tests.

Server to client: two uint64 (plain and compressed length), zstd of msgpack {messages, binaryBufferLengths}, then raw
buffers aligned to 8 bytes. Client to server: one msgpack map per message. The subprotocol names viser's version, and a
client counts as connected only after its first camera message.
"""

import asyncio
import contextlib
import re
import struct
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
import viser
import websockets.asyncio.client as websockets_client
import websockets.exceptions
import zstandard
from numpy.typing import ArrayLike
from websockets.typing import Subprotocol

CAMERA = {"type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (1.0, 1.0, 1.0), "fov": 1.0,
          "near": 0.01, "far": 100.0, "image_height": 600, "image_width": 800, "look_at": (0.0, 0.0, 0.0),
          "up_direction": (0.0, 0.0, 1.0)}

PATIENCE = 60.0
"""How long what must come is waited for [s]: a page among others on two slow cores is a minute late at times."""
ELSEWHERE = 15
"""Niceness of a process of clients: they stand for people at machines of their own."""


def unpack(raw: bytes) -> tuple[list[dict[str, Any]], list[int], int]:
    """The messages of one frame, the sizes of the arrays that follow them, and how many bytes the messages take in it."""
    length, compressed = struct.unpack_from("<QQ", raw, 0)
    packed = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + compressed], max_output_size=length)
    body = msgspec.msgpack.decode(packed)
    return body["messages"], body["binaryBufferLengths"], 16 + compressed


def decode(raw: bytes) -> list[dict[str, Any]]:
    """The messages of one frame, arrays as numpy."""
    messages, lengths, offset = unpack(raw)
    starts = []
    for size in lengths:
        offset += -offset % 8
        starts.append(offset)
        offset += size

    def restored(value: Any) -> Any:
        if isinstance(value, dict) and "__binary_index" in value:
            index, dtype = value["__binary_index"], np.dtype(value["dtype"])
            return np.frombuffer(raw, dtype, lengths[index] // dtype.itemsize, starts[index])
        if isinstance(value, dict):
            return {key: restored(entry) for key, entry in value.items()}
        return [restored(entry) for entry in value] if isinstance(value, list) else value

    return [restored(message) for message in messages]


class Client:
    """Keeps `gui` (uuid -> message) and `nodes` (name -> properties) as a browser would.

    alive: answers pings. ahead: frames that are received before they are taken.
    """

    def __init__(self, port: int, *, path: str = "/", origin: str | None = None, headers: dict[str, str] | None = None,
                 camera: bool = True, ahead: int = 16) -> None:
        self.gui: dict[str, dict[str, Any]] = {}
        self.nodes: dict[str, dict[str, Any]] = {}
        self.commands: dict[str, str] = {}
        self.bytes = 0
        self.alive = True
        self.ready, self.closed = threading.Event(), threading.Event()
        self.close_code: int | None = None
        self._connect: dict[str, Any] = {
            "uri": f"ws://127.0.0.1:{port}{path}", "origin": origin, "additional_headers": headers, "max_queue": ahead}
        self._camera = camera
        self._socket: Any = None
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_until_complete, args=(self._main(),), daemon=True).start()

    async def _main(self) -> None:
        try:
            protocol = Subprotocol(f"viser-v{viser.__version__}")
            async with websockets_client.connect(subprotocols=[protocol], max_size=None, compression=None,
                                                 **self._connect) as self._socket:
                if self._camera:
                    await self._socket.send(msgspec.msgpack.encode(CAMERA))
                while True:  # `async for` would leave its generator half way when an answer finds the line torn
                    raw = await self._socket.recv()
                    self.bytes += len(raw)
                    await self.take_frame(raw)
        except (OSError, websockets.exceptions.WebSocketException):
            pass
        except AttributeError:  # asyncio, of a transport that was closed in the middle of a large message
            if not self._socket.transport.is_closing():
                raise
        finally:
            self.close_code = getattr(self._socket, "close_code", None)
            self.closed.set()

    async def take_frame(self, raw: bytes) -> None:
        """What came in one frame."""
        for message in decode(raw):
            await self._take(message)

    async def _take(self, message: dict[str, Any]) -> None:
        kind, props, name = message["type"], message.get("props"), message.get("name")
        if kind == "ReplayDoneMessage":
            self.ready.set()
        elif kind == "LocalStorageGetItemRequestMessage" and self.alive:
            await self._socket.send(msgspec.msgpack.encode({
                "type": "LocalStorageGetItemResponseMessage", "value": None, "error": None,
                "request_uuid": message["request_uuid"]}))
        elif kind == "RegisterCommandMessage":
            self.commands[message["props"]["label"]] = message["uuid"]
        elif kind == "GuiUpdateMessage":
            widget = self.gui.setdefault(message["uuid"], {"props": {}})
            for key, value in message["updates"].items():
                (widget if key == "value" else widget["props"])[key] = value
        elif kind.startswith("Gui") and "uuid" in message and props is not None:
            self.gui[message["uuid"]] = message
        elif kind == "SceneNodeUpdateMessage":
            self.nodes.setdefault(message["name"], {}).update(message["updates"])
        elif kind in ("SetPositionMessage", "SetOrientationMessage", "SetSceneNodeVisibilityMessage"):
            self.nodes.setdefault(message["name"], {}).update(message)
        elif name is not None and props is not None:
            self.nodes.setdefault(name, {}).update(props)

    def send(self, message: dict[str, Any] | bytes | str) -> None:
        """One message; a dict is packed, anything else goes as it is. Raises ConnectionError when it is closed."""
        data = msgspec.msgpack.encode(message) if isinstance(message, dict) else message
        sent = asyncio.run_coroutine_threadsafe(self._socket.send(data), self._loop)
        until(lambda: sent.done() or self.closed.is_set(), 5.0, pause=0.0)
        if not sent.done():
            sent.cancel()
        if sent.cancelled() or sent.exception() is not None:
            raise ConnectionError("the server has closed the connection")

    def close(self) -> None:
        """Leave."""
        if self._socket is not None:
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(lambda: self._loop.create_task(self._socket.close()))
        self.closed.wait(2.0)

    def tear(self) -> None:
        """Leave without a goodbye, as when the line breaks."""
        self._loop.call_soon_threadsafe(self._socket.transport.abort)

    def freeze(self, thawed: threading.Event) -> None:
        """Until it thaws, read nothing and answer nothing, but do not go away."""
        self._loop.call_soon_threadsafe(thawed.wait)

    # -- widgets

    def widget(self, label: str) -> str:
        """The uuid of a widget by its label. Raises KeyError."""
        for uuid, widget in list(self.gui.items()):
            if widget.get("props", {}).get("label") == label:
                return uuid
        raise KeyError(label)

    def value(self, label: str) -> Any:
        """A widget's value."""
        return self.gui[self.widget(label)].get("value")

    def set(self, label: str, value: Any) -> None:
        """Choose a value, as a visitor would."""
        uuid = self.widget(label)
        self.gui[uuid]["value"] = value  # the server tells the others, not the one who chose
        self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})

    def click(self, label: str) -> None:
        """Press a button."""
        self.set(label, True)

    def banner(self) -> dict[str, str]:
        """The banner's data attributes. Raises KeyError before there is one."""
        for widget in list(self.gui.values()):
            content = str(widget.get("props", {}).get("content", ""))
            if 'id="eb-banner"' in content:
                return dict(re.findall(r'data-(\w+)="([^"]*)"', content))
        raise KeyError("banner")

    def seat(self) -> dict[str, str]:
        """What this visitor is told about who drives: role, visitor, operator, asking; and trip, of its line [ms].

        Raises KeyError before that.
        """
        for widget in list(self.gui.values()):
            content = str(widget.get("props", {}).get("content", ""))
            if 'id="eb-seat"' in content:
                return dict(re.findall(r'data-(\w+)="([^"]*)"', content))
        raise KeyError("seat")

    def drives(self) -> bool:
        """Whether it is the operator."""
        return self.seat()["role"] == "operator"

    def hand_back(self) -> None:
        """Give up the seat."""
        self.click("Release control")
        until(lambda: not self.drives())

    def text(self) -> str:
        """All HTML on the page."""
        return " ".join(str(w.get("props", {}).get("content", "")) for w in list(self.gui.values()))

    # -- scene

    def position(self, name: str) -> np.ndarray:
        """Where a scene node is [m] (3,). Raises KeyError."""
        return np.array(self.nodes[name]["position"], float)

    def drag(self, name: str, phase: str, start: ArrayLike, end: ArrayLike, modifier: str | None = None) -> None:
        """A phase of a left-button drag of a scene node, positions in the world [m]."""
        self.send({"type": "SceneNodeDragMessage", "phase": phase, "name": name, "instance_index": None,
                   "start_position": np.asarray(start, float).tolist(), "start_screen_pos": [0.5, 0.5],
                   "end_position": np.asarray(end, float).tolist(), "end_screen_pos": [0.5, 0.5], "button": "left",
                   "modifier": modifier, "owner": ""})

    def gizmo(self, name: str, position: Sequence[Any], wxyz: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> None:
        """Move a gizmo."""
        self.send({"type": "TransformControlsUpdateMessage", "name": name, "wxyz": list(wxyz),
                   "position": list(position), "owner": ""})

    def wait(self, condition: Callable[[], Any], timeout: float = PATIENCE) -> None:
        """Until the condition holds; what is not there yet counts as no."""
        until(condition, timeout)


def until(condition: Callable[[], Any], timeout: float = PATIENCE, pause: float = 0.01) -> None:
    """Wait for a condition, at most so long [s]. Raises TimeoutError; a KeyError inside counts as not yet."""
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        with contextlib.suppress(KeyError):
            if condition():
                return
        time.sleep(pause)
    raise TimeoutError("the condition did not become true")
