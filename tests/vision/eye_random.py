"""Random cameras, robots and obstacles: for every number one scene, the same on each run."""

from dataclasses import dataclass

import numpy as np
from eye_robot import poses as robot_poses

from hrc import meshes
from hrc.geometry import Array, rotation_about, transform
from hrc.scene import Box
from hrc.vision.camera import Camera, CameraConfig
from hrc.vision.localize import VisionConfig
from hrc.vision.render import Renderer, environment_depth

ROBOTS = ("posed", "scattered", "moving", "posed", "close", "scattered", "absent")
"""A robot at random joint angles, also one that moved since the frame; its parts anywhere, also around the camera; none."""
OBSTACLES = ("bodies", "noise", "mixed", "speckle", "border", "brink", "mixed", "blank")
"""Balls and boxes; pixels at random, many or few; both; along the image's border; one pixel just within reach; none. The two
cycles have no common divisor."""
INFINITE = 1e6
TILE = (16, 8)
"""Pixels that the eye looks at together, columns and rows."""


@dataclass(frozen=True)
class Scene:
    """A camera, the robot's poses T_world_link (8, 4, 4) when the frame was exposed and now, and a depth image."""

    name: str
    camera: Camera
    config: VisionConfig
    environment: tuple[Box, ...]
    T_stamp: Array
    T_now: Array
    real: np.ndarray

    @property
    def paper(self) -> bool:
        """Whether the distance is that of the expanded surface to obstacles without an end."""
        return self.config.mode == "paper"

    @property
    def thickness(self) -> float:
        """Of an obstacle [m]."""
        return INFINITE if self.paper else self.config.thickness


def name_of(number: int) -> str:
    """What kind of scene it is."""
    return f"{number:03d}-{ROBOTS[number % len(ROBOTS)]}-{OBSTACLES[number % len(OBSTACLES)]}"


def scene(number: int, camera: Camera | None = None) -> Scene:
    """The scene of this number, through its own camera or through this one."""
    rng = np.random.default_rng(number)
    robot, obstacle = name_of(number).split("-")[1:]
    own = _camera(rng)
    camera = camera or own
    config = VisionConfig(
        mode="paper" if rng.random() < 0.35 else "interval", margin=float(rng.choice([0.0, 0.01, 0.03])),
        reach=_log_uniform(rng, 0.02, 0.4), thickness=float(rng.choice([0.0, 0.12, rng.uniform(0.0, 0.5)])),
        neighbours=int(rng.choice([0, 3])) if obstacle in ("bodies", "mixed") else 0,
        environment_margin=float(rng.choice([0.0, 0.04])), first_link=int(rng.choice([0, 3])))
    T_stamp = T_now = _robot(robot, camera, rng)
    if robot == "moving" and config.mode == "interval":
        T_now = np.array([T @ transform(rotation_about(rng.normal(size=3), 0.1), rng.normal(0, 0.02, 3)) for T in T_stamp])
    boxes = tuple(Box(f"box {i}", _triple(rng, -1, 1), _triple(rng, 0.05, 0.4)) for i in range(rng.integers(0, 3)))
    surface = Renderer(camera, meshes.robot("perception")).render(T_stamp).depth
    if obstacle == "brink":
        real, reach = _brink(camera, surface, rng)
        config = config.replace(mode="interval", margin=0.0, reach=reach, thickness=0.0, first_link=0)
        return Scene(name_of(number), camera, config, (), T_stamp, T_stamp, real)
    real = np.minimum(surface, environment_depth(camera, boxes))
    real = np.minimum(real, _obstacles(obstacle, camera, surface, config.reach, rng)).astype(np.float32)
    for invalid in (0.0, np.inf, -1.0):
        real[rng.random(real.shape) < rng.choice([0.0, 0.03])] = invalid
    return Scene(name_of(number), camera, config, boxes, T_stamp, T_now, real)


def _camera(rng: np.random.Generator) -> Camera:
    """Of any size, whole tiles or not, from any side; the optical axis may miss the image."""
    width, height = (int(n) for n in rng.integers((16, 16), (160, 120)))
    focal, away = max(width * rng.uniform(0.5, 1.6), 12.5), rng.uniform(0, 2 * np.pi)
    axis = rng.uniform(0.3, 0.7, 2) if rng.random() < 0.8 else rng.uniform(-0.3, 1.3, 2)
    eye = np.array([np.cos(away), np.sin(away), 0.0]) * rng.uniform(0.8, 3.0) + [0.0, 0.0, rng.uniform(0.1, 1.5)]
    return Camera(CameraConfig(width=width, height=height, fx=focal, fy=focal * rng.uniform(0.8, 1.25), cx=width * axis[0],
                               cy=height * axis[1], eye=(eye[0], eye[1], eye[2]), target=(0.0, 0.0, rng.uniform(0.3, 0.9))))


def _robot(kind: str, camera: Camera, rng: np.random.Generator) -> Array:
    if kind in ("posed", "moving"):
        return robot_poses(rng.uniform(-2.0, 2.0, 7))
    if kind == "absent":
        return camera.T_world_camera @ np.tile(transform(np.eye(3), [0.0, 0.0, -5.0]), (8, 1, 1))
    near, far = (0.01, 0.35) if kind == "close" else (0.4, 3.0)
    parts = []
    for _ in range(8):
        u, v = rng.uniform(-0.2, 1.2, 2) * [camera.config.width, camera.config.height]
        centre = camera.unproject(u, v, _log_uniform(rng, near, far))
        parts.append(transform(rotation_about(rng.normal(size=3), rng.uniform(0, np.pi)), centre))
    return camera.T_world_camera @ np.array(parts)


def _obstacles(kind: str, camera: Camera, robot: np.ndarray, reach: float, rng: np.random.Generator) -> np.ndarray:
    """Depth [m] (H, W) of what stands around the robot, most of it about as far away as the reach."""
    (height, width), depth = camera.shape, np.full(camera.shape, np.inf)
    v, u = np.nonzero(np.isfinite(robot))
    on = camera.unproject(u, v, robot[v, u]) if len(u) else camera.unproject(width / 2, height / 2, [[0.8], [1.6]])[:, 0]
    if kind in ("bodies", "mixed"):
        for _ in range(rng.integers(1, 6)):
            size, towards = _log_uniform(rng, 0.01, 0.25), rng.normal(size=3)
            gap = (size + rng.uniform(-0.1, 1.3) * reach) * towards / np.linalg.norm(towards)
            shape = _ball if rng.random() < 0.6 else _block
            depth = np.minimum(depth, shape(camera, on[rng.integers(len(on))] + gap, size, rng))
    share = {"noise": _log_uniform(rng, 0.02, 0.6), "speckle": _log_uniform(rng, 0.001, 0.02), "mixed": 0.01}.get(kind, 0.0)
    chosen = rng.random(depth.shape) < share
    if kind == "border":
        chosen[[0, -1]], chosen[:, [0, -1]] = rng.random((2, width)) < 0.7, rng.random((height, 2)) < 0.7
    low, high = on[:, 2].min() - 1.5 * reach, on[:, 2].max() + 1.5 * reach
    return np.where(chosen, rng.uniform(max(low, 0.02), high, depth.shape), depth)


def _brink(camera: Camera, robot: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """A single pixel, and a reach [m] that is hardly more than its distance from a certain pixel of the robot.

    Both are at the edges of their tiles that face each other, and the obstacle is where its ray is nearest to the robot's
    point: what looks at no more of the image than it must has to look just that far.
    """
    depth, pixels = np.full(camera.shape, np.inf, np.float32), np.argwhere(np.isfinite(robot))
    for v, u in rng.permutation(pixels)[:4000]:
        du, dv = ((1, 0), (-1, 0), (0, 1), (0, -1))[rng.integers(4)]
        at_edge = (u + max(du, 0)) % TILE[0] == 0 if du else (v + max(dv, 0)) % TILE[1] == 0
        away = rng.integers(0, 5) * (TILE[0] if du else TILE[1]) + 1
        column, row = u + du * away, v + dv * away
        if not at_edge or not (0 <= column < depth.shape[1] and 0 <= row < depth.shape[0]) or np.isfinite(robot[row, column]):
            continue
        p, ray = camera.unproject(u, v, robot[v, u]), camera.unproject(column, row, 1.0)
        foot = p @ ray / (ray @ ray)
        distance = float(np.linalg.norm(p - foot * ray))
        if foot > 0.1 and 0.02 < distance < 0.4:
            depth[row, column] = foot
            return depth, 1.001 * distance
    return depth, 0.1


def _ball(camera: Camera, centre: Array, radius: float, _: np.random.Generator) -> np.ndarray:
    rays = camera.rays()
    square, along = (rays * rays).sum(axis=-1), rays @ centre
    under = along**2 - square * (centre @ centre - radius**2)
    depth = (along - np.sqrt(np.maximum(under, 0.0))) / square
    return np.where((under > 0) & (depth > 0.01), depth, np.inf)


def _block(camera: Camera, centre: Array, size: float, rng: np.random.Generator) -> np.ndarray:
    """A box at any attitude, seen by the camera in the box's own frame, where its sides run along the axes."""
    R = rotation_about(rng.normal(size=3), rng.uniform(0, np.pi))
    block = Box("block", (0.0, 0.0, 0.0), _triple(rng, 0.3 * size, size))
    return environment_depth(camera.moved(transform(R, -R @ centre)), [block])


def _triple(rng: np.random.Generator, low: float, high: float) -> tuple[float, float, float]:
    x, y, z = rng.uniform(low, high, 3)
    return float(x), float(y), float(z)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
