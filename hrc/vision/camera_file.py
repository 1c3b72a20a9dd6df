"""A calibrated camera from a TOML file: intrinsics, pose, lens, and what a step of its depth image means."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrc import toml_file
from hrc.errors import AssetError, ConfigError, unknown
from hrc.geometry import Array, transform
from hrc.messages import DepthFrame
from hrc.vision.camera import Camera, CameraConfig
from hrc.vision.depth_image import Distortion, Rectifier, depth_frame

INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy")
POSE = ("eye", "target", "T_world_camera")
KNOWN = (*INTRINSICS, *POSE, "unit", "distortion")
FARTHEST = 10.0
"""No camera stands farther from the robot's base than this, along an axis [m]."""


@dataclass(frozen=True, eq=False)
class CalibratedCamera:
    """A real camera: the pinhole one its rectified image belongs to, its lens, and the unit of its images.

    distortion, rectifier: None for a camera that corrects its images itself. unit: metres in one step of the image; None for
    a millimetre in images of uint16 and a metre in those of floats.
    """

    camera: Camera
    distortion: Distortion | None = None
    rectifier: Rectifier | None = None
    unit: float | None = None

    def frame(self, tick: int, image: NDArray[np.generic]) -> DepthFrame:
        """The depth frame, rectified, from an image as the camera's driver hands it over; errors as in `depth_frame`."""
        return depth_frame(tick, image, unit=self.unit, rectify=self.rectifier)


def load_camera(path: str | Path) -> CalibratedCamera:
    """Read a camera file: width, height, fx, fy, cx, cy; eye and target, or T_world_camera; and if there is one, a table
    [distortion] and the unit.

    Raises AssetError for a file that is missing or no TOML, and ConfigError for a key or value that cannot be.
    """
    path = Path(path)
    table = toml_file.read(path, "camera", AssetError)
    try:
        return _camera(table)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def _camera(table: dict[str, Any]) -> CalibratedCamera:
    for key in table:
        if key not in KNOWN:
            raise ConfigError(unknown("key", key, KNOWN))
    if missing := [key for key in INTRINSICS if key not in table]:
        raise ConfigError(f"{', '.join(missing)} missing; a camera needs {', '.join(INTRINSICS)} [px]")
    pose = [key for key in POSE if key in table]
    if pose not in (["eye", "target"], ["T_world_camera"]):
        raise ConfigError("where the camera stands is either eye and target [m] or the matrix T_world_camera (4 x 4), not "
                          + (" and ".join(pose) or "missing"))
    config = CameraConfig(**{key: table[key] for key in (*INTRINSICS, "eye", "target") if key in table})
    camera = Camera(config, _pose(table["T_world_camera"]) if "T_world_camera" in table else None)
    distortion = _distortion(table["distortion"]) if "distortion" in table else None
    return CalibratedCamera(camera, distortion, Rectifier(camera, distortion) if distortion else None, _unit(table))


def _unit(table: dict[str, Any]) -> float | None:
    unit = table.get("unit")
    if unit is None:
        return None
    if isinstance(unit, bool) or not isinstance(unit, int | float) or not 1e-6 <= unit <= 1.0:
        raise ConfigError(f"unit must be the metres in one step of the image, from 1e-06 to 1, not {unit!r}; "
                          "0.001 is a millimetre")
    return float(unit)


def _distortion(table: Any) -> Distortion:
    known = [field.name for field in fields(Distortion)]
    if not isinstance(table, dict):
        raise ConfigError(f"distortion must be a table of {', '.join(known)}, not {table!r}")
    for key in table:
        if key not in known:
            raise ConfigError(unknown("key of distortion", key, known))
    try:
        return Distortion(**table)
    except ConfigError as error:
        raise ConfigError(f"distortion: {error}") from None


def _pose(rows: Any) -> Array:
    try:
        T = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError):
        T = np.empty(0)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise ConfigError("T_world_camera must be four rows of four numbers")
    if not np.allclose(T[3], [0, 0, 0, 1]):
        raise ConfigError(f"T_world_camera must end with the row 0 0 0 1, not {T[3].tolist()}; is it transposed?")
    R, p = T[:3, :3], T[:3, 3]
    if not np.allclose(R @ R.T, np.eye(3), atol=2e-3) or np.linalg.det(R) < 0:
        what = "mirrors: its determinant is -1" if np.linalg.det(R) < 0 else "scales or shears"
        raise ConfigError(f"T_world_camera holds no rotation, its upper left 3 x 3 {what}; its columns are the camera's x "
                          "(right), y (down) and z (forward) in the world")
    if np.abs(p).max() > FARTHEST:
        raise ConfigError(f"T_world_camera puts the camera at {p.tolist()} m; metres from -{FARTHEST:g} to {FARTHEST:g} are "
                          "expected: are these millimetres?")
    # A calibration is printed to a few digits: the rotation nearest to it.
    U, _, Vt = np.linalg.svd(R)
    return transform(U @ Vt, p)
