"""Steering: which task, target and posture the arm has, and how they are exchanged while it moves."""

import numpy as np
from numpy.typing import NDArray

from hrc.cell.reach import Reach
from hrc.cell.task import Task, plan
from hrc.control.paths import Path, Point
from hrc.control.posture import Posture
from hrc.control.reference import KINDS, PathFollower, TaskConfig, nearest
from hrc.errors import ConfigError, EventError, unknown
from hrc.events import MoveTarget, SetPosture, SetTask
from hrc.messages import Aim, Mode, RobotState, frozen
from hrc.model import Dynamics, JointLimits
from hrc.scene import Scene

Array = NDArray[np.float64]
FOLLOW = "follow"
STANDS, STUCK = 0.01, 0.01
"""An arm whose joints are all slower than the first [rad/s], farther from its reference than the second [m], is stuck."""


class Steering:
    """Acts on the reference and the posture that the reaction follows; `aim` says what they are after."""

    def __init__(self, config: TaskConfig, task: Task, reference: PathFollower, posture: Posture, dynamics: Dynamics,
                 limits: JointLimits, scene: Scene) -> None:
        self._config, self._limits, self._scene, self._dynamics = config, limits, scene, dynamics
        self._reference, self._posture = reference, posture
        self._reach = Reach(dynamics, limits, scene, task.R_d)
        self._paths: dict[str, Path] = {config.kind: task.path}
        self._kind = config.kind
        self._target = self._goal = reference.x_d if config.kind == FOLLOW else None
        self.configure(config)

    def configure(self, config: TaskConfig) -> None:
        """Take over what may change while the cell runs: speeds, acceleration, the posture's rate."""
        self._reference.speed, self._reference.approach = config.speed, config.approach
        self._reference.acceleration, self._posture.rate = config.acceleration, config.posture_rate

    @property
    def aim(self) -> Aim:
        """What the end effector is to do now."""
        return Aim(self._kind, self._posture.goal, self._target, self._goal, self._reference.joined)

    def apply(self, event: SetTask | MoveTarget | SetPosture, state: RobotState, mode: Mode) -> None:
        """state, mode: of the arm now. Raises EventError or ConfigError, with nothing changed."""
        if isinstance(event, SetTask):
            self._set_task(event.kind, state, mode)
        elif isinstance(event, MoveTarget):
            self._move_target(frozen(event.position, (3,)), state, mode)
        else:
            self._set_posture(frozen(event.q, (7,)))

    def _set_task(self, kind: str, state: RobotState, mode: Mode) -> None:
        if kind not in KINDS:
            raise EventError(unknown("task", kind, KINDS))
        if kind == self._kind:
            return
        start = self._start(state, mode)
        if kind == FOLLOW:
            x = self._reference.stand if start is None else start
            self._go(x, start, state.q)
        else:
            if kind not in self._paths:
                # The way round is checked once for each kind: up to a third of a second for a long file of waypoints.
                self._paths[kind] = plan(self._config.replace(kind=kind), self._dynamics, self._limits, self._scene).path
            path = self._paths[kind]
            self._check_the_way(path, state.q)
            self._reference.join(path, start)
            self._target = self._goal = None
        self._kind = kind

    def _check_the_way(self, path: Path, q: Array) -> None:
        """Raises EventError if the arm would not get to a path's nearest point straight from where it is."""
        x = self._reference.x_d
        to = path.at(nearest(path, x))
        self._reach.check(to, x)
        at = self._reach.nearest(to, q, self._posture.goal)
        if at is not to:
            raise EventError(
                f"straight from here the arm does not get to the path, but to {np.round(at, 3).tolist()} m; move it nearer to "
                f'{np.round(to, 3).tolist()} m in the task "{FOLLOW}" first')

    def _move_target(self, x: Array, state: RobotState, mode: Mode) -> None:
        if self._kind != FOLLOW:
            raise EventError(f'the task is "{self._kind}", which has no target; SetTask "{FOLLOW}" gives it one')
        self._reach.check(x, self._reference.x_d)
        self._go(x, self._start(state, mode), state.q)

    def _go(self, x: Array, start: Array | None, q: Array) -> None:
        goal = self._reach.nearest(x, q, self._posture.goal)
        self._reference.join(Point(goal), start)
        self._target, self._goal = x, goal

    def _start(self, state: RobotState, mode: Mode) -> Array | None:
        """Where the reference begins anew, if the arm stands where it could not keep up with it; else None."""
        x = self._dynamics.kinematics(state.q)[1]
        stuck = mode is Mode.IDLE and float(np.abs(state.dq).max()) < STANDS
        return x if stuck and float(np.linalg.norm(x - self._reference.x_d)) > STUCK else None

    def _set_posture(self, q_d: Array) -> None:
        low, high = self._limits.q_min, self._limits.q_max
        beyond = np.flatnonzero((q_d < low) | (q_d > high))
        if len(beyond):
            j = int(beyond[0])
            raise ConfigError(f"joint {j + 1} of the posture must be from {np.rad2deg(low[j]):.0f} to "
                              f"{np.rad2deg(high[j]):.0f} deg, not {np.rad2deg(q_d[j]):.1f}")
        self._posture.goal = q_d
