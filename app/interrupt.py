"""Ctrl-C as a question the loop asks, instead of an exception in the middle of a step."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager


class Interrupt:
    """`set` by the first Ctrl-C while `listening`; a second one raises KeyboardInterrupt as usual."""

    def __init__(self) -> None:
        self.set = False

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Listen to Ctrl-C inside the block. Off the main thread, which alone may listen, it does nothing."""
        try:
            previous = signal.signal(signal.SIGINT, self._on_signal)
        except ValueError:
            yield
            return
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, previous)

    def _on_signal(self, *_: object) -> None:
        self.set = True
        signal.signal(signal.SIGINT, signal.default_int_handler)
