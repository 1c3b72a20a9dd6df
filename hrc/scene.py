"""The cell around the robot: the fixed environment and the obstacles that may enter."""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hrc.errors import AssetError
from hrc.paths import assets

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """A fixed box of the environment: centre and half lengths [m], in the world; colour 0..1."""

    name: str
    centre: Vector
    half: Vector
    rgb: Vector = (0.6, 0.6, 0.6)


@dataclass(frozen=True)
class BodySpec:
    """An obstacle: shape "sphere" (size = (radius,)) or "box" (size = half lengths) [m]; mass [kg]; colour 0..1."""

    name: str
    shape: str
    size: tuple[float, ...]
    mass: float = 1.0
    rgb: Vector = (0.3, 0.5, 0.8)

    @property
    def radius(self) -> float:
        """Half the largest extent along an axis [m]."""
        return max(self.size)


@dataclass(frozen=True)
class Scene:
    """Environment boxes, and the obstacles by name."""

    environment: tuple[Box, ...]
    bodies: tuple[BodySpec, ...]


def load_scene(path: Path | None = None) -> Scene:
    """Read a scene file; by default the project's cell. Raises AssetError if it is missing or malformed."""
    path = path or assets() / "scenes" / "cell.toml"
    try:
        table = tomllib.loads(path.read_text())
        boxes = tuple(Box(**_tuples(t)) for t in table.get("environment", []))
        bodies = tuple(BodySpec(**_tuples(t)) for t in table.get("body", []))
    except OSError as error:
        raise AssetError(f"the scene file {path.name} cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, TypeError) as error:
        raise AssetError(f"the scene file {path.name} is malformed: {error}") from None
    for body in bodies:
        if len(body.size) != {"sphere": 1, "box": 3}.get(body.shape):
            raise AssetError(f'{path.name}: obstacle "{body.name}" must be a sphere with one size or a box with three')
    return Scene(boxes, bodies)


def _tuples(table: dict[str, Any]) -> dict[str, Any]:
    return {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}
