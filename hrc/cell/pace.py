"""How fast the cell runs against the wall clock. The only reader of that clock in the library."""

import time
from collections.abc import Callable
from typing import Protocol


class Pacer(Protocol):
    """Says how many ticks are due."""

    def steps_due(self) -> int:
        """Ticks to run now; may wait a moment before it answers, and may answer 0."""
        ...


class FreeRun:
    """As fast as it can: headless."""

    def __init__(self, batch: int = 50) -> None:
        self._batch = batch

    def steps_due(self) -> int:
        """Always a batch."""
        return self._batch


class RealTime:
    """Keeps to the wall clock: makes good what it is late by, smoothly, drops what is too much and says so; never stretches a
    tick.

    A contact costs twice as much as free motion. On a slow machine the cell falls behind in it, and catches up after it: a
    little faster than asked for, which nobody sees, where all at once would be a leap of the arm.

    factor: the real-time factor achieved lately (0 while paused). capped: whether time was dropped lately.
    """

    LATE_S = 1.0
    """What is made good at most; the rest is dropped."""
    AT_ONCE_S = 0.05
    """Of that without delay: what a machine with other things to do is late by all the time."""
    FASTER = 1.25
    """How many times as fast as asked for it makes good the rest."""
    BURST = 10
    """At most so many ticks at once, however late it is: a pause takes hold after them."""
    NAP_S = 0.003
    """How long it waits when nothing is due [s]: a core that is woken for each tick anew does it with empty caches, and takes
    half as long again for the same."""
    WINDOW_S = 1.0

    def __init__(self, base_hz: int = 1000, speed: float = 1.0, *, now: Callable[[], float] = time.perf_counter,
                 sleep: Callable[[float], None] = time.sleep) -> None:
        self.speed = speed
        self.paused = False
        self.factor = 0.0
        self.capped = False
        self._base_hz, self._now, self._sleep = base_hz, now, sleep
        self._last = now()
        self._owed = self._allowed = 0.0
        self._steps_asked = 0
        self._window_start, self._window_steps, self._window_dropped = self._last, 0, False

    def step_once(self, n_ticks: int) -> None:
        """Run this many ticks although paused."""
        self._steps_asked += n_ticks

    def steps_due(self) -> int:
        """The ticks that the time since the last call is worth; waits a little when there are none."""
        now = self._now()
        passed, self._last = max(0.0, now - self._last), now  # a clock may be set back
        if self.paused:
            self._owed = self._allowed = 0.0
            due, self._steps_asked = self._steps_asked, 0
        else:
            asked, scale = passed * self.speed, max(1.0, self.speed)
            self._owed += asked
            if self._owed > self.LATE_S * scale:
                self._owed, self._window_dropped = self.LATE_S * scale, True
            self._allowed = min(self._allowed + self.FASTER * asked, self.AT_ONCE_S * scale)
            due = min(int(min(self._owed, self._allowed) * self._base_hz), self.BURST)
            self._owed -= due / self._base_hz
            self._allowed -= due / self._base_hz
        self._count(now, due)
        if due == 0:
            self._sleep(self.NAP_S)
        return due

    def _count(self, now: float, due: int) -> None:
        self._window_steps += due
        elapsed = now - self._window_start
        if elapsed >= self.WINDOW_S:
            self.factor = self._window_steps / self._base_hz / elapsed
            self.capped = self._window_dropped
            self._window_start, self._window_steps, self._window_dropped = now, 0, False
