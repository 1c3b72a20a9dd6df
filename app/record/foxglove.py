"""Foxglove's well-known messages as JSON, and their schemas: of each the fields that a session fills."""

import base64
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from app.record.signals import SIGNALS, Columns
from hrc.meshes import Mesh
from hrc.vision.camera import Camera

Json = dict[str, Any]
NUMBER, TEXT, WHOLE, TRUTH = {"type": "number"}, {"type": "string"}, {"type": "integer"}, {"type": "boolean"}
DEBUG, INFO, WARNING = 1, 2, 3
SHAFT, HEAD = 0.016, 0.036
"""Diameters of an arrow [m]."""


def _object(**properties: Any) -> Json:
    return {"type": "object", "properties": properties}


def _list(of: Json) -> Json:
    return {"type": "array", "items": of}


_TIME = _object(sec=WHOLE, nsec=WHOLE)
_VECTOR = _object(x=NUMBER, y=NUMBER, z=NUMBER)
_TURN = _object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
_COLOUR = _object(r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
_POSE = _object(position=_VECTOR, orientation=_TURN)
_SOLID = _object(pose=_POSE, size=_VECTOR, color=_COLOUR)
_ENTITY = _object(
    timestamp=_TIME, frame_id=TEXT, id=TEXT, lifetime=_TIME, frame_locked=TRUTH, cubes=_list(_SOLID), spheres=_list(_SOLID),
    arrows=_list(_object(pose=_POSE, shaft_length=NUMBER, shaft_diameter=NUMBER, head_length=NUMBER, head_diameter=NUMBER,
                         color=_COLOUR)),
    triangles=_list(_object(pose=_POSE, points=_list(_VECTOR), color=_COLOUR, indices=_list(WHOLE))))
SCHEMAS: Mapping[str, Json] = {
    "foxglove.FrameTransforms": _object(transforms=_list(_object(
        timestamp=_TIME, parent_frame_id=TEXT, child_frame_id=TEXT, translation=_VECTOR, rotation=_TURN))),
    "foxglove.SceneUpdate": _object(
        deletions=_list(_object(timestamp=_TIME, type=WHOLE, id=TEXT)), entities=_list(_ENTITY)),
    "foxglove.RawImage": _object(
        timestamp=_TIME, frame_id=TEXT, width=WHOLE, height=WHOLE, encoding=TEXT, step=WHOLE,
        data={"type": "string", "contentEncoding": "base64"}),
    "foxglove.CameraCalibration": _object(
        timestamp=_TIME, frame_id=TEXT, width=WHOLE, height=WHOLE, distortion_model=TEXT, D=_list(NUMBER), K=_list(NUMBER),
        R=_list(NUMBER), P=_list(NUMBER)),
    "foxglove.Log": _object(timestamp=_TIME, level=WHOLE, message=TEXT, name=TEXT, file=TEXT, line=WHOLE),
    "elbowroom.Signals": _object(**{signal.name: {
        **(_list(NUMBER) if signal.width > 1 else TEXT if signal.kind == "mode" else NUMBER),
        "description": f"{signal.meaning} [{signal.unit}]"} for signal in SIGNALS}),
}


def encoded(message: Json) -> bytes:
    """As it goes into a file."""
    return json.dumps(message, allow_nan=False, separators=(",", ":")).encode()


def time(ns: int) -> Json:
    """A time [ns] from the start of the session."""
    return {"sec": ns // 1_000_000_000, "nsec": ns % 1_000_000_000}


def vector(xyz: ArrayLike) -> Json:
    """A point or a direction (3,)."""
    return dict(zip("xyz", np.asarray(xyz, float).tolist(), strict=True))


def colour(rgb: Sequence[float], alpha: float = 1.0) -> Json:
    """A colour 0..1."""
    return {**dict(zip("rgb", map(float, rgb), strict=True)), "a": alpha}


def pose(T: NDArray[np.float64]) -> Json:
    """A pose (4, 4)."""
    return {"position": vector(T[:3, 3]), "orientation": _turn(Rotation.from_matrix(T[:3, :3]))}


def _turn(rotation: Rotation) -> Json:
    return dict(zip("xyzw", rotation.as_quat().tolist(), strict=True))


def transforms(ns: int, poses: Mapping[str, NDArray[np.float64]]) -> Json:
    """foxglove.FrameTransforms of poses (4, 4) in the world, by the frame's name."""
    return {"transforms": [{
        "timestamp": time(ns), "parent_frame_id": "world", "child_frame_id": name, "translation": vector(T[:3, 3]),
        "rotation": _turn(Rotation.from_matrix(T[:3, :3]))} for name, T in poses.items()]}


def scene(entities: Sequence[Json], ns: int = 0, gone: Sequence[str] = ()) -> Json:
    """foxglove.SceneUpdate. gone: ids of what is there no more."""
    return {"deletions": [{"timestamp": time(ns), "type": 0, "id": name} for name in gone], "entities": list(entities)}


def entity(ns: int, name: str, frame: str = "world", **primitives: Json) -> Json:
    """A thing in the scene, made of one primitive of each kind given; it stays until it is replaced or gone."""
    return {"timestamp": time(ns), "frame_id": frame, "id": name, "lifetime": time(0), "frame_locked": True,
            **{kind: [primitive] for kind, primitive in primitives.items()}}


def solid(T: NDArray[np.float64], size: ArrayLike, rgb: Sequence[float]) -> Json:
    """A cube or sphere with whole lengths or diameters `size` [m]."""
    return {"pose": pose(T), "size": vector(size), "color": colour(rgb)}


def triangles(mesh: Mesh, rgb: Sequence[float], T: NDArray[np.float64] | None = None) -> Json:
    """A mesh, at the pose T (4, 4) in its frame if not at its origin."""
    return {"pose": pose(np.eye(4) if T is None else T), "points": [vector(vertex) for vertex in mesh.vertices],
            "color": colour(rgb), "indices": mesh.faces.ravel().tolist()}


def arrow(tip: NDArray[np.float64], along: NDArray[np.float64], rgb: Sequence[float]) -> Json:
    """An arrow of the length of `along` [m] that ends at `tip`."""
    length = max(float(np.linalg.norm(along)), 1e-9)
    x, y, z = along / length
    # From +x, where an arrow points by itself; the axis is any across where it is to point the other way.
    turn = Rotation.from_quat([0.0, -z, y, 1.0 + x] if x > -0.999999 else [0.0, 0.0, 1.0, 0.0])
    return {"pose": {"position": vector(tip - along), "orientation": _turn(turn)}, "shaft_length": 0.75 * length,
            "shaft_diameter": SHAFT, "head_length": 0.25 * length, "head_diameter": HEAD, "color": colour(rgb)}


def image(ns: int, frame: str, millimetres: NDArray[np.uint16]) -> Json:
    """foxglove.RawImage of depth [mm] (H, W), 0 where nothing was measured."""
    height, width = millimetres.shape
    data = base64.b64encode(np.ascontiguousarray(millimetres, "<u2").tobytes()).decode()
    return {"timestamp": time(ns), "frame_id": frame, "width": width, "height": height, "encoding": "16UC1", "step": 2 * width,
            "data": data}


def calibration(ns: int, frame: str, camera: Camera) -> Json:
    """foxglove.CameraCalibration of a pinhole without distortion."""
    c = camera.config
    K = [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0]
    P = [c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return {"timestamp": time(ns), "frame_id": frame, "width": c.width, "height": c.height, "distortion_model": "", "D": [],
            "K": K, "R": np.eye(3).ravel().tolist(), "P": P}


def log(ns: int, level: int, text: str) -> Json:
    """foxglove.Log."""
    return {"timestamp": time(ns), "level": level, "message": text, "name": "elbowroom", "file": "", "line": 0}


def signals(columns: Columns, row: int) -> Json:
    """elbowroom.Signals: every column of one control tick; what is no number is null."""
    return {name: _plain(values[row].tolist()) for name, values in columns.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(x) for x in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
