"""What is measured on: distinct depth frames of a moving arm and of a person, or a board, or balls, moving beside it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hrc.config import Config
from hrc.geometry import Array, transform
from hrc.messages import Body, DepthFrame
from hrc.model import Dynamics, load_spec, pinocchio_model
from hrc.scene import BodySpec, Box, load_scene
from hrc.sim.depth_camera import DepthCamera
from hrc.vision.camera import Camera, CameraConfig

POSTURE = np.array([0.9, 0.6, 0.0, -1.3, 0.0, 0.6, 0.0])
SWING = 0.3
"""The arm moves around this posture, every joint by as much [rad]."""
VIEWS = ((2.2, 0.0, 0.75), (0.9, -2.0, 0.9), (1.6, 1.6, 1.2), (1.7, -1.4, 0.3))
"""Where the first, second, third and fourth camera stand [m]; all look at the same point."""
LIMB = 0.32
"""Length of the person's upper arm and of the forearm [m]."""
SHOULDER = np.array([0.1, 0.85, 0.7])

Place = Callable[[Array, float], tuple[Body, ...]]
"""The obstacles, given the links' poses (8, 4, 4) and the phase of the motion [rad]."""


@dataclass(frozen=True)
class Condition:
    """Of the frames. scale: of the resolution, 1 is 512 x 424. distance: of the first camera from the robot [m].

    obstacle: "person", whose hand is at the forearm; "hand", that hand alone; "balls", `balls` of them, each at a link of its
    own; "flat", a slab laid along the forearm; "board", one that covers `coverage` of the image, its edge at the elbow.
    """

    scale: float = 1.0
    distance: float = 2.2
    cameras: int = 1
    obstacle: str = "person"
    balls: int = 1
    coverage: float = 0.0


@dataclass(frozen=True, eq=False)
class Take:
    """Frames of one camera, the links' poses (8, 4, 4) in each of them, and what does not move."""

    camera: Camera
    environment: Sequence[Box]
    frames: list[DepthFrame]
    T_world_link: list[Array]


def record(condition: Condition, number: int, seed: int = 0, device: str = "cpu") -> list[Take]:
    """So many frames for each camera. Raises DeviceError if there is no such device."""
    dynamics = Dynamics(pinocchio_model(load_spec().compile(), armature=False))
    phases = 2 * np.pi * np.arange(number) / number
    arm = [np.asarray(dynamics.kinematics(POSTURE + SWING * np.sin(phase + np.arange(7)))[0]) for phase in phases]
    specs, place = _obstacles(condition)
    environment = load_scene().environment
    takes = []
    for i, eye in enumerate(VIEWS[: condition.cameras]):
        camera = Camera(_camera(condition, eye))
        sensor = DepthCamera(camera, environment, specs, Config().sensor, seed=seed + i, latency=0, device=device)
        frames = []
        for k, (T, phase) in enumerate(zip(arm, phases, strict=True)):
            sensor.expose(k, T, place(T, phase))
            frame = sensor.latest(k)
            assert frame is not None
            frames.append(frame)
        takes.append(Take(camera, environment, frames, arm))
    return takes


def _camera(condition: Condition, eye: tuple[float, float, float]) -> CameraConfig:
    """The default camera elsewhere, and with more or fewer pixels over the same view."""
    c, s = CameraConfig(), condition.scale
    target = np.array(c.target)
    away = np.array(eye) - target
    if condition.distance != Condition.distance:
        away *= condition.distance / np.linalg.norm(away)
    return c.replace(width=round(c.width * s), height=round(c.height * s), fx=c.fx * s, fy=c.fy * s,
                     cx=(c.cx + 0.5) * s - 0.5, cy=(c.cy + 0.5) * s - 0.5, eye=tuple((target + away).tolist()))


def _obstacles(condition: Condition) -> tuple[list[BodySpec], Place]:
    """The bodies, and how they move."""
    if condition.obstacle in ("person", "hand"):
        specs = _PERSON if condition.obstacle == "person" else _PERSON[:1]
        return specs, lambda T, phase: _bodies(specs, _person(_hand(T, phase)))
    if condition.obstacle == "balls":
        specs = [BodySpec(f"ball {i}", "sphere", (0.04,)) for i in range(condition.balls)]
        return specs, lambda T, phase: _bodies(specs, [
            transform(np.eye(3), T[link][:3, 3] + [0.03, side * (0.12 + 0.03 * np.sin(3 * phase)), 0.03])
            for link, side in ((3, 1), (5, -1), (3, -1), (5, 1))])
    if condition.obstacle == "flat":
        specs = [BodySpec("slab", "box", (0.15, 0.02, 0.05))]
        return specs, lambda T, phase: _bodies(specs, [_flat(T, phase)])
    area = condition.coverage * CameraConfig().width * CameraConfig().height
    pixel = condition.distance / CameraConfig().fx
    width = min(np.sqrt(area), 240.0)
    specs = [BodySpec("board", "box", (0.01, 0.5 * width * pixel, 0.5 * area / width * pixel))]
    return specs, lambda T, phase: _bodies(specs, [_board(T, phase, specs[0])])


_PERSON = [BodySpec("hand", "sphere", (0.045,)), BodySpec("forearm", "capsule", (0.04, LIMB / 2)),
           BodySpec("upper arm", "capsule", (0.05, LIMB / 2)), BodySpec("trunk", "capsule", (0.16, 0.25)),
           BodySpec("head", "sphere", (0.11,))]


def _hand(T: Array, phase: float) -> Array:
    return T[5][:3, 3] + [0.04, 0.14 + 0.06 * np.sin(3 * phase), 0.05]


def _person(hand: Array) -> list[Array]:
    """Poses of hand, forearm, upper arm, trunk and head: the shoulder follows when the hand is out of reach."""
    away = SHOULDER - hand
    reach = min(float(np.linalg.norm(away)), 1.95 * LIMB)
    shoulder = hand + away / np.linalg.norm(away) * reach
    elbow = (hand + shoulder) / 2 - [0.0, 0.0, np.sqrt(LIMB**2 - (reach / 2) ** 2)]
    trunk = shoulder + np.array([0.0, 0.2, -0.3])
    return [transform(np.eye(3), hand), _along(hand, elbow), _along(elbow, shoulder), transform(np.eye(3), trunk),
            transform(np.eye(3), trunk + np.array([0.0, 0.0, 0.55]))]


def _along(start: Array, end: Array) -> Array:
    """The pose of a capsule from one point to the other."""
    z = (end - start) / np.linalg.norm(end - start)
    x = np.cross(z, [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    return transform(np.column_stack([x, np.cross(z, x), z]), (start + end) / 2)


def _flat(T: Array, phase: float) -> Array:
    """A slab whose long side lies along the forearm, beside it."""
    start, end = T[4][:3, 3], T[5][:3, 3]
    x = (end - start) / np.linalg.norm(end - start)
    y = np.cross(np.cross(x, [0.0, 1.0, 0.0]), x)
    y /= np.linalg.norm(y)
    return transform(np.column_stack([x, y, np.cross(x, y)]), (start + end) / 2 + (0.11 + 0.02 * np.sin(3 * phase)) * y)


def _board(T: Array, phase: float, spec: BodySpec) -> Array:
    edge = T[4][:3, 3] + [0.0, 0.02 + 0.08 * np.sin(3 * phase), 0.0]
    return transform(np.eye(3), edge + np.array([0.0, spec.size[1], 0.0]))


def _bodies(specs: Sequence[BodySpec], poses: Sequence[Array]) -> tuple[Body, ...]:
    return tuple(Body(s.name, s.shape, s.size, T) for s, T in zip(specs, poses, strict=False))
