"""Where the cell's thread leaves what the page shows: the latest snapshot, and whatever must not be lost in between."""

import math
import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from hrc.events import Event
from hrc.messages import Mode, Snapshot

PLOT_PERIOD = 0.1
"""Simulated time between two points of the force plot [s]."""
PLOT_POINTS = 300


@dataclass(frozen=True)
class Note:
    """Something for the log: an event that was applied, one that was refused (and why), a new mode (and why), or, as text, what
    broke the cell."""

    time: float
    subject: Event | Mode | str
    refused: str = ""
    reason: str = ""


@dataclass(frozen=True)
class ForcePoint:
    """The largest |F| [N] since the point before, estimated and true: a peak between two points is not lost."""

    time: float
    estimate: float
    truth: float


class Mailbox:
    """An observer of the cell. `on_step` runs at the base rate in the cell's thread, so it does next to nothing."""

    def __init__(self) -> None:
        self.latest: Snapshot | None = None
        self._lock = threading.Lock()
        self._notes: deque[Note] = deque(maxlen=1000)
        self._forces: deque[ForcePoint] = deque(maxlen=PLOT_POINTS)
        self._mode: Mode | None = None
        self._estimate = self._truth = 0.0
        self._next_point = 0.0

    def clear(self) -> None:
        """Forget everything: another cell is about to start."""
        with self._lock:
            self.latest = None
            self._notes.clear()
            self._restart()

    def on_step(self, snapshot: Snapshot) -> None:
        """Keep the snapshot; note its events, refusals, change of mode and force."""
        before, self.latest = self.latest, snapshot
        mode = snapshot.command.mode
        if mode is not self._mode or snapshot.events or snapshot.refused:
            with self._lock:
                self._notes.extend(Note(snapshot.time, event) for event in snapshot.events)
                self._notes.extend(Note(snapshot.time, event, str(why)) for event, why in snapshot.refused)
                if mode is not self._mode:
                    self._notes.append(Note(snapshot.time, mode, reason=snapshot.command.reason))
                    self._mode = mode
        if before is not None and snapshot.tick < before.tick:  # a Reset
            with self._lock:
                self._restart()
        if snapshot.fresh_control:
            self._feel(snapshot)

    def fail(self, events: Iterable[Event], what: str) -> None:
        """Note the end of the cell in the step after the latest snapshot. events: those of that step, which it cannot tell."""
        time = self.latest.time if self.latest is not None else 0.0
        with self._lock:
            self._notes.extend(Note(time, event) for event in events)
            self._notes.append(Note(time, what))

    def refuse(self, event: Event, why: str) -> None:
        """Note an event that came when no cell could take it."""
        with self._lock:
            self._notes.append(Note(self.latest.time if self.latest is not None else 0.0, event, why))

    def deliver(self, notes: Iterable[Note], forces: Iterable[ForcePoint], latest: Snapshot | None, *, begun: bool) -> None:
        """Keep what another process tells. begun: the force plot starts anew with these points."""
        with self._lock:
            if begun:
                self._forces.clear()
            self._notes.extend(notes)
            self._forces.extend(forces)
        self.latest = latest

    def take_notes(self) -> list[Note]:
        """What happened since the last call."""
        with self._lock:
            notes = list(self._notes)
            self._notes.clear()
        return notes

    def forces(self) -> list[ForcePoint]:
        """The last half minute of force."""
        with self._lock:
            return list(self._forces)

    def _feel(self, snapshot: Snapshot) -> None:
        F_true, contact = snapshot.truth.F_world, snapshot.contact
        self._truth = max(self._truth, math.sqrt(F_true @ F_true))
        if contact is not None:
            self._estimate = max(self._estimate, math.sqrt(contact.F_world @ contact.F_world))
        if snapshot.time >= self._next_point:
            with self._lock:
                self._forces.append(ForcePoint(snapshot.time, self._estimate, self._truth))
            self._estimate = self._truth = 0.0
            self._next_point = snapshot.time + PLOT_PERIOD

    def _restart(self) -> None:
        self._forces.clear()
        self._mode = None
        self._estimate = self._truth = self._next_point = 0.0
