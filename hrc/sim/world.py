"""The MuJoCo world: the robot, the environment and the obstacles, compiled once."""

import mujoco
import numpy as np

from hrc.errors import AssetError
from hrc.model import load_spec
from hrc.scene import BodySpec, Scene

SKIN = {"solref": [-6000.0, -120.0], "solimp": [0.0, 0.9, 0.005, 0.5, 2.0]}
"""Contact impedance of an obstacle: progressive, so that its drive sets the softness and the contact does not chatter."""
PARKED = -20.0
"""Obstacles outside the scene wait at this height [m], 2 m apart, without drive."""
ROBOT_BIT, SCENE_BIT = 1, 2


def compile_world(scene: Scene, base_hz: int) -> mujoco.MjModel:
    """The compiled model: the robot first (7 degrees of freedom), then three slides for each obstacle, in order.

    Raises AssetError if a file of the robot is missing or malformed.
    """
    spec = load_spec()
    spec.option.timestep = 1.0 / base_hz
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # the sparse solver of MuJoCo 4.0.0 is wrong
    for box in scene.environment:
        spec.worldbody.add_geom(
            name=box.name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=list(box.centre), size=list(box.half),
            contype=SCENE_BIT, conaffinity=ROBOT_BIT | SCENE_BIT)
    for body in scene.bodies:
        _add_obstacle(spec, body)
    try:
        model = spec.compile()
    except ValueError as error:
        raise AssetError(f"the robot description cannot be compiled: {' '.join(str(error).split())}") from None
    # Let an obstacle's geom turn about the body's origin at run time; the compiler took it for fixed.
    for body in scene.bodies:
        model.geom_sameframe[model.geom(body.name).id] = 0
    return model


def _add_obstacle(spec: mujoco.MjSpec, body: BodySpec) -> None:
    added = spec.worldbody.add_body(name=body.name, pos=[0.0, 0.0, 0.0])
    added.gravcomp = 1.0
    added.mass = body.mass
    added.inertia = [body.mass * body.radius**2] * 3  # it only slides: any inertia will do
    added.explicitinertial = True
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        added.add_joint(name=f"{body.name}_{name}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=list(axis))
    sphere = body.shape == "sphere"
    added.add_geom(
        name=body.name, type=mujoco.mjtGeom.mjGEOM_SPHERE if sphere else mujoco.mjtGeom.mjGEOM_BOX,
        size=[body.size[0], 0.0, 0.0] if sphere else list(body.size), contype=SCENE_BIT,
        conaffinity=ROBOT_BIT, friction=[0.5, 0.005, 0.0001], priority=1, **SKIN)


def parked(index: int) -> np.ndarray:
    """Where obstacle `index` waits [m] (3,)."""
    return np.array([2.0 * index, 0.0, PARKED])
