"""Open loop: perception, estimation and reaction of a cell on what a robot has measured before, whatever they would command."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.cell.cell import Cell
from hrc.cell.clock import Rate
from hrc.cell.eyes import CameraSetup, Eyes, Sensor, simulated
from hrc.cell.foresight import ForeseenCamera
from hrc.config import Config
from hrc.errors import SensorError
from hrc.events import Event, MoveCamera, MoveTarget, Reset, Resume, SetParameter, SetPosture, SetTask, Stop
from hrc.executor import Beside
from hrc.messages import Body, DepthFrame, Mode, RobotState, Snapshot, Truth
from hrc.scene import Scene
from hrc.sim.depth_camera import SensorConfig

Array = NDArray[np.float64]
OWN_EVENTS = (Reset, Resume, SetParameter, SetPosture, SetTask, MoveCamera, MoveTarget, Stop)
"""Events that concern the cell; the others have already had their effect on the robot."""
Images = Callable[[str, int], NDArray[np.float32]]
"""The depth image [m] (H, W) of a camera, by its name and the step after which it was taken."""


@dataclass(frozen=True)
class Tape:
    """What a robot has measured in n steps of the base rate, and what its cell made of that in m control cycles.

    stamps: tick of each reading (n,); q [rad], dq [rad/s], tau [N m] (n, 7). exposed: by step (from 0), the true poses of the
    links (8, 4, 4) and the obstacles, where a camera took a frame. commands [rad/s] (m, 7), modes (m,), and the truth, where
    known: forces [N], points [m] (m, 3), links, visible (m,).
    """

    stamps: NDArray[np.int64]
    q: Array
    dq: Array
    tau: Array
    exposed: Mapping[int, tuple[Array, tuple[Body, ...]]]
    commands: Array
    modes: NDArray[np.str_]
    forces: Array
    points: Array
    links: NDArray[np.int64]
    visible: NDArray[np.bool_]


class PlayedCell(Cell):
    """Steps like the cell of the tape, whose config (but for what is asked), seed and events it must be given.

    Its robot answers from the tape. An ABORT ends at the latest when the one on the tape has ended and its force is gone:
    the arm is back then, whatever this cell would have it do.
    """

    def __init__(self, config: Config, tape: Tape, device: str = "cpu", fixed: Collection[str] = (),
                 images: Images | None = None, stops: Collection[int] = ()) -> None:
        """fixed: keys of parameters that events do not change. images: where frames come from; None renders them anew.

        stops: ticks at which events come.
        """
        self._tape, self._fixed, self._images = tape, frozenset(fixed), images
        self._stops = {tick + late for tick in stops for late in (0, 1)}  # the step after an event may have its effect
        self._steps = self._cycles = 0
        self._beside = Beside()
        super().__init__(config, device)

    def apply(self, event: Event) -> None:
        """Take an event before the next step. Raises HrcError for one that cannot be."""
        if isinstance(event, OWN_EVENTS) and not (isinstance(event, SetParameter) and event.key in self._fixed):
            super().apply(event)

    def step(self) -> Snapshot:
        """On to the next tick at which something is due, or an event comes: in between nothing but torques add up."""
        while not self._due(self.tick + 1):
            self.tick += 1
            self._tau_sum += self._tape.tau[self._steps]
            self._steps += 1
        return super().step()

    def _due(self, tick: int) -> bool:
        return (self._control.due(tick) or self._localize.due(tick) or self._eyes.due(tick) or tick in self._stops
                or int(self._tape.stamps[self._steps]) != tick)

    @property
    def _commanded(self) -> Array:
        return self._issued

    def _before_cameras(self) -> tuple[Array, tuple[Body, ...]]:
        return self._tape.exposed[self._steps - 1] if self._images is None else (np.zeros((8, 4, 4)), ())

    def _move(self) -> RobotState:
        n, tape = self._steps, self._tape
        self._steps += 1
        if tape.stamps[n] == self._state.tick:
            self._reaction.stop("robot: no reading, as recorded")
        else:
            self._state = RobotState(int(tape.stamps[n]), tape.q[n], tape.dq[n], tape.tau[n])
        return self._state

    def _decide(self, state: RobotState) -> None:
        super()._decide(state)
        if self.command.mode is Mode.ABORT and self._tape.modes[self._cycles] != Mode.ABORT:
            self._reaction.come_back()
        self._issued = self._tape.commands[self._cycles]
        self._cycles += 1

    def _bodies(self) -> tuple[Body, ...]:
        return ()

    def _truth(self) -> Truth:
        i, tape = self._cycles - 1, self._tape
        return Truth(tape.forces[i], tape.points[i], int(tape.links[i]), np.zeros(7), bool(tape.visible[i]))

    def _build(self) -> None:
        self._beside.idle()
        self._issued = np.zeros(7)
        super()._build()

    def _open_eyes(self, config: Config) -> Eyes:
        render = simulated()

        def foreseen(setup: CameraSetup, scene: Scene, seed: int, device: str) -> Sensor:
            camera = render(setup, scene, seed, device)
            if device != "cpu":  # there the host has little to do with it
                return camera
            rate = Rate(setup.hz, config.rates.base_hz)
            return ForeseenCamera(camera, self._tape.exposed, rate, lambda: self._steps - 1, self._beside)

        if (images := self._images) is None:
            return Eyes(self.scene, config, self.device, foreseen, images=False)

        def recorded(setup: CameraSetup, _scene: Scene, _seed: int, _device: str) -> RecordedCamera:
            return RecordedCamera(setup, images, lambda: self._steps)

        return Eyes(self.scene, config, self.device, recorded, images=False)


class RecordedCamera:
    """Delivers recorded frames as late as the camera did. step: tells the number of the one being taken."""

    def __init__(self, setup: CameraSetup, images: Images, step: Callable[[], int]) -> None:
        self._name, self._images, self._step = setup.name, images, step
        self.configure(setup.sensor)
        self._queue: list[tuple[int, int]] = []
        self._frame: DepthFrame | None = None

    def configure(self, config: SensorConfig) -> None:
        """Take changed live parameters."""
        self._config = config

    def move(self, _T_world_camera: Array) -> None:
        """Stand elsewhere: so it did when the images were taken."""

    def expose(self, tick: int, _T_world_link: Array, _bodies: object) -> bool:
        """Note that there is a frame; whether it will come."""
        if self._config.unplugged:
            self._queue.clear()
            return False
        self._queue = [*self._queue[-1 - self._config.latency :], (tick, self._step())]
        return True

    def latest(self, _tick: int) -> DepthFrame | None:
        """The newest frame that is followed by `latency` others; None before there is one."""
        if len(self._queue) <= self._config.latency:
            return None
        exposed, step = self._queue[-1 - self._config.latency]
        if self._frame is None or self._frame.tick != exposed:
            self._frame = DepthFrame(exposed, self._images(self._name, step))
        return self._frame

    def sees(self, _p_world: Array) -> bool:
        """Unknown here; the tape holds what there is."""
        raise SensorError("a recorded camera knows nothing of the truth")
