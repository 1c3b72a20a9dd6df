"""Where the depth images of a real camera come in: any unit, any invalid pixel, a lens that bends straight lines."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrc.errors import SensorError
from hrc.geometry import Array
from hrc.messages import DepthFrame
from hrc.parameters import Parameters, param
from hrc.vision.camera import Camera

MILLIMETRE = 0.001
NO_ROOM = (0.01, 100.0)
"""An image whose every depth [m] is below the first or above the second is taken to have the wrong unit."""
_STEPS = 20
"""Newton steps at most; four or five are enough away from where the lens model folds."""


def depth_frame(tick: int, image: NDArray[np.generic], *, unit: float | None = None,
                rectify: "Callable[[NDArray[np.generic]], NDArray[np.generic]] | None" = None) -> DepthFrame:
    """A depth frame from an image (H, W) as a camera's driver hands it over: uint16, float32 or float64.

    unit: metres in one step of the image; a millimetre for uint16 and a metre for floats when not given. rectify: takes the
    lens distortion out, as `Rectifier` does. A pixel that is 0, negative, NaN or infinite measured nothing: +inf in the
    frame. The image is copied, so a driver may use its buffer again.

    Raises SensorError for an image of another type or shape, and for depths that only a wrong unit explains.
    """
    image = _checked(np.asarray(image))
    if unit is None:
        unit = MILLIMETRE if image.dtype.kind == "u" else 1.0
    if not (math.isfinite(unit) and unit > 0):
        raise SensorError(f"unit must be the metres in one step of the image, as 0.001 for millimetres, not {unit!r}")
    if rectify is not None:
        image = rectify(image)
    with np.errstate(over="ignore"):  # a float64 beyond float32 is as far as can be
        depth = image.astype(np.float32)
        depth *= np.float32(unit)
    measured = depth > 0  # False for NaN, too
    depth[~measured] = np.inf
    _check_unit(depth, unit)
    return DepthFrame(tick, depth)


def _checked(image: NDArray[np.generic]) -> NDArray[np.generic]:
    given = f"{image.dtype} {image.shape}"
    if image.ndim != 2 or not image.size:
        raise SensorError(f"a depth image must have the shape (H, W), one number for each pixel, not {given}")
    if image.dtype.kind + str(image.dtype.itemsize) not in ("u2", "f4", "f8"):
        hint = "; 8 bits are a picture of depth, not depth" if image.dtype.itemsize == 1 else ""
        raise SensorError(f"a depth image must be uint16 (millimetres) or float32 or float64 (metres), not {given}{hint}")
    return image


def _check_unit(depth: NDArray[np.float32], unit: float) -> None:
    nearest = float(depth.min())
    if NO_ROOM[0] <= nearest <= NO_ROOM[1] or nearest == math.inf:
        return
    farthest = float(depth.max(where=np.isfinite(depth), initial=0.0))
    if nearest > NO_ROOM[1] or farthest < NO_ROOM[0]:
        raise SensorError(f"depths of {nearest:g} to {farthest:g} m are no room: unit = {unit:g} m cannot be right; it is the "
                          "metres in one step of the image, 0.001 for millimetres")


@dataclass(frozen=True)
class Distortion(Parameters):
    """The lens model of Brown and Conrady, with the coefficients' names of OpenCV and of the Kinect's factory values.

    OpenCV's vector has them in the order k1, k2, p1, p2, k3. Coordinates x, y are those of a ray at depth 1.
    """

    k1: float = param(0.0, low=-100.0, high=100.0, live=False)
    """Radial, of r^2."""
    k2: float = param(0.0, low=-100.0, high=100.0, live=False)
    """Radial, of r^4."""
    p1: float = param(0.0, low=-10.0, high=10.0, live=False)
    """Tangential: a lens tilted about the rows."""
    p2: float = param(0.0, low=-10.0, high=10.0, live=False)
    """Tangential: a lens tilted about the columns."""
    k3: float = param(0.0, low=-100.0, high=100.0, live=False)
    """Radial, of r^6."""

    @property
    def limit(self) -> float:
        """Radius at depth 1 up to which a ray farther out is also farther out in the image.

        Beyond it the polynomial turns round, and the model would show there what is seen farther in.
        """
        turns = np.roots([7 * self.k3, 5 * self.k2, 3 * self.k1, 1.0])  # of r (1 + k1 r^2 + ...), in r^2
        real = turns.real[(np.abs(turns.imag) < 1e-9) & (turns.real > 0)]
        return math.sqrt(real.min()) if real.size else math.inf

    def distort(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Where the lens shows the ray through (x, y, 1)."""
        x, y = np.asarray(x, float), np.asarray(y, float)
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return (x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x),
                y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y)

    def undistort(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """The ray (x, y, 1) that the lens shows at (x, y): Newton's method on `distort`. NaN where there is none."""
        to_x, to_y = np.asarray(x, float), np.asarray(y, float)
        at_x, at_y = to_x.copy(), to_y.copy()
        with np.errstate(all="ignore"):  # rays that do not exist run away
            for _ in range(_STEPS):
                dx, dy = (to - now for to, now in zip((to_x, to_y), self.distort(at_x, at_y), strict=True))
                if max(np.nanmax(np.abs(dx), initial=0.0), np.nanmax(np.abs(dy), initial=0.0)) < 1e-12:
                    break
                xx, xy, yy = self._slopes(at_x, at_y)
                det = xx * yy - xy * xy
                at_x, at_y = at_x + (yy * dx - xy * dy) / det, at_y + (xx * dy - xy * dx) / det
            dx, dy = (to - now for to, now in zip((to_x, to_y), self.distort(at_x, at_y), strict=True))
            found = (np.hypot(dx, dy) < 1e-9) & (np.hypot(at_x, at_y) < self.limit)
        return np.where(found, at_x, np.nan), np.where(found, at_y, np.nan)

    def _slopes(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """The symmetric Jacobian of `distort`: its entries xx, xy, yy."""
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        slope = 2 * (self.k1 + r2 * (2 * self.k2 + r2 * 3 * self.k3))
        return (radial + slope * x * x + 2 * self.p1 * y + 6 * self.p2 * x,
                slope * x * y + 2 * self.p1 * x + 2 * self.p2 * y,
                radial + slope * y * y + 6 * self.p1 * y + 2 * self.p2 * x)


class Rectifier:
    """From the image a lens makes to the one a pinhole camera of the same intrinsics would.

    A pixel takes the depth of the nearest one in the distorted image, off by half a pixel at most: a mean over an edge would
    be a surface where there is none. Depth is along the optical axis, so it is the same in both images. The lookup is made
    once.
    """

    def __init__(self, camera: Camera, distortion: Distortion) -> None:
        self.camera, self.distortion = camera, distortion
        rays = camera.rays()[..., :2].reshape(-1, 2).T
        c, (rows, columns) = camera.config, camera.shape
        x, y = distortion.distort(*rays)
        u, v = np.rint(c.fx * x + c.cx), np.rint(c.fy * y + c.cy)
        inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows) & (np.hypot(*rays) < distortion.limit)
        self._index = np.where(inside, v * columns + u, 0).astype(np.intp)
        self._outside = np.nonzero(~inside)[0]

    def __call__(self, image: NDArray[np.generic]) -> NDArray[np.generic]:
        """The rectified image (H, W), of the same type; 0, which is invalid, where the lens shows nothing.

        Raises SensorError if the image does not have the camera's size.
        """
        if image.shape != self.camera.shape:
            raise SensorError(f"the depth image must be {self.camera.shape}, like the camera's, not {image.shape}")
        flat = image.reshape(-1).take(self._index, mode="clip")
        flat[self._outside] = 0
        return flat.reshape(image.shape)
