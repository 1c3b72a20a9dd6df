"""Obstacles that yield: sliding bodies whose drive is limited in force, and the ways they are moved."""

from dataclasses import dataclass, field
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrc.errors import EventError, unknown
from hrc.events import Event, MoveObstacle, Press, RemoveObstacle
from hrc.geometry import quaternion_from_rotation, rotation_from_quaternion, transform
from hrc.messages import Body
from hrc.parameters import Parameters, param
from hrc.scene import BodySpec
from hrc.sim.world import parked

Array = NDArray[np.float64]
ZETA = 0.7
ROOM = 0.01
"""An obstacle may appear no nearer to the robot than this [m]: a body put into overlap is thrown out with kilonewtons."""


@dataclass(frozen=True)
class ObstacleConfig(Parameters):
    """The drive of an obstacle that a person drags."""

    stiffness: float = param(1000.0, low=10.0, high=5000.0, unit="N/m")
    """Stiffness of the drive towards where the obstacle is dragged."""
    cap: float = param(100.0, low=1.0, high=200.0, unit="N")
    """No obstacle pushes harder than this."""
    speed: float = param(0.5, low=0.01, high=2.0, unit="m/s")
    """No obstacle is dragged faster than this."""


class LinkSurface(Protocol):
    """What a choreography may know of the plant: where a point of a link is, and how far its surface reaches."""

    def point(self, link: int, p_link: Array) -> Array:
        """A point of a link [m] (3,), in the world."""
        ...

    def reach(self, link: int, p_link: Array, direction: Array) -> float:
        """Distance from that point to the link's surface along a direction of the world [m]."""
        ...


@dataclass
class Drive:
    """Where a body's drive wants it: position [m], velocity [m/s], stiffness [N/m], cap [N]."""

    position: Array
    velocity: Array
    stiffness: float
    cap: float


class Drag:
    """Goes for a fixed target at limited speed, and never winds up: the setpoint stays within cap / stiffness."""

    def __init__(self, position: Array, target: Array) -> None:
        self._setpoint, self.target = position.copy(), target

    def drive(self, position: Array, c: ObstacleConfig, dt: float) -> Drive:
        """The drive for this tick."""
        step = self.target - self._setpoint
        distance = float(np.linalg.norm(step))
        velocity = step / distance * min(c.speed, distance / dt) if distance > 1e-9 else np.zeros(3)
        self._setpoint = self._setpoint + velocity * dt
        lead = self._setpoint - position
        leash = c.cap / c.stiffness
        length = float(np.linalg.norm(lead))
        if length > leash:
            self._setpoint = position + lead * (leash / length)
        return Drive(self._setpoint, velocity, c.stiffness, c.cap)


class Pressing:
    """The choreography of a Press: follow the link point and close the gap, press, hold, withdraw."""

    GAP = 0.06
    """Distance to the surface when the approach begins, unless it comes from aside [m]."""
    AWAY = 0.5
    """It is done when it has withdrawn this far [m]."""

    def __init__(self, press: Press, body: BodySpec, robot: LinkSurface) -> None:
        self._press = press
        self._n = np.asarray(press.direction)
        extent = body.extent(self._n)
        self._point = np.asarray(press.point)
        self._standoff = robot.reach(press.link, self._point, -self._n) + extent
        self._from = np.asarray(press.aside) if press.aside is not None else -self.GAP * self._n
        self._robot = robot
        self._t = 0.0
        self._previous = self.start()
        self._touch = self._previous

    def start(self) -> Array:
        """Where the body appears [m] (3,)."""
        return self._robot.point(self._press.link, self._point) - self._n * self._standoff + self._from

    def drive(self, _: Array, __: ObstacleConfig, dt: float) -> Drive | None:
        """The drive for this tick, or None when it has withdrawn."""
        p = self._press
        self._t += dt
        if self._t < p.approach:
            left = 1.0 - self._t / p.approach
            self._touch = self._robot.point(p.link, self._point) - self._n * self._standoff
            target = self._touch + self._from * left
        else:
            t, pressing = self._t - p.approach, p.depth / p.speed
            away = p.withdraw_speed * max(0.0, t - pressing - p.hold)
            if away > self.AWAY:
                return None
            target = self._touch + self._n * p.speed * min(t, pressing) + self._way_out() * away
        velocity = (target - self._previous) / dt
        self._previous = target
        return Drive(target, velocity, p.stiffness, p.cap)

    def _way_out(self) -> Array:
        """Unit direction of withdrawal: the way it came."""
        return self._from / np.linalg.norm(self._from)


@dataclass
class _Obstacle:
    spec: BodySpec
    index: int
    present: bool = False
    mover: Drag | Pressing | None = None
    R: Array = field(default_factory=lambda: np.eye(3))


class Obstacles:
    """All obstacles of the scene, inside the compiled world."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, specs: tuple[BodySpec, ...],
                 config: ObstacleConfig) -> None:
        self._model, self._data, self.config = model, data, config
        self._all = {s.name: _Obstacle(s, i) for i, s in enumerate(specs)}
        for obstacle in self._all.values():
            self._put(obstacle, parked(obstacle.index))

    def apply(self, event: Event, robot: LinkSurface) -> None:
        """Take an obstacle event. Raises EventError for an unknown obstacle, or one that has no room to appear."""
        if isinstance(event, (MoveObstacle, RemoveObstacle, Press)):
            obstacle = self._all.get(event.name)
            if obstacle is None:
                raise EventError(unknown("obstacle", event.name, self._all))
            if isinstance(event, RemoveObstacle):
                self._park(obstacle)
            elif isinstance(event, Press):
                pressing = Pressing(event, obstacle.spec, robot)
                self._appear(obstacle, pressing.start(), obstacle.R)
                obstacle.mover = pressing
            else:
                self._move(obstacle, event)

    def step(self, dt: float) -> None:
        """Set every drive's force for the coming tick."""
        for obstacle in self._all.values():
            force = self._data.qfrc_applied[self._dofs(obstacle)]
            force[:] = 0.0
            if obstacle.mover is None:
                continue
            position = self._position(obstacle)
            drive = obstacle.mover.drive(position, self.config, dt)
            if drive is None:
                self._park(obstacle)
                continue
            damping = 2.0 * ZETA * np.sqrt(drive.stiffness * obstacle.spec.mass)
            velocity = self._data.qvel[self._dofs(obstacle)]
            pull = drive.stiffness * (drive.position - position) + damping * (drive.velocity - velocity)
            force[:] = pull * min(1.0, drive.cap / max(float(np.linalg.norm(pull)), 1e-9))

    def bodies(self) -> tuple[Body, ...]:
        """Where they are now."""
        return tuple(Body(o.spec.name, o.spec.shape, o.spec.size, transform(o.R, self._position(o)), o.present)
                     for o in self._all.values())

    def _move(self, obstacle: _Obstacle, event: MoveObstacle) -> None:
        target = np.asarray(event.position)
        R = rotation_from_quaternion(event.wxyz) if event.wxyz is not None else obstacle.R
        if not obstacle.present:
            self._appear(obstacle, target, R)
        elif not np.array_equal(R, obstacle.R):
            self._appear(obstacle, self._position(obstacle), R)
        if isinstance(obstacle.mover, Drag):
            obstacle.mover.target = target
        else:
            obstacle.mover = Drag(self._position(obstacle), target)

    def _appear(self, obstacle: _Obstacle, position: Array, R: Array) -> None:
        """Put the body at this pose at once; EventError, with nothing changed, if the robot is in the way."""
        before = self._data.qpos[self._dofs(obstacle)].copy(), self._data.qvel[self._dofs(obstacle)].copy(), obstacle.R
        self._put(obstacle, position)
        self._turn(obstacle, R)
        gap = self._room(obstacle)
        if gap < ROOM:
            self._data.qpos[self._dofs(obstacle)], self._data.qvel[self._dofs(obstacle)] = before[:2]
            self._turn(obstacle, before[2])
            raise EventError(f'no room for "{obstacle.spec.name}" there: {max(gap, 0) * 1e3:.0f} mm from the robot, '
                             f"at least {ROOM * 1e3:.0f} mm are needed")
        obstacle.present = True

    def _turn(self, obstacle: _Obstacle, R: Array) -> None:
        obstacle.R = R
        self._model.geom_quat[self._model.geom(obstacle.spec.name).id] = quaternion_from_rotation(R)

    def _room(self, obstacle: _Obstacle) -> float:
        """Distance to the nearest collision geom of the robot [m], up to 0.2 m."""
        mujoco.mj_kinematics(self._model, self._data)
        own = self._model.geom(obstacle.spec.name).id
        gaps = [mujoco.mj_geomDistance(self._model, self._data, own, g, 0.2, None)
                for g in range(self._model.ngeom) if self._model.geom_contype[g] == 1]
        return min(gaps, default=0.2)

    def _park(self, obstacle: _Obstacle) -> None:
        obstacle.present, obstacle.mover = False, None
        self._put(obstacle, parked(obstacle.index))

    def _put(self, obstacle: _Obstacle, position: Array) -> None:
        self._data.qpos[self._dofs(obstacle)] = position
        self._data.qvel[self._dofs(obstacle)] = 0.0

    def _position(self, obstacle: _Obstacle) -> Array:
        return self._data.qpos[self._dofs(obstacle)].copy()

    @staticmethod
    def _dofs(obstacle: _Obstacle) -> slice:
        """The three slides, after the robot's seven joints; the same indices in qpos and qvel."""
        return slice(7 + 3 * obstacle.index, 10 + 3 * obstacle.index)
