"""The simulated robot: MuJoCo's contact and motion, behind the interface of the real one.

Commanded by joint velocities as over FRI, it answers with q, dq and link-side joint torques. Inside runs the servo:
computed torque in plain motor actuators at the base rate. (MuJoCo's own position and velocity actuators under an implicit
integrator report a torque that is not the one integrated, which reads as a contact of newton metres.)
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrc.errors import SensorError
from hrc.events import Event, MoveObstacle, Press, Pull, Push, Release, RemoveObstacle
from hrc.messages import LINKS, Body, RobotState, Truth
from hrc.model import Dynamics, joint_limits, pinocchio_model
from hrc.parameters import Parameters, param
from hrc.scene import Scene
from hrc.sim.faults import FaultConfig, JointFaults
from hrc.sim.obstacles import ObstacleConfig, Obstacles
from hrc.sim.push import Grip, PushConfig
from hrc.sim.sensor import Encoder, TorqueSensor
from hrc.sim.world import compile_world

Array = NDArray[np.float64]


DIVERGED = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1)
"""MuJoCo's warnings after which it has put the state back to zero."""


@dataclass(frozen=True)
class PlantConfig(Parameters):
    """The simulated robot's imperfections and its servo."""

    torque_noise: float = param(0.003, low=0.0, high=0.1, live=False)
    """Standard deviation of the torque sensors' noise, as a fraction of each joint's torque limit."""
    friction_left: float = param(0.2, low=0.0, high=2.0, live=False)
    """Part of the friction and offset that link-side sensors of a real LWR show, left after compensation."""
    payload: float = param(0.0, low=0.0, high=7.0, unit="kg", live=False)
    """A weight at the flange that neither servo nor observer knows of."""
    encoder_step: float = param(0.0, low=0.0, high=0.01, unit="rad", live=False)
    """Step of the joint encoders; velocities are then differences of readings over a control period."""
    jitter: int = param(0, low=0, high=20, live=False)
    """A command takes effect up to this many ticks late, each time anew."""
    servo_wn: float = param(60.0, low=5.0, high=200.0, unit="rad/s", live=False)
    """Bandwidth of the joint servo (critically damped)."""
    leash: float = param(0.03, low=0.005, high=0.2, unit="rad", live=False)
    """The servo's reference never leads the joint by more than this, so a blocked arm does not whip when freed."""


class SimulatedRobot:
    """The plant: one step is one tick of the base rate."""

    def __init__(self, scene: Scene, plant: PlantConfig, push: PushConfig, obstacles: ObstacleConfig, *, base_hz: int,
                 control_hz: int, rng: np.random.Generator) -> None:
        self.model = compile_world(scene, base_hz, plant.payload)
        self._data = data = mujoco.MjData(self.model)
        self._config = plant
        self._dt = 1.0 / base_hz
        self._ramp_ticks = base_hz // control_hz
        self._dynamics = Dynamics(pinocchio_model(self.model, armature=True))
        self.limits = joint_limits(self.model)
        self._sensor = TorqueSensor(self.limits.tau_max, plant.torque_noise, plant.friction_left, rng)
        self._links = np.array([self.model.body(name).id for name in LINKS])
        # Views of the arm's part, which stay where they are: making them anew takes as long as MuJoCo's own step.
        self._q, self._v, self._u, self._applied, self._actuated = (
            part[:7] for part in (data.qpos, data.qvel, data.ctrl, data.qfrc_applied, data.qfrc_actuator))
        self._diverged = data.warning.number[DIVERGED]
        self._armature_rate = self.model.dof_armature[:7] / self._dt
        self._link_of_geom = self._geom_links()
        self._tau_min, self._tau_max = -self.limits.tau_max, self.limits.tau_max
        self.grip = Grip(self.model, self._data, self._links, push)
        self.obstacles = Obstacles(self.model, self._data, scene.bodies, obstacles)
        self._tick = 0
        self._command = self._target = self._issued = np.zeros(7)
        self._since = 0
        self._shares = np.minimum(np.arange(1, self._ramp_ticks + 2) / self._ramp_ticks, 1.0)[:, None]
        self._leash, self._leash_back = np.full(7, plant.leash), np.full(7, -plant.leash)
        self._damping, self._stiffness = np.full(7, 2.0 * plant.servo_wn), np.full(7, plant.servo_wn**2)
        self._ramp(np.zeros(7))
        self._encoder = Encoder(plant.encoder_step, self._ramp_ticks, self._dt)
        self._jitter_rng, self._late = rng.spawn(1)[0], 0
        self.faults = JointFaults(FaultConfig())

    def place(self, q: Array) -> None:
        """Put the arm at rest at q [rad] (7,)."""
        self._q[:] = q
        self._v[:] = 0.0
        mujoco.mj_forward(self.model, self._data)
        self._target = np.array(q)

    def apply(self, event: Event) -> None:
        """Take an event that concerns the plant. Raises EventError for one that cannot be."""
        if isinstance(event, (Pull, Push, Release)):
            self.grip.apply(event)
        elif isinstance(event, (MoveObstacle, RemoveObstacle, Press)):
            self.obstacles.apply(event, self)

    def step(self, dq: Array) -> RobotState:
        """One tick under the velocity command dq [rad/s] (7,); returns what the sensors read after it."""
        v = self._v.copy()
        self._servo(self._q, v, dq)
        self._applied[:] = self.grip.torque()
        self.obstacles.step(self._dt)
        mujoco.mj_step(self.model, self._data)
        if np.count_nonzero(self._diverged):
            raise SensorError("the simulation has diverged; reset it")
        self._tick += 1
        # On the link side of the gear: what the motor gives, less what it takes to turn itself.
        tau = np.subtract(self._v, v, out=v)
        tau *= self._armature_rate
        np.subtract(self._actuated, tau, out=tau)
        readings = np.empty((3, 7))
        readings[0], readings[1], readings[2] = self.faults.spoil(
            *self._encoder.read(self._q, self._v), self._sensor.read(tau, self._v))
        return RobotState.of(self._tick, readings)

    def _servo(self, q: Array, v: Array, dq: Array) -> None:
        """Computed torque towards the command, ramped over one control period."""
        if dq is not self._issued:  # the controller issues a new array every period
            self._issued, self._late = dq, int(self._jitter_rng.integers(self._config.jitter + 1))
        if self._issued is not self._command and self._late <= 0:
            previous, self._command, self._since = self._command, self._issued, 0
            self._ramp(previous)
        self._late -= 1
        i = self._since
        if i < self._ramp_ticks:
            self._since += 1
        ahead = self._target + self._advance[i]
        ahead -= q
        np.maximum(ahead, self._leash_back, out=ahead)  # with np.minimum a third of the time of np.clip
        np.minimum(ahead, self._leash, out=ahead)
        self._target = q + ahead
        ddq = np.multiply(ahead, self._stiffness, out=ahead)
        ddq += self._lead[i]
        ddq -= self._damping * v
        tau = self._dynamics.inverse_dynamics(q, v, ddq)
        np.maximum(tau, self._tau_min, out=tau)
        np.minimum(tau, self._tau_max, out=self._u)

    def _ramp(self, previous: Array) -> None:
        """The servo's reference from a command to the present one: how far it goes in each tick [rad], and what it adds to
        the acceleration [rad/s2]; the last row stands for all ticks that follow."""
        change = self._command - previous
        dq_ref = previous + self._shares * change
        self._advance, self._lead = dq_ref * self._dt, self._damping * dq_ref
        self._lead[:-1] += change / (self._ramp_ticks * self._dt)

    # -- what only the plant knows ----------------------------------------------------------------------------------

    def T_world_link(self) -> Array:
        """True poses of base and links (8, 4, 4)."""
        mujoco.mj_kinematics(self.model, self._data)
        T = np.zeros((len(LINKS), 4, 4))
        T[:, :3, :3] = self._data.xmat[self._links].reshape(-1, 3, 3)
        T[:, :3, 3] = self._data.xpos[self._links]
        T[:, 3, 3] = 1.0
        return T

    def bodies(self) -> tuple[Body, ...]:
        """The obstacles, and the hand of a push or pull."""
        return (*self.obstacles.bodies(), self.grip.hand())

    def truth(self) -> Truth:
        """The true contact: net force, and place of the largest one."""
        F, best, link, p = np.zeros(3), 0.0, -1, np.full(3, np.nan)
        if self.grip.active:
            F = self.grip.force.copy()
            best, link, p = float(np.linalg.norm(F)), self.grip.link, self.grip.p_world
        for touched, f, point in self._contacts():
            F += f
            size = float(np.linalg.norm(f))
            if size > best:
                best, link, p = size, touched, point
        tau = self._data.qfrc_applied[:7] + self._data.qfrc_constraint[:7]
        return Truth(F, p, link if best > 0.0 else -1, tau)

    def touched(self, least: float) -> set[int]:
        """The links with a contact whose force is at least this [N]."""
        return {link for link, f, _ in self._contacts() if np.linalg.norm(f) >= least}

    def _contacts(self) -> Iterator[tuple[int, Array, Array]]:
        """Link, force on the robot [N] (3,) and point [m] (3,) of each contact with the scene."""
        wrench = np.empty(6)
        for i in range(self._data.ncon):
            contact = self._data.contact[i]
            link1, link2 = self._link_of_geom[contact.geom[0]], self._link_of_geom[contact.geom[1]]
            if (link1 < 0) == (link2 < 0):
                continue
            mujoco.mj_contactForce(self.model, self._data, i, wrench)
            # MuJoCo's normal points from the first geom to the second, and so does the force on the second.
            f = contact.frame.reshape(3, 3).T @ wrench[:3] * (1.0 if link2 >= 0 else -1.0)
            yield int(max(link1, link2)), f, contact.pos.copy()

    def point(self, link: int, p_link: Array) -> Array:
        """A point of a link [m] (3,), in the world."""
        body = self._links[link]
        return self._data.xpos[body] + self._data.xmat[body].reshape(3, 3) @ p_link

    def reach(self, link: int, p_link: Array, direction: Array) -> float:
        """Distance from a point inside a link to its surface along a direction of the world [m]."""
        inside, far = self.point(link, p_link), 0.5
        geoms = np.flatnonzero((self._link_of_geom == link) & (self.model.geom_contype == 1))
        hits = [self._ray(int(g), inside + far * direction, -direction) for g in geoms]
        return far - min((h for h in hits if h >= 0.0), default=far)

    def _ray(self, geom: int, origin: Array, direction: Array) -> float:
        """Distance along a ray to one geom, -1 for none."""
        kind = self.model.geom_type[geom]
        pose = self._data.geom_xpos[geom], self._data.geom_xmat[geom]
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            return mujoco.mj_rayMesh(self.model, self._data, int(geom), origin, direction, None)
        return mujoco.mju_rayGeom(*pose, self.model.geom_size[geom], origin, direction, int(kind), None)

    def _geom_links(self) -> NDArray[np.int64]:
        """The link of every geom, -1 for those of the scene."""
        of_body = np.full(self.model.nbody, -1)
        of_body[self._links] = np.arange(len(LINKS))
        return of_body[self.model.geom_bodyid]

