"""The MuJoCo world: the robot, the environment and the obstacles, compiled once."""

import mujoco
import numpy as np

from hrc.errors import AssetError
from hrc.figure import parts
from hrc.geometry import Array, quaternion_from_rotation
from hrc.messages import LINKS
from hrc.model import FLANGE, load_spec
from hrc.scene import BodySpec, Scene

SKIN = {"solref": [-6000.0, -120.0], "solimp": [0.0, 0.9, 0.005, 0.5, 2.0]}
"""Contact impedance of an obstacle: progressive, so that its drive sets the softness and the contact does not chatter."""
PARKED = -20.0
"""Obstacles outside the scene wait at this height [m], 2 m apart, without drive."""
ROBOT_BIT, SCENE_BIT = 1, 2
PAYLOAD_AT = np.array([0.0, 0.0, 0.05])
"""Where the centre of a payload is, from the flange [m]."""


def compile_world(scene: Scene, base_hz: int, payload: float = 0.0) -> mujoco.MjModel:
    """The compiled model: the robot first (7 degrees of freedom), then three slides for each obstacle, in order.

    payload [kg]: of a weight at the flange, a body of its own that no model made of the links knows. Raises AssetError if a
    file of the robot is missing or malformed.
    """
    spec = load_spec()
    spec.option.timestep = 1.0 / base_hz
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # the sparse solver of MuJoCo 4.0.0 is wrong
    for box in scene.environment:
        spec.worldbody.add_geom(
            name=box.name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=list(box.centre), size=list(box.half),
            contype=SCENE_BIT, conaffinity=ROBOT_BIT | SCENE_BIT)
    if payload > 0.0:
        _add_payload(spec, payload)
    for body in scene.bodies:
        _add_obstacle(spec, body)
    try:
        return spec.compile()
    except ValueError as error:
        raise AssetError(f"the robot description cannot be compiled: {' '.join(str(error).split())}") from None


def geoms(model: mujoco.MjModel, body: BodySpec) -> slice:
    """The geoms of an obstacle."""
    compiled = model.body(body.name)
    first = int(compiled.geomadr[0])
    return slice(first, first + int(compiled.geomnum[0]))


def _add_payload(spec: mujoco.MjSpec, mass: float) -> None:
    added = spec.body(LINKS[-1]).add_body(name="payload", pos=spec.site(FLANGE).pos + PAYLOAD_AT)
    added.mass = mass
    added.inertia = [mass * 0.03**2] * 3
    added.explicitinertial = True


def _add_obstacle(spec: mujoco.MjSpec, body: BodySpec) -> None:
    added = spec.worldbody.add_body(name=f"{body.name}_slides", pos=[0.0, 0.0, 0.0])
    added.gravcomp = 1.0
    added.mass = body.mass
    added.inertia = [body.mass * body.radius**2] * 3  # no joint turns it: any inertia will do
    added.explicitinertial = True
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        added.add_joint(name=f"{body.name}_{name}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=list(axis))
    # A frame of its own, whose orientation is set at run time: bounding boxes turn with it, of a geom's own they would not.
    turning = added.add_body(name=body.name)
    if body.shape == "figure":
        for part in parts(*body.size):
            _add_geom(turning, part.shape, part.size, part.T_figure_part)
    else:
        _add_geom(turning, body.shape, body.size, np.eye(4))


def _add_geom(body: mujoco.MjsBody, shape: str, size: tuple[float, ...], T_body_geom: Array) -> None:
    kind = {"sphere": mujoco.mjtGeom.mjGEOM_SPHERE, "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE, "box": mujoco.mjtGeom.mjGEOM_BOX}
    body.add_geom(
        type=kind[shape], pos=list(T_body_geom[:3, 3]), quat=list(quaternion_from_rotation(T_body_geom[:3, :3])),
        size=[*size, 0.0, 0.0][:3], contype=SCENE_BIT, conaffinity=ROBOT_BIT, friction=[0.5, 0.005, 0.0001], priority=1,
        **SKIN)


def parked(index: int) -> np.ndarray:
    """Where obstacle `index` waits [m] (3,)."""
    return np.array([2.0 * index, 0.0, PARKED])
