"""Whoever comes late is sent what is there, in order, then viser's mark of its end, then what comes, however late he is."""

import asyncio
import importlib.util
import time

import pytest
from viser import _messages
from viser.infra import _async_message_buffer
from viser.infra._async_message_buffer import AsyncMessageBuffer
from viser.infra._messages import Message

from app.serve.backlog import windows


def moved(node: str, x: float) -> Message:
    return _messages.SetPositionMessage(node, (x, 0.0, 0.0))


def as_installed():
    """viser's own way, whatever a page in this process has put in its place."""
    spec = importlib.util.find_spec(_async_message_buffer.__name__)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.AsyncMessageBuffer._window_loop


MARK, STOCK = _messages.ResetGuiMessage(), as_installed()


async def seen(buffer: AsyncMessageBuffer, number: int, *, stock: bool = False) -> list[Message]:
    """The first messages of a visitor who comes now, and brings forth one more when he has come."""
    loop = (STOCK if stock else windows)(buffer, 7, buffer.message_counter - 1, MARK)
    buffer.push(moved("/late", 9.0))
    found: list[Message] = []
    async with asyncio.timeout(5.0):
        while len(found) < number:
            found += await anext(loop)
    assert buffer.generator_cursors[7] == buffer.message_counter - 1
    await loop.aclose()
    assert buffer.generator_cursors == {}
    return found



@pytest.mark.parametrize("nodes", [0, 1, 300])
@pytest.mark.parametrize("persistent", [True, False])
def test_it_is_what_viser_sends(nodes: int, persistent: bool) -> None:
    async def scene(*, stock: bool) -> list[Message]:
        buffer = AsyncMessageBuffer(asyncio.get_running_loop(), persistent_messages=persistent)
        for x in range(3):
            for node in range(nodes):
                buffer.push(moved(f"/{node}", float(x * node)))
        return await seen(buffer, nodes + 2, stock=stock)

    assert asyncio.run(scene(stock=False)) == asyncio.run(scene(stock=True))
    assert asyncio.run(scene(stock=False))[nodes] is MARK


def test_a_visitor_does_not_pay_for_what_was_replaced_before_he_came() -> None:
    async def scene() -> tuple[float, float]:
        buffer = AsyncMessageBuffer(asyncio.get_running_loop(), persistent_messages=True)
        buffer.push(moved("/first", 0.0))
        buffer.message_counter = 2_000_000  # as after an hour
        buffer.push(moved("/second", 1.0))
        spent = []
        for stock in (True, False):
            begin = time.thread_time()
            await seen(buffer, 4, stock=stock)
            spent.append(time.thread_time() - begin)
        return spent[0], spent[1]

    stock, ours = asyncio.run(scene())
    assert ours < 0.2 * stock


def test_what_is_one_block_comes_in_one_piece_and_what_comes_wakes_him() -> None:
    async def scene() -> None:
        buffer = AsyncMessageBuffer(asyncio.get_running_loop(), persistent_messages=True)
        loop = windows(buffer, 7, -1, None)
        waiting = asyncio.ensure_future(anext(loop))
        await asyncio.sleep(0.02)
        buffer.atomic_start()
        buffer.push(moved("/a", 0.0))
        await asyncio.sleep(0.05)
        assert not waiting.done()
        buffer.push(moved("/b", 0.0))
        buffer.atomic_end()
        assert [getattr(message, "name", None) for message in await asyncio.wait_for(waiting, 1.0)] == ["/a", "/b"]
        waiting = asyncio.ensure_future(anext(loop))
        await asyncio.sleep(0.02)
        buffer.set_done()
        with pytest.raises(StopAsyncIteration):
            await asyncio.wait_for(waiting, 1.0)

    asyncio.run(scene())
