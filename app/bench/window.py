"""The part of the image that can matter: the rectangle around the robot's links."""

from collections.abc import Sequence

import numpy as np

from hrc import meshes
from hrc.geometry import Array
from hrc.vision.camera import Camera

NEAREST = 0.05
"""A link nearer to the camera than this [m] is taken to be this far."""


def corners(margin: float) -> Array:
    """The corners of the box around each link (8, 8, 3), `margin` [m] larger on every side, in its frame [m]."""
    out = []
    for mesh in meshes.robot("perception"):
        sides = np.stack([mesh.vertices.min(axis=0) - margin, mesh.vertices.max(axis=0) + margin])
        out.append([[sides[i, 0], sides[j, 1], sides[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    return np.array(out)


def rectangle(camera: Camera, T_camera_link: Sequence[Array] | Array, boxes: Array, reach: float) -> tuple[slice, slice]:
    """Rows and columns that hold these boxes (n, 8, 3) at these poses (n, 4, 4), and all within `reach` [m] of them."""
    T = np.asarray(T_camera_link)
    u, v, z = camera.project(np.einsum("nij,nkj->nki", T[:, :3, :3], boxes) + T[:, None, :3, 3])
    rows, columns = camera.shape
    grow = reach * camera.config.fx / max(float(z.min()) - reach, NEAREST) + 1.0
    top, left = max(int(v.min() - grow), 0), max(int(u.min() - grow), 0)
    return slice(top, min(int(v.max() + grow) + 1, rows)), slice(left, min(int(u.max() + grow) + 1, columns))
