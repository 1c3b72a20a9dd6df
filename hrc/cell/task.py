"""From a task's config to a path the arm can run: everything that could be wrong with it is said before anything moves."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.cell.reach import outside
from hrc.control import laws
from hrc.control.paths import Path
from hrc.control.reference import TaskConfig, make_path
from hrc.errors import ConfigError
from hrc.model import Dynamics, JointLimits
from hrc.scene import Scene

Array = NDArray[np.float64]
STEP, MOST = 0.05, 200
"""The path is checked every so many metres, at no more points than this."""


@dataclass(frozen=True, eq=False)
class Task:
    """What the arm is to do. q_d: desired posture; q_start: posture at the path's beginning [rad] (7,).

    R_d: orientation of the last link to keep (3, 3), if that belongs to the task.
    """

    path: Path
    q_d: Array
    q_start: Array
    R_d: Array | None


def plan(config: TaskConfig, dynamics: Dynamics, limits: JointLimits, scene: Scene) -> Task:
    """The task, checked. Raises ConfigError where the path is out of reach, beyond the joint limits, inside the environment, or
    faster than the joints are.
    """
    path = make_path(config)
    s = np.linspace(0.0, path.length, min(MOST, max(2, round(path.length / STEP))), endpoint=False)
    points = np.array([path.at(v) for v in s])
    outside(points, scene, "the path")
    centre = points.mean(axis=0) if config.kind == "waypoints" else np.asarray(config.centre)
    q_d = dynamics.solve_position(centre, np.deg2rad(config.posture_deg))
    q = q_start = dynamics.solve_position(points[0], q_d)
    R = dynamics.kinematics(q)[0][7, :3, :3] if config.upright else None
    for v, x in zip(s, points, strict=True):
        q = dynamics.solve_position(x, q, R)
        where = f"the path at {np.round(x, 3).tolist()} m"
        if np.any(q <= limits.q_min) or np.any(q >= limits.q_max):
            raise ConfigError(f"{where} is beyond the joint limits, at {np.rad2deg(q).round().tolist()} deg")
        J = dynamics.tool_jacobian(q)[: 3 if R is None else 6]
        tangent = np.concatenate([path.at(v + 1e-4) - x, np.zeros(len(J) - 3)]) / 1e-4
        fastest = float(np.abs(laws.inverse(J).pinv @ tangent * config.speed / limits.dq_max).max())
        if fastest > 1.0:
            raise ConfigError(f"{where} is too fast for the joints: {config.speed:g} m/s would take {fastest:.1f} times their "
                              f"limit; at most {config.speed / fastest:.2f} m/s can be done there")
    return Task(path, q_d, q_start, R)
