"""What a depth camera sees, made small enough for a browser: the foreground as a few points in the world."""

import numpy as np
from numpy.typing import NDArray

from hrc.geometry import Array
from hrc.messages import DepthFrame, View
from hrc.vision.camera import Camera

MAX_POINTS = 8000
VOXEL = 0.01
"""Of all points in a cube of this side one is shown [m]: the eye loses nothing, and the browser has a third to draw."""
LOOKED_AT = 4
"""Of more than so many times the points shown, only every n-th is looked at."""
NEAR_BASE = 1.5
"""Points farther than this from the robot's base are not shown [m]."""


class Sight:
    """Turns frames of one camera into points. The camera is the nominal one, as perception knows it."""

    def __init__(self, camera: Camera) -> None:
        R_world_camera = camera.T_world_camera[:3, :3]
        self._rays = (camera.rays() @ R_world_camera.T).astype(np.float32).reshape(-1, 3)
        self._eye = np.asarray(camera.T_world_camera[:3, 3], np.float32)

    def points(self, foreground: DepthFrame, at_most: int = MAX_POINTS) -> NDArray[np.float32]:
        """The foreground near the robot, in the world [m], shape (n, 3) with n <= at_most."""
        depth = foreground.depth.ravel()
        pixels = np.flatnonzero(np.isfinite(depth))
        points = np.asarray(self._eye + depth[pixels, None] * self._rays[pixels], np.float32)
        points = points[np.einsum("ij,ij->i", points, points) < NEAR_BASE**2]
        points = points[::_step(len(points), LOOKED_AT * at_most)]
        x, y, z = np.floor((points + NEAR_BASE) / VOXEL).astype(np.int32).T
        side = int(2.0 * NEAR_BASE / VOXEL) + 1
        points = points[np.sort(np.unique((x * side + y) * side + z, return_index=True)[1])]
        return points[::_step(len(points), at_most)]


def _step(number: int, at_most: int) -> int:
    return -(-number // at_most) or 1  # rounded up


def standing(camera: Camera, view: View) -> Camera:
    """The camera where it took the frame of the view."""
    return camera if view.T_world_camera is None else camera.moved(view.T_world_camera)


def field_of_view(camera: Camera) -> tuple[float, float, Array]:
    """Vertical field of view [rad], width over height, and pose (4, 4): what it takes to draw the camera."""
    c = camera.config
    return 2.0 * float(np.arctan(0.5 * c.height / c.fy)), c.width / c.height * c.fy / c.fx, camera.T_world_camera
