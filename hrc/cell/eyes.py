"""All depth cameras of the cell, and what they see together: any number, each with its own place, rate, delay and noise."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from hrc.cell.clock import Rate
from hrc.config import Config
from hrc.errors import AssetError, ConfigError, EventError, SensorError, unknown
from hrc.executor import Executor, Inline
from hrc.messages import Body, Clearance, DepthFrame, Nearest, View, frozen
from hrc.scene import CameraSpec, Scene, load_scene
from hrc.sim.depth_camera import DepthCamera, SensorConfig
from hrc.sim.push import HAND
from hrc.vision.camera import Camera, CameraConfig
from hrc.vision.localize import Localizer
from hrc.vision.margin import margins

Array = NDArray[np.float64]
T = TypeVar("T")
SAME_PLACE = 0.1
"""Touches that two cameras see nearer to each other than this are one [m]."""
MOST_TOUCHES = 4
FROZEN = 0.01
"""A camera that repeats its image while a link has moved by this is frozen [m]."""
MONITOR_EVERY = 4
"""In every so-many-th localization the distances of all links out to the monitored range are measured, too: nothing that needs
them is in a hurry, and with somebody near they take half of its time."""
APART = 7919
"""Between the seeds of two cameras, so that their noise differs."""


@dataclass(frozen=True)
class CameraSetup:
    """One camera of the rig: placement and intrinsics, imperfections, and frames per second."""

    name: str
    camera: CameraConfig
    sensor: SensorConfig
    hz: int


def rig(config: Config, scene: Scene | None = None) -> tuple[CameraSetup, ...]:
    """The cameras of the config's scene; if it names none, the one of the config.

    Raises AssetError for a camera with an unknown or impossible parameter.
    """
    specs = (scene or load_scene(config.scene)).cameras or (CameraSpec("camera", {}),)
    return tuple(_setup(config, spec) for spec in specs)


def _setup(config: Config, spec: CameraSpec) -> CameraSetup:
    changes = dict(spec.changes)
    hz = changes.pop("hz", config.rates.camera_hz)
    own = {"camera": [f.name for f in fields(CameraConfig)], "sensor": [f.name for f in fields(SensorConfig)]}
    try:
        for key in changes:
            if key not in own["camera"] + own["sensor"]:
                raise ConfigError(unknown("parameter", key, ["hz", *own["camera"], *own["sensor"]]))
        rate = config.rates.replace(camera_hz=hz).camera_hz
        camera = config.camera.replace(**{k: v for k, v in changes.items() if k in own["camera"]})
        sensor = config.sensor.replace(**{k: v for k, v in changes.items() if k in own["sensor"]})
    except ConfigError as error:
        raise AssetError(f'camera "{spec.name}": {error}') from None
    return CameraSetup(spec.name, camera, sensor, rate)


@dataclass(frozen=True)
class Sighting:
    """What all cameras see at one tick. nearest: surest first, then by distance; touches and clearances as in Snapshot."""

    nearest: tuple[Nearest, ...] = ()
    touches: tuple[Nearest, ...] = ()
    clearances: tuple[Clearance, ...] = ()

    def since(self, tick: int) -> "Sighting":
        """Without what older images say: a camera may die."""
        return Sighting(_since(tick, self.nearest), _since(tick, self.touches), _since(tick, self.clearances))

    @property
    def clearance(self) -> float:
        """Of the whole robot [m]: inf while no obstacle is within the monitored range."""
        return min((c.distance for c in self.clearances), default=np.inf)


Seen = TypeVar("Seen", Nearest, Clearance)


def _since(tick: int, seen: tuple[Seen, ...]) -> tuple[Seen, ...]:
    return tuple(x for x in seen if x.stamp >= tick)


class Sensor(Protocol):
    """What delivers the frames: a `DepthCamera`, where the methods are explained, or a recording of one."""

    def configure(self, config: SensorConfig, /) -> None:
        """Take changed live parameters."""
        ...

    def move(self, T_world_camera: Array, /) -> None:
        """Stand elsewhere from the next frame on."""
        ...

    def expose(self, tick: int, T_world_link: Array, bodies: Sequence[Body], /) -> bool:
        """Take a frame; whether it will come."""
        ...

    def latest(self, tick: int, /) -> DepthFrame | None:
        """The newest frame that has arrived."""
        ...

    def sees(self, p_world: Array, /) -> bool:
        """Whether a perfect camera would see the point."""
        ...


MakeSensor = Callable[[CameraSetup, Scene, int, str], Sensor]
"""From a camera's setup, the scene, the seed of its noise, and the device."""


def simulated(executor: Executor | None = None) -> Callable[[CameraSetup, Scene, int, str], DepthCamera]:
    """A camera that renders the scene, each frame as a job of the executor."""
    executor = executor or Inline()

    def camera(setup: CameraSetup, scene: Scene, seed: int, device: str) -> DepthCamera:
        return DepthCamera(Camera(setup.camera), scene.environment, (*scene.bodies, HAND), setup.sensor, seed=seed,
                           device=device, executor=executor)
    return camera


class Eye:
    """One camera: its frames, the robot's poses that belong to them, and its localizer."""

    def __init__(self, setup: CameraSetup, scene: Scene, config: Config, device: str, sensor: MakeSensor) -> None:
        self.name, self._scene, self._device, self._make_sensor = setup.name, scene, device, sensor
        self._home = Camera(setup.camera).T_world_camera
        self._stood: Array | None = None  # where the camera was when it took the newest frame; None: as configured
        self._localizer = Localizer(Camera(setup.camera), scene.environment, config.vision, device, name=setup.name)
        self.begin(setup, config, config.seed)

    def begin(self, setup: CameraSetup, config: Config, seed: int) -> None:
        """Start anew: no frame yet, the sensor as and where in its setup."""
        self._sensor = self._make_sensor(setup, self._scene, seed, self._device)
        self._rate = Rate(setup.hz, config.rates.base_hz)
        self._poses: dict[int, tuple[Array, Array, Array | None]] = {}
        self._stands: Array | None = None  # where the camera was moved to; None: as configured
        self._frame: DepthFrame | None = None
        self._first = np.zeros((8, 4, 4))  # where the robot was when the present image was new
        self._arrived = self._heard = self._looks = 0
        self._clearances: tuple[Clearance, ...] = ()
        self._look_from(None)
        self._localizer.reset()
        self.configure(setup, config)

    def configure(self, setup: CameraSetup, config: Config) -> None:
        """Take changed live parameters."""
        self._silent = config.tracker.stale * config.rates.base_hz
        self._base = config.vision.margin
        self._sensor.configure(setup.sensor)
        self._localizer.configure(config.vision)

    def move(self, T_world_camera: Array) -> None:
        """Stand elsewhere (4, 4) from the next frame on. Frames on their way are seen from where they were taken."""
        self._stands = frozen(T_world_camera, (4, 4), "T_world_camera")
        self._sensor.move(self._stands)

    def _look_from(self, T_world_camera: Array | None) -> None:
        """Take the frames that follow to be from there."""
        if T_world_camera is not self._stood:
            self._localizer.move(self._home if T_world_camera is None else T_world_camera)
            self._stood = T_world_camera

    def due(self, tick: int) -> bool:
        """Whether it takes a frame at this tick."""
        return self._rate.due(tick)

    def expose(self, tick: int, T_true: Array, bodies: Sequence[Body], T_measured: Array, T_later: Array) -> None:
        """Take a frame of the true scene. T_measured, T_later (8, 4, 4): where the robot says it is, and soon will be."""
        if self._sensor.expose(tick, T_true, bodies):
            self._poses[tick] = T_measured, T_later, self._stands

    def receive(self, tick: int) -> bool:
        """Filter the robot out of a frame that has arrived, with its poses at the frame's stamp; whether there was one.

        Raises SensorError for a frame that is none, or no news; it is dropped.
        """
        frame = self._sensor.latest(tick)
        if frame is None or frame.tick not in self._poses:
            return False
        T, T_later, stood = self._poses[frame.tick]
        self._poses = {t: poses for t, poses in self._poses.items() if t > frame.tick}
        self._arrived = tick
        self._check_news(frame, T)
        self._look_from(stood)
        self._localizer.filter(frame, T, margins(T, T_later, self._base))
        self._frame, self._heard = frame, frame.tick
        return True

    def _check_news(self, frame: DepthFrame, T_world_link: Array) -> None:
        """An image that is the same to the last bit although the robot has moved is not one of now: the camera is frozen.

        Only motion tells: a perfect camera repeats itself in an empty cell where nothing moves.
        """
        if self._frame is None or not _same(frame.depth, self._frame.depth):
            self._first = T_world_link
        elif np.abs(T_world_link[:, :3, 3] - self._first[:, :3, 3]).max() > FROZEN:
            raise SensorError("it repeats one image although the robot has moved")

    def localize(self, tick: int, T_world_link: Array) -> Sighting:
        """What this camera sees, the robot being at T_world_link (8, 4, 4) now."""
        eye = self._localizer
        nearest, touches = eye.localize(tick, T_world_link), eye.touches()
        if self._looks % MONITOR_EVERY == 0:
            self._clearances = eye.clearances()
        self._looks += 1
        return Sighting(nearest, touches, self._clearances)

    def silent(self, tick: int) -> bool:
        """Whether the newest frame is too old to say anything about now."""
        return tick - self._heard > self._silent

    def late(self, tick: int) -> int:
        """How old its images are when they arrive [ticks], if any arrive; else 0."""
        return self._arrived - self._heard if tick - self._arrived <= self._silent else 0

    def view(self, tick: int, *, images: bool) -> View:
        """The newest frame and what was made of it."""
        silent = self.silent(tick)
        T = self._stands if silent or self._frame is None else self._stood
        if not images:
            return View(self.name, self._frame, silent=silent, T_world_camera=T)
        return View(self.name, self._frame, self._localizer.foreground, self._localizer.robot_image, silent, T)

    def sees(self, p_world: Array) -> bool:
        """Whether a perfect camera in its place would see this point: for the truth, never for the loop."""
        return self._sensor.sees(p_world)


class Eyes:
    """The rig. trouble: what was wrong with a frame that was dropped since the last good one."""

    def __init__(self, scene: Scene, config: Config, device: str, sensor: MakeSensor | None = None, *,
                 images: bool = True) -> None:
        """images: keep in the views what was made of the frames; nothing but a screen or a recording needs it."""
        self._scene, self._base_hz, self._images = scene, config.rates.base_hz, images
        self.trouble = ""
        self._eyes = [Eye(setup, scene, config, device, sensor or simulated()) for setup in rig(config, scene)]

    def begin(self, config: Config) -> None:
        """Start anew, with no frames and the noise of the config's seed."""
        self.trouble = ""
        for i, (eye, setup) in enumerate(zip(self._eyes, rig(config, self._scene), strict=True)):
            eye.begin(setup, config, config.seed + APART * i)

    def configure(self, config: Config) -> None:
        """Take changed live parameters."""
        for eye, setup in zip(self._eyes, rig(config, self._scene), strict=True):
            eye.configure(setup, config)

    def move(self, name: str, T_world_camera: Array) -> None:
        """Let a camera stand elsewhere (4, 4) from its next frame on. Raises EventError if there is none of this name."""
        eyes = {eye.name: eye for eye in self._eyes}
        if name not in eyes:
            raise EventError(unknown("camera", name, eyes))
        eyes[name].move(T_world_camera)

    def due(self, tick: int) -> bool:
        """Whether a camera takes a frame at this tick."""
        return any(eye.due(tick) for eye in self._eyes)

    def expose(self, tick: int, T_true: Array, bodies: Sequence[Body], T_measured: Array, T_later: Array) -> None:
        """Let the cameras that are due take a frame; the arguments are those of `Eye.expose`."""
        for eye in self._eyes:
            if eye.due(tick):
                self._try(eye, lambda eye=eye: eye.expose(tick, T_true, bodies, T_measured, T_later))

    def receive(self, tick: int) -> bool:
        """Take the frames that have arrived; whether there was one."""
        arrived = [self._try(eye, lambda eye=eye: eye.receive(tick)) for eye in self._eyes]
        if not any(arrived):
            return False
        self.trouble = ""
        return True

    def _try(self, eye: Eye, act: Callable[[], T]) -> T | None:
        """A frame that is none is dropped, and `trouble` says why: if no other follows, the camera is silent."""
        try:
            return act()
        except SensorError as error:
            self.trouble = f"{eye.name}: {error}"
            return None

    def localize(self, tick: int, T_world_link: Array) -> Sighting:
        """What all cameras see together, the robot being at T_world_link (8, 4, 4) now."""
        seen = [eye.localize(tick, T_world_link) for eye in self._eyes]
        return seen[0] if len(seen) == 1 else _together(seen)

    def blindness(self, tick: int) -> str:
        """Why nothing is seen now, if no camera delivers images; else empty."""
        if not all(eye.silent(tick) for eye in self._eyes):
            return ""
        late = min((eye.late(tick) for eye in self._eyes), default=0) / self._base_hz
        trouble = self.trouble or (f"they are {late:.2f} s old when they arrive" if late > 0.0 else "")
        return "no camera delivers images" + (f" ({trouble})" if trouble else "")

    def views(self, tick: int) -> tuple[View, ...]:
        """One for each camera."""
        return tuple(eye.view(tick, images=self._images) for eye in self._eyes)

    def see(self, p_world: Array) -> bool:
        """Whether a perfect camera in the place of one of them would see this point: for the truth, never for the loop."""
        return any(eye.sees(p_world) for eye in self._eyes)


def _same(a: NDArray[np.float32], b: NDArray[np.float32]) -> bool:
    """Whether two images are the same to the last bit; of two that are not, a few rows tell as a rule."""
    return np.array_equal(a[::32], b[::32]) and np.array_equal(a, b)


def _together(seen: Sequence[Sighting]) -> Sighting:
    """A contact hidden from one camera and seen by another is found; what is sure comes before what is not."""
    nearest = sorted((n for s in seen for n in s.nearest), key=_rank)
    clearances: dict[int, Clearance] = {}
    for c in sorted((c for s in seen for c in s.clearances), key=lambda c: c.distance):
        clearances.setdefault(c.link, c)
    return Sighting(tuple(nearest), _places(n for s in seen for n in s.touches), tuple(clearances.values()))


def _places(touches: Iterable[Nearest]) -> tuple[Nearest, ...]:
    kept: list[Nearest] = []
    for n in sorted(touches, key=_rank):
        if all(np.linalg.norm(n.p_world - k.p_world) > SAME_PLACE for k in kept):
            kept.append(n)
    return tuple(kept[:MOST_TOUCHES])


def _rank(n: Nearest) -> tuple[bool, float]:
    return not n.sure, n.distance
