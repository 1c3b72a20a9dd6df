"""Messages that other threads have for a browser wake its task, and nothing else is touched from there."""

import asyncio
import threading

import pytest
from vclient import until

from app.serve.main import Page
from app.serve.wakeup import NotedEvent


def elsewhere(act):
    thread = threading.Thread(target=act)
    thread.start()
    thread.join()


def test_from_elsewhere_it_is_noted_and_wakes_nobody_until_its_own_loop_sets_it():
    async def scene():
        event = NotedEvent(asyncio.get_running_loop())
        waiting = asyncio.create_task(event.wait())
        await asyncio.sleep(0)
        elsewhere(event.set)
        assert event.is_set()
        await asyncio.wait_for(event.wait(), 1.0)  # who comes now need not wait
        await asyncio.sleep(0.01)
        assert not waiting.done()
        event.set()
        assert await asyncio.wait_for(waiting, 1.0)
        event.clear()
        assert not event.is_set()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(event.wait(), 0.01)

    asyncio.run(scene())


@pytest.mark.usefixtures("raw")
def test_every_buffer_of_the_page_has_one(served: Page) -> None:
    until(lambda: len(served.server.get_clients()) == 1)
    (client,) = served.server.get_clients().values()
    for connection in (served.server._websock_server, client._websock_connection):
        assert isinstance(connection.get_message_buffer().message_event, NotedEvent)
