"""How far each link is expanded before it is removed from the image: more, the faster it moves."""

import functools

import numpy as np

from hrc import meshes
from hrc.geometry import Array


def margins(T_world_link: Array, T_later: Array, base: float) -> Array:
    """base + |v| t for each link [m] (8,), v being the speed of its fastest corner.

    T_world_link, T_later: poses (8, 4, 4) at the image's stamp, and where the links would be a time t later. An image whose
    stamp is off by up to t then still lies within the expanded robot.
    """
    moved = np.einsum("lij,lkj->lki", T_later - T_world_link, _corners())[..., :3]
    return base + np.linalg.norm(moved, axis=2).max(axis=1)


@functools.cache
def _corners() -> Array:
    """The corners of each link's bounding box (8, 8, 4), homogeneous, in its frame [m]."""
    boxes = [(m.vertices.min(axis=0), m.vertices.max(axis=0)) for m in meshes.robot("filter")]
    grid = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
    corners = np.ones((len(boxes), 8, 4))
    for i, (low, high) in enumerate(boxes):
        corners[i, :, :3] = low + grid * (high - low)
    return corners
