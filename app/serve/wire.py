"""What the page's process and the cell's tell each other: objects, in order, and none is lost.

Both are this program, started by the same person: what comes is trusted, and pickled. Images go beside the pickle, uncopied.
"""

import pickle
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from app.record.shelf import Progress
from app.serve.driver import Status
from app.serve.mailbox import ForcePoint, Note
from hrc.config import Config
from hrc.messages import Snapshot, View

LARGE = 1 << 16
"""From here on a piece of memory goes beside the pickle [bytes]."""


class CutError(Exception):
    """The other process has gone."""


@dataclass(frozen=True, slots=True)
class Call:
    """Of the page: do this. number: counts them. answer: whether it waits for an `Answer`."""

    number: int
    what: str
    arguments: tuple[Any, ...] = ()
    answer: bool = False


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of a call; error: what it raised instead."""

    number: int
    result: Any = None
    error: Exception | None = None


@dataclass(frozen=True, slots=True)
class Said:
    """A line for the terminal."""

    line: str


@dataclass(frozen=True, slots=True)
class Over:
    """A recording has ended by itself, and why."""

    told: str


@dataclass(frozen=True, slots=True)
class State:
    """Of the cell, as in `Driver`. silence: at the time when it was sent [s]."""

    status: Status
    paused: bool
    speed: float
    factor: float
    capped: bool
    silence: float
    stages: Mapping[str, tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Pulse:
    """What is new since the pulse before, up to thirty times a second.

    heard: number of the last call that had been taken. config: of another cell. notes, forces: all of them; begun: the forces
    before these are to be forgotten. snapshot: the latest, if there is one, and if it is not still the one before, which is
    `same`. images: whether its views have theirs; else they are those before. recording: the one that is being made.
    """

    heard: int
    state: State
    config: Config | None
    notes: tuple[Note, ...]
    forces: tuple[ForcePoint, ...]
    begun: bool
    snapshot: Snapshot | None
    same: bool
    images: bool
    recording: Progress | None


class Link(Protocol):
    """One end of a `multiprocessing.Pipe`."""

    def send_bytes(self, buf: Any, /) -> None:
        """A message."""
        ...

    def recv_bytes(self) -> bytes:
        """The next one."""
        ...

    def close(self) -> None:
        """Hang up."""
        ...


class Wire:
    """One end of the connection. Any thread may send, one receives."""

    def __init__(self, connection: Link) -> None:
        self._connection = connection
        self._sending = threading.RLock()

    def send(self, message: object) -> None:
        """To the other end; waits while that is behind. Raises CutError if it has gone."""
        beside: list[pickle.PickleBuffer] = []

        def keeps(buffer: pickle.PickleBuffer) -> bool:
            if buffer.raw().nbytes < LARGE:
                return True
            beside.append(buffer)
            return False

        told = pickle.dumps(message, pickle.HIGHEST_PROTOCOL, buffer_callback=keeps)
        try:
            with self._sending:
                self._connection.send_bytes(len(beside).to_bytes(2, "little") + told)
                for buffer in beside:
                    self._connection.send_bytes(buffer.raw())
        except OSError:
            raise CutError from None

    def send_made(self, make: Callable[[], object]) -> None:
        """Make a message and send it before any other can be: so it tells nothing that is over when it is read."""
        with self._sending:
            self.send(make())

    def receive(self) -> Any:
        """The next message; waits for it. Raises CutError if the other end has gone."""
        try:
            told = memoryview(self._connection.recv_bytes())
            beside = [self._connection.recv_bytes() for _ in range(int.from_bytes(told[:2], "little"))]
        except (EOFError, OSError):
            raise CutError from None
        return pickle.loads(told[2:], buffers=beside)

    def close(self) -> None:
        """Hang up."""
        self._connection.close()


def slim(snapshot: Snapshot, *, images: bool) -> Snapshot:
    """What the page needs of a snapshot; without images its views tell only where cameras stand and whether they are silent."""
    views = snapshot.views if images else tuple(
        View(view.camera, silent=view.silent, T_world_camera=view.T_world_camera) for view in snapshot.views)
    return replace(snapshot, exposed=None, views=views)


def with_images(snapshot: Snapshot, before: Snapshot | None, *, own: bool) -> Snapshot:
    """A snapshot that has come, with its own images or with those of the one before.

    Where a camera stands as it stood it is the same array, which tells whoever draws that nothing has moved.
    """
    old = {view.camera: view for view in before.views} if before is not None else {}
    return replace(snapshot, views=tuple(_merged(view, old.get(view.camera, view), own=own) for view in snapshot.views))


def _merged(view: View, old: View, *, own: bool) -> View:
    T, shown = view.T_world_camera, view if own else old
    if T is not None and old.T_world_camera is not None and np.array_equal(T, old.T_world_camera):
        T = old.T_world_camera
    return View(view.camera, shown.frame, shown.foreground, shown.robot_image, view.silent, T)
