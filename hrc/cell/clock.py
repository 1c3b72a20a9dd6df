"""Integer time: rates that divide a base rate without drift, and values that become readable late."""

from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

from hrc.errors import ConfigError
from hrc.parameters import Parameters, param

T = TypeVar("T")


@dataclass(frozen=True)
class RatesConfig(Parameters):
    """How often each part of the cell runs."""

    base_hz: int = param(1000, low=200, high=5000, unit="Hz", live=False)
    """Rate of the plant and of its inner servo loop: one tick."""
    control_hz: int = param(200, low=20, high=1000, unit="Hz", live=False)
    """Rate of residual, force estimate and reaction: the paper's robot process, T_c = 5 ms."""
    camera_hz: int = param(30, low=1, high=120, unit="Hz", live=False)
    """Rate of the depth camera."""
    localize_hz: int = param(170, low=1, high=1000, unit="Hz", live=False)
    """Rate of contact localization against the latest frame, with the robot where it is now."""
    localize_latency_s: float = param(0.006, low=0.0, high=0.5, unit="s", live=False)
    """How long a localization takes before the controller can read it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.base_hz % self.control_hz:
            raise ConfigError(f"control_hz must divide base_hz ({self.base_hz}), {self.control_hz} does not")


@dataclass(frozen=True)
class Rate:
    """A part that runs at `hz` on a clock of `base_hz`: at most one tick of jitter, no drift."""

    hz: int
    base_hz: int

    def due(self, tick: int) -> bool:
        """Whether it runs at this tick; true at tick 0."""
        return (tick * self.hz) % self.base_hz < self.hz


class Delayed(Generic[T]):
    """The latest value whose delay has passed."""

    def __init__(self, delay: int) -> None:
        self._delay = delay
        self._waiting: deque[tuple[int, T]] = deque()
        self._latest: T | None = None

    def put(self, tick: int, value: T) -> None:
        """A value that becomes readable `delay` ticks from now."""
        self._waiting.append((tick + self._delay, value))

    def get(self, tick: int) -> T | None:
        """The newest readable value, or None before the first."""
        while self._waiting and self._waiting[0][0] <= tick:
            self._latest = self._waiting.popleft()[1]
        return self._latest
