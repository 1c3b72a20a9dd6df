"""The process that the cell has to itself: nothing that a page does takes the interpreter away from it.

Here run the cell's thread, the recording, and two more: one takes the calls of the page, one sends it a pulse for each picture
that it draws. When the page has gone, however that happened, the recording is closed and the process ends.
"""

import contextlib
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from app.record.archive import Archive
from app.serve.heap import Holes
from app.serve.mailbox import ForcePoint, Mailbox
from app.serve.session import Session
from app.serve.wire import Answer, Call, CutError, Link, Over, Pulse, Said, State, Wire, slim
from hrc.cell.run import Observer
from hrc.config import Config
from hrc.errors import HrcError
from hrc.events import Event, Release
from hrc.messages import Snapshot

PULSES = 30
"""A second, while nobody looks; else as many as the page draws pictures."""
IMAGES_EVERY = 2
"""Of so many pulses one has images, which is as often as the page draws points."""
SIGN, SILENT = 0.5, 2.0
"""How often the page gives a sign of life, and without one for how long the arm is let go [s]."""
SWITCH = 0.0005
"""For how long a thread may keep the interpreter to itself [s]. The cell gives it up some times in each tick of 1 ms, for
MuJoCo and for each kernel, and would wait ten times as long by default until whoever took it meanwhile gives it back.
"""
URGENT = -8
"""Added to the niceness of the process, where the system lets it: the cell is due at each tick, pictures can wait."""


class Witness(Observer, Protocol):
    """Sees every snapshot where the cell is, and answers questions about it: its public methods, by name."""


@dataclass(frozen=True)
class Order:
    """What the process is made for. settings, seed, device: as of `Session`. recordings: their folder. witness: makes one."""

    recordings: Path
    device: str = "cpu"
    settings: tuple[tuple[str, Any], ...] = ()
    seed: int = 0
    witness: Callable[[], Witness] | None = None


def main(connection: Link) -> None:
    """Serve the page at the other end, which sends its order first, until it says so, has gone, or this process is to end."""
    sys.setswitchinterval(SWITCH)
    with contextlib.suppress(PermissionError):  # whoever is not root needs RLIMIT_NICE for it (`ulimit -e 28`)
        os.nice(URGENT)
    wire = Wire(connection)
    try:
        order = wire.receive()
    except CutError:  # there will be no page
        return
    told: list[int] = []  # an Event would lock up when a second signal comes in the middle of the first one's set()
    signal.signal(signal.SIGTERM, lambda number, _: told.append(number))
    host = Host(wire, order)
    threading.excepthook = host.broken
    host.start()
    while not told and not host.over.wait(0.1):
        host.mind_the_page()
    host.close()


class Host:
    """Cell, recording, and what the page hears of them. over: the page needs it no more."""

    def __init__(self, wire: Wire, order: Order) -> None:
        self.over, self._holes = threading.Event(), Holes()
        self._wire, self._mailbox = wire, Mailbox()
        self._archive = Archive(order.recordings, order.device)
        self._archive.over = lambda told: self._tell(Over(told))
        self._witness = order.witness() if order.witness is not None else None
        watchers: Sequence[Observer] = (self._archive, *filter(None, [self._witness]))
        self._session = Session(self._mailbox, device=order.device, settings=dict(order.settings), seed=order.seed,
                                say=lambda line: self._tell(Said(line)), observers=watchers)
        self._begun, self._heard, self._looked = False, 0, 0
        self._heard_at = time.monotonic()
        self._config: Config | None = None
        self._sent: Snapshot | None = None
        self._plotted: ForcePoint | None = None
        self._images_at, self._whole = 0.0, False

    def start(self) -> None:
        """Listen, and tell."""
        self._holes.start()
        for act, name in ((self._listen, "calls"), (self._beat, "pulses")):
            threading.Thread(target=act, name=name, daemon=True).start()

    def mind_the_page(self) -> None:
        """Let go of the arm when the page stands still: nobody there can."""
        latest = self._mailbox.latest
        if latest is not None and latest.pull is not None and time.monotonic() - self._heard_at > SILENT:
            self._put(Release())

    def close(self) -> None:
        """Stop the cell, then finish its recording."""
        self.over.set()
        self._session.close()
        self._archive.close()
        self._holes.close()

    def broken(self, failure: "threading.ExceptHookArgs") -> None:
        """A thread has failed: told at the terminal and to the page."""
        traceback.print_exception(failure.exc_type, failure.exc_value, failure.exc_traceback, file=sys.stderr)
        name = failure.thread.name if failure.thread is not None else "?"
        self._tell(Said(f'thread "{name}" of the cell failed ({failure.exc_type.__name__}: {failure.exc_value})'))

    # -- what the page wants ----------------------------------------------------------------------------------------

    def _listen(self) -> None:
        acts: Mapping[str, Callable[..., Any]] = {
            "open": self._open, "put": self._put, "reset": self._reset, "pause": self._pause, "step": self._session.step,
            "speed": self._speed, "watched": self._watch, "record": self._archive.start, "end": self._archive.stop,
            "warm": self._archive.warm, "ask": self._ask, "leave": self.over.set}
        try:
            while True:
                call: Call = self._wire.receive()
                self._heard_at = time.monotonic()
                if call.answer:  # it may take a second, and a Stop after it must not wait
                    threading.Thread(target=self._answer, args=(call, acts[call.what]), name=call.what, daemon=True).start()
                else:
                    acts[call.what](*call.arguments)
                self._heard = call.number
        except CutError:
            pass
        finally:  # without its ears the cell must not go on
            self.over.set()

    def _answer(self, call: Call, act: Callable[..., Any]) -> None:
        try:
            answer = Answer(call.number, act(*call.arguments))
        except Exception as error:  # it belongs to whoever has asked
            answer = Answer(call.number, error=error)
        self._tell(answer)

    def _open(self, name: str) -> None:
        self._session.open(name) if self._begun else self._session.start(name)
        self._begun = True

    def _put(self, event: Event) -> None:
        try:
            self._session.put(event)
        except HrcError as error:  # the cell has ended since the page put it
            self._mailbox.refuse(event, str(error))

    def _reset(self) -> None:
        try:
            self._session.reset()
        except HrcError as error:
            self._tell(Said(f"not reset: {error}"))

    def _pause(self, paused: bool) -> None:
        self._session.paused = paused

    def _speed(self, speed: float) -> None:
        self._session.speed = speed

    def _watch(self, hz: int) -> None:
        self._looked = hz

    def _ask(self, what: str) -> Any:
        return getattr(self._witness, what)()

    # -- what it hears ----------------------------------------------------------------------------------------------

    def _beat(self) -> None:
        due = time.monotonic()
        while not self.over.wait(max(0.0, due - time.monotonic())):
            due = max(due + 1.0 / (self._looked or PULSES), time.monotonic())
            try:
                self._wire.send_made(self._pulse)
            except CutError:
                self.over.set()

    def _pulse(self) -> Pulse:
        heard = self._heard
        notes = tuple(self._mailbox.take_notes())
        forces, begun = self._fresh_forces()
        latest = self._mailbox.latest  # after the notes: what they tell of has happened in it
        config = self._session.config if self._session.config is not self._config else None
        self._config = self._session.config
        same, images, shown = latest is self._sent, False, None
        if latest is not None and (not same or (self._looked and not self._whole)):
            images = self._images_due(latest)
            shown, same = slim(latest, images=images), False
            self._whole = images
        self._sent = latest
        return Pulse(heard, self._state(), config, notes, forces, begun, shown, same, images, self._archive.now)

    def _images_due(self, snapshot: Snapshot) -> bool:
        """Whether this snapshot is sent with its images."""
        now = time.monotonic()
        none = any(view.frame is None for view in snapshot.views)
        if none or (self._looked and now >= self._images_at):
            gap = IMAGES_EVERY / (self._looked or PULSES)
            self._images_at = max(self._images_at + gap, now - 0.5 * gap)
            return True
        return False

    def _state(self) -> State:
        s = self._session
        return State(s.status, s.paused, s.speed, s.factor, s.capped, s.silence, s.stages())

    def _fresh_forces(self) -> tuple[tuple[ForcePoint, ...], bool]:
        """The points of the plot that have not been sent, and whether those before are over."""
        points = self._mailbox.forces()
        known = next((i for i in range(len(points) - 1, -1, -1) if points[i] is self._plotted), None)
        begun = known is None and self._plotted is not None
        fresh = points if known is None else points[known + 1 :]
        self._plotted = points[-1] if points else None
        return tuple(fresh), begun

    def _tell(self, message: object) -> None:
        try:
            self._wire.send(message)
        except CutError:
            self.over.set()
