"""The simulated depth camera: what a Kinect behind the robot would deliver, rendered without any graphics library."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrc import meshes
from hrc.errors import SensorError, unknown
from hrc.executor import Executor, Inline, Pending
from hrc.geometry import Array, rotation_about, transform
from hrc.messages import LINKS, Body, DepthFrame
from hrc.parameters import Parameters, param
from hrc.scene import BodySpec
from hrc.vision import kernels
from hrc.vision.camera import Camera
from hrc.vision.render import FixedBox, environment_depth

SEEN = 0.02
"""A point counts as seen when it lies within this of the rendered surface, in depth [m]."""


@dataclass(frozen=True)
class SensorConfig(Parameters):
    """How far the depth camera is from perfect; the defaults are those of a Kinect V2."""

    noise: float = param(1.0, low=0.0, high=10.0)
    """Axial noise as a multiple of the sensor's: 1.9 mm at 2.2 m, more at grazing incidence."""
    flying: float = param(0.3, low=0.0, high=1.0)
    """Share of pixels at a depth edge that mix front and back."""
    dropout: float = param(0.4, low=0.0, high=1.0)
    """Share of pixels at a depth edge that measure nothing."""
    quantum: float = param(0.001, low=1e-6, high=0.1, unit="m")
    """Step of the measured depth."""
    nearest: float = param(0.5, low=0.05, high=10.0, unit="m")
    """Nothing nearer is measured."""
    farthest: float = param(4.5, low=0.1, high=100.0, unit="m")
    """Nothing farther is measured."""
    latency: int = param(2, low=0, high=30)
    """Frames between exposure and delivery."""
    unplugged: bool = param(False)
    """Delivers nothing, as with its cable pulled."""
    frozen: bool = param(False)
    """Delivers its last image again and again, as if each were new."""
    extrinsic_rotation_deg: float = param(0.25, low=0.0, high=10.0, unit="deg", live=False)
    """Error of the camera's calibrated orientation, about an axis drawn from the seed."""
    extrinsic_translation: float = param(0.005, low=0.0, high=0.1, unit="m", live=False)
    """Error of the camera's calibrated position, in a direction drawn from the seed."""


class DepthCamera:
    """Renders robot, obstacles and environment from its true pose, spoils the image, and delivers it late.

    camera: as calibrated; the true one, `true_camera`, from which the last frame was taken, is off by the config's extrinsic
    error. bodies: all obstacles that may ever be drawn. latency: frames between exposure and delivery, by default those of the
    config. executor: draws the frames that are exposed. Raises DeviceError for an unknown device.
    """

    def __init__(self, camera: Camera, environment: Sequence[FixedBox], bodies: Sequence[BodySpec],
                 config: SensorConfig | None = None, seed: int = 0, latency: int | None = None, device: str = "cpu",
                 executor: Executor | None = None) -> None:
        self._executor = executor or Inline()
        self._seed, self._fixed_latency = seed, latency
        self._device = kernels.check_device(device)
        self._slot = {body.name: len(LINKS) + i for i, body in enumerate(bodies)}
        self._camera = self._drawn = camera
        self._environment = environment
        self.true_camera = _disturbed(camera, config or SensorConfig(), seed)
        grid = kernels.grid(camera)
        background = _background(self.true_camera, environment)
        surfaces = [*meshes.robot("plant"), *(meshes.shape(body.shape, body.size) for body in bodies)]
        self._raster = kernels.Rasteriser(grid, surfaces, self._device, background=background)
        self._noise = kernels.Noise(grid, self._raster.keys, self._device)
        self.configure(config or SensorConfig())
        self.reset()

    def configure(self, config: SensorConfig) -> None:
        """Take changed parameters from the next frame on; the true pose stays as it was built."""
        self._executor.idle()
        self.config, n = config, self._noise
        self._latency = config.latency if self._fixed_latency is None else self._fixed_latency
        n.scale, n.flying, n.dropout = config.noise, config.flying, config.dropout
        n.quantum, n.nearest, n.farthest = config.quantum, config.nearest, config.farthest
        self._graph = kernels.Graph([self._raster.launch, n.launch], self._device)

    def move(self, T_world_camera: Array) -> None:
        """Stand elsewhere from the next frame on: this is its calibrated pose (4, 4), the true one is off by the same error.

        Frames on their way come as they were taken.
        """
        self._camera = self._camera.moved(T_world_camera)

    def reset(self) -> None:
        """Forget all frames; the next one is the first again, with the same noise."""
        self._count = 0
        self._newest: Pending[DepthFrame] | None = None
        self._queue: deque[tuple[int, Pending[DepthFrame]]] = deque()

    def expose(self, tick: int, T_world_link: Array, bodies: Sequence[Body]) -> bool:
        """Take a frame with the links at these true poses (8, 4, 4) and the bodies where they are; whether one will come.

        Raises SensorError for a body that was not given at construction.
        """
        T, camera, number = self._placed(T_world_link, bodies), self._camera, self._count
        return self._keep(tick, self._executor.do(lambda: DepthFrame(tick, self._draw(number, T, camera))))

    def render(self, number: int, T_world_link: Array, bodies: Sequence[Body]) -> NDArray[np.float32]:
        """The image [m] (H, W) of the frame with this number, counted from 0, which decides on its noise.

        Raises SensorError for a body that was not given at construction.
        """
        return self._draw(number, self._placed(T_world_link, bodies), self._camera)

    def _placed(self, T_world_link: Array, bodies: Sequence[Body]) -> Array:
        """The pose of each mesh that is drawn (n, 4, 4)."""
        T_world_mesh = np.zeros((len(LINKS) + len(self._slot), 4, 4))  # zeros: not drawn
        T_world_mesh[: len(LINKS)] = T_world_link
        for body in bodies:
            if body.name not in self._slot:
                raise SensorError(unknown("body", body.name, self._slot))
            if body.present:
                T_world_mesh[self._slot[body.name]] = body.T_world_body
        return T_world_mesh

    def _draw(self, number: int, T_world_mesh: Array, camera: Camera) -> NDArray[np.float32]:
        """camera: as it was taken to stand at the exposure."""
        if camera is not self._drawn:  # not before: while it is carried about, a frame is taken now and then
            self.true_camera, self._drawn = _disturbed(camera, self.config, self._seed), camera
            self._raster.replace_background(_background(self.true_camera, self._environment))
        self._raster.place(self.true_camera.T_camera_world @ T_world_mesh)
        self._noise.draw(self._seed, number)
        self._graph.replay()
        return self._noise.image()

    def keep(self, tick: int, image: NDArray[np.float32]) -> bool:
        """Count a rendered image as taken at this tick; whether it will come."""
        frame = DepthFrame(tick, image)
        return self._keep(tick, lambda: frame)

    def _keep(self, tick: int, frame: Pending[DepthFrame]) -> bool:
        self._count += 1
        self._newest = frame
        if self.config.unplugged:
            self._queue.clear()
            return False
        if self.config.frozen and self._queue:
            stuck = DepthFrame(tick, self._queue[-1][1]().depth)
            self._queue.append((tick, lambda: stuck))
        else:
            self._queue.append((tick, frame))
        while len(self._queue) > self._latency + 2:
            self._queue.popleft()
        return True

    def latest(self, tick: int) -> DepthFrame | None:
        """The newest frame, of those exposed up to `tick`, that is followed by `latency` others; None before there is one."""
        exposed = [frame for taken, frame in self._queue if taken <= tick]
        return exposed[-1 - self._latency]() if len(exposed) > self._latency else None

    def perfect(self) -> Array:
        """The last frame without any noise: depth [m] (H, W), +inf where there is nothing."""
        self._executor.idle()
        return self._raster.image()[0]

    def sees(self, p_world: ArrayLike) -> bool:
        """Whether the surface in the last noise-free render, at that point's pixel, is within 2 cm of it in depth."""
        if self._newest is None:
            return False
        self._newest()  # until it is drawn
        u, v, z = self.true_camera.pixel(np.asarray(p_world, np.float64))
        rows, columns = self.true_camera.shape
        if not (z > 0 and -0.5 <= u < columns - 0.5 and -0.5 <= v < rows - 0.5):
            return False
        key = self._raster.key(round(u), round(v))
        return bool(key) and abs(kernels.key_depth(key) - z) <= SEEN


def _background(camera: Camera, environment: Sequence[FixedBox]) -> NDArray[np.uint32]:
    """What it sees of the fixed environment, as keys of a raster."""
    return kernels.pack(environment_depth(camera, environment), np.full(camera.shape, 15), kernels.grid(camera))


def _disturbed(camera: Camera, config: SensorConfig, seed: int) -> Camera:
    """The camera where it really stands."""
    axis, direction = np.random.default_rng([seed, 0xE7E]).normal(size=(2, 3))
    turn = rotation_about(axis, np.radians(config.extrinsic_rotation_deg))
    shift = config.extrinsic_translation * direction / np.linalg.norm(direction)
    return camera.moved(camera.T_world_camera @ transform(turn, shift))
