"""The end-effector task: where the arm should be along its path."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.control.paths import Circle, Path, Point, Polygon, read_waypoints
from hrc.parameters import Parameters, param

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TaskConfig(Parameters):
    """The end effector's path; the default is the paper's, a hexagon on a vertical plane at constant speed."""

    kind: str = param("hexagon", options=("hexagon", "circle", "hold", "waypoints"), live=False)
    """hexagon, circle: around the centre, on the plane x = constant. hold: stay at the centre. waypoints: a closed path
    through the points of a file."""
    centre: tuple[float, ...] = param((-0.55, 0.0, 0.45), low=-1.2, high=1.2, unit="m", live=False)
    """Centre of hexagon and circle, in the world; the desired posture has the end effector there."""
    radius: float = param(0.15, low=0.02, high=0.3, unit="m", live=False)
    """Distance from the centre to a corner of the hexagon, or to the circle."""
    waypoints: str = param("", live=False)
    """A text file with x, y, z [m] in each line, for kind waypoints."""
    speed: float = param(0.2, low=0.0, high=0.5, unit="m/s")
    """Speed along the path."""
    corner: float = param(0.01, low=0.001, high=0.05, unit="m", live=False)
    """A corner is rounded by a parabola that begins this far before it."""
    start: int = param(3, low=0, high=5, live=False)
    """Corner where hexagon and circle begin: 0 is the one farthest in +y, and they count with +z."""
    upright: bool = param(False, live=False)
    """Keep the tool's orientation, too: then the task takes six of the seven joints (m = 6)."""
    posture_deg: tuple[float, ...] = param((0.0, 25.0, 0.0, -85.0, 0.0, 70.0, 0.0), low=-170.0, high=170.0, unit="deg",
                                           live=False)
    """Where the search for the desired posture q_d starts; q_d is near it, with the end effector at the centre."""


def make_path(config: TaskConfig) -> Path:
    """The path of a task. Raises ConfigError for a file of waypoints that is none."""
    centre, phase = np.asarray(config.centre), config.start * np.pi / 3.0
    if config.kind == "hold":
        return Point(centre)
    if config.kind == "circle":
        return Circle(centre, config.radius, phase)
    if config.kind == "waypoints":
        return Polygon(read_waypoints(config.waypoints), config.corner)
    angle = phase + np.arange(6) * np.pi / 3.0
    ring = np.column_stack([np.zeros(6), np.cos(angle), np.sin(angle)])
    return Polygon(centre + config.radius * ring, config.corner)


class PathFollower:
    """Progress along the path: it can be slowed, frozen and resumed, and never jumps."""

    def __init__(self, path: Path, speed: float) -> None:
        self.path = path
        self.speed = speed
        self.s = 0.0

    @property
    def x_d(self) -> Array:
        """The reference now [m] (3,)."""
        return self.path.at(self.s)

    def ahead(self, dt: float) -> Array:
        """dx_d over the next dt [s] at the task's full speed [m/s] (3,); the reference stays where it is."""
        return (self.path.at(self.s + self.speed * dt) - self.x_d) / dt

    def advance(self, path_speed: float, dt: float) -> Array:
        """Move on by `path_speed` (0..1) times the task's speed for dt [s]; returns dx_d over that time [m/s] (3,)."""
        before = self.x_d
        self.s += self.speed * path_speed * dt
        return (self.x_d - before) / dt
