"""The cell around the robot: the fixed environment, the obstacles that may enter, the depth cameras."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hrc import figure, toml_file
from hrc.errors import AssetError, unknown
from hrc.geometry import Array

Vector = tuple[float, float, float]
ENTRIES = ("extends", "environment", "body", "camera")


@dataclass(frozen=True)
class Box:
    """A fixed box of the environment: centre and half lengths [m], in the world; colour 0..1."""

    name: str
    centre: Vector
    half: Vector
    rgb: Vector = (0.6, 0.6, 0.6)


@dataclass(frozen=True)
class BodySpec:
    """An obstacle: shape "sphere" (size = (radius,)), "capsule" (radius, half length of its axis, along z), "box" (half
    lengths) or "figure", a person from the waist up (height,) [m]; mass [kg]; colour 0..1."""

    name: str
    shape: str
    size: tuple[float, ...]
    mass: float = 1.0
    rgb: Vector = (0.3, 0.5, 0.8)

    @property
    def radius(self) -> float:
        """Half the largest extent along an axis [m]."""
        return sum(self.size) if self.shape == "capsule" else max(self.size) / (2.0 if self.shape == "figure" else 1.0)

    @property
    def reach(self) -> float:
        """How far the body's farthest point is from its centre [m]."""
        if self.shape == "figure":
            return max(float(np.linalg.norm(part.T_figure_part[:3, 3])) + sum(part.size) for part in figure.parts(*self.size))
        return float(np.linalg.norm(self.size)) if self.shape == "box" else sum(self.size)

    def extent(self, direction: ArrayLike) -> float:
        """How far the body reaches from its centre along a unit vector of its own frame [m]."""
        if self.shape == "figure":
            return max(_extent(part, np.asarray(direction, float)) for part in figure.parts(*self.size))
        along = np.abs(np.asarray(direction, float))
        if self.shape == "box":
            return float(along @ np.asarray(self.size))
        return self.size[0] + (float(along[2]) * self.size[1] if self.shape == "capsule" else 0.0)


@dataclass(frozen=True)
class CameraSpec:
    """A depth camera by name, with the parameters in which it differs from the config's (groups camera, sensor; `hz`)."""

    name: str
    changes: dict[str, Any]


@dataclass(frozen=True)
class Scene:
    """Environment boxes, and obstacles and cameras by name. No camera means the one of the config."""

    environment: tuple[Box, ...]
    bodies: tuple[BodySpec, ...]
    cameras: tuple[CameraSpec, ...] = ()


def scenes() -> list[str]:
    """The scenes that come with the project."""
    return toml_file.names("scenes")


def load_scene(name: str | Path = "cell") -> Scene:
    """A scene by its name, or by the path of its file. Raises AssetError if it is missing or malformed.

    A file may say `extends = "cell"`: then it adds to that scene.
    """
    path = toml_file.find(name, "scenes", "scene", AssetError)
    table = toml_file.read(path, "scene", AssetError)
    try:
        for key in table:
            if key not in ENTRIES:
                raise AssetError(f"the scene file {path.name} is malformed: {unknown('entry', key, ENTRIES)}")
        base = load_scene(table["extends"]) if "extends" in table else Scene((), ())
        boxes = tuple(Box(**_tuples(t)) for t in table.get("environment", []))
        bodies = tuple(BodySpec(**_tuples(t)) for t in table.get("body", []))
        cameras = tuple(CameraSpec(t.pop("name"), t) for t in (_tuples(t) for t in table.get("camera", [])))
    except KeyError:
        raise AssetError(f"the scene file {path.name} is malformed: a camera needs a name") from None
    except (TypeError, RecursionError) as error:
        raise AssetError(f"the scene file {path.name} is malformed: {error}") from None
    for body in bodies:
        if len(body.size) != {"sphere": 1, "capsule": 2, "box": 3, "figure": 1}.get(body.shape):
            raise AssetError(f'{path.name}: obstacle "{body.name}" must be a sphere or figure with one size, a capsule with '
                             "two or a box with three")
    scene = Scene(base.environment + boxes, base.bodies + bodies, base.cameras + cameras)
    for kind, entries in (("obstacle", scene.bodies), ("camera", scene.cameras)):
        names = [entry.name for entry in entries]
        if len(set(names)) < len(names):
            raise AssetError(f"{path.name}: two {kind}s have the same name: {', '.join(names)}")
    return scene


def _extent(part: figure.Part, direction: Array) -> float:
    T = part.T_figure_part
    return float(T[:3, 3] @ direction) + part.size[0] + abs(float(T[:3, 2] @ direction)) * sum(part.size[1:])


def _tuples(table: dict[str, Any]) -> dict[str, Any]:
    return {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}
