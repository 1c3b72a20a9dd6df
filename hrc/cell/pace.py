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
    """Keeps to the wall clock: catches up a little, drops the rest and says so; never stretches a tick.

    factor: the real-time factor achieved lately (0 while paused). capped: whether time was dropped lately.
    """

    CATCH_UP_S = 0.2
    BURST = 10
    """At most so many ticks at once, however late it is: a pause takes hold after them."""
    WINDOW_S = 1.0

    def __init__(self, base_hz: int = 1000, speed: float = 1.0, *, now: Callable[[], float] = time.perf_counter,
                 sleep: Callable[[float], None] = time.sleep) -> None:
        self.speed = speed
        self.paused = False
        self.factor = 0.0
        self.capped = False
        self._base_hz, self._now, self._sleep = base_hz, now, sleep
        self._last = now()
        self._owed = 0.0
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
            self._owed = 0.0
            due, self._steps_asked = self._steps_asked, 0
        else:
            self._owed += passed * self.speed
            limit = self.CATCH_UP_S * max(1.0, self.speed)
            if self._owed > limit:
                self._owed, self._window_dropped = limit, True
            due = min(int(self._owed * self._base_hz), self.BURST)
            self._owed -= due / self._base_hz
        self._count(now, due)
        if due == 0:
            self._sleep(0.001)
        return due

    def _count(self, now: float, due: int) -> None:
        self._window_steps += due
        elapsed = now - self._window_start
        if elapsed >= self.WINDOW_S:
            self.factor = self._window_steps / self._base_hz / elapsed
            self.capped = self._window_dropped
            self._window_start, self._window_steps, self._window_dropped = now, 0, False
