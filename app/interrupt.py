"""Ctrl-C or SIGTERM as a question the loop asks, instead of an exception in the middle of a step."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupt:
    """`set` by the first Ctrl-C or SIGTERM while `listening`; the next one acts as usual."""

    def __init__(self) -> None:
        self.set = False

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Listen inside the block. Off the main thread, which alone may listen, it does nothing."""
        try:
            previous = [signal.signal(number, self._on_signal) for number in SIGNALS]
        except ValueError:
            yield
            return
        try:
            yield
        finally:
            for number, handler in zip(SIGNALS, previous, strict=True):
                signal.signal(number, handler)

    def _on_signal(self, *_: object) -> None:
        self.set = True
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
