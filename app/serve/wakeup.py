"""viser notes a new message by `set` of an asyncio event from whichever thread has the message. asyncio does not allow that:
with threads that take quick turns it raised "deque mutated during iteration" twice in 50 minutes, and left tasks that never
woke. Right after it viser sets the event once more, on its loop; so from elsewhere a note is enough.
"""

import asyncio
import functools
from typing import Any, Literal

from viser.infra._async_message_buffer import AsyncMessageBuffer


class NotedEvent(asyncio.Event):
    """An event that other threads may set, too; then nobody is woken before `set` on its own loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._own, self._noted = loop, False

    def set(self) -> None:
        """On its loop, wake all who wait; elsewhere, only note it."""
        try:
            here = asyncio.get_running_loop()
        except RuntimeError:
            here = None
        if here is self._own:
            super().clear()  # else those who began to wait before the note would be passed over
            super().set()
        else:
            self._noted = True

    def is_set(self) -> bool:
        """Whether it is set or noted."""
        return self._noted or super().is_set()

    def clear(self) -> None:
        """Forget both."""
        self._noted = False
        super().clear()

    async def wait(self) -> Literal[True]:
        """Until it is set; at once if that is noted."""
        return True if self._noted else await super().wait()


@functools.cache
def install() -> None:
    """From now on every message buffer of viser has such an event."""
    stock = AsyncMessageBuffer.__init__

    @functools.wraps(stock)
    def begin(self: AsyncMessageBuffer, *args: Any, **options: Any) -> None:
        stock(self, *args, **options)
        self.message_event = NotedEvent(self.event_loop)

    AsyncMessageBuffer.__init__ = begin
