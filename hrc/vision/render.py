"""Virtual depth images: the robot's meshes, Eq. (8), and the boxes of the fixed environment."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from hrc.geometry import Array
from hrc.messages import RobotImage
from hrc.vision import kernels
from hrc.vision.camera import Camera

Vector = tuple[float, float, float]
ROWS = 32
"""Of the environment so many rows are drawn at a time: what is made on the way stays in the cache."""


class FixedBox(Protocol):
    """A box with sides along the world's axes: centre and half lengths [m]."""

    @property
    def centre(self) -> Vector:
        """In the world [m]."""
        ...

    @property
    def half(self) -> Vector:
        """Half the length of each side [m]."""
        ...


def environment_depth(camera: Camera, boxes: Sequence[FixedBox], grow: float = 0.0) -> Array:
    """Depth [m] (H, W) of the nearest box, each `grow` [m] larger on every side; +inf where there is none.

    Rays meet boxes in closed form (the slab method), so a floor that runs beneath the camera needs no clipping. A box
    around the camera itself is not seen.
    """
    rays = np.ascontiguousarray(np.moveaxis(camera.rays() @ camera.T_world_camera[:3, :3].T, -1, 0))
    eye = camera.T_world_camera[:3, 3]
    depth = np.full(camera.shape, np.inf)
    for top in range(0, len(depth), ROWS):
        for box in boxes:
            _draw_box(depth[top : top + ROWS], rays[:, top : top + ROWS], eye, box, grow)
    return depth


def _draw_box(depth: Array, rays: Array, eye: Array, box: FixedBox, grow: float) -> None:
    enter, leave = np.full(depth.shape, -np.inf), np.full(depth.shape, np.inf)
    for axis, ray in enumerate(rays):
        low, high = box.centre[axis] - box.half[axis] - grow, box.centre[axis] + box.half[axis] + grow
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = (low - eye[axis]) / ray, (high - eye[axis]) / ray
        # fmin and fmax pass over the 0/0 of a ray within a face: it neither enters nor leaves through that one.
        enter, leave = np.fmax(enter, np.fmin(first, second)), np.fmin(leave, np.fmax(first, second))
    np.minimum(depth, enter, out=depth, where=(enter <= leave) & (enter > 0))


class Renderer:
    """The robot as a camera should see it.

    meshes: one for each link, in the link's frame. Raises DeviceError if there is no such device.
    """

    def __init__(self, camera: Camera, meshes: Sequence[kernels.Surface], device: str = "cpu") -> None:
        self.camera, self._device = camera, kernels.check_device(device)
        self.raster = kernels.Rasteriser(kernels.grid(camera), meshes, self._device)
        self._graph = kernels.Graph([self.raster.launch], self._device)

    def move(self, camera: Camera) -> None:
        """See with this camera from the next `place` on; it differs in nothing but its pose."""
        self.camera = camera

    def place(self, T_world_link: Array) -> None:
        """Move the links to these poses (n, 4, 4)."""
        self.raster.place(self.camera.T_camera_world @ T_world_link)

    def render(self, T_world_link: Array) -> RobotImage:
        """Depth and link of what is seen with the links at these poses (n, 4, 4)."""
        self.draw(T_world_link)
        return RobotImage(*self.raster.image())

    def draw(self, T_world_link: Array) -> None:
        """Only draw them, in the raster's keys."""
        self.place(T_world_link)
        self._graph.replay()

    def expand(self, margins: ArrayLike) -> None:
        """Draw every surface moved out along its vertex normals from now on, by one margin [m] or one for each link (n,)."""
        self.raster.expand(margins)
