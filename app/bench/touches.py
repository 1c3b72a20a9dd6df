"""Obstacles that touch the true surface of the arm somewhere, seen from everywhere: what accuracy is measured on."""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hrc import meshes
from hrc.geometry import Array, apply, rotation_about, transform
from hrc.messages import LINKS, Body
from hrc.model import Dynamics, load_spec, pinocchio_model
from hrc.scene import BodySpec
from hrc.vision.camera import Camera
from hrc.vision.render import Renderer

OBSTACLES = (BodySpec("sphere", "sphere", (0.05,)), BodySpec("capsule", "capsule", (0.04, 0.085)),
             BodySpec("box", "box", (0.05, 0.05, 0.05)))
"""A fist of 5 cm radius, a forearm of 4 cm radius and 25 cm length, a box of 10 cm sides."""
VIEWS = {"front": (0.0, 30.0), "oblique": (30.0, 60.0), "side": (60.0, 80.0), "grazing": (80.0, 100.0),
         "behind": (100.0, 130.0), "hidden": (0.0, 180.0)}
"""Classes of view, by the angle [deg] between the surface's normal at the contact and the line of sight."""
POSTURE = np.array([0.0, 0.6, 0.0, -1.3, 0.0, 0.6, 0.0])
SWING = np.array([1.2, 0.5, 1.0, 0.7, 1.0, 1.0, 1.0])
"""The middle of the random postures, and how far they leave it [rad]."""
OVERLAP, TOUCHED, ALONE = 0.001, 0.001, 0.003
"""An obstacle sinks no deeper into the arm [m]; it touches what is within TOUCHED [m], and is this far from other links [m]."""
TABLE = 0.05
"""What is nearer to the table than this [m] is masked with it, hence no obstacle comes so low."""
NEAR = 0.07
"""The obstacle's surface within this of the contact [m] is what the camera must not see in class "hidden"."""
PART, SHOWN = 0.11, {"behind": 0.1}
"""At least this share, by default half, of what lies within PART [m] of the contact is seen in the other classes."""


@dataclass(frozen=True, eq=False)
class Touch:
    """An obstacle at the arm: poses T_world_link (8, 4, 4), at q (7,), and T_world_body (4, 4).

    point: the middle [m] (3,) of what is touched on the link, be it a point, a line or a face; normal (3,): outward, there.
    clearance: distance of the obstacle to the arm's other links [m].
    """

    q: Array
    T_world_link: Array
    link: int
    point: Array
    normal: Array
    obstacle: BodySpec
    T_world_body: Array
    view: str
    clearance: float

    @property
    def body(self) -> Body:
        """The obstacle as a camera sees it."""
        return Body(self.obstacle.name, self.obstacle.shape, self.obstacle.size, self.T_world_body)


def touches(camera: Camera, number: int, seed: int, obstacles: Sequence[BodySpec] = OBSTACLES) -> list[Touch]:
    """So many for each obstacle and class of view, always the same for a seed.

    Postures, links 3 to 7, and points on the link (by area) are random; a posture gives an obstacle one touch of a class at
    most. In every class but "behind" and "hidden" the contact is on the visible side of the arm.
    """
    rng = np.random.default_rng(seed)
    eye = Renderer(camera, [*meshes.robot("plant"), *(meshes.shape(b.shape, b.size) for b in obstacles)])
    found: dict[tuple[str, str], list[Touch]] = {(b.name, view): [] for b in obstacles for view in VIEWS}
    while any(len(group) < number for group in found.values()):
        q = POSTURE + SWING * rng.uniform(-1, 1, 7)
        T = poses(q)
        bare = eye.render(np.concatenate([T, np.zeros((len(obstacles), 4, 4))]))
        surface = [apply(t, p) for t, (p, _) in zip(T, samples(), strict=True)]
        done = set()
        for slot, link, point, normal in _places(T, obstacles, rng):
            obstacle = obstacles[slot]
            pose = _against(obstacle, point, normal, rng)
            sight = camera.T_world_camera[:3, 3] - point
            angle = float(np.degrees(np.arccos(np.clip(normal @ sight / np.linalg.norm(sight), -1.0, 1.0))))
            views = [view for view, (low, high) in VIEWS.items() if low <= angle < high
                     and len(found[obstacle.name, view]) < number and (slot, view) not in done]
            if not views:
                continue
            clearance = [gap(obstacle, pose, points).min() for points in surface]
            others = float(min(c for i, c in enumerate(clearance) if i != link))
            if clearance[link] < -OVERLAP or others < ALONE or pose[2, 3] - obstacle.extent(pose[2, :3]) < TABLE:
                continue
            touched = surface[link][gap(obstacle, pose, surface[link]) < TOUCHED]
            middle = np.mean([point, *touched], axis=0)
            view = _view(eye, camera, np.asarray(bare.depth, np.float64), T, slot, pose, point, views, len(obstacles))
            if view is not None:
                done.add((slot, view))
                found[obstacle.name, view].append(Touch(q, T, link, middle, normal, obstacle, pose, view, others))
    return [touch for group in found.values() for touch in group]


def poses(q: Array) -> Array:
    """T_world_link (8, 4, 4) of the arm at q (7,) [rad]."""
    return np.asarray(_dynamics().kinematics(q)[0])


@functools.cache
def _dynamics() -> Dynamics:
    return Dynamics(pinocchio_model(load_spec().compile(), armature=False))


@functools.cache
def samples(number: int = 6000) -> list[tuple[Array, Array]]:
    """Points (n, 3) [m] evenly over the true surface of each part, in its frame, and the normals there (n, 3)."""
    rng, out = np.random.default_rng(0), []
    for mesh in meshes.robot("plant"):
        corners = mesh.vertices[mesh.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(cross, axis=1)
        face = rng.choice(len(area), number, p=area / area.sum())
        weights = rng.dirichlet(np.ones(3), number)
        out.append((np.einsum("nk,nkc->nc", weights, corners[face]), cross[face] / area[face, None]))
    return out


def gap(body: BodySpec, T_world_body: Array, points: Array) -> Array:
    """Signed distance [m] of points (n, 3) in the world to the body's surface, negative inside."""
    p = (points - T_world_body[:3, 3]) @ T_world_body[:3, :3]
    if body.shape == "box":
        beyond = np.abs(p) - np.asarray(body.size)
        return np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
    if body.shape == "capsule":
        p = p - np.clip(p[:, 2], -body.size[1], body.size[1])[:, None] * np.array([0.0, 0.0, 1.0])
    return np.linalg.norm(p, axis=1) - body.size[0]


def _places(T: Array, obstacles: Sequence[BodySpec], rng: np.random.Generator) -> Iterator[tuple[int, int, Array, Array]]:
    """Obstacle, link, surface point and normal in the world, at random."""
    for _ in range(60):
        slot, link = int(rng.integers(len(obstacles))), int(rng.integers(3, len(LINKS)))
        points, normals = samples()[link]
        i = rng.integers(len(points))
        yield slot, link, apply(T[link], points[i]), T[link][:3, :3] @ normals[i]


def _against(obstacle: BodySpec, point: Array, normal: Array, rng: np.random.Generator) -> Array:
    """A random pose in which the obstacle touches there: a capsule with its side, a box with a face or an edge."""
    across = np.cross(normal, rng.normal(size=3))
    across /= np.linalg.norm(across)
    R = np.column_stack([normal, np.cross(across, normal), across])
    away = obstacle.size[0]
    slide = rng.uniform(-0.8, 0.8) * obstacle.size[-1] if obstacle.shape != "sphere" else 0.0
    if obstacle.shape == "box" and rng.random() < 0.5:
        R, away = R @ rotation_about((0.0, 0.0, 1.0), np.pi / 4), away * np.sqrt(2.0)
    return transform(R, point + away * normal + slide * across)


def _view(eye: Renderer, camera: Camera, bare: Array, T: Array, slot: int, pose: Array, point: Array, views: Sequence[str],
          obstacles: int) -> str | None:
    """The class this touch belongs to, of those asked for."""
    u, v, z = camera.project(apply(camera.T_camera_world, point))
    rows, columns = camera.shape
    if not (40 <= u < columns - 40 and 40 <= v < rows - 40):
        return None
    hidden = bare[round(float(v)), round(float(u))] < float(z) - 0.02
    bodies = np.zeros((obstacles, 4, 4))
    bodies[slot] = pose
    alone = eye.render(np.concatenate([np.zeros_like(T), bodies])).depth
    both = eye.render(np.concatenate([T, bodies]))
    rows, columns = np.nonzero(np.isfinite(alone))
    p = camera.unproject(columns, rows, alone[rows, columns])
    off = np.linalg.norm(p - apply(camera.T_camera_world, point), axis=1)
    shown = both.link[rows, columns] == len(LINKS) + slot
    if "hidden" in views and not (shown & (off < NEAR)).any():
        return "hidden"
    for view in views:
        if view != "hidden" and shown[off < PART].mean() >= SHOWN.get(view, 0.5) and (view == "behind" or not hidden):
            return view if (shown & (off < NEAR)).any() or view in ("front", "oblique") else None
    return None
