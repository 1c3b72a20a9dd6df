"""How long the stages of the cell take: each step is timed as a whole, and told apart by what was due in it."""

import time
from collections.abc import Callable, Mapping
from typing import TypeVar

from hrc.cell.cell import Cell
from hrc.cell.clock import Rate
from hrc.config import Config
from hrc.executor import Beside, Pending
from hrc.messages import Snapshot

T = TypeVar("T")
MEMORY = 0.05
"""Weight of the newest time in the running mean."""
ROBOT, CAMERA, LOCALIZE, CONTROL = "robot", "camera", "localize", "control"
"""The plant's tick; render, noise and filter of the frames; distances and contact points; Eq. (2) to (15)."""


class Rendering(Beside):
    """Renders for one cell after the other. seconds: what a frame takes lately."""

    seconds = 0.0

    def do(self, job: Callable[[], T], /) -> Pending[T]:
        """Take a job, and time it."""
        return super().do(lambda: self._timed(job))

    def _timed(self, job: Callable[[], T]) -> T:
        begun = time.perf_counter()
        result = job()
        took = time.perf_counter() - begun
        self.seconds += (MEMORY if self.seconds else 1.0) * (took - self.seconds)
        return result


class TimedCell(Cell):
    """A cell whose steps are timed; with `rendering`, its cameras render beside it.

    A step in which one stage was due with the robot gives that stage's time, by what it takes longer than the robot alone;
    steps with more tell nothing apart, and are left out.
    """

    def __init__(self, config: Config, device: str, rendering: Rendering | None) -> None:
        self._rendering = rendering
        super().__init__(config, device, rendering)
        rates = config.rates
        hz = {CAMERA: rates.camera_hz, LOCALIZE: rates.localize_hz, CONTROL: rates.control_hz}
        self._stages = {stage: Rate(each, rates.base_hz) for stage, each in hz.items()}
        self._hz = {ROBOT: rates.base_hz, **hz}
        self._mean: dict[str, float] = {}

    def step(self) -> Snapshot:
        """One tick."""
        begun = time.perf_counter()
        snapshot = super().step()
        self._note(snapshot, time.perf_counter() - begun)
        return snapshot

    def stages(self) -> Mapping[str, tuple[float, float]]:
        """Stage -> time of one run of it [s], and its part of a core at its rate; those that could be told so far."""
        robot = self._mean.get(ROBOT, 0.0)
        each = {stage: max(0.0, mean - (0.0 if stage == ROBOT else robot)) for stage, mean in list(self._mean.items())}
        if CAMERA in each and self._rendering is not None:
            each[CAMERA] += self._rendering.seconds
        return {stage: (each[stage], each[stage] * self._hz[stage]) for stage in self._hz if stage in each}

    def _note(self, snapshot: Snapshot, took: float) -> None:
        due = [stage for stage, rate in self._stages.items() if rate.due(snapshot.tick)]
        if snapshot.fresh_frame and CAMERA not in due:  # a frame came in between two exposures
            due.append(CAMERA)
        if len(due) < 2:
            stage = due[0] if due else ROBOT
            mean = self._mean.get(stage, took)
            self._mean[stage] = mean + MEMORY * (took - mean)
