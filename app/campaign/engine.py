"""Where episodes are played: on worker processes of this machine, or of a cluster whose scheduler runs elsewhere.

Dask's distributed scheduler in both cases, so that there is one way through. Everybody who can reach a scheduler's port can run
programs on its workers: a cluster on a network needs TLS.
"""

import logging
import math
import os
import queue
import signal
import socket
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any
from urllib.parse import urlsplit

from app.campaign.cluster import Cluster
from app.campaign.episode import Episode, Record, play
from app.campaign.plan import CampaignError
from app.campaign.versions import differences, versions

SETTINGS = {"distributed.scheduler.worker-saturation": 1.0, "distributed.scheduler.allowed-failures": 1}
"""A worker holds one episode at a time, and one whose worker dies is given one more chance: with the scheduler's own values a
worker holds a second episode, which is blamed, too, when the first one kills the worker."""
ATTEMPTS = 2
"""So often is an episode tried that was being played when workers died, each time by two of them: a machine may be taken away
more than once."""
PATIENCE, FIRST = 10.0, 60.0
"""Within this a scheduler must answer, and within that have a worker, which may be starting [s]."""
FETCH, LOST = 8.0, 5
"""A result must come within this [s]: it lives on its worker, and may be lost with it before it is read. Then the episode is
played again, so often at most."""
LOOK, COUNT = 0.2, 2.0
"""Between two looks at whether to stop, and between two counts of the workers [s]."""


class LostError(CampaignError):
    """The scheduler is gone."""


@contextmanager
def engine(cluster: Cluster) -> "Iterator[Engine]":
    """Raises CampaignError if the scheduler cannot be reached, has no worker, or one of another version."""
    import distributed  # noqa: F401  (before the settings: its own are added to them when it is imported, and must stay)
    from dask import config

    for name in ("distributed", "distributed.nanny", "distributed.worker", "distributed.scheduler", "distributed.core"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with config.set(SETTINGS), ExitStack() as stack:
        client = _remote(cluster, stack) if cluster.address else _local(cluster, stack)
        yield Engine(client)


def _local(cluster: Cluster, stack: ExitStack) -> Any:
    from distributed import Client, LocalCluster

    options: dict[str, Any] = {"dashboard_address": None, "silence_logs": logging.CRITICAL, "memory_limit": 0}
    number = cluster.workers or cores()
    started = stack.enter_context(LocalCluster(n_workers=number, threads_per_worker=1, processes=True, **options))
    client = stack.enter_context(Client(started))
    client.register_plugin(_deaf())
    return client


def _deaf() -> Any:
    """Ctrl-C in a terminal reaches the workers, too; whether they stop is not theirs to decide."""
    from distributed import WorkerPlugin

    class Deaf(WorkerPlugin):
        name = "deaf"

        def setup(self, worker: Any) -> None:  # noqa: ARG002
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    return Deaf()


def _remote(cluster: Cluster, stack: ExitStack) -> Any:
    from distributed import Client
    from distributed.security import Security

    tls = None
    if cluster.tls_ca is not None:
        tls = Security(tls_ca_file=str(cluster.tls_ca), tls_client_cert=str(cluster.tls_cert),
                       tls_client_key=str(cluster.tls_key), require_encryption=True)
    try:
        _knock(cluster.address or "")
        client = stack.enter_context(Client(cluster.address, security=tls, timeout=PATIENCE))
    except (OSError, ValueError, RuntimeError) as error:
        how = "" if tls is None else " with TLS"  # one without would be asked by tcp://
        raise CampaignError(f"there is no scheduler that answers{how} at {cluster.address}: "
                            f"{str(error) or type(error).__name__}") from None
    try:
        client.wait_for_workers(1, timeout=FIRST)
    except TimeoutError:
        raise CampaignError(f"the scheduler at {cluster.address} has no workers") from None
    return client


def _knock(address: str) -> None:
    """A Client that finds nobody leaves the thread of its loop behind.

    Raises OSError if nobody listens within PATIENCE, ValueError for an address without a port.
    """
    where, deadline = urlsplit(address), time.monotonic() + PATIENCE
    if where.port is None:
        raise ValueError(f"missing port number in address {address}")
    while True:
        try:
            left = max(LOOK, deadline - time.monotonic())
            return socket.create_connection((where.hostname or "", where.port), timeout=left).close()
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(LOOK)


def cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Engine:
    """Plays episodes on the workers of a Dask client."""

    def __init__(self, client: Any, say: Callable[[str], None] = print) -> None:
        """say: told when the last worker has gone, and when one has come."""
        self._client, self._say = client, say
        for worker, theirs in client.run(versions, on_error="return").items():
            if isinstance(theirs, ImportError):
                raise CampaignError(f"the worker {worker} does not have elbowroom with this command: {theirs}")
            if isinstance(theirs, (OSError, TimeoutError)):
                continue  # it has gone in the meantime, and is asked again should it play
            if isinstance(theirs, BaseException):
                raise theirs
            if differs := differences(versions(), theirs):
                raise CampaignError(f"the worker {worker} has {differs}; all must have the same")

    @property
    def workers(self) -> list[str]:
        """Their addresses, now. Raises LostError if the scheduler does not say."""
        try:
            found = sorted(self._client.scheduler_info(n_workers=-1)["workers"])
        except (OSError, RuntimeError, TimeoutError, ValueError):  # the last of tornado, of a handshake that was broken off
            found = None
        if found is None or self._client.status != "running":
            raise LostError("the scheduler is gone; the records so far are kept, and the same command goes on from there")
        return found

    def play(self, episodes: Iterable[Episode], stopped: Callable[[], bool] = lambda: False,
             only: Sequence[str] = ()) -> Generator[Record, None, None]:
        """The records as they come. A worker that dies costs its episode a new start, and no other one anything.

        stopped: asked all the time; then no more begin, and those that are not done are dropped. only: play on these workers.
        Raises CampaignError if the scheduler is lost, a worker of another version has joined, or one of `only` has died.
        """
        waiting: queue.Queue[Any] = queue.Queue()
        source, left, tries = iter(episodes), dict[str, tuple[Any, Episode]](), defaultdict[int, float](float)

        def submit(episode: Episode) -> None:
            future = self._client.submit(_play, versions(), episode, pure=False, workers=only or None, retries=0)
            left[future.key] = future, episode
            future.add_done_callback(waiting.put)

        wanted, counted, deserted = 0, -math.inf, False

        def refill() -> None:
            # enough that no worker waits for us, and no more: a campaign may be long
            nonlocal wanted, counted, deserted
            if time.monotonic() - counted > COUNT:
                there = len(only or self.workers)
                if (there == 0) is not deserted:
                    deserted = not deserted
                    self._say("no worker is left; waiting for one to join" if deserted else "a worker has joined")
                wanted, counted = 2 * there + 1, time.monotonic()
            while len(left) < wanted and (episode := next(source, None)) is not None:
                submit(episode)

        refill()
        try:
            while left and not stopped():
                try:
                    future = waiting.get(timeout=LOOK)
                except queue.Empty:
                    if not set(only) <= set(self.workers):
                        raise CampaignError("a worker died while its rate was measured; the records so far are kept") from None
                    refill()
                    continue
                _, episode = left.pop(future.key)
                record, fault = self._result(future)
                if record is None:
                    tries[episode.index] += fault
                    if tries[episode.index] < 1.0:
                        submit(episode)
                        continue
                yield record or {"index": episode.index, "seed": episode.trial.seed, **episode.values,
                                 "error": "WorkerDied: whoever played it"}
                refill()
        finally:
            if left:
                self._client.cancel([future for future, _ in left.values()], force=True)

    def _result(self, future: Any) -> tuple[Record | None, float]:
        """The record, or None and how much of our patience with this episode is used up by that."""
        from distributed import CancelledError, KilledWorker

        try:
            return future.result(timeout=FETCH), 0.0
        except (KilledWorker, CancelledError, TimeoutError, OSError) as error:
            _ = self.workers  # without a scheduler nobody is to blame
            return None, 1.0 / (ATTEMPTS if isinstance(error, KilledWorker) else LOST)


def _play(expected: dict[str, str], episode: Episode) -> Record:
    """On a worker. One that joined later may be of another version."""
    if differs := differences(expected, versions()):
        raise CampaignError(f"a worker has joined with {differs}; all must have the same")
    return play(episode)
