"""The three images of a depth camera as a browser gets them: what it measures, the robot as it should see it, what is left.

Of each image the part around the robot is shown: the rest is floor and walls.
"""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from app import palette
from app.palette import Colour
from hrc.geometry import apply
from hrc.messages import DepthFrame, RobotImage
from hrc.vision.camera import Camera

Pixel = TypeVar("Pixel", bound=np.generic)
Indices = NDArray[np.intp]
Picture = NDArray[np.uint8]
"""RGB, shape (rows, columns, 3)."""

CENTRE, RADIUS = (-0.2, 0.0, 0.45), 0.75
"""A ball around the robot at its task, with room for what comes near [m]."""
SIDE = 400
"""Rows and columns of the largest picture."""
SHADE_NEAR, SHADE_FAR = 1.2, 3.6
"""Depths drawn white and black [m]."""
EMPTY: Colour = (20, 22, 27)
"""Where a camera measured nothing, and where nothing is left."""
OBSTACLE: Colour = (84, 178, 255)
CROSS: Colour = (255, 59, 48)
LINK_COLOURS = np.array(palette.LINKS, np.float32)


class Pictures:
    """Draws what belongs to one camera. Methods take images of its full size, and change none of their arguments."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._rows, self._columns = _around_the_robot(camera)
        self.blank: Picture = np.full((*np.empty(camera.shape)[self._rows, self._columns].shape, 3), EMPTY, np.uint8)

    def measured(self, frame: DepthFrame) -> Picture:
        """The depth image in grey: near is bright."""
        depth = self._cut(frame.depth)
        here = np.isfinite(depth)
        near = np.clip((SHADE_FAR - np.where(here, depth, SHADE_FAR)) / (SHADE_FAR - SHADE_NEAR), 0.0, 1.0)
        picture = np.repeat((35 + 215 * near).astype(np.uint8)[:, :, None], 3, axis=2)
        picture[~here] = EMPTY
        return picture

    def expected(self, robot: RobotImage) -> Picture:
        """The robot as the camera should see it, each link in its colour."""
        link = self._cut(robot.link)
        return self._lit(self._cut(robot.depth), link < len(LINK_COLOURS), lambda on: LINK_COLOURS[link[on]])

    def remaining(self, foreground: DepthFrame) -> Picture:
        """What perception takes for obstacles: the depth image without robot and environment."""
        depth = self._cut(foreground.depth)
        return self._lit(depth, np.isfinite(depth), lambda _: np.array(OBSTACLE, np.float32))

    def marked(self, picture: Picture, pixel: tuple[float, float], colour: Colour, radius: float) -> Picture:
        """The picture with a ring around a pixel (u, v) of the depth image. radius: over the picture's longer side."""
        column, row = (round((at - cut.start) / cut.step) for at, cut in zip(pixel, (self._columns, self._rows), strict=True))
        radius *= max(picture.shape)
        reach = round(radius) + 3
        top, left = max(0, row - reach), max(0, column - reach)
        marked = picture.copy()
        patch = marked[top : max(0, row + reach + 1), left : max(0, column + reach + 1)]
        v, u = np.ogrid[top : top + patch.shape[0], left : left + patch.shape[1]]
        off = np.abs(np.hypot(v - row, u - column) - radius)
        patch[off <= 2.0] = EMPTY  # a rim: it stands out on any ground
        patch[off <= 1.0] = colour
        return marked

    def _cut(self, image: NDArray[Pixel]) -> NDArray[Pixel]:
        return image[self._rows, self._columns]

    def _lit(self, depth: NDArray[np.float32], on: NDArray[np.bool_],
             colours: Callable[[tuple[Indices, Indices]], NDArray[np.float32]]) -> Picture:
        """What lies at some pixels, under a headlamp; only the part of the image that holds it is looked at.

        colours: of pixels by row and column (n, 3), or one for all (3,).
        """
        picture, (rows, columns) = self.blank.copy(), np.nonzero(on)
        if len(rows):
            top, left = max(0, int(rows[0]) - 1), max(0, int(columns.min()) - 1)
            light = self._relief(depth[top : int(rows[-1]) + 1, left : int(columns.max()) + 1])
            picture[rows, columns] = colours((rows, columns)) * light[rows - top, columns - left, None]
        return picture

    def _relief(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """How much light a headlamp at the camera throws back, 0.4 to 1: dark where the surface turns away."""
        z = np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)
        pixel = np.maximum(z, 0.1) * np.float32(self._rows.step / self._camera.config.fx)  # its size on the surface [m]
        slope = np.zeros_like(z)
        slope[:, 1:] += (np.diff(z, axis=1) / pixel[:, 1:]) ** 2
        slope[1:] += (np.diff(z, axis=0) / pixel[1:]) ** 2
        return np.maximum(0.4, 1.0 / np.sqrt(1.0 + 0.5 * slope))


def crossed(picture: Picture) -> Picture:
    """The picture darkened and crossed out: it is old."""
    rows, columns = picture.shape[:2]
    v, u = np.ogrid[:rows, :columns]
    rising, falling = np.abs(v - u * rows / columns), np.abs(v - (columns - u) * rows / columns)
    crossed = picture // 3
    crossed[np.minimum(rising, falling) < 2] = CROSS
    return crossed


def _around_the_robot(camera: Camera) -> tuple[slice, slice]:
    """Rows and columns that are shown; all of them where the camera stands too near, or looks elsewhere."""
    rows, columns = camera.shape
    centre = apply(camera.T_camera_world, np.array(CENTRE))
    cut = (slice(0, rows), slice(0, columns))
    if centre[2] > RADIUS:
        u, v, z = (float(x) for x in camera.project(centre))
        around = camera.config.fx * RADIUS / math.sqrt(z * z - RADIUS * RADIUS)
        cut = tuple(slice(max(0, round(at - around)), min(end, round(at + around))) for at, end in ((v, rows), (u, columns)))
    if any(part.stop - part.start < 16 for part in cut):
        cut = (slice(0, rows), slice(0, columns))
    step = -(-max(part.stop - part.start for part in cut) // SIDE)  # rounded up
    return slice(cut[0].start, cut[0].stop, step), slice(cut[1].start, cut[1].stop, step)
