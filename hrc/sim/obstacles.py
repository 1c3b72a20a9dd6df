"""Obstacles that yield: sliding bodies whose drive is limited in force and torque, and the ways they are moved and turned."""

import math
from dataclasses import dataclass, field
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrc.errors import EventError, unknown
from hrc.events import Event, MoveObstacle, Press, RemoveObstacle
from hrc.geometry import quaternion_from_rotation, rotation_about, rotation_from_quaternion, rotation_vector, transform
from hrc.messages import Body
from hrc.parameters import Parameters, param
from hrc.scene import BodySpec
from hrc.sim.world import geoms, parked

Array = NDArray[np.float64]
ZETA = 0.7
STILL = np.zeros(3)
ROOM = 0.01
"""An obstacle may appear no nearer to the robot than this [m]: a body put into overlap is thrown out with kilonewtons."""


@dataclass(frozen=True)
class ObstacleConfig(Parameters):
    """The drive of an obstacle that a person drags."""

    stiffness: float = param(1000.0, low=10.0, high=5000.0, unit="N/m")
    """Stiffness of the drive towards where the obstacle is dragged."""
    cap: float = param(100.0, low=1.0, high=200.0, unit="N")
    """No obstacle pushes harder than this, nor is it turned harder than this force at its farthest point would."""
    speed: float = param(0.5, low=0.01, high=2.0, unit="m/s")
    """No obstacle is dragged faster than this, nor is its farthest point turned faster."""


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
        step, velocity = self.target - self._setpoint, STILL
        distance = math.sqrt(step @ step)
        if distance > 1e-9:
            velocity = step / distance * min(c.speed, distance / dt)
            self._setpoint = self._setpoint + velocity * dt
        lead = self._setpoint - position
        leash = c.cap / c.stiffness
        length = math.sqrt(lead @ lead)
        if length > leash:
            self._setpoint = position + lead * (leash / length)
        return Drive(self._setpoint, velocity, c.stiffness, c.cap)


class Pressing:
    """The choreography of a Press: follow the link point and close the gap, press, hold, withdraw."""

    GAP = 0.06
    """Distance to the surface when the approach begins, unless it comes from aside [m]."""
    AWAY = 0.5
    """It is done when it has withdrawn this far [m]."""

    def __init__(self, press: Press, body: BodySpec, R: Array, robot: LinkSurface) -> None:
        """R: the body's orientation (3, 3)."""
        self._press = press
        self._n = np.asarray(press.direction)
        extent = body.extent(R.T @ self._n)
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


class Turn:
    """Goes for an orientation at limited speed, and yields to what is in the way.

    A body has no inertia against turning: a viscous drive turns it about its centre, by speed / reach [rad/s] at most, reach
    [m] being the distance of its farthest point. The torque of its contacts slows it down, holds it at cap * reach [N m], and
    turns it back above. Meanwhile the body slides as it would, so the net force of its contacts is still that of its drive.
    Once it is there, within CLOSE, its orientation is fixed.
    """

    CLOSE = 1e-3
    """Difference of orientation that is none [rad]."""

    def __init__(self, target: Array) -> None:
        """target: orientation (3, 3)."""
        self.target = target

    def step(self, R: Array, torque: Array, reach: float, c: ObstacleConfig, dt: float) -> Array:
        """The orientation (3, 3) after this tick; the target itself when it is there. torque [N m] (3,): of the contacts."""
        fastest = c.speed / reach
        error = rotation_vector(self.target @ R.T)
        velocity = error * min(fastest / max(float(np.linalg.norm(error)), 1e-9), 1.0 / dt)
        velocity = velocity + torque * fastest / (c.cap * reach)
        speed = float(np.linalg.norm(velocity))
        if speed > 0.0:
            R = rotation_about(velocity, min(speed, fastest) * dt) @ R
        if np.linalg.norm(rotation_vector(self.target @ R.T)) < self.CLOSE:
            return self.target
        return rotation_from_quaternion(quaternion_from_rotation(R))  # rounding does not add up


@dataclass
class _Obstacle:
    """position, velocity, applied: views of the plant's, which stay where they are; anew they take as long as their use."""

    spec: BodySpec
    index: int
    position: Array
    velocity: Array
    applied: Array
    present: bool = False
    mover: Drag | Pressing | None = None
    turn: Turn | None = None
    R: Array = field(default_factory=lambda: np.eye(3))
    away: Body = field(init=False)


class Obstacles:
    """All obstacles of the scene, inside the compiled world."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, specs: tuple[BodySpec, ...],
                 config: ObstacleConfig) -> None:
        self._model, self._data, self.config = model, data, config
        self._all = {s.name: _Obstacle(s, i, *_slides(data, i)) for i, s in enumerate(specs)}
        for obstacle in self._all.values():
            self._park(obstacle)

    def apply(self, event: Event, robot: LinkSurface) -> None:
        """Take an obstacle event. Raises EventError for an unknown obstacle, or one that has no room to appear."""
        if isinstance(event, (MoveObstacle, RemoveObstacle, Press)):
            obstacle = self._all.get(event.name)
            if obstacle is None:
                raise EventError(unknown("obstacle", event.name, self._all))
            if isinstance(event, RemoveObstacle):
                self._park(obstacle)
            elif isinstance(event, Press):
                pressing = Pressing(event, obstacle.spec, obstacle.R, robot)
                self._appear(obstacle, pressing.start(), obstacle.R)
                obstacle.mover = pressing
            else:
                self._move(obstacle, event)

    def step(self, dt: float) -> None:
        """Set every drive's force for the coming tick."""
        for obstacle in self._all.values():
            if obstacle.mover is None:
                continue
            if obstacle.turn is not None:
                R = obstacle.turn.step(obstacle.R, self._torque(obstacle), obstacle.spec.reach, self.config, dt)
                if R is obstacle.turn.target:
                    obstacle.turn = None
                self._orient(obstacle, R)
            position = self._position(obstacle)
            drive = obstacle.mover.drive(position, self.config, dt)
            if drive is None:
                self._park(obstacle)
                continue
            damping = 2.0 * ZETA * math.sqrt(drive.stiffness * obstacle.spec.mass)
            pull = drive.stiffness * (drive.position - position) + damping * (drive.velocity - obstacle.velocity)
            length = math.sqrt(pull @ pull)
            obstacle.applied[:] = pull if length <= drive.cap else pull * (drive.cap / length)

    def bodies(self) -> tuple[Body, ...]:
        """Where they are now."""
        return tuple(self._body(o) if o.present else o.away for o in self._all.values())

    def _move(self, obstacle: _Obstacle, event: MoveObstacle) -> None:
        target = np.asarray(event.position)
        R = rotation_from_quaternion(event.wxyz) if event.wxyz is not None else obstacle.R
        if not obstacle.present:
            self._appear(obstacle, target, R)
        elif event.wxyz is not None:
            obstacle.turn = Turn(R)
        if isinstance(obstacle.mover, Drag):
            obstacle.mover.target = target
        else:
            obstacle.mover = Drag(self._position(obstacle), target)

    def _appear(self, obstacle: _Obstacle, position: Array, R: Array) -> None:
        """Put the body at this pose at once; EventError, with nothing changed, if the robot is in the way."""
        before = obstacle.position.copy(), obstacle.velocity.copy(), obstacle.R
        self._put(obstacle, position)
        self._orient(obstacle, R)
        gap = self._room(obstacle)
        if gap < ROOM:
            obstacle.position[:], obstacle.velocity[:] = before[:2]
            self._orient(obstacle, before[2])
            raise EventError(f'no room for "{obstacle.spec.name}" there: {max(gap, 0) * 1e3:.0f} mm from the robot, '
                             f"at least {ROOM * 1e3:.0f} mm are needed")
        obstacle.present, obstacle.turn = True, None

    def _orient(self, obstacle: _Obstacle, R: Array) -> None:
        obstacle.R = R
        self._model.body_quat[self._model.body(obstacle.spec.name).id] = quaternion_from_rotation(R)

    def _torque(self, obstacle: _Obstacle) -> Array:
        """Torque of all contacts on the body, about its origin, after the last tick [N m] (3,)."""
        own, centre = geoms(self._model, obstacle.spec), self._position(obstacle)
        torque, wrench = np.zeros(3), np.empty(6)
        for i in range(self._data.ncon):
            contact = self._data.contact[i]
            first, second = (own.start <= geom < own.stop for geom in contact.geom)
            if first or second:
                mujoco.mj_contactForce(self._model, self._data, i, wrench)
                # MuJoCo's normal points from the first geom to the second, and so does the force on the second.
                force = contact.frame.reshape(3, 3).T @ wrench[:3] * (1.0 if second else -1.0)
                torque += np.cross(contact.pos - centre, force)
        return torque

    def _room(self, obstacle: _Obstacle) -> float:
        """Distance to the nearest collision geom of the robot [m], up to 0.2 m."""
        mujoco.mj_kinematics(self._model, self._data)
        own = geoms(self._model, obstacle.spec)
        gaps = [mujoco.mj_geomDistance(self._model, self._data, part, g, 0.2, None)
                for part in range(own.start, own.stop) for g in range(self._model.ngeom) if self._model.geom_contype[g] == 1]
        return min(gaps, default=0.2)

    def _park(self, obstacle: _Obstacle) -> None:
        obstacle.present, obstacle.mover, obstacle.turn = False, None, None
        self._put(obstacle, parked(obstacle.index))
        obstacle.applied[:] = 0.0
        obstacle.away = self._body(obstacle)

    def _body(self, obstacle: _Obstacle) -> Body:
        spec = obstacle.spec
        return Body(spec.name, spec.shape, spec.size, transform(obstacle.R, self._position(obstacle)), obstacle.present)

    def _put(self, obstacle: _Obstacle, position: Array) -> None:
        obstacle.position[:], obstacle.velocity[:] = position, 0.0

    def _position(self, obstacle: _Obstacle) -> Array:
        return obstacle.position.copy()


def _slides(data: mujoco.MjData, index: int) -> tuple[Array, Array, Array]:
    """Of an obstacle's three slides, after the robot's seven joints, the positions, velocities and applied forces: views."""
    dofs = slice(7 + 3 * index, 10 + 3 * index)
    return data.qpos[dofs], data.qvel[dofs], data.qfrc_applied[dofs]
