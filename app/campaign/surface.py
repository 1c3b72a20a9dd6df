"""Metrics over the robot's surface: smoothed from the episodes' contacts, and drawn on the robot."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.bench.pushes import dynamics
from app.campaign.metrics import METRICS
from hrc import meshes
from hrc.config import Config
from hrc.geometry import Array, apply
from hrc.vision.camera import Camera, CameraConfig
from hrc.vision.render import Renderer

DETAIL = "perception"
WIDTH, FAR = 0.035, 0.07
"""A contact counts around it by a bell of this width [m]; farther from every contact [m] nothing is known."""
SIZE = (440, 580)
"""Of a picture [px]."""
VIEWS = {"from the camera": (2.2, 0.0, 0.75), "from behind": (-2.0, 0.9, 0.9)}
"""Where the pictures are taken from [m]."""
LOOK_AT, FOCAL = (-0.2, 0.0, 0.37), 1500.0
"""What they show the middle of [m]; their focal length [px]."""
PLAIN, EMPTY = np.array([0.80, 0.82, 0.84]), np.ones(3)
"""Colour of the robot where nothing is known, and of what is not the robot."""


@dataclass(frozen=True, eq=False)
class Field:
    """A metric at the vertices of each part: (n,) each, NaN where nothing is known; scale: between these values."""

    metric: str
    values: tuple[Array, ...]
    scale: tuple[float, float]


def over(records: Sequence[Mapping[str, Any]], metric: str) -> Field | None:
    """A metric over the surface; None if no record has it."""
    values: list[Array] = []
    for link, mesh in enumerate(meshes.robot(DETAIL)):
        here = [r for r in records if r.get("link") == link and r.get(metric) is not None]
        values.append(smoothed(mesh.vertices, np.array([r["p_link_m"] for r in here]).reshape(-1, 3),
                               np.array([float(r[metric]) for r in here])))
    known = np.concatenate([v[np.isfinite(v)] for v in values])
    if not known.size:
        return None
    low, high = (0.0, 1.0) if METRICS[metric].unit == "bool" else (0.0, float(np.percentile(known, 97)) or 1.0)
    return Field(metric, tuple(values), (low, high))


def smoothed(points: Array, at: Array, values: Array) -> Array:
    """Values (m,) at places (m, 3) [m], as they are around the points (n, 3); NaN farther than FAR from all of them."""
    out = np.full(len(points), np.nan)
    if not len(at):
        return out
    for i in range(0, len(points), 500):
        d2 = ((points[i:i + 500, None] - at) ** 2).sum(axis=2)
        weights = np.exp(-d2 / (2.0 * WIDTH**2))
        near = d2.min(axis=1) < FAR**2
        out[i:i + 500][near] = (weights @ values)[near] / weights.sum(axis=1)[near]
    return out


def colormap() -> Any:
    """From little to much: blue, green, yellow, red."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["turbo"](np.linspace(0.08, 0.95, 256)))


def ramp() -> list[str]:
    """Nine of its colours, from little to much, as a page writes them."""
    return ["#" + "".join(f"{round(255 * c):02x}" for c in colour) for colour in colormap()(np.linspace(0.0, 1.0, 9))[:, :3]]


def colours(values: Array, scale: tuple[float, float]) -> Array:
    """RGB (n, 3) in 0..1; PLAIN where nothing is known."""
    share = np.clip((values - scale[0]) / (scale[1] - scale[0]), 0.0, 1.0)
    rgb = colormap()(np.nan_to_num(share))[:, :3]
    return np.where(np.isfinite(values)[:, None], rgb, PLAIN)


def poses(config: Config) -> Array:
    """T_world_link (8, 4, 4) in the task's posture."""
    q = dynamics().solve_position(np.asarray(config.task.centre), np.deg2rad(config.task.posture_deg))
    return np.asarray(dynamics().kinematics(q)[0])


def picture(field: Field, eye: tuple[float, float, float], T_world_link: Array) -> Array:
    """The robot with a field on it, RGB (H, W, 3) in 0..1, as a camera at `eye` [m] sees it."""
    camera = _camera(eye)
    image = _renderer(eye).render(T_world_link)
    out = np.broadcast_to(EMPTY, (*camera.shape, 3)).copy()
    v, u = np.nonzero(image.link != 255)
    depth = image.depth[v, u].astype(float)
    p_world = apply(camera.T_world_camera, camera.unproject(u, v, depth))
    for link, mesh in enumerate(meshes.robot(DETAIL)):
        on = image.link[v, u] == link
        R = T_world_link[link, :3, :3]
        near, weights = _around(link, (p_world[on] - T_world_link[link, :3, 3]) @ R)
        normal = np.einsum("nk,nkc->nc", weights, mesh.normals[near]) @ R.T
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        sight = camera.T_world_camera[:3, 3] - p_world[on]
        light = 0.45 + 0.55 * np.clip(np.einsum("nc,nc->n", normal, sight / np.linalg.norm(sight, axis=1, keepdims=True)), 0, 1)
        rgb = np.einsum("nk,nkc->nc", weights, colours(field.values[link], field.scale)[near])
        out[v[on], u[on]] = rgb * light[:, None]
    return out


def _around(link: int, p_link: Array) -> tuple[NDArray[np.intp], Array]:
    """The three nearest vertices of each point (n, 3) [m], and their weights, both (n, 3)."""
    from scipy.spatial import KDTree

    distance, near = KDTree(meshes.robot(DETAIL)[link].vertices).query(p_link, k=3)
    weights = 1.0 / (distance + 1e-4) ** 2
    return np.asarray(near), weights / weights.sum(axis=1, keepdims=True)


@functools.cache
def _renderer(eye: tuple[float, float, float]) -> Renderer:
    return Renderer(_camera(eye), meshes.robot("plant"))


def _camera(eye: tuple[float, float, float]) -> Camera:
    width, height = SIZE
    return Camera(CameraConfig(width=width, height=height, fx=FOCAL, fy=FOCAL, cx=(width - 1) / 2, cy=(height - 1) / 2, eye=eye,
                               target=LOOK_AT))
