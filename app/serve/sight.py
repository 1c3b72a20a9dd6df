"""What the depth camera sees, made small enough for a browser: the foreground as points, the frame as a picture."""

import numpy as np
from numpy.typing import NDArray

from hrc.geometry import Array
from hrc.messages import DepthFrame, RobotImage
from hrc.vision.camera import Camera

MAX_POINTS = 8000
NEAR_BASE = 1.5
"""Points farther than this from the robot's base are not shown [m]."""
SHADE_NEAR, SHADE_FAR = 1.2, 4.4
"""Depths drawn white and black [m]."""
ROBOT, OBSTACLE, INVALID = (255, 122, 31), (74, 168, 255), 14
OFF_ROBOT = 255


class Sight:
    """Turns frames of one camera into points and pictures. The camera is the nominal one, as perception knows it."""

    def __init__(self, camera: Camera) -> None:
        R_world_camera = camera.T_world_camera[:3, :3]
        self._rays = (camera.rays() @ R_world_camera.T).astype(np.float32).reshape(-1, 3)
        self._eye = np.asarray(camera.T_world_camera[:3, 3], np.float32)

    def points(self, foreground: DepthFrame) -> NDArray[np.float32]:
        """The foreground near the robot, in the world [m], shape (n, 3) with n <= MAX_POINTS."""
        depth = foreground.depth.ravel()
        pixels = np.flatnonzero(np.isfinite(depth))
        points = np.asarray(self._eye + depth[pixels, None] * self._rays[pixels], np.float32)
        points = points[np.einsum("ij,ij->i", points, points) < NEAR_BASE**2]
        every = -(-len(points) // MAX_POINTS) or 1  # rounded up
        return points[::every]

    def picture(self, frame: DepthFrame, foreground: DepthFrame | None, robot: RobotImage | None) -> NDArray[np.uint8]:
        """The frame at half size (H/2, W/2, 3): depth in grey, the robot tinted, obstacles in blue, holes dark."""
        depth = frame.depth[::2, ::2]
        measured = np.isfinite(depth)
        near = np.clip((SHADE_FAR - np.where(measured, depth, SHADE_FAR)) / (SHADE_FAR - SHADE_NEAR), 0.0, 1.0)
        grey = np.where(measured, 28 + 200 * near, INVALID)
        picture = np.repeat(grey[:, :, None], 3, axis=2)
        if robot is not None:
            on = (robot.link[::2, ::2] != OFF_ROBOT) & measured
            picture[on] = 0.45 * picture[on] + 0.5 * np.array(ROBOT)
        if foreground is not None:
            picture[np.isfinite(foreground.depth[::2, ::2])] = OBSTACLE
        return picture.astype(np.uint8)


def field_of_view(camera: Camera) -> tuple[float, float, Array]:
    """Vertical field of view [rad], width over height, and pose (4, 4): what it takes to draw the camera."""
    c = camera.config
    return 2.0 * float(np.arctan(0.5 * c.height / c.fy)), c.width / c.height * c.fy / c.fx, camera.T_world_camera
