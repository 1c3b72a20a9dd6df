"""A process that loads what a cell takes before anybody has said which: so it is ready when the page is, which loads as much.

Nothing here may take long to load.
"""

import multiprocessing
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from app.serve.wire import Link

_waiting: "list[tuple[BaseProcess, Link]]" = []


@contextmanager
def prepared() -> Iterator[None]:
    """Begin one now, for whoever takes it meanwhile. Not taken, it ends with the block, or with this process."""
    _waiting.append(begun := _begun())
    try:
        yield
    finally:
        if begun in _waiting:  # nobody came for it: an option was wrong, or a port taken
            _waiting.remove(begun)
            process, link = begun
            link.close()
            process.kill()
            process.join()


def taken() -> "tuple[BaseProcess, Link]":
    """The one that has begun, or else one that begins now; it waits at the other end for an `Order`."""
    while _waiting:
        process, link = _waiting.pop()
        if process.is_alive():
            return process, link
        link.close()
    return _begun()


def _begun() -> "tuple[BaseProcess, Link]":
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=_load, args=(there,), name="cell", daemon=True)
    process.start()
    there.close()
    return process, here


def _load(link: "Link") -> None:
    """In the new process: load, then serve the page."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C is the page's, which ends this one then
    from app.serve.process import main

    main(link)
