"""Random places on the robot, directions of a push, and postures."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.bench.pushes import ROOM, dynamics, free
from app.bench.touches import samples
from hrc import meshes
from hrc.errors import HrcError
from hrc.geometry import Array, apply
from hrc.messages import LINKS
from hrc.model import joint_limits, load_spec
from hrc.vision.camera import Camera, CameraConfig
from hrc.vision.render import Renderer

TRIED = 200
"""So many places are looked at before the surface counts as covered; as many postures."""
IN_VIEW = 0.02
"""A place is seen if the robot in the image is as deep there as it is itself, to this [m]."""
LOW, WIDE = 0.06, 0.02
"""In a random posture no link comes lower than this, the base apart, nor so near to another that is not its neighbour [m]."""


class Place(NamedTuple):
    """A point on a link: p_link [m] (3,), and the outward normal there (3,), both in the link's frame."""

    link: int
    p_link: Array
    normal: Array


def draw(links: Sequence[int], T_world_link: Array, rng: np.random.Generator,
         cameras: Sequence[CameraConfig] = ()) -> Place:
    """A place drawn by area from where no other link covers it, T_world_link (8, 4, 4) being the poses.

    cameras: only what one of them sees. Raises HrcError if nothing is left.
    """
    area = np.array([areas()[link] for link in links])
    chosen = rng.choice(len(links), TRIED, p=area / area.sum())
    spots = rng.integers(len(samples()[0][0]), size=TRIED)
    for which, i in zip(chosen, spots, strict=True):
        link = links[which]
        p, normal = samples()[link]
        if free(link, p[i:i + 1] + ROOM * normal[i], T_world_link)[0] \
                and (not cameras or seen(apply(T_world_link[link], p[i]), T_world_link, cameras)):
            return Place(link, p[i], normal[i])
    raise HrcError(f"no {'visible ' if cameras else ''}place is free on {', '.join(LINKS[link] for link in links)}")


def within_cone(inward: Array, friction: float, rng: np.random.Generator) -> Array:
    """A unit vector (3,) drawn uniformly by solid angle from the friction cone around the unit vector `inward` (3,)."""
    cosine = 1.0 - rng.random() * (1.0 - 1.0 / np.sqrt(1.0 + friction**2))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    side = np.cross(inward, np.eye(3)[int(np.argmin(np.abs(inward)))])
    side /= np.linalg.norm(side)
    across = np.cos(angle) * side + np.sin(angle) * np.cross(inward, side)
    return cosine * inward + np.sqrt(1.0 - cosine**2) * across


def posture(spread: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Joint positions [rad] (7,) drawn from this part of each joint's range, clear of table and self, and where the end
    effector is then [m] (3,). Raises HrcError if none was found."""
    limits = joint_limits(load_spec().compile())
    middle, half = 0.5 * (limits.q_min + limits.q_max), 0.5 * spread * (limits.q_max - limits.q_min)
    for _ in range(TRIED):
        q = middle + half * rng.uniform(-1.0, 1.0, 7)
        T, tip, _ = dynamics().kinematics(q)
        if _clear(T):
            return q, tip
    raise HrcError(f"no posture within {spread:g} of the joints' range is clear of table and self")


@functools.cache
def areas() -> tuple[float, ...]:
    """The surface of each part of the robot [m2]."""
    found = []
    for mesh in meshes.robot("plant"):
        corners = mesh.vertices[mesh.faces]
        found.append(0.5 * float(np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()))
    return tuple(found)


def _clear(T_world_link: Array) -> bool:
    surface = [apply(T, p[::40]) for T, (p, _) in zip(T_world_link, samples(), strict=True)]
    if min(float(p[:, 2].min()) for p in surface[2:]) < LOW:
        return False
    for i in range(len(surface)):
        for j in range(i + 3, len(surface)):  # neighbours, and theirs through the short links of a joint, always touch
            if ((surface[i][:, None] - surface[j]) ** 2).sum(axis=2).min() < WIDE**2:
                return False
    return True


def seen(p_world: Array, T_world_link: Array, cameras: Sequence[CameraConfig]) -> bool:
    """Whether one of the cameras would see this point of the robot [m] (3,), with nothing before it but the robot."""
    return any(_in_view(p_world, T_world_link, config) for config in cameras)


def _in_view(p_world: Array, T_world_link: Array, config: CameraConfig) -> bool:
    camera = Camera(config)
    u, v, z = (float(x) for x in camera.project(apply(camera.T_camera_world, p_world)))
    rows, columns = camera.shape
    if z <= 0.0 or not (0 <= round(u) < columns and 0 <= round(v) < rows):
        return False
    depth = _eye(config).render(T_world_link).depth
    return bool(abs(float(depth[round(v), round(u)]) - z) < IN_VIEW)


@functools.lru_cache(maxsize=4)
def _eye(config: CameraConfig) -> Renderer:
    return Renderer(Camera(config), meshes.robot("plant"))


