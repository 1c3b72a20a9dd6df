"""The one driver of a cell: headless, live and replay."""

from collections import deque
from collections.abc import Callable, Iterable
from typing import Protocol

from hrc.cell.pace import Pacer
from hrc.cell.scenario import Scenario
from hrc.errors import HrcError
from hrc.events import Event, Reset
from hrc.messages import Snapshot


class Observer(Protocol):
    """Sees every snapshot; must return quickly and never blocks on disk, network or encoding."""

    def on_step(self, snapshot: Snapshot, /) -> None:
        """One step has been taken."""
        ...


class Steps(Protocol):
    """What is driven: a `Cell`, or something around one."""

    @property
    def tick(self) -> int:
        """Ticks since the start, or the last Reset."""
        ...

    def step(self) -> Snapshot:
        """One tick."""
        ...

    def apply(self, event: Event) -> None:
        """Take an event before the next step."""
        ...

    def refuse(self, event: Event, reason: str) -> None:
        """Note an event that was not taken."""
        ...


class Source(Protocol):
    """Where events come from: an `Inbox`, or a `Record`."""

    def take(self, tick: int) -> list[Event]:
        """Everything due before the step that follows `tick`, in order."""
        ...


class Inbox:
    """Events on their way to the cell: those of a scenario at their ticks, and those anybody puts, from any thread."""

    def __init__(self, script: Scenario | None = None, base_hz: int = 1000) -> None:
        self._scripted: dict[int, list[Event]] = {}
        for time, event in script.events if script is not None else ():
            self._scripted.setdefault(round(time * base_hz), []).append(event)
        self._put: deque[Event] = deque()

    def put(self, event: Event) -> None:
        """Hand in an event for the next tick. Safe from any thread: a deque's append is atomic."""
        self._put.append(event)

    def take(self, tick: int) -> list[Event]:
        """Everything due before the step that follows `tick`: the script's first, then the others in order."""
        due = list(self._scripted.get(tick, ()))
        while self._put:
            due.append(self._put.popleft())
        return due


class Record:
    """The events of an earlier run, each before the step before which it was applied then.

    After a Reset the ticks count from 0 again: what follows it waits for that.
    """

    def __init__(self, events: Iterable[tuple[int, Event]]) -> None:
        """events: (tick, event) in the order in which they were applied."""
        self._left = deque(events)

    def take(self, tick: int) -> list[Event]:
        """The events of this tick up to the next Reset, which is the last then."""
        due: list[Event] = []
        while self._left and self._left[0][0] == tick and not (due and isinstance(due[-1], Reset)):
            due.append(self._left.popleft()[1])
        return due


def run(cell: Steps, pacer: Pacer, inbox: Source, observers: Iterable[Observer], *, until: int,
        stopped: Callable[[], bool] = lambda: False) -> None:
    """Step the cell until its tick is `until`, or `stopped()` says so.

    An event that cannot be is noted in the next snapshot's `refused`, and nothing else happens.
    """
    watchers = tuple(observers)
    while cell.tick < until and not stopped():
        for _ in range(min(pacer.steps_due(), until - cell.tick)):
            due = inbox.take(cell.tick)
            while due:
                event = due.pop(0)
                try:
                    cell.apply(event)
                except HrcError as error:
                    cell.refuse(event, str(error))
                if isinstance(event, Reset):
                    due = inbox.take(cell.tick) + due  # what the script has at tick 0
            snapshot = cell.step()
            for watcher in watchers:
                watcher.on_step(snapshot)
