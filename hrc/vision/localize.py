"""Where is the robot nearest to something? From a depth frame and the joint positions (Sec. III)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hrc import meshes
from hrc.errors import SensorError
from hrc.geometry import Array, apply
from hrc.messages import LINKS, Clearance, DepthFrame, Nearest, RobotImage, frozen, read_only
from hrc.parameters import Parameters, param
from hrc.vision import kernels
from hrc.vision.camera import Camera
from hrc.vision.environment import Environment, environment_mask
from hrc.vision.render import Renderer

PLACE = 0.05
"""Points nearer to each other than this [m] are of the same place."""


@dataclass(frozen=True)
class VisionConfig(Parameters):
    """How the robot is removed from the depth image, and what counts as the nearest point."""

    mode: str = param("interval", options=("interval", "paper"))
    """interval: an obstacle is as deep as it is wide, up to `thickness`, the point is the centre of the nearest patch on the
    true surface. paper: whatever is in front of the robot reaches back to it, the point is the first nearest pixel of the
    expanded surface, and the robot is removed with the joint positions of now."""
    margin: float = param(0.025, low=0.0, high=0.2, unit="m")
    """How far the robot's surface is moved out, at rest, before it is removed from the image."""
    skew: float = param(0.01, low=0.0, high=0.2, unit="s")
    """By how much the stamps of image and joint positions may differ: a link that moves is moved out by |v| times this more."""
    environment_margin: float = param(0.04, low=0.0, high=0.5, unit="m")
    """How far table, floor and wall are enlarged before they are removed from the image; if they were learned from images,
    how much nearer along the depth they are taken to be."""
    reach: float = param(0.10, low=0.01, high=1.0, unit="m")
    """The distance rho up to which obstacles are looked for around each pixel of the robot."""
    thickness: float = param(0.12, low=0.0, high=0.5, unit="m")
    """How deep an obstacle is behind its visible surface, at most; else it is taken to be as deep as it is wide, a ball, a
    cylinder or a box (mode interval)."""
    neighbours: int = param(4, low=0, high=8)
    """How many of the eight pixels around an obstacle pixel must be of the obstacle, too, and at its depth, to 3 cm, for it to
    count: flying pixels at the edge of an obstacle do not pass, nor slivers of the robot beside its image (mode interval)."""
    first_link: int = param(3, low=0, high=7)
    """The first link on which a contact is looked for; the last one is 7."""
    spread: float = param(0.005, low=0.0005, high=0.05, unit="m")
    """Excess distance at which a pixel's weight in the patch falls to 1/e (mode interval)."""
    patch: float = param(0.10, low=0.005, high=0.5, unit="m")
    """Radius of the patch around the first nearest pixel (mode interval)."""
    sure_within: float = param(0.035, low=0.0, high=0.2, unit="m")
    """A contact is taken to be where the camera sees it only if the obstacle is nearer than this (mode interval)."""
    sure_facing_deg: float = param(80.0, low=0.0, high=180.0, unit="deg")
    """And only if the obstacle's middle is seen from there within this angle of the camera: beyond, it reaches behind the edge
    of what the camera sees of the robot, and so may the contact (mode interval)."""
    sure_apart: float = param(0.01, low=0.0, high=0.2, unit="m")
    """And only if no other link is as near elsewhere: farther by less than this, which is what calibration and noise leave to
    doubt (mode interval)."""
    touch: float = param(0.06, low=0.005, high=0.2, unit="m")
    """A place on the robot where an obstacle is nearer than this may be in contact; `margin` makes a touching obstacle seem
    as far as that. At most `reach`."""
    monitor: float = param(0.5, low=0.05, high=2.0, unit="m")
    """How far the distance of each link to the obstacles is watched, contact or not."""


class Localizer:
    """Filters each depth frame once, then finds the nearest point of the robot's visible surface at any later tick.

    The true surface measures distances; the expanded one only removes the robot. Raises DeviceError if there is no such
    device. One instance belongs to one thread: it works in place.
    """

    def __init__(self, camera: Camera, environment: Environment, config: VisionConfig | None = None,
                 device: str = "cpu", *, name: str = "", filter_detail: str = "filter") -> None:
        """environment: boxes, or a depth image of the empty cell (`learned_environment`). name: of the camera, for what it
        finds. filter_detail: of the meshes that remove the robot, see `meshes.robot`."""
        self.name = name
        self.camera, self._environment, self._rays = camera, environment, camera.rays()
        self._device = kernels.check_device(device)
        self._surface = Renderer(camera, meshes.robot("perception"), device)
        self._expanded = Renderer(camera, meshes.robot(filter_detail), device)
        grid = self._surface.raster.grid
        self._filter = kernels.Filter(grid, self._expanded.raster.keys, self._device)
        self._distance = kernels.Distance(grid, self._surface.raster.keys, self._filter, self._device)
        self._chords, self._endless = kernels.Chords(self._filter), self._distance.back
        self._point = kernels.ContactPoints(self._distance)
        self._touches = kernels.Touches(self._distance)
        self._clearance = kernels.Clearances(grid, self._surface.raster.keys, self._filter, self._device)
        self._covering = kernels.Graph([self._expanded.raster.launch], self._device)
        self._grown: float | None = None
        self.configure(config or VisionConfig())
        self.reset()

    def reset(self) -> None:
        """Forget the last frame."""
        self._now: tuple[int, Array] | None = None
        self._drawn: Array | None = None
        self._mapped = False
        self._frame: DepthFrame | None = None
        self._T_stamp: Array | None = None
        self._foreground: DepthFrame | None = None
        self._robot: RobotImage | None = None

    def move(self, T_world_camera: Array) -> None:
        """The camera stands at another pose (4, 4) in the frames that follow; the last one is forgotten.

        Raises SensorError if the environment was learned from images: they show it from one place alone.
        """
        if isinstance(self._environment, np.ndarray):
            raise SensorError("a camera whose environment was learned from images must stay where it was")
        self.camera = self.camera.moved(frozen(T_world_camera, (4, 4), "T_world_camera"))
        for renderer in (self._surface, self._expanded):
            renderer.move(self.camera)
        self._mask()
        self.reset()

    def _mask(self) -> None:
        self._filter.mask(environment_mask(self.camera, self._environment, self.config.environment_margin))

    def configure(self, config: VisionConfig) -> None:
        """Take changed parameters from the next call on."""
        self.config = config
        if self._grown != config.environment_margin:
            self._grown = config.environment_margin
            self._mask()
        paper = config.mode == "paper"
        robot = self._expanded.raster if paper else self._surface.raster
        links = sum(1 << i for i in range(config.first_link, len(LINKS)))
        self._filter.neighbours = 0 if paper else config.neighbours
        self._distance.keys, self._distance.links, self._distance.reach = robot.keys, links, config.reach
        # Sec. III-C: d_f < d_v => d_f := d_v, an obstacle of no end.
        self._distance.thickness = 1e6 if paper else config.thickness
        for point in (self._point, self._touches.points):
            point.centred, point.spread, point.patch = not paper, config.spread, config.patch
            point.within, point.facing = config.sure_within, float(np.cos(np.radians(config.sure_facing_deg)))
        self._touches.touch, self._clearance.monitor, self._clearance.thickness = config.touch, config.monitor, config.thickness
        self._distance.back = self._endless if paper else self._chords.back
        self._chords.thickness = config.thickness
        more = 0 if paper else kernels.Chords.MORE
        self._localizing = kernels.Graph([
            robot.launch, lambda: robot.surround(links, config.reach, self._filter.region, more), self._filter.launch,
            *([] if paper else [self._chords.launch]), self._distance.launch, self._point.launch], self._device)
        self._touching = self._touches.capture()
        surface, watch, everything = self._surface.raster, self._clearance, (1 << len(LINKS)) - 1
        self._monitoring = kernels.Graph([
            lambda: surface.surround(everything, 0.0, watch.robot_region),
            lambda: surface.surround(everything, config.monitor, watch.region),
            lambda: self._filter.launch(watch.region), watch.launch], self._device)
        self._margins: Array | float = config.margin
        self._covered = False

    def filter(self, frame: DepthFrame, T_world_link: Array, margins: Array | None = None) -> None:
        """Take a new frame, and remove from it the robot, at its poses (8, 4, 4) when the frame was exposed.

        margins [m] (8,): how far the surface of each link is moved out for that; `config.margin` without.
        Raises SensorError if the frame does not have the camera's size, or a pose is not finite.
        """
        if frame.depth.shape != self.camera.shape:
            raise SensorError(f"the depth image must be {self.camera.shape}, like the camera's, not {frame.depth.shape}")
        T_stamp = frozen(T_world_link, (len(LINKS), 4, 4), "T_world_link")
        self._frame, self._T_stamp, self._foreground, self._robot = frame, T_stamp, None, None
        self._margins = self.config.margin if margins is None else margins
        self._filter.load(frame.depth)
        self._covered = self._mapped = False

    @property
    def foreground(self) -> DepthFrame | None:
        """What the filter left of the last frame, None before the first; in mode paper, as the last `localize` left it."""
        if self._foreground is None and self._frame is not None:
            self._draw_cover()
            self._foreground = DepthFrame(self._frame.tick, self._filter.image())
        return self._foreground

    @property
    def robot_image(self) -> RobotImage | None:
        """The robot in the last frame, None before the first."""
        if self._robot is None and self._T_stamp is not None:
            self._robot, self._drawn = self._surface.render(self._T_stamp), self._T_stamp
        return self._robot

    def localize(self, tick: int, T_world_link: Array) -> tuple[Nearest, ...]:
        """The nearest point of each link that has an obstacle within reach, the nearest first (mode paper: that one alone).

        T_world_link: the robot's poses now (8, 4, 4). Empty while nothing is within reach, or before the first frame. Raises
        SensorError if the poses are none.
        """
        if self._frame is None:
            return ()
        paper, T_now = self.config.mode == "paper", frozen(T_world_link, (len(LINKS), 4, 4), "T_world_link")
        if paper:
            self._place_cover(T_now)
        else:
            self._draw_cover()
            self._surface.place(T_now)
        self._localizing.replay()
        self._now, self._mapped, self._drawn = (tick, T_now), True, self._drawn if paper else T_now
        found = self._point.result()[: 1 if paper else None]
        nearest = self._nearest(tick, self._frame.tick, found, T_now)
        return nearest if paper else self._doubted(nearest)

    def touches(self) -> tuple[Nearest, ...]:
        """Up to four separate places nearer than `config.touch` to an obstacle, the nearest first, at the last `localize`.

        A hand laid flat on the arm is one place, two hands are two (Remarks 1 and 2). Empty after a new frame, until then.
        """
        if self._frame is None or self._now is None or not self._mapped:
            return ()
        tick, T_now = self._now
        if self.config.mode != "paper":
            self._draw(T_now)
        self._touches.load()
        self._touching.replay()
        return self._nearest(tick, self._frame.tick, self._touches.result(), T_now)

    def clearances(self) -> tuple[Clearance, ...]:
        """The least distance of each link's true surface to any obstacle within `config.monitor`, the nearest link first.

        The robot stands where it stood at the last `localize`, the obstacles are those of the last frame, each as deep as
        `thickness` in either mode. What is not in that frame any more is forgotten.
        """
        if self._frame is None or self._now is None:
            return ()
        tick, T_now = self._now
        self._draw_cover()
        self._draw(T_now)
        self._monitoring.replay()
        found = self._clearance.result()
        pixels = np.array([p for w in found for p in (w.robot, w.obstacle)]).reshape(-1, 3)  # all at once: it is 5 % of a cycle
        places = apply(self.camera.T_world_camera, self.camera.unproject(*pixels.T)).reshape(-1, 2, 3)
        off = places[:, 0] - places[:, 1]
        stamp, apart = self._frame.tick, np.sqrt((off * off).sum(axis=1)).tolist()
        cleared = [Clearance(tick, stamp, w.link, distance, robot, obstacle, self.name)
                   for w, distance, (robot, obstacle) in zip(found, apart, places, strict=True)]
        return tuple(sorted(cleared, key=lambda c: c.distance))

    def _draw(self, T_world_link: Array) -> None:
        """See to it that the true surface is drawn at these poses, those of the last localize."""
        if self._drawn is not T_world_link:
            self._surface.draw(T_world_link)
            self._drawn = T_world_link

    def _draw_cover(self) -> None:
        """See to it that what removes the robot from the frame is drawn; the filter does each part of it when it is needed."""
        if not self._covered and self._T_stamp is not None:
            self._place_cover(self._T_stamp)
            self._covering.replay()

    def _place_cover(self, T_world_link: Array) -> None:
        self._expanded.place(T_world_link)
        self._expanded.expand(self._margins)
        self._filter.renew()
        self._covered = True

    def _nearest(self, tick: int, stamp: int, found: Sequence[kernels.Found], T_world_link: Array) -> tuple[Nearest, ...]:
        return tuple(self._at(tick, stamp, f, T_world_link[f.link]) for f in found)

    def _at(self, tick: int, stamp: int, f: kernels.Found, T_world_link: Array) -> Nearest:
        T = self.camera.T_world_camera
        p_world = T[:3, :3] @ (self._rays[f.v, f.u] * f.depth) + T[:3, 3]  # Eq. (9)
        p_link = (p_world - T_world_link[:3, 3]) @ T_world_link[:3, :3]  # by the inverse of T
        read_only(p_world, p_link)
        return Nearest(tick, stamp, f.link, p_world, p_link, f.distance, (f.u, f.v), self.name, f.sure)

    def _doubted(self, nearest: tuple[Nearest, ...]) -> tuple[Nearest, ...]:
        """Of two links that are equally near at different places one may be the link in contact, the other not: neither is
        sure. Nor is a point surer than one that is nearer."""
        c = self.config
        rivals = [n for n in nearest if n.distance < nearest[0].distance + c.sure_apart]
        if any(np.linalg.norm(n.p_world - nearest[0].p_world) > PLACE for n in rivals):
            return tuple(replace(n, sure=False) for n in nearest)
        doubtful = next((i for i, n in enumerate(nearest) if not n.sure), len(nearest))
        return nearest[:doubtful] + tuple(replace(n, sure=False) if n.sure else n for n in nearest[doubtful:])

    def distances(self) -> Array:
        """The distance map [m] (H, W) of the last `localize`: +inf off the robot's links and beyond reach."""
        return self._distance.image()
