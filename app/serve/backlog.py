"""What a visitor is sent, in which order. viser numbers its messages since the server began, drops those that newer ones
replace, and looks for every number anew for each visitor who comes: after a day of six hundred a second that takes some
seconds, in which nobody gets anything. Here a visitor is sent what is there, and from then on what comes.
"""

import asyncio
import functools
from collections import deque
from collections.abc import AsyncGenerator, Sequence

from viser.infra._async_message_buffer import AsyncMessageBuffer
from viser.infra._messages import Message


async def windows(buffer: AsyncMessageBuffer, visitor: int, last: int,
                  mark: Message | None) -> AsyncGenerator[Sequence[Message]]:
    """Messages for a visitor, a few at a time, until the buffer is done; waits while there is nothing to send.

    last: number of the newest message when the visitor came. mark: comes right after that one, before whatever is newer.
    """
    with buffer.buffer_lock:
        there = deque(number for number in buffer.message_from_id if number <= last)  # ascending, as they came
    sent, flush = -1, buffer.event_loop.create_task(buffer.flush_event.wait())
    try:
        while not buffer.done:
            window: list[Message] = []
            while len(window) < buffer.max_window_size and buffer.atomic_counter == 0:
                if there:
                    sent = there.popleft()
                elif mark is None and max(sent, last) < buffer.message_counter - 1:
                    sent = max(sent, last) + 1
                else:
                    break
                message = _taken(buffer, sent)
                if message is not None and message.excluded_self_client != visitor:
                    window.append(message)
            buffer.generator_cursors[visitor] = sent  # viser forgets only what every visitor has had
            if mark is not None and not there and buffer.atomic_counter == 0:
                window.append(mark)
                mark = None
            if window:
                yield window
            else:
                await buffer.message_event.wait()
                buffer.message_event.clear()
            if not window or max(sent, last) == buffer.message_counter - 1:
                done, _ = await asyncio.wait([flush], timeout=buffer.window_duration_sec)
                if done and not buffer.done:
                    buffer.flush_event.clear()
                    flush = buffer.event_loop.create_task(buffer.flush_event.wait())
    finally:
        buffer.generator_cursors.pop(visitor, None)
        flush.cancel()


def _taken(buffer: AsyncMessageBuffer, number: int) -> Message | None:
    """A message; one that is for a single visitor is gone then."""
    if buffer.persistent_messages:
        return buffer.message_from_id.get(number)
    with buffer.buffer_lock:
        return buffer.pop_message_locked(number)


@functools.cache
def install() -> None:
    """From now on every visitor of every server is served so."""
    AsyncMessageBuffer._window_loop = windows  # pyright: ignore[reportAttributeAccessIssue]
