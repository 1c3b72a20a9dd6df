"""The robot's kinematics and dynamics in Pinocchio, built from the compiled MuJoCo model.

One description, two engines: `assets/lwr/lwr.xml` is compiled by MuJoCo, and the Pinocchio model is made from the
compiled numbers, so both agree to rounding. The servo's model carries the motors' reflected inertia (armature); the
observer's does not, because the torque sensors sit on the link side and tau in Eq. (1)-(2) is what they read.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from hrc.errors import AssetError, ConfigError
from hrc.geometry import rotation_vector, skew
from hrc.jacobian import Terms
from hrc.messages import LINKS
from hrc.parameters import Parameters, param
from hrc.paths import assets

Array = NDArray[np.float64]
DQ_MAX = np.deg2rad([110.0, 110.0, 128.0, 128.0, 204.0, 184.0, 184.0])
"""Joint velocity limits of the LWR 4+ [rad/s]; MJCF has no place for them."""
FLANGE = "flange"


@dataclass(frozen=True)
class ModelConfig(Parameters):
    """How far the model that estimator and controller use is from the plant's."""

    inertial_error: float = param(0.02, low=0.0, high=0.5, live=False)
    """Relative error of every mass, centre of mass and inertia in the observer's model (uniform, drawn from the seed)."""


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of the joints: position [rad], velocity [rad/s], torque [N m], each shape (7,)."""

    q_min: Array
    q_max: Array
    dq_max: Array
    tau_max: Array


def load_spec() -> mujoco.MjSpec:
    """The robot's description, open for additions. Raises AssetError if it is missing or malformed."""
    path = assets() / "lwr" / "lwr.xml"
    try:
        return mujoco.MjSpec.from_file(str(path))
    except (ValueError, FileNotFoundError) as error:
        raise AssetError(f"the robot description {path.name} cannot be read: {error}") from None


def joint_limits(compiled: mujoco.MjModel) -> JointLimits:
    """The limits the compiled model carries, and the velocity limits."""
    joints = [compiled.joint(f"joint_{i}") for i in range(1, 8)]
    motors = [compiled.actuator(f"motor_{i}") for i in range(1, 8)]
    ranges = np.array([j.range for j in joints])
    return JointLimits(ranges[:, 0], ranges[:, 1], DQ_MAX.copy(), np.array([m.forcerange[1] for m in motors]))


def pinocchio_model(compiled: mujoco.MjModel, *, armature: bool) -> pin.Model:
    """The Pinocchio model of the robot inside a compiled MuJoCo model; whatever else the scene holds is left out."""
    model = pin.Model()
    model.name = "lwr"
    model.gravity.linear = compiled.opt.gravity.copy()
    parent, placement = 0, pin.SE3.Identity()
    for name in LINKS:
        body = compiled.body(name)
        placement = placement * pin.SE3(_rotation(body.quat), body.pos.copy())
        if body.jntnum[0]:
            joint = compiled.joint(int(body.jntadr[0]))
            parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(joint.axis.copy()), placement, joint.name)
            placement = pin.SE3.Identity()
            if armature:
                model.armature[model.idx_vs[parent]] = compiled.dof_armature[int(joint.dofadr[0])]
            R = _rotation(body.iquat)
            inertia = pin.Inertia(float(body.mass[0]), body.ipos.copy(), R @ np.diag(body.inertia) @ R.T)
            model.appendBodyToJoint(parent, inertia, placement)
        model.addFrame(pin.Frame(name, parent, 0, placement, pin.FrameType.BODY))
    site = compiled.site(FLANGE)
    flange = placement * pin.SE3(_rotation(site.quat), site.pos.copy())
    model.addFrame(pin.Frame(FLANGE, parent, 0, flange, pin.FrameType.OP_FRAME))
    return model


def perturbed(model: pin.Model, fraction: float, rng: np.random.Generator) -> pin.Model:
    """A copy whose masses, centres of mass and inertias are each off by up to `fraction` (uniform)."""
    copy = model.copy()
    for i in range(1, copy.njoints):
        inertia = copy.inertias[i]
        scale = 1.0 + fraction * rng.uniform(-1.0, 1.0, 5)
        copy.inertias[i] = pin.Inertia(inertia.mass * scale[0], inertia.lever * scale[1:4], inertia.inertia * scale[4])
    return copy


class Dynamics:
    """Kinematics and dynamics at one configuration after the other; holds its own Pinocchio data."""

    def __init__(self, model: pin.Model) -> None:
        self.model = model
        self._data = model.createData()
        self._weightless = model.copy()
        self._weightless.gravity.linear = np.zeros(3)
        self._weightless_data = self._weightless.createData()
        self._flange = model.getFrameId(FLANGE)
        self._frames = [model.getFrameId(name) for name in LINKS]
        self._still = np.zeros(model.nv)

    def terms(self, q: Array, dq: Array) -> Terms:
        """Everything one control cycle needs, at (q, dq)."""
        data = self._data
        C = pin.computeCoriolisMatrix(self.model, data, q, dq)
        Ct_dq = C.T @ dq
        g = pin.computeGeneralizedGravity(self.model, data, q).copy()
        T_world_link, x, J_spatial = self.kinematics(q)
        J = J_spatial[:3] - skew(x) @ J_spatial[3:]
        return Terms(self.momentum(q, dq), Ct_dq, g, T_world_link, x, J, J_spatial)

    def kinematics(self, q: Array) -> tuple[Array, Array, Array]:
        """T_world_link (8, 4, 4), the end effector [m] (3,), and the spatial Jacobian at the world's origin (6, 7)."""
        data = self._data
        J_spatial = pin.computeJointJacobians(self.model, data, q).copy()
        pin.updateFramePlacements(self.model, data)
        T = np.empty((len(self._frames), 4, 4))
        for i, frame in enumerate(self._frames):
            T[i] = data.oMf[frame].homogeneous
        return T, data.oMf[self._flange].translation.copy(), J_spatial

    def momentum(self, q: Array, dq: Array) -> Array:
        """p = M(q) dq: inverse dynamics without gravity and velocity, with dq in the place of the acceleration."""
        return pin.rnea(self._weightless, self._weightless_data, q, self._still, dq).copy()

    def mass_matrix(self, q: Array) -> Array:
        """M(q) [kg m2], shape (7, 7), symmetric."""
        upper = np.triu(pin.crba(self.model, self._data, q))
        return upper + np.triu(upper, 1).T

    def coriolis_matrix(self, q: Array, dq: Array) -> Array:
        """C(q, dq) of Christoffel symbols, shape (7, 7)."""
        return pin.computeCoriolisMatrix(self.model, self._data, q, dq).copy()

    def gravity(self, q: Array) -> Array:
        """g(q) [N m], shape (7,)."""
        return pin.computeGeneralizedGravity(self.model, self._data, q).copy()

    def inverse_dynamics(self, q: Array, dq: Array, ddq: Array) -> Array:
        """M ddq + C dq + g [N m], shape (7,), the left side of Eq. (1)."""
        return pin.rnea(self.model, self._data, q, dq, ddq).copy()

    def tool_jacobian(self, q: Array) -> Array:
        """Jacobian of the end effector's velocity, linear part first, in the world's axes, shape (6, 7)."""
        _, at, J_spatial = self.kinematics(q)
        return np.vstack([J_spatial[:3] - skew(at) @ J_spatial[3:], J_spatial[3:]])

    def solve_position(self, x: Array, q_start: Array, R: Array | None = None, *, iterations: int = 200) -> Array:
        """A configuration near q_start with its end effector at x [m] (Gauss-Newton with a small damping).

        R: the last link's orientation there (3, 3), if it matters. Raises ConfigError when there is none within reach.
        """
        q = np.array(q_start, dtype=float)
        rows = 3 if R is None else 6
        for _ in range(iterations):
            e = self._error(q, x, R)
            J = self.tool_jacobian(q)[:rows]
            step = 0.5 * J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(rows), e)
            q += step
            if float(step @ step) < 1e-24:
                break
        if not np.linalg.norm(self._error(q, x, R)) < 1e-3:
            raise ConfigError(f"the end effector cannot reach {np.round(x, 3).tolist()} m from the posture it starts in")
        return q

    def _error(self, q: Array, x: Array, R: Array | None) -> Array:
        """What is missing to x [m], and to R as a rotation vector [rad], in the world."""
        T, at, _ = self.kinematics(q)
        return x - at if R is None else np.concatenate([x - at, rotation_vector(R @ T[7, :3, :3].T)])


def _rotation(wxyz: Array) -> Array:
    return pin.Quaternion(*(float(c) for c in wxyz)).toRotationMatrix()
