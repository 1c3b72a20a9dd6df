"""Where is the robot nearest to something? From a depth frame and the joint positions (Sec. III)."""

from collections.abc import Sequence
from dataclasses import dataclass

from hrc import meshes
from hrc.errors import SensorError
from hrc.geometry import Array, apply, inverse
from hrc.messages import LINKS, DepthFrame, Nearest, RobotImage, frozen
from hrc.parameters import Parameters, param
from hrc.vision import kernels
from hrc.vision.camera import Camera
from hrc.vision.render import FixedBox, Renderer, environment_depth


@dataclass(frozen=True)
class VisionConfig(Parameters):
    """How the robot is removed from the depth image, and what counts as the nearest point."""

    mode: str = param("interval", options=("interval", "paper"))
    """interval: an obstacle pixel is as deep as `thickness`, the point is the centre of the nearest patch on the true
    surface. paper: whatever is in front of the robot reaches back to it, the point is the first nearest pixel of the
    expanded surface, and the robot is removed with the joint positions of now."""
    margin: float = param(0.03, low=0.0, high=0.2, unit="m")
    """How far the robot's surface is moved out before it is removed from the image."""
    environment_margin: float = param(0.04, low=0.0, high=0.5, unit="m")
    """How far table, floor and wall are enlarged before they are removed from the image."""
    reach: float = param(0.10, low=0.01, high=1.0, unit="m")
    """The distance rho up to which obstacles are looked for around each pixel of the robot."""
    thickness: float = param(0.12, low=0.0, high=0.5, unit="m")
    """How deep an obstacle is taken to be behind its visible surface (mode interval)."""
    neighbours: int = param(3, low=0, high=8)
    """How many of the eight pixels around an obstacle pixel must have its depth, to 3 cm, for it to count; flying pixels
    at the edge of an obstacle do not pass (mode interval)."""
    first_link: int = param(3, low=0, high=7)
    """The first link on which a contact is looked for; the last one is 7."""
    spread: float = param(0.01, low=0.0005, high=0.05, unit="m")
    """Excess distance at which a pixel's weight in the patch falls to 1/e (mode interval)."""
    patch: float = param(0.10, low=0.005, high=0.5, unit="m")
    """Radius of the patch around the first nearest pixel (mode interval)."""


class Localizer:
    """Filters each depth frame once, then finds the nearest point of the robot's visible surface at any later tick.

    The true surface measures distances; the expanded one only removes the robot. Raises DeviceError if there is no such
    device. One instance belongs to one thread: it works in place.
    """

    def __init__(self, camera: Camera, environment: Sequence[FixedBox], config: VisionConfig | None = None,
                 device: str = "cpu") -> None:
        self.camera, self._environment = camera, tuple(environment)
        self._device = kernels.check_device(device)
        self._surface = Renderer(camera, meshes.robot("perception"), device)
        self._expanded = Renderer(camera, meshes.robot("filter"), device)
        grid = self._surface.raster.grid
        self._filter = kernels.Filter(grid, self._expanded.raster.keys, self._device)
        self._distance = kernels.Distance(grid, self._surface.raster.keys, self._filter, self._device)
        self._point = kernels.ContactPoints(self._distance)
        self._grown: float | None = None
        self.configure(config or VisionConfig())
        self.reset()

    def reset(self) -> None:
        """Forget the last frame."""
        self._stamp: int | None = None
        self._T_stamp: Array | None = None
        self._foreground: DepthFrame | None = None
        self._robot: RobotImage | None = None

    def configure(self, config: VisionConfig) -> None:
        """Take changed parameters from the next call on."""
        self.config = config
        if self._grown != config.environment_margin:
            self._grown = config.environment_margin
            self._filter.mask(environment_depth(self.camera, self._environment, self._grown))
        paper = config.mode == "paper"
        surface = self._expanded if paper else self._surface
        self._filter.neighbours = 0 if paper else config.neighbours
        self._expanded.raster.margin = config.margin
        self._distance.keys = surface.raster.keys
        self._distance.links = sum(1 << i for i in range(config.first_link, len(LINKS)))
        self._distance.reach = config.reach
        # Sec. III-C: d_f < d_v => d_f := d_v, an obstacle of no end.
        self._distance.thickness = 1e6 if paper else config.thickness
        self._point.centred, self._point.spread, self._point.patch = not paper, config.spread, config.patch
        filtering = [self._expanded.raster.launch, self._filter.launch]
        measuring = [self._distance.launch, self._point.launch]
        self._filtering = kernels.Graph(filtering, self._device)
        self._localizing = kernels.Graph([*(filtering if paper else [surface.raster.launch]), *measuring], self._device)

    def filter(self, frame: DepthFrame, T_world_link: Array) -> None:
        """Take a new frame, and remove from it the robot, at its poses (8, 4, 4) when the frame was exposed.

        Raises SensorError if the frame does not have the camera's size.
        """
        if frame.depth.shape != self.camera.shape:
            raise SensorError(f"the depth image must be {self.camera.shape}, like the camera's, not {frame.depth.shape}")
        self._filter.load(frame.depth)
        self._expanded.place(T_world_link)
        self._filtering.replay()
        self._foreground = DepthFrame(frame.tick, self._filter.image())
        self._stamp, self._T_stamp, self._robot = frame.tick, T_world_link.copy(), None

    @property
    def foreground(self) -> DepthFrame | None:
        """What the filter left of the last frame, None before the first."""
        return self._foreground

    @property
    def robot_image(self) -> RobotImage | None:
        """The robot in the last frame, None before the first."""
        if self._robot is None and self._T_stamp is not None:
            self._robot = self._surface.render(self._T_stamp)
        return self._robot

    def localize(self, tick: int, T_world_link: Array) -> tuple[Nearest, ...]:
        """The nearest point of each link that has an obstacle within reach, the nearest first (mode paper: that one alone).

        T_world_link: the robot's poses now (8, 4, 4). Empty while nothing is within reach, or before the first frame.
        """
        if self._stamp is None:
            return ()
        robot = self._expanded if self.config.mode == "paper" else self._surface
        robot.place(T_world_link)
        self._localizing.replay()
        found = self._point.result()[: 1 if self.config.mode == "paper" else None]
        return tuple(self._nearest(tick, self._stamp, f, T_world_link) for f in found)

    def _nearest(self, tick: int, stamp: int, f: kernels.Found, T_world_link: Array) -> Nearest:
        p_world = apply(self.camera.T_world_camera, self.camera.unproject(f.u, f.v, f.depth))  # Eq. (9)
        p_link = apply(inverse(T_world_link[f.link]), p_world)
        return Nearest(tick, stamp, f.link, frozen(p_world, (3,), "p_world"), frozen(p_link, (3,), "p_link"), f.distance,
                       (f.u, f.v))

    def distances(self) -> Array:
        """The distance map [m] (H, W) of the last `localize`: +inf off the robot's links and beyond reach."""
        return self._distance.image()
