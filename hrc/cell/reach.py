"""Where the end effector can go: within the arm's length, outside the environment, as far as the joint limits let it."""

import numpy as np
from numpy.typing import NDArray

from hrc.control import laws
from hrc.control.limits import MARGIN, limited
from hrc.errors import ConfigError, EventError
from hrc.geometry import rotation_vector
from hrc.model import Dynamics, JointLimits
from hrc.scene import Scene

Array = NDArray[np.float64]
ROOM = 0.01
"""The end effector keeps this far from the environment [m]."""
SPACE = 0.01
"""What counts as reachable keeps this much more than the control's margin from every joint limit [rad]."""
STRIDE, RELAXATION = 0.03, 0.3
"""A way is tried every so many metres; at each point the posture makes up for this part of what it lacks."""
TRIES, LAST = 6, 40
"""Corrections at each point of a way, and at its end or where it does not go on."""
CLOSE, THERE = 5e-3, 1e-3
"""The way goes on as long as the arm follows to within the first, and has led to its end within the second [m]."""
UNBOUNDED = 1e9


class Reach:
    """The limits of one arm in one scene; R: the orientation of the last link to keep (3, 3), if that belongs to the task."""

    def __init__(self, dynamics: Dynamics, limits: JointLimits, scene: Scene, R: Array | None = None) -> None:
        self._dynamics, self._scene, self._R = dynamics, scene, R
        self._low, self._high = limits.q_min + MARGIN + SPACE, limits.q_max - MARGIN - SPACE
        T, tip, _ = dynamics.kinematics(np.zeros(7))
        self.shoulder = T[2, :3, 3].copy()
        self.radius = float(np.linalg.norm(tip - self.shoulder))
        """Of the stretched arm, from the shoulder [m]."""

    def check(self, x: Array, start: Array) -> None:
        """Raises EventError if x [m] (3,) is farther than the arm is long, or the straight way from `start` leads through the
        environment."""
        distance = float(np.linalg.norm(x - self.shoulder))
        if distance > self.radius:
            raise EventError(f"the target {_shown(x)} m is {distance:.2f} m from the shoulder at {_shown(self.shoulder)} m; "
                             f"the arm is {self.radius:.2f} m long")
        try:
            outside(np.stack([x]), self._scene, "the way to the target")
            # A way that begins nearer to the environment than ROOM leads away from it.
            outside(np.linspace(start, x, 50)[1:-1], self._scene, "the straight way to the target", 0.0)
        except ConfigError as error:
            raise EventError(str(error)) from None

    def nearest(self, x: Array, q: Array, q_d: Array) -> Array:
        """The point [m] (3,) where the arm comes to on its way from posture q [rad] (7,) straight to x [m] (3,).

        That is x if it can be reached so; else a point beside the way that can be and is the nearest to x, or the end of the
        way. q_d: the posture that the null space goes for.
        """
        q_end, at = self._walk(x, q, q_d)
        if float(np.linalg.norm(at - x)) < THERE:
            return x
        beside = self._dynamics.kinematics(self._slide(x, q_end))[1]
        if float(np.linalg.norm(beside - x)) < float(np.linalg.norm(at - x)):
            reached = self._walk(beside, q, q_d)[1]
            if float(np.linalg.norm(reached - beside)) < THERE:
                return beside
        return at

    def _walk(self, x: Array, q: Array, q_d: Array) -> tuple[Array, Array]:
        """The control law in steps of space instead of time, straight to x; the posture at the end, and the point."""
        q, start = np.clip(q, self._low, self._high), self._dynamics.kinematics(q)[1]
        n = max(1, int(np.ceil(np.linalg.norm(x - start) / STRIDE)))
        for k in range(1, n + 1):
            q, missing = self._correct(start + (x - start) * (k / n), q, q_d, LAST if k == n else TRIES)
            if missing > CLOSE:
                break
        return q, self._dynamics.kinematics(q)[1]

    def _correct(self, x: Array, q: Array, q_d: Array, tries: int) -> tuple[Array, float]:
        """Eq. (11) and (12) within the joint limits until the arm is at x; the posture, and what is missing [m]."""
        for k in range(LAST):
            e, J = self._error(x, q)
            missing = float(np.linalg.norm(e[:3]))
            if (k >= tries and missing < CLOSE) or (k >= 2 and missing < 0.1 * THERE):
                break
            inverse = laws.inverse(J)
            null = inverse.projector @ (RELAXATION * (q_d - q))
            q = q + limited(inverse.pinv @ e, null, (self._low - q, self._high - q), np.zeros(7), UNBOUNDED).dq
        return q, float(np.linalg.norm(self._error(x, q)[0][:3]))

    def _slide(self, x: Array, q: Array) -> Array:
        """Nearer to x, with whatever joint is at its limit left out."""
        for _ in range(LAST):
            e, J = self._error(x, q)
            step = laws.inverse(J).pinv @ e
            blocked = ((q <= self._low) & (step < 0.0)) | ((q >= self._high) & (step > 0.0))
            step = laws.inverse(np.where(blocked, 0.0, J)).pinv @ e
            q = np.clip(q + 0.5 * step, self._low, self._high)
        return q

    def _error(self, x: Array, q: Array) -> tuple[Array, Array]:
        """What is missing to x [m], and to R as a rotation vector [rad], and the Jacobian of it."""
        T, at, _ = self._dynamics.kinematics(q)
        J = self._dynamics.tool_jacobian(q)
        if self._R is None:
            return x - at, J[:3]
        return np.concatenate([x - at, rotation_vector(self._R @ T[7, :3, :3].T)]), J


def outside(points: Array, scene: Scene, what: str, room: float = ROOM) -> None:
    """Raises ConfigError if one of the points (n, 3) [m] is inside the environment, or nearer to it than `room` [m]."""
    for box in scene.environment:
        inside = np.all(np.abs(points - np.asarray(box.centre)) < np.asarray(box.half) + room, axis=1)
        if inside.any():
            x = points[int(np.argmax(inside))]
            raise ConfigError(f"{what} leads through the {box.name}, at {_shown(x)} m")


def _shown(x: Array) -> list[float]:
    return np.round(x, 3).tolist()
