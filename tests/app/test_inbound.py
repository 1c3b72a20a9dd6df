"""The table of messages: what must pass does, and nothing else, however it is damaged."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
import viser
from fuzz import COUNT, VALID, WRONG, damaged, message
from target import Target
from viser import _messages

from app.serve.inbound import SCHEMA, RefusedError, screen


@pytest.fixture(scope="module")
def target() -> Iterator[Target]:
    target = Target(guarded=True)
    yield target
    target.server.stop()


def accepted(raw: bytes | str, server: viser.ViserServer) -> bool:
    try:
        screen(raw, server)
    except RefusedError:
        return False
    return True


def test_a_valid_message_of_every_kind_passes(target: Target) -> None:
    assert set(VALID) == set(SCHEMA), "each kind that the page may send needs an example, to be damaged here"
    for kind in VALID:
        valid = message(kind)
        for field, widget in (("uuid", target.gain), ("source_component_uuid", target.upload)):
            if field in valid:
                valid[field] = widget._impl.uuid
        assert accepted(msgspec.msgpack.encode(valid), target.server), kind
        owned = "owner" in {field.name for field in dataclasses.fields(getattr(_messages, kind))}
        assert accepted(msgspec.msgpack.encode({**valid, "owner": ""}), target.server) == owned


@pytest.mark.parametrize("kind", VALID)
def test_no_field_of_any_kind_takes_what_it_must_not(target: Target, kind: str) -> None:
    for field, right in VALID[kind].items():
        lengths = (right[:-1], [*right, 0.0]) if isinstance(right, list) else ()
        for wrong in (*WRONG, *lengths):
            if isinstance(right, bytes) and isinstance(wrong, bytes):
                continue
            bad = message(kind, **{field: wrong})
            assert not accepted(msgspec.msgpack.encode(bad), target.server), (field, wrong)
        assert not accepted(msgspec.msgpack.encode({k: v for k, v in message(kind).items() if k != field}), target.server)
    assert not accepted(msgspec.msgpack.encode(message(kind, more=1)), target.server)


@pytest.mark.parametrize("kind", ["ViewerCameraMessage", "TransformControlsUpdateMessage"])
@pytest.mark.parametrize("wxyz", [[0.0] * 4, [1e-9, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0]])
def test_four_numbers_that_are_no_orientation_do_not_pass(target: Target, kind: str, wxyz: list[float]) -> None:
    assert not accepted(msgspec.msgpack.encode(message(kind, wxyz=wxyz)), target.server)


def sane(value: Any) -> bool:
    """By other means than the validator's: no number that is not finite or not of this world, no endless text."""
    if isinstance(value, dict):
        return all(sane(entry) for entry in value.values())
    if isinstance(value, (list, tuple)):
        return len(value) <= 4 and all(map(sane, value))
    if isinstance(value, (str, bytes)):
        return len(value) <= 256
    return value is None or abs(value) <= 1e6  # false for NaN


def test_fuzzed_messages_never_pass_with_anything_but_what_the_table_allows(target: Target) -> None:
    uuids = tuple(target.server.gui._gui_input_handle_from_uuid)
    passed = 0
    for raw, _ in zip(damaged(1, uuids), range(COUNT), strict=False):
        try:
            let_in = screen(raw, target.server)
        except RefusedError:
            continue
        passed += 1
        assert sane(let_in), let_in
        assert set(let_in) - {"type", "owner"} == set(VALID[let_in["type"]])
        if let_in["type"] == "GuiUpdateMessage":
            assert set(let_in["updates"]) == {"value"}
    assert COUNT / 100 < passed < COUNT / 2, "a fuzzer that only ever makes nonsense, or none, proves little"
