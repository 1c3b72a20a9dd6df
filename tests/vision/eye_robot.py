"""The real meshes in real poses, for the tests of the eye."""

import functools

import numpy as np

from hrc.geometry import apply, transform
from hrc.meshes import robot
from hrc.messages import Body
from hrc.model import Dynamics, load_spec, pinocchio_model
from hrc.scene import BodySpec, load_scene
from hrc.sim.depth_camera import DepthCamera, SensorConfig
from hrc.vision.camera import Camera

POSTURE = np.array([0.0, 0.6, 0.0, -1.3, 0.0, 0.6, 0.0])
RADIUS = 0.05
SPHERE = BodySpec("sphere", "sphere", (RADIUS,))
PERFECT = SensorConfig(noise=0.0, flying=0.0, dropout=0.0, extrinsic_rotation_deg=0.0, extrinsic_translation=0.0)


@functools.cache
def _dynamics():
    return Dynamics(pinocchio_model(load_spec().compile(), armature=False))


def poses(q=POSTURE):
    return np.asarray(_dynamics().kinematics(np.asarray(q, float))[0])


def sphere_at(p, present=True):
    return Body("sphere", "sphere", (RADIUS,), transform(np.eye(3), p), present=present)


@functools.cache
def depth_camera(config=PERFECT, seed=3, latency=0):
    return DepthCamera(Camera(), load_scene().environment, [SPHERE], config, seed=seed, latency=latency)


def touching(T, link, angles_deg, rng):
    """A visible surface point of a link whose normal makes such an angle with the line of sight, and the centre of a
    sphere that touches it there, is visible too, and keeps clear of the rest of the robot and of the table.

    None if the link has no such point in this pose.
    """
    eye = Camera().T_world_camera[:3, 3]
    parts = robot("plant")
    points, normals = apply(T[link], parts[link].vertices), parts[link].normals @ T[link][:3, :3].T
    surface = np.concatenate([apply(t, m.vertices) for t, m in zip(T, parts, strict=True)])
    sight = (eye - points) / np.linalg.norm(eye - points, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip((normals * sight).sum(axis=1), -1, 1)))
    bare, with_sphere = depth_camera(latency=1), depth_camera(latency=2)
    bare.expose(0, T, ())
    for i in rng.permutation(np.nonzero((angle >= angles_deg[0]) & (angle < angles_deg[1]))[0])[:60]:
        centre = points[i] + RADIUS * normals[i]
        clear = centre[2] > RADIUS + 0.05 and np.linalg.norm(surface - centre, axis=1).min() > RADIUS - 1e-3
        if clear and bare.sees(points[i]):
            with_sphere.expose(0, T, [sphere_at(centre)])
            if with_sphere.sees(centre + RADIUS * sight[i]):
                return points[i], centre
    return None


def contacts(link, angles_deg, number, rng):
    """So many (T, point, centre) as in `touching`, in random poses."""
    found = []
    while len(found) < number:
        T = poses(POSTURE + rng.uniform(-1, 1, 7) * [1.2, 0.5, 1.0, 0.7, 1.0, 1.0, 1.0])
        contact = touching(T, link, angles_deg, rng)
        if contact is not None:
            found.append((T, *contact))
    return found
