"""What a browser may say: every inbound message is checked against a table before viser acts on it.

viser trusts its clients: any of them may overwrite a widget's callbacks, send values outside a slider's range or NaN
for a pose, or ask for a public tunnel. Here a message passes only if its type is known, its fields are exactly those of
the type, every number is finite and of sane size, and a widget's new value is one that the screen offers.
"""

import math
from collections.abc import Callable
from typing import Any

import msgspec
import viser

Check = Callable[[Any], bool]
LIMIT = 1e4
"""No coordinate of a message is larger than this [m]."""
TEXT = 256
"""No string of a message is longer than this."""

LARGEST_FILE = 32 * 1024
"""Bytes of the largest file that may be uploaded, in one piece; one with all settings has about 5000."""


class RefusedError(Exception):
    """The message is not one that this page could have sent."""


def _number(value: Any, low: float = -LIMIT, high: float = LIMIT) -> bool:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and math.isfinite(value) and low <= value <= high


def _between(low: float, high: float) -> Check:
    return lambda value: _number(value, low, high)


def _numbers(length: int) -> Check:
    return lambda value: isinstance(value, list) and len(value) == length and all(map(_number, value))


def _unit(value: Any) -> bool:
    return _numbers(4)(value) and 0.99 < math.hypot(*value) < 1.01


def _text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= TEXT


def _one_of(*choices: Any) -> Check:
    return lambda value: value in choices


def _maybe(check: Check) -> Check:
    return lambda value: value is None or check(value)


def _whole(value: Any) -> bool:
    return _number(value, 0, 2**31) and value == int(value)


def _exactly(number: int) -> Check:
    return lambda value: type(value) is int and value == number


def _file(value: Any) -> bool:
    return isinstance(value, bytes) and len(value) <= LARGEST_FILE


def _updates(value: Any) -> bool:
    """Of a widget a client may change the value only: its callbacks, limits and life belong to the server."""
    return isinstance(value, dict) and set(value) == {"value"}


SCHEMA: dict[str, dict[str, Check]] = {
    "ViewerCameraMessage": {
        "wxyz": _unit, "position": _numbers(3), "look_at": _numbers(3), "up_direction": _numbers(3),
        "fov": _between(0.01, 3.2), "near": _between(0, LIMIT), "far": _between(0, 1e6),
        "image_height": _between(0, 20000), "image_width": _between(0, 20000)},
    "GuiUpdateMessage": {"uuid": _text, "updates": _updates},
    "CommandTriggerMessage": {"uuid": _text},
    "SceneNodeDragMessage": {
        "phase": _one_of("start", "update", "end"), "name": _text, "instance_index": _maybe(_whole),
        "start_position": _numbers(3), "start_screen_pos": _numbers(2), "end_position": _numbers(3),
        "end_screen_pos": _numbers(2), "button": _one_of("left", "middle", "right"), "modifier": _maybe(_text)},
    "SceneNodeClickMessage": {
        "name": _text, "instance_index": _maybe(_whole), "ray_origin": _numbers(3), "ray_direction": _numbers(3),
        "screen_pos": _numbers(2), "modifier": _maybe(_text)},
    "FileTransferStartUpload": {
        "source_component_uuid": _text, "transfer_uuid": _text, "filename": _text, "mime_type": _text,
        "part_count": _exactly(1), "size_bytes": _between(1, LARGEST_FILE)},
    "FileTransferPart": {
        "source_component_uuid": _text, "transfer_uuid": _text, "part_index": _exactly(0), "content": _file},
    "TransformControlsUpdateMessage": {"name": _text, "wxyz": _unit, "position": _numbers(3)},
    "TransformControlsDragStartMessage": {"name": _text},
    "TransformControlsDragEndMessage": {"name": _text},
    "LocalStorageGetItemResponseMessage": {"value": _maybe(_text), "error": _maybe(_text), "request_uuid": _text},
}
"""Message type -> field -> check: another kind of message is let in by one more entry, and is the operator's alone unless
guard.py names it. `owner`, the scope of a scene node, may stand beside the node's `name`."""


def screen(raw: bytes | str, server: viser.ViserServer, visitor: int | None = None) -> dict[str, Any]:
    """Check one message as it came over the wire, and decode it. visitor: its sender, who may have widgets of its own.

    Raises RefusedError, with the reason, if it must not get in.
    """
    if not isinstance(raw, bytes):
        raise RefusedError("a text frame")
    try:
        message = msgspec.msgpack.decode(raw)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise RefusedError("no msgpack") from None
    kind = message.get("type") if isinstance(message, dict) else None
    schema = SCHEMA.get(kind) if isinstance(kind, str) else None
    if schema is None:
        raise RefusedError("a type the page does not send")
    fields = {key: value for key, value in message.items() if key != "type"}
    if "name" in schema and not _text(fields.pop("owner", "")):
        raise RefusedError(f"owner of {kind}")
    if set(fields) != set(schema):
        raise RefusedError(f"fields of {kind}")
    for name, check in schema.items():
        if not check(fields[name]):
            raise RefusedError(f"{name} of {kind}")
    if kind == "GuiUpdateMessage":
        _screen_widget(widget_of(fields["uuid"], server, visitor), fields["updates"]["value"])
    if "source_component_uuid" in schema:
        _screen_upload(widget_of(fields["source_component_uuid"], server, visitor))
    return message


def widget_of(uuid: str, server: viser.ViserServer, visitor: int | None) -> Any:
    """The handle of a widget that this visitor has on the screen, everybody's or its own; None if it has not."""
    widget = server.gui._gui_input_handle_from_uuid.get(uuid)
    client = server._connected_clients.get(visitor) if visitor is not None else None
    if widget is None and client is not None:
        widget = client.gui._gui_input_handle_from_uuid.get(uuid)
    return widget


def _screen_upload(widget: Any) -> None:
    """A file may be sent to a button that is there for it."""
    if not isinstance(widget, viser.GuiUploadButtonHandle):
        raise RefusedError("no such widget")
    if widget.disabled or not widget.visible:
        raise RefusedError("a widget that is disabled or hidden")


def _screen_widget(widget: Any, value: Any) -> None:
    """A widget's new value must be one that its user could have chosen on the screen."""
    if widget is None:
        raise RefusedError("no such widget")
    props, present = widget._impl.props, widget.value
    if getattr(props, "disabled", False) or not getattr(props, "visible", True):
        raise RefusedError("a widget that is disabled or hidden")
    options = getattr(props, "options", None)
    if options is not None:
        allowed = isinstance(value, str) and value in options
    elif isinstance(present, bool):
        allowed = isinstance(value, bool)
    elif isinstance(present, (int, float)):
        low, high = getattr(props, "min", None), getattr(props, "max", None)
        allowed = _number(value, -LIMIT if low is None else low, LIMIT if high is None else high)
    else:
        allowed = False  # the page has no other kind of widget
    if not allowed:
        raise RefusedError("a value the widget does not offer")
