"""Where a job is done: on the thread that brings it, or beside it, on a second core. What comes of it has the same bits."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, Protocol, TypeVar

T = TypeVar("T")
Pending = Callable[[], T]
"""A result: the call waits until it is there, and raises what kept it from being."""


class Executor(Protocol):
    """Takes jobs and does them in the order in which they came, one at a time."""

    def do(self, job: Callable[[], T], /) -> Pending[T]:
        """Take a job."""
        ...

    def idle(self) -> None:
        """Wait until all jobs are done: what they work on may be touched then."""
        ...


class Inline:
    """Does each at once: for runs of which several share the cores."""

    def do(self, job: Callable[[], T], /) -> Pending[T]:
        """Do a job. Raises what it raises."""
        result = job()
        return lambda: result

    def idle(self) -> None:
        """It always is."""


class Beside:
    """A thread for them. It pays for jobs that are nearly all Warp's kernels, in which the interpreter is free for the loop:
    each time that one comes back from there, the two wait for each other.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, "beside")
        self._last: Future[Any] | None = None

    def do(self, job: Callable[[], T], /) -> Pending[T]:
        """Take a job; it begins when those before are done."""
        self._last = future = self._pool.submit(job)
        return future.result

    def idle(self) -> None:
        """Wait until all jobs are done."""
        if self._last is not None:
            wait((self._last,))
