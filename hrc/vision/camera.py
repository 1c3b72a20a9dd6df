"""The pinhole depth camera: where it stands, and the two directions of Eq. (8) and (9)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hrc.errors import ConfigError
from hrc.geometry import Array, inverse, look_at
from hrc.parameters import Parameters, param


@dataclass(frozen=True)
class CameraConfig(Parameters):
    """Intrinsics and placement of the depth camera; the defaults are a Kinect V2 behind the robot."""

    width: int = param(512, low=16, high=4096, unit="px", live=False)
    """Columns of the depth image."""
    height: int = param(424, low=16, high=4096, unit="px", live=False)
    """Rows of the depth image."""
    fx: float = param(365.456, low=10.0, high=10000.0, unit="px", live=False)
    """Focal length along a row, in pixels."""
    fy: float = param(365.456, low=10.0, high=10000.0, unit="px", live=False)
    """Focal length along a column, in pixels."""
    cx: float = param(254.878, low=-4096.0, high=8192.0, unit="px", live=False)
    """Column where the optical axis meets the image; the centre of the first pixel is 0."""
    cy: float = param(205.395, low=-4096.0, high=8192.0, unit="px", live=False)
    """Row where the optical axis meets the image; the centre of the first pixel is 0."""
    eye: tuple[float, float, float] = param((2.2, 0.0, 0.75), low=-10.0, high=10.0, unit="m", live=False)
    """The optical centre, in the world."""
    target: tuple[float, float, float] = param((0.0, 0.0, 0.55), low=-10.0, high=10.0, unit="m", live=False)
    """The point the camera looks at, in the world; the image is level."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if np.hypot(self.eye[0] - self.target[0], self.eye[1] - self.target[1]) < 1e-3:
            raise ConfigError(f"the camera must not look straight up or down: eye {self.eye}, target {self.target}")


class Camera:
    """A pinhole camera without distortion. Points in its frame: +z forward, +x right, +y down.

    T_world_camera, T_camera_world: its pose and the inverse, shape (4, 4). A copy may stand elsewhere: `moved`.
    """

    def __init__(self, config: CameraConfig | None = None, T_world_camera: Array | None = None) -> None:
        self.config = config or CameraConfig()
        pose = look_at(self.config.eye, self.config.target) if T_world_camera is None else T_world_camera
        self.T_world_camera = np.array(pose, dtype=np.float64)
        self.T_camera_world = inverse(self.T_world_camera)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image (H, W)."""
        return self.config.height, self.config.width

    def moved(self, T_world_camera: Array) -> "Camera":
        """The same camera at another pose (4, 4)."""
        return Camera(self.config, T_world_camera)

    def project(self, p_camera: ArrayLike) -> tuple[Array, Array, Array]:
        """Pixel coordinates u, v [px] and depth [m] of points (..., 3) [m] in the camera frame (T_depth, Eq. (8))."""
        x, y, z = np.moveaxis(np.asarray(p_camera, np.float64), -1, 0)
        c = self.config
        return c.fx * x / z + c.cx, c.fy * y / z + c.cy, z

    def pixel(self, p_world: Array) -> tuple[float, float, float]:
        """Pixel coordinates u, v [px] and depth [m] of one point (3,) [m] in the world; no number where it is not in front."""
        x, y, z = (self.T_camera_world[:3, :3] @ p_world + self.T_camera_world[:3, 3]).tolist()
        c = self.config
        return (c.fx * x / z + c.cx, c.fy * y / z + c.cy, z) if z > 0.0 else (math.nan, math.nan, z)

    def unproject(self, u: ArrayLike, v: ArrayLike, depth: ArrayLike) -> Array:
        """The point (..., 3) [m] in the camera frame behind pixel (u, v) at a depth [m]: the inverse used in Eq. (9)."""
        c, d = self.config, np.asarray(depth, np.float64)
        x, y = (np.asarray(u, np.float64) - c.cx) / c.fx * d, (np.asarray(v, np.float64) - c.cy) / c.fy * d
        return np.stack(np.broadcast_arrays(x, y, d), axis=-1)

    def rays(self) -> Array:
        """For every pixel, the point at depth 1 [m] in the camera frame, shape (H, W, 3)."""
        v, u = np.mgrid[: self.config.height, : self.config.width]
        return self.unproject(u, v, 1.0)
