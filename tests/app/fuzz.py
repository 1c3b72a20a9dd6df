"""Messages as no browser sends them: a valid one of each kind, and endless damaged ones, from one seed."""

import copy
import math
import os
import random
from collections.abc import Iterator
from typing import Any

import msgspec

COUNT = int(os.environ.get("ELBOWROOM_FUZZ", 1_000_000))
"""Fuzzed messages for the validator, half a minute of them; a fiftieth go over a socket. Fewer where that is too long."""
VALID: dict[str, dict[str, Any]] = {
    "ViewerCameraMessage": {
        "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1.0, 1.0, 1.0], "look_at": [0.0, 0.0, 0.0],
        "up_direction": [0.0, 0.0, 1.0], "fov": 1.0, "near": 0.01, "far": 100.0, "image_height": 600, "image_width": 800},
    "GuiUpdateMessage": {"uuid": "none", "updates": {"value": 0.5}},
    "CommandTriggerMessage": {"uuid": "none"},
    "SceneNodeDragMessage": {
        "phase": "update", "name": "/robot/link_4", "instance_index": None, "start_position": [0.0, 0.0, 0.5],
        "start_screen_pos": [0.5, 0.5], "end_position": [0.0, 0.1, 0.5], "end_screen_pos": [0.5, 0.5], "button": "left",
        "modifier": None},
    "SceneNodeClickMessage": {
        "name": "/robot/link_4", "instance_index": None, "ray_origin": [2.0, 0.0, 1.0], "ray_direction": [-1.0, 0.0, 0.0],
        "screen_pos": [0.5, 0.5], "modifier": None},
    "FileTransferStartUpload": {
        "source_component_uuid": "none", "transfer_uuid": "none", "filename": "a.toml", "mime_type": "", "part_count": 1,
        "size_bytes": 5},
    "FileTransferPart": {
        "source_component_uuid": "none", "transfer_uuid": "none", "part_index": 0, "content": b"a = 1"},
    "TransformControlsUpdateMessage": {"name": "/gizmo", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [0.1, 0.2, 0.3]},
    "TransformControlsDragStartMessage": {"name": "/gizmo"},
    "TransformControlsDragEndMessage": {"name": "/gizmo"},
    "LocalStorageGetItemResponseMessage": {"value": None, "error": None, "request_uuid": "none"},
}
"""A message of each kind that the page may send, as a browser sends it."""

WRONG: tuple[Any, ...] = (
    math.nan, math.inf, -math.inf, 1e300, -1e9, 2**63, True, {}, [], [[]], [math.nan] * 3, [math.nan] * 4, [0.0], [0.0] * 5,
    [True] * 3, ["0"] * 3, [None] * 4, [1e300] * 3, "x" * 300, b"bytes", {"value": 1.0, "update_cb": []}, {"removed": True})
"""What no field of any message may be."""


def message(kind: str, **changed: Any) -> dict[str, Any]:
    """A valid message, with these fields changed."""
    return {"type": kind, **copy.deepcopy(VALID[kind]), **changed}


def spoiled(kind: str, **changed: Any) -> Iterator[dict[str, Any]]:
    """Messages of a kind with one field spoiled: wrong, of another length, missing, or one too many. changed: to be valid."""
    valid = message(kind, **{field: value for field, value in changed.items() if field in VALID[kind]})
    for field, right in VALID[kind].items():
        lengths = (right[:-1], [*right, 0.0]) if isinstance(right, list) else ()
        yield from (valid | {field: wrong} for wrong in (*WRONG, *lengths)
                    if not (isinstance(right, bytes) and isinstance(wrong, bytes)))
        yield {key: value for key, value in valid.items() if key != field}
    yield valid | {"more": 1}


def damaged(seed: int, uuids: tuple[str, ...] = ()) -> Iterator[bytes]:
    """Endless messages: some valid, most with fields, types, lengths or bytes changed. uuids: of widgets to aim at."""
    chance = random.Random(seed)
    while True:
        kind = chance.choice(tuple(VALID))
        body = message(kind)
        if "uuid" in body and uuids:
            body["uuid"] = chance.choice(uuids)
        for _ in range(chance.choice((0, 1, 1, 2, 5))):
            _damage(body, chance)
        packed = msgspec.msgpack.encode(body)
        yield _scrambled(packed, chance) if chance.random() < 0.3 else packed


def _damage(body: dict[str, Any], chance: random.Random) -> None:
    key = chance.choice(tuple(body) or ("type",))
    what = chance.randrange(6)
    value = body.get(key)
    if what == 0:
        body.pop(key, None)
    elif what == 1:
        body[chance.choice(("x", "update_cb", "owner", "removed", "value"))] = _anything(chance)
    elif what == 2 and isinstance(value, list) and value:
        value[chance.randrange(len(value))] = _anything(chance)
    elif what == 3 and isinstance(value, (int, float)):
        body[key] = float(value) * chance.choice((-1.0, 1e3, 1e30))
    elif what == 4 and isinstance(value, dict):
        value[chance.choice(("value", "update_cb", "visible"))] = _anything(chance)
    else:
        body[key] = _anything(chance)


def _anything(chance: random.Random, depth: int = 0) -> Any:
    what = chance.randrange(9 if depth < 3 else 6)
    if what < 3:
        return copy.deepcopy(chance.choice(WRONG[:9]))
    if what == 3:
        return "".join(chance.choices("abc/\0é\"<", k=chance.choice((0, 3, 400))))
    if what == 4:
        return chance.uniform(-2.0, 2.0)
    if what == 5:
        return None
    if what == 6:
        return [_anything(chance, depth + 1) for _ in range(chance.randrange(6))]
    if what == 7:
        return {str(_anything(chance, 9)): _anything(chance, depth + 1) for _ in range(chance.randrange(4))}
    return chance.choice(tuple(VALID))


def _scrambled(packed: bytes, chance: random.Random) -> bytes:
    data = bytearray(packed)
    for _ in range(chance.randrange(1, 5)):
        what, at = chance.randrange(3), chance.randrange(len(data) + 1)
        if what == 0 and data:
            data[at % len(data)] = chance.randrange(256)
        elif what == 1:
            del data[at:at + chance.randrange(8)]
        else:
            data[at:at] = chance.randbytes(chance.randrange(8))
    return bytes(data)
