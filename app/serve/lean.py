"""Two things that viser does for every message, with less: together a quarter of what the page's process did for five visitors.

A change is made ready for the wire once, not for each visitor anew; whether a pose has changed is seen from its three or four
numbers, without a call of numpy that takes ten times as long.
"""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from viser import _scene_handles
from viser._scene_api import cast_vector
from viser.infra._messages import Message

READY = "_ready"
"""The name under which a message keeps what was made of it."""
ABSOLUTE, RELATIVE = 1e-8, 1e-5
"""A number that differs by no more than this is the same, as numpy's `allclose` has it."""


@functools.cache
def install() -> None:
    """From now on, for every server."""
    Message.as_serializable_dict = _once(Message.as_serializable_dict)
    _scene_handles._set_pose_vector = _moved  # pyright: ignore[reportAttributeAccessIssue]


def _once(stock: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
    @functools.wraps(stock)
    def ready(self: Message, binary_buffers: list[memoryview] | None = None) -> dict[str, Any]:
        if binary_buffers is None or self.lifecycle_phase not in ("update_simple", "update_dict"):
            return stock(self, binary_buffers)  # what creates a thing shares its properties with the thing: they change
        kept = getattr(self, READY, None)
        if kept is None:
            before = len(binary_buffers)
            kept = stock(self, binary_buffers)
            if len(binary_buffers) == before:  # else it says which of the arrays beside it are its own
                setattr(self, READY, kept)
        return kept

    return ready


def _moved(current: np.ndarray, value: Any, length: int, queue: Callable[[Message], None],
           make_message: Callable[[Any], Message]) -> None:
    """Take a new position or orientation, and tell the visitors, unless it is the current one."""
    new = cast_vector(value, length)
    if any(not abs(x - old) <= ABSOLUTE + RELATIVE * abs(old) for x, old in zip(new, current.tolist(), strict=True)):
        current[:] = new
        queue(make_message(new))
