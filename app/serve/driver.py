"""The cell as the page knows it, whichever process it runs in."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from hrc.config import Config
from hrc.errors import HrcError
from hrc.events import Event

HANGS, BUILDS = 10.0, 120.0
"""For how long the cell may give no sign of life: while it runs, and while one is built [s]."""


class Phase(StrEnum):
    """Of the cell; while it is running, the arm's own mode says more."""

    STARTING = "starting"
    RUNNING = "running"
    FAILED = "failed"
    CLOSED = "closed"


@dataclass(frozen=True)
class Status:
    """The phase, and a line about it for the banner."""

    phase: Phase
    text: str = ""

    def well(self, silence: float) -> bool:
        """Whether a cell in this phase may give no sign of life for so long [s]."""
        return silence < {Phase.STARTING: BUILDS, Phase.RUNNING: HANGS}.get(self.phase, 0.0)

    @property
    def refusal(self) -> HrcError:
        """What an event is refused with while no cell runs."""
        return HrcError(f"the cell is not running ({self.text})")


STOPPED = Status(Phase.STARTING, "stopped: the arm will stand still until Resume")
"""Of a cell that is still being built when a Stop comes."""


class Driver(Protocol):
    """Runs a cell in real time, one scenario after another."""

    config: Config | None
    """The running cell's, at its start; None before the first."""
    scenario: str
    """The one asked for last."""

    @property
    def paused(self) -> bool:
        """Whether simulated time stands still."""
        ...

    @paused.setter
    def paused(self, paused: bool, /) -> None: ...

    @property
    def speed(self) -> float:
        """Simulated seconds per second that are asked for."""
        ...

    @speed.setter
    def speed(self, speed: float, /) -> None: ...

    @property
    def status(self) -> Status:
        """The phase, and a line about it."""
        ...

    @property
    def factor(self) -> float:
        """Simulated seconds per second that are reached."""
        ...

    @property
    def capped(self) -> bool:
        """Whether the machine is too slow: steps are dropped, and enough of them to see."""
        ...

    @property
    def silence(self) -> float:
        """For how long the cell has given no sign of life [s]; it does so with each step, or while there is none to take."""
        ...

    @property
    def healthy(self) -> bool:
        """Whether the cell has given a sign of life lately, paused or not, and has not failed."""
        ...

    def start(self, name: str) -> None:
        """Begin with a scenario."""
        ...

    def open(self, name: str) -> None:
        """Leave the running cell and start another with this scenario."""
        ...

    def close(self) -> None:
        """Stop stepping for good."""
        ...

    def put(self, event: Event) -> None:
        """An event for the next step. Raises HrcError while no cell runs.

        A Stop for a cell that is still being built waits for it: the arm stands from its first step on.
        For a Stop, Resume or Reset a paused cell takes one control cycle, so that it takes hold at once.
        """
        ...

    def reset(self) -> None:
        """Back to the start of the scenario; a cell that failed is made anew."""
        ...

    def watch(self, hz: int) -> None:
        """How often somebody looks at the cell [Hz]; 0: nobody does."""
        ...

    def step(self, ticks: int) -> None:
        """Pause, and take so many steps."""
        ...

    def stages(self) -> Mapping[str, tuple[float, float]]:
        """Of each stage of the cell the time of one run [s], and its part of a core."""
        ...
