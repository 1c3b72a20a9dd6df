"""`elbowroom campaign`: play what is missing, keep every record, and write what people can use."""

import json
import sys
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

from app.campaign import plan, report, summary, worst
from app.campaign.cluster import Cluster
from app.campaign.engine import Engine, engine
from app.campaign.episode import Episode
from app.campaign.metrics import METRICS
from app.campaign.plan import Campaign, CampaignError
from app.campaign.store import Record, Store, opened
from app.interrupt import Interrupt
from app.output import OutputError
from hrc.errors import HrcError

TABLE, SUMMARY = "records.parquet", "summary.parquet"
STAMP = ".written"
"""Of what tables and report were made."""
REPORTS = 60.0
"""Between two lines about how far it is, where there is no terminal [s]."""
BLOCK, TURNS, WARM = 12, 2, 2
"""Scaling: episodes for each worker in a turn; turns; episodes for each worker before, which do not count."""


@dataclass(frozen=True)
class Job:
    """What the command line asks for."""

    campaign: str
    out: Path
    episodes: int | None = None
    cluster: Cluster = field(default_factory=Cluster)
    record: int = 0
    scaling: bool = False
    overwrite: bool = False
    quiet: bool = False


@dataclass
class Rate:
    """Episodes played, and the wall time for them [s]."""

    episodes: int = 0
    seconds: float = 0.0

    def __str__(self) -> str:
        return f"{self.episodes} episodes in {self.seconds:.1f} s, {self.each:.2f} a second"

    def __add__(self, other: "Rate") -> "Rate":
        return Rate(self.episodes + other.episodes, self.seconds + other.seconds)

    @property
    def each(self) -> float:
        """Episodes a second."""
        return self.episodes / self.seconds if self.seconds else 0.0


def execute(job: Job) -> bool:
    """Play, write and print; whether it was interrupted. Raises HrcError for what the user can put right."""
    campaign = plan.load(job.campaign, job.episodes)
    job.cluster.check()
    _installed("distributed", "pyarrow", "matplotlib", *(["rerun"] if job.record else []))
    if job.record < 0:
        raise CampaignError(f"--record must be a number of episodes, not {job.record}")
    interrupt = Interrupt()
    with opened(job.out, campaign, overwrite=job.overwrite) as store:
        missing = campaign.total - len(_of(campaign, store))
        print(f"{campaign.title}: {campaign.total} episodes, {campaign.total - missing} of them there")
        if missing:
            with interrupt.listening():
                _play(job, campaign, store, missing, interrupt)
        records = _of(campaign, store)
        try:
            problem = _write(job, campaign, store.folder, records, fresh=bool(missing))
        except OSError as error:
            raise OutputError(f"{job.out}: {error.strerror or error}; all records are kept") from None
        if not job.quiet:
            print("\n".join(summary.printed(campaign, summary.rows(campaign, records))))
        print("\n".join([*_errors(records), f"{job.out}: {len(records)} of {campaign.total} records"]))
        if problem:
            raise CampaignError(f"the worst episodes could not all be kept: {problem}")
    return interrupt.set


def _installed(*names: str) -> None:
    """Raises ModuleNotFoundError now, not after hours."""
    for name in names:
        if find_spec(name) is None:
            raise ModuleNotFoundError(f"no module named {name}", name=name)


def _of(campaign: Campaign, store: Store) -> list[Record]:
    """The records of the episodes that are asked for, by index: an earlier run may have had more."""
    return [store.records[index] for index in sorted(store.records) if index < campaign.total]


def _play(job: Job, campaign: Campaign, store: Store, missing: int, interrupt: Interrupt) -> None:
    from tqdm import tqdm

    episodes = campaign.chosen(lambda index: index not in store.records)
    with engine(job.cluster) as workers, tqdm(total=campaign.total, initial=campaign.total - missing, unit="episode",
                                             desc=campaign.name, disable=job.quiet or not sys.stderr.isatty()) as bar:
        told = _Progress(campaign.total, silent=job.quiet or sys.stderr.isatty())

        def keep(records: Generator[Record, None, None]) -> Rate:
            rate, began = Rate(), time.perf_counter()
            with closing(records):  # at once, while there is a client: what is still being played is dropped
                for record in records:
                    store.add(record)
                    bar.update()
                    rate.episodes += 1
                    rate.seconds = time.perf_counter() - began
                    told.note(len(store.records))
            return rate

        count = len(workers.workers)
        if job.scaling:
            print(_scaling(workers, episodes, keep, interrupt))
        rate = keep(workers.play(episodes, lambda: interrupt.set))
    if rate.episodes:
        print(f"{rate} on {count} worker{'s' * (count > 1)}")


class _Progress:
    """A line now and then where no bar can be drawn: in a log."""

    def __init__(self, total: int, *, silent: bool) -> None:
        self._total, self._silent, self._due = total, silent, time.monotonic() + REPORTS

    def note(self, done: int) -> None:
        """So many records are there."""
        if not self._silent and time.monotonic() >= self._due:
            self._due = time.monotonic() + REPORTS
            print(f"{done} of {self._total} episodes", flush=True)


def _scaling(workers: Engine, episodes: Iterator[Episode], keep: Callable[[Generator[Record, None, None]], Rate],
             interrupt: Interrupt) -> str:
    """Rates of one worker and of all, in turns, so that a machine that slows down slows both; in words."""
    names = workers.workers
    alone, together = Rate(), Rate()
    keep(workers.play(islice(episodes, WARM * len(names)), lambda: interrupt.set))
    for _ in range(TURNS):
        alone += keep(workers.play(islice(episodes, BLOCK), lambda: interrupt.set, only=names[:1]))
        together += keep(workers.play(islice(episodes, BLOCK * len(names)), lambda: interrupt.set))
    if together.episodes < TURNS * BLOCK * len(names):
        return "the scaling was not measured: " + ("interrupted" if interrupt.set else "too few episodes were left")
    return (f"one worker: {alone}; {len(names)} workers: {together}; scaling {together.each / alone.each:.2f} = "
            f"{together.each / alone.each / len(names):.2f} x {len(names)}")


def _write(job: Job, campaign: Campaign, folder: Path, records: Sequence[Record], *, fresh: bool) -> str:
    """Tables, report and sessions; again only if there are other records, or something else is asked for of them.

    Returns why a session could not be kept; the report is there all the same.
    """
    indices = worst.ranked(campaign, records, job.record)
    kept = all((folder / worst.FOLDER / worst.name(index)).is_dir() for index in indices)
    stamp, now = folder / STAMP, [len(records), campaign.title, campaign.description, [*campaign.metrics], [*indices]]
    there = all((folder / name).is_file() for name in (STAMP, TABLE, SUMMARY, report.REPORT))
    if not fresh and kept and there:
        with suppress(ValueError):  # torn, by a process that was killed: then all is written again
            *before, named = json.loads(stamp.read_text(encoding="utf-8"))
            if before == now[:-1] and (not job.record or named == now[-1]):
                return ""
    stamp.unlink(missing_ok=True)
    units = {name: metric.unit for name, metric in METRICS.items()}
    summary.write(folder / TABLE, records, units)
    summary.write(folder / SUMMARY, summary.rows(campaign, records))
    problem = ""
    try:
        if job.record:
            worst.keep(campaign, indices, folder / worst.FOLDER)
    except HrcError as error:
        problem = str(error)
    sessions = [folder / worst.FOLDER / worst.name(index) for index in indices]
    report.write(campaign, records, folder, [path for path in sessions if path.is_dir()])
    if problem:
        return problem
    stamp.write_text(json.dumps(now), encoding="utf-8")
    return ""


def _errors(records: Sequence[Record]) -> Iterator[str]:
    """How many episodes failed, and the most frequent reasons."""
    reasons = Counter(record["error"] for record in records if record["error"] is not None)
    if reasons:
        yield f"{reasons.total()} of {len(records)} episodes failed:"
        yield from (f"  {count} x {reason}" for reason, count in reasons.most_common(5))
