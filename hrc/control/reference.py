"""The end-effector task: where the arm should be along its path."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.parameters import Parameters, param

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TaskConfig(Parameters):
    """The paper's task: a hexagon on a vertical plane, at constant speed."""

    centre: tuple[float, ...] = param((-0.55, 0.0, 0.45), low=-1.2, high=1.2, unit="m", live=False)
    """Centre of the hexagon, in the world; its plane is x = constant."""
    radius: float = param(0.15, low=0.02, high=0.3, unit="m", live=False)
    """Distance from the centre to a corner."""
    speed: float = param(0.2, low=0.0, high=0.5, unit="m/s")
    """Speed along the path."""
    corner: float = param(0.01, low=0.0, high=0.05, unit="m", live=False)
    """A corner is rounded by a parabola that begins this far before it."""
    start: int = param(3, low=0, high=5, live=False)
    """Corner where the path begins: 0 is the one farthest in +y, and they count with +z."""
    posture_deg: tuple[float, ...] = param((0.0, 25.0, 0.0, -85.0, 0.0, 70.0, 0.0), low=-170.0, high=170.0, unit="deg",
                                           live=False)
    """Where the search for the desired posture q_d starts; q_d is near it, with the end effector at the centre."""


class Hexagon:
    """A closed hexagonal path with parabolic corners, by its arc length."""

    def __init__(self, config: TaskConfig) -> None:
        angle = (np.arange(6) + config.start) * np.pi / 3.0
        ring = np.column_stack([np.zeros(6), np.cos(angle), np.sin(angle)])
        self._corners = np.asarray(config.centre) + config.radius * ring
        self._side = config.radius
        self._blend = min(config.corner, 0.4 * config.radius)
        self._directions = (np.roll(self._corners, -1, axis=0) - self._corners) / self._side
        self.length = 6.0 * self._side

    def at(self, s: float) -> Array:
        """The point of the path [m] (3,) at arc length s [m] (along the sharp hexagon); continuous with its tangent."""
        side, along = divmod(s % self.length, self._side)
        k = int(side) % 6
        rounding = self._blend
        if along < rounding:
            return self._corner(k, along + rounding)
        if along > self._side - rounding:
            return self._corner((k + 1) % 6, along - (self._side - rounding))
        return self._corners[k] + along * self._directions[k]

    def _corner(self, k: int, w: float) -> Array:
        """The parabola around corner k, `w` [m] after its beginning: tangent to both sides."""
        before, after = self._directions[k - 1], self._directions[k]
        if self._blend == 0.0:
            return self._corners[k]
        return self._corners[k] + (w - self._blend) * before + (after - before) * (w * w / (4.0 * self._blend))


class PathFollower:
    """Progress along the path: it can be slowed, frozen and resumed, and never jumps."""

    def __init__(self, path: Hexagon, speed: float) -> None:
        self.path = path
        self.speed = speed
        self.s = 0.0

    @property
    def x_d(self) -> Array:
        """The reference now [m] (3,)."""
        return self.path.at(self.s)

    def advance(self, path_speed: float, dt: float) -> Array:
        """Move on by `path_speed` (0..1) times the task's speed for dt [s]; returns dx_d over that time [m/s] (3,)."""
        before = self.x_d
        self.s += self.speed * path_speed * dt
        return (self.x_d - before) / dt
