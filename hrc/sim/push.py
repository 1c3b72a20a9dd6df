"""A hand at a point of the robot: the mouse's spring, or a given force, and the hand that the camera sees."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrc import meshes
from hrc.events import Event, Pull, Push, Release
from hrc.geometry import transform
from hrc.messages import Body, read_only
from hrc.parameters import Parameters, param
from hrc.scene import BodySpec

Array = NDArray[np.float64]
HAND_RADIUS = 0.045
"""Radius of the hand drawn in the depth scene [m]."""
HAND_LIFT = 0.03
"""Its centre stands this far out of the surface [m]."""
NOTHING, STILL = np.zeros(3), np.zeros(7)
HAND = BodySpec("grip", "sphere", (HAND_RADIUS,), rgb=(0.93, 0.72, 0.60))
AWAY = Body(HAND.name, HAND.shape, HAND.size, np.eye(4), present=False, virtual=True)
read_only(AWAY.T_world_body)


@dataclass(frozen=True)
class PushConfig(Parameters):
    """The spring of a mouse pull."""

    stiffness: float = param(150.0, low=20.0, high=1000.0, unit="N/m")
    """Stiffness of the spring between the grabbed point and the mouse."""
    damping: float = param(30.0, low=0.0, high=200.0, unit="N s/m")
    """Damping of that spring."""
    cap: float = param(80.0, low=1.0, high=150.0, unit="N")
    """A pull is never stronger than this."""


class Grip:
    """What holds the robot: nothing, a Pull's spring, or a Push's force."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, links: NDArray[np.int64], config: PushConfig) -> None:
        self.config = config
        self._model, self._data = model, data
        # Views of each link's pose, which stay where they are.
        self._poses = [(data.xpos[body], data.xmat[body].reshape(3, 3)) for body in links.tolist()]
        self._bodies = links.tolist()
        self._event: Pull | Push | None = None
        self._normal = np.array([0.0, 0.0, 1.0])
        self._point = self._wanted = np.zeros(3)  # of the event, as arrays
        self.force = np.zeros(3)
        self._J = np.zeros((3, model.nv))
        self._J_arm, self._dq = self._J[:, :7], data.qvel[:7]

    @property
    def active(self) -> bool:
        """Whether something holds the robot."""
        return self._event is not None

    @property
    def link(self) -> int:
        """The link that is held, -1 for none."""
        return self._event.link if self._event is not None else -1

    @property
    def p_world(self) -> Array:
        """The held point [m] (3,), in the world; NaN without one."""
        if self._event is None:
            return np.full(3, np.nan)
        position, R = self._poses[self._event.link]
        return position + R @ self._point

    @property
    def pull(self) -> tuple[Array, Array] | None:
        """The held point and where it is pulled to [m], while it is a Pull."""
        return (self.p_world, self._wanted) if isinstance(self._event, Pull) else None

    def apply(self, event: Event) -> None:
        """Take a Pull, Push or Release."""
        if isinstance(event, Release):
            self._event = None
        elif isinstance(event, (Pull, Push)):
            held = self._event
            if held is None or (held.link, held.point) != (event.link, event.point):
                self._normal = outward(event.link, np.asarray(event.point))
            self._event, self._point = event, np.array(event.point)
            self._wanted = np.array(event.target if isinstance(event, Pull) else event.force)

    def torque(self) -> Array:
        """Joint torque of the force in the coming tick [N m] (7,); `force` [N] (3,) is that force, on the robot."""
        event = self._event
        if event is None:
            self.force = NOTHING
            return STILL
        p, J = self.p_world, self._J
        mujoco.mj_jac(self._model, self._data, J, None, p, self._bodies[event.link])
        if isinstance(event, Push):
            self.force = self._wanted
        else:
            config, velocity = self.config, self._J_arm @ self._dq  # nothing but the arm moves its links
            pull = config.stiffness * (self._wanted - p) - config.damping * velocity
            strength = math.sqrt(pull @ pull)
            self.force = pull if strength <= config.cap else pull * (config.cap / strength)
        return self.force @ self._J_arm

    def hand(self) -> Body:
        """The hand in the depth scene: it stands on the surface and collides with nothing."""
        if self._event is None:
            return AWAY
        R = self._poses[self._event.link][1]
        T = transform(np.eye(3), self.p_world + HAND_LIFT * R @ self._normal)
        return Body(HAND.name, HAND.shape, HAND.size, T, virtual=True)


def outward(link: int, p_link: Array) -> Array:
    """The unit normal of a link's surface nearest to a point [m] (3,), in the link's frame."""
    mesh = meshes.robot("perception")[link]
    nearest = int(np.argmin(((mesh.vertices - p_link) ** 2).sum(axis=1)))
    return mesh.normals[nearest]
