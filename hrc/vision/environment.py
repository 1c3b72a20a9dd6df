"""The fixed environment of a camera, table and walls: learned from images of the empty cell, or rendered from boxes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrc.errors import SensorError
from hrc.geometry import Array
from hrc.messages import DepthFrame, RobotImage
from hrc.vision.camera import Camera
from hrc.vision.render import FixedBox, environment_depth

Environment = Sequence[FixedBox] | NDArray[np.floating]
"""Boxes in the world, or a depth image [m] (H, W) of one camera as `learned_environment` makes it."""
AROUND = 2
"""A learned pixel is as near as any within so many rows and columns."""


def environment_mask(camera: Camera, environment: Environment, margin: float) -> Array:
    """The depth [m] (H, W) at which a pixel begins to belong to the environment: boxes are `margin` [m] larger on every
    side, an image is that much nearer along the depth.

    Raises SensorError for an image that is not of the camera's size, or holds anything but depths > 0 and +inf.
    """
    if not isinstance(environment, np.ndarray):
        return environment_depth(camera, environment, margin)
    if environment.shape != camera.shape:
        raise SensorError(f"the environment's depth image must be {camera.shape}, like the camera's, not {environment.shape}")
    if not (environment > 0).all():
        raise SensorError("the environment's depth image must hold depths > 0 [m], and +inf where nothing is")
    return np.maximum(environment.astype(np.float64) - margin, 1e-3)


def learned_environment(frames: Sequence[DepthFrame], robots: Sequence[RobotImage] | None = None) -> Array:
    """The near side [m] (H, W) of what stands in a cell, from frames with nothing else in it; +inf where nothing was measured.

    Each pixel's median over the frames passes over what a minority of them had: a mixed pixel, a hand that came by. Then the
    nearest of the 5 x 5 pixels around counts, for at an edge a pixel has the front in one frame, the back or a mixture in
    the next, and any one statistic of its own readings is on the wrong side of some. What noise remains, the margin of
    `environment_mask` covers; readings that a pixel has seldom count like all others, because they will come again.

    robots: if the robot was in the cell, its image in each frame, moved out by the filter's margin (`Renderer.expand`). A
    reading at or behind it says nothing about the cell. A pixel that had no other reading begins to be environment at the
    farthest place where the robot was: up to there the space was free, and farther nobody has looked. So let it move.

    Raises SensorError without frames, or if frames and robot images differ in number or size.
    """
    if not frames:
        raise SensorError("an environment is learned from images of the empty cell: give some, 30 for instance")
    shape = frames[0].depth.shape
    images = [frame.depth for frame in frames] + [robot.depth for robot in robots or ()]
    if any(image.shape != shape for image in images) or (robots is not None and len(robots) != len(frames)):
        raise SensorError(f"there must be as many robot images as frames, and all of the same size, {shape}")
    readings = np.stack([frame.depth for frame in frames])
    surface = np.full(shape, np.inf)
    if robots is not None:
        covers = np.stack([robot.depth for robot in robots])
        readings[readings >= covers] = np.inf
        free = covers.max(axis=0, where=np.isfinite(covers), initial=0.0)
        surface[free > 0] = free[free > 0]
    readings[np.isinf(readings)] = np.nan
    measured = ~np.isnan(readings).all(axis=0)
    surface[measured] = np.nanmedian(readings[:, measured], axis=0)
    return _nearest_around(surface)


def _nearest_around(depth: Array) -> Array:
    """The least of the (2 AROUND + 1)^2 pixels around each."""
    for axis in (0, 1):
        padding = [(0, 0), (0, 0)]
        padding[axis] = (AROUND, AROUND)
        padded = np.pad(depth, padding, mode="edge")
        depth = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1, axis).min(axis=-1)
    return depth
