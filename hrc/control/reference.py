"""The end-effector task: where the arm should be along its path."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrc.control import laws
from hrc.control.paths import Circle, Path, Point, Polygon, read_waypoints
from hrc.parameters import Parameters, param

Array = NDArray[np.float64]
KINDS = ("hexagon", "circle", "hold", "waypoints", "follow")
BRAKING, SETTLE = 0.5, 8.0
"""A target is neared on the braking curve of this part of the acceleration (the rest is left for turning), and over the last
centimetres at SETTLE [1/s] times the distance."""
NOTHING = 1e-9
"""An offset below this [m] is none."""
SAMPLES = 120
"""Points of a path among which the nearest is sought first."""
JOINED = 0.01
"""A path that is being joined begins to run when it is this near [m]."""


@dataclass(frozen=True)
class TaskConfig(Parameters):
    """The end effector's path; the default is the paper's, a hexagon on a vertical plane at constant speed."""

    kind: str = param("hexagon", options=KINDS, live=False)
    """hexagon, circle: around the centre, on the plane x = constant. hold: stay at the centre. waypoints: a closed path
    through the points of a file. follow: go to a target that is moved while the cell runs; it begins at the centre."""
    centre: tuple[float, ...] = param((-0.55, 0.0, 0.45), low=-1.2, high=1.2, unit="m", live=False)
    """Centre of hexagon and circle, in the world; the desired posture has the end effector there."""
    radius: float = param(0.15, low=0.02, high=0.3, unit="m", live=False)
    """Distance from the centre to a corner of the hexagon, or to the circle."""
    waypoints: str = param("", live=False)
    """A text file with x, y, z [m] in each line, for kind waypoints."""
    speed: float = param(0.2, low=0.0, high=0.5, unit="m/s")
    """Speed along the path."""
    approach: float = param(0.25, low=0.02, high=0.5, unit="m/s")
    """Speed at which a target is followed, and at which another path is joined."""
    acceleration: float = param(1.0, low=0.1, high=4.0, unit="m/s2")
    """Acceleration of the same, and of a change of speed along the path."""
    corner: float = param(0.01, low=0.001, high=0.05, unit="m", live=False)
    """A corner is rounded by a parabola that begins this far before it."""
    start: int = param(3, low=0, high=5, live=False)
    """Corner where hexagon and circle begin: 0 is the one farthest in +y, and they count with +z."""
    upright: bool = param(False, live=False)
    """Keep the tool's orientation, too: then the task takes six of the seven joints (m = 6)."""
    posture_rate: float = param(0.3, low=0.01, high=1.0, unit="rad/s")
    """Rate at which q_d goes to another posture that is asked for while the cell runs."""
    posture_deg: tuple[float, ...] = param((0.0, 25.0, 0.0, -85.0, 0.0, 70.0, 0.0), low=-170.0, high=170.0, unit="deg",
                                           live=False)
    """Where the search for the desired posture q_d starts; q_d is near it, with the end effector at the centre."""


def make_path(config: TaskConfig) -> Path:
    """The path of a task. Raises ConfigError for a file of waypoints that is none."""
    centre, phase = np.asarray(config.centre), config.start * np.pi / 3.0
    if config.kind in ("hold", "follow"):
        return Point(centre)
    if config.kind == "circle":
        return Circle(centre, config.radius, phase)
    if config.kind == "waypoints":
        return Polygon(read_waypoints(config.waypoints), config.corner)
    angle = phase + np.arange(6) * np.pi / 3.0
    ring = np.column_stack([np.zeros(6), np.cos(angle), np.sin(angle)])
    return Polygon(centre + config.radius * ring, config.corner)


class Motion(NamedTuple):
    """Of a reference: ds/dt along the path [m/s]; the offset from the path [m] (3,) and its velocity [m/s] (3,)."""

    rate: float
    offset: Array
    drift: Array


class PathFollower:
    """Progress along a path: it can be slowed, frozen and resumed, exchanged for another, and never jumps.

    x_d is the path's point plus an offset. A path that is joined begins with the offset that leaves x_d where it is, and as
    fast as it is; the offset then goes to zero, no faster than `approach` [m/s] and with no more than `acceleration` [m/s2].
    All of it runs in the path's own time: frozen, it stands still wherever it is.
    """

    def __init__(self, path: Path, speed: float, approach: float = 0.25, acceleration: float = 1.0) -> None:
        self.path = path
        self.speed, self.approach, self.acceleration = speed, approach, acceleration
        self.s = 0.0
        self._motion = Motion(speed, np.zeros(3), np.zeros(3))
        self._x_d = self._reference()

    @property
    def x_d(self) -> Array:
        """The reference now [m] (3,)."""
        return self._x_d

    def _reference(self) -> Array:
        x_d = self.path.at(self.s) + self._motion.offset
        x_d.flags.writeable = False
        return x_d

    @property
    def velocity(self) -> Array:
        """dx_d at the task's full speed [m/s] (3,)."""
        h = 1e-4
        tangent = (self.path.at(self.s + h) - self.path.at(self.s - h)) / (2.0 * h)
        return self._motion.rate * tangent + self._motion.drift

    @property
    def stand(self) -> Array:
        """Where the reference comes to a stand if it begins to slow down now [m] (3,)."""
        v = self.velocity
        speed = float(np.sqrt(v @ v))
        if speed < 1e-9:
            return self.x_d
        return self.x_d + v / speed * max(speed**2 / (2.0 * BRAKING * self.acceleration), speed / SETTLE)

    @property
    def joined(self) -> bool:
        """Whether the reference is on its path, or at its target, to a millimetre."""
        return float(np.abs(self._motion.offset).max()) < 1e-3

    def ahead(self, dt: float) -> Array:
        """dx_d over the next dt [s] at the task's full speed [m/s] (3,); the reference stays where it is."""
        s, motion = self._after(1.0, dt)
        return (self.path.at(s) + motion.offset - self.x_d) / dt

    def advance(self, path_speed: float, dt: float) -> Array:
        """Move on by `path_speed` (0..1) times the task's speed for dt [s]; returns dx_d over that time [m/s] (3,)."""
        before = self.x_d
        self.s, self._motion = self._after(path_speed, dt)
        self._x_d = self._reference()
        return (self._x_d - before) / dt

    def join(self, path: Path, x: Array | None = None) -> None:
        """Go to another path, to its point that is nearest now, and on along it from there.

        x: where an arm stands that could not keep up [m] (3,): then the reference begins anew there.
        """
        x, v = (self.x_d, self.velocity) if x is None else (x, np.zeros(3))
        self.path, self.s = path, nearest(path, x)
        self._motion = Motion(0.0, x - path.at(self.s), v)
        self._x_d = self._reference()

    def _after(self, path_speed: float, dt: float) -> tuple[float, Motion]:
        """Arc length and motion after dt [s] more at `path_speed` (0..1)."""
        m, change = self._motion, self.acceleration * path_speed * dt
        offset, drift = m.offset, m.drift
        distance = float(np.sqrt(offset @ offset))
        wanted = self.speed if distance < JOINED else 0.0
        rate = min(max(wanted, m.rate - change), m.rate + change)
        if distance > 0.0 or drift.any():
            drift = drift + laws.saturated(self._homing(offset, distance) - drift, change)
            offset = offset + drift * path_speed * dt
            if float(np.abs(offset).max()) < NOTHING and float(np.abs(drift).max()) < NOTHING:
                offset, drift = np.zeros(3), np.zeros(3)
        return self.s + rate * path_speed * dt, Motion(rate, offset, drift)

    def _homing(self, offset: Array, distance: float) -> Array:
        """The velocity that brings the offset to zero, in time to stop there [m/s] (3,)."""
        if distance == 0.0:
            return np.zeros(3)
        braking = float(np.sqrt(2.0 * BRAKING * self.acceleration * distance))
        return offset * (-min(self.approach, braking, SETTLE * distance) / distance)


def nearest(path: Path, x: Array) -> float:
    """The arc length [m] of the path's point nearest to x [m] (3,), to a tenth of a millimetre."""
    s, width = np.linspace(0.0, path.length, SAMPLES, endpoint=False), path.length / SAMPLES
    while True:
        distances = [float(np.linalg.norm(path.at(v) - x)) for v in s]
        best = float(s[int(np.argmin(distances))])
        if width < 1e-4:
            return best
        s, width = np.linspace(best - width, best + width, 21), width / 10.0
