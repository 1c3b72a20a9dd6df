"""A folder of depth images with the robot's joint positions: camera.toml, depth/, joints.csv, and maybe the empty cell."""

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrc.errors import AssetError, SensorError
from hrc.geometry import Array
from hrc.messages import DepthFrame, frozen
from hrc.vision.camera_file import CalibratedCamera, load_camera

IMAGES = (".png", ".npy")
JOINTS = tuple(f"q{i}" for i in range(1, 8))
COLUMNS = ("file", "time", *JOINTS)
TURN = 2 * math.pi
"""No joint turns farther than this from zero [rad]."""


@dataclass(frozen=True, eq=False)
class Shot:
    """A depth image's file, and when it was exposed [s] with the robot at which joint positions [rad] (7,)."""

    path: Path
    time: float = 0.0
    q: Array = field(default_factory=lambda: np.zeros(7))

    def image(self) -> NDArray[np.generic]:
        """The image as it is in the file. Raises SensorError if it cannot be read, or is no depth image."""
        try:
            return np.load(self.path, allow_pickle=False) if self.path.suffix == ".npy" else _png(self.path)
        except (OSError, ValueError, SyntaxError, EOFError) as error:  # SyntaxError: a broken PNG, for Pillow
            raise SensorError(f"it cannot be read: {error}") from None

    def frame(self, tick: int, camera: CalibratedCamera) -> DepthFrame:
        """The depth frame. Raises SensorError for an image or joint positions that are no measurement."""
        frame = camera.frame(tick, self.image())
        if frame.depth.shape != camera.camera.shape:
            raise SensorError(f"the image is {frame.depth.shape}, the camera file says {camera.camera.shape} (height, width)")
        frozen(self.q, (7,), "its row of joint positions")
        return frame


@dataclass(frozen=True, eq=False)
class DepthFolder:
    """What a folder holds. empty: images of the cell without obstacles, from which its environment is learned.

    robot_in_empty: whether the robot stands in those, too. scene: file of the environment's boxes.
    """

    camera: CalibratedCamera
    shots: tuple[Shot, ...]
    empty: tuple[Shot, ...] = ()
    robot_in_empty: bool = False
    scene: Path | None = None


def read(folder: Path) -> DepthFolder:
    """Read all but the images. Raises AssetError, ConfigError or SensorError for what is missing or cannot be."""
    if not folder.is_dir():
        raise AssetError(f"{folder} is no folder; it should hold camera.toml, joints.csv and depth/ with the images")
    camera = load_camera(folder / "camera.toml")
    shots = _shots(folder / "depth", folder / "joints.csv")
    scene, empty, rows = folder / "scene.toml", folder / "empty", folder / "empty.csv"
    robot_in_empty, background = rows.exists(), ()
    if empty.exists() or robot_in_empty:
        background = _shots(empty, rows) if robot_in_empty else tuple(Shot(path) for path in _images(empty))
    return DepthFolder(camera, shots, background, robot_in_empty, scene if scene.exists() else None)


def _shots(images: Path, table: Path) -> tuple[Shot, ...]:
    """The images of a folder in the order of the table, which has one row for each."""
    paths = {path.name: path for path in _images(images)}
    rows = list(_rows(table))
    names = [row.path.name for row in rows]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise AssetError(f"{table} names {_some(twice)} twice; it needs one row for each image")
    if without := sorted(paths.keys() - set(names)):
        raise AssetError(f"{table} has {len(rows)} rows for {len(paths)} images; none for {_some(without)}")
    if missing := [name for name in names if name not in paths]:
        raise AssetError(f"{table} has {len(rows)} rows for {len(paths)} images; {images} holds no {_some(missing)}")
    return tuple(Shot(paths[row.path.name], row.time, row.q) for row in rows)


def _images(folder: Path) -> list[Path]:
    found = sorted(path for path in folder.glob("*") if path.suffix.lower() in IMAGES)
    if not found:
        raise AssetError(f"there are no depth images in {folder}; they are 16-bit PNG (.png) or numpy arrays (.npy)")
    return found


def _rows(table: Path) -> Iterator[Shot]:
    try:
        with table.open(newline="", encoding="utf-8-sig") as lines:
            reader = csv.DictReader(lines, skipinitialspace=True)
            header = [name.strip() for name in reader.fieldnames or ()]
            reader.fieldnames = header
            if missing := [name for name in COLUMNS if name not in header]:
                raise AssetError(f"{table} lacks the column {missing[0]}; its first line should be {','.join(COLUMNS)}, "
                                 "with times in s and joint positions in rad")
            for row in reader:
                yield _row(f"{table}, line {reader.line_num}", row)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise AssetError(f"the table of joint positions {table} cannot be read: {error}") from None


def _row(where: str, row: dict[str, Any]) -> Shot:
    try:
        time, *q = (float(row[name]) for name in COLUMNS[1:])
    except (TypeError, ValueError):
        raise AssetError(f"{where}: {', '.join(COLUMNS[1:])} must all be numbers (nan if one is not known)") from None
    turned = [(name, angle) for name, angle in zip(JOINTS, q, strict=True) if abs(angle) > TURN]
    if turned:
        raise SensorError(f"{where}: {turned[0][0]} is {turned[0][1]:g}, more than a full turn; joint positions are in "
                          "radians: are these degrees?")
    return Shot(Path(str(row["file"]).strip()), time, np.array(q))


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} others" if len(names) > 3 else "")


def _png(path: Path) -> NDArray[np.generic]:
    from PIL import Image  # here, because only images need it

    with Image.open(path) as image:
        if image.mode.partition(";")[0] == "I":
            return np.asarray(image).astype(np.uint16)
        bits = "8-bit grey" if image.mode in ("L", "P", "1") else image.mode
        raise SensorError(f"it is a {bits} image; depth is a 16-bit grey PNG, in steps of the camera file's unit")
