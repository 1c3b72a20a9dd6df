"""One episode: a cell built anew, what happens to it, and the row that says what came of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from app.campaign import places
from app.campaign.contacts import Contacts
from app.campaign.judge import Judge
from app.campaign.trial import Trial
from hrc.cell.cell import Cell
from hrc.cell.pace import FreeRun
from hrc.cell.run import Inbox, Observer, Source, run
from hrc.cell.scenario import Scenario
from hrc.config import Config

Record = dict[str, Any]
LONGEST = 10_000_000
"""No episode has more ticks."""


@dataclass(frozen=True)
class Episode:
    """What a worker needs to know. index: of the record; values: what the campaign has swept and drawn, for the record.

    seed: of all that is random besides the cell, which has the seed of its config. script: what happens instead of the
    situation.
    """

    index: int
    seed: tuple[int, ...]
    trial: Trial
    values: Mapping[str, Any]
    script: Scenario | None = None


@dataclass(frozen=True)
class Stage:
    """An episode about to begin: source of the events, observers that must see it, and when it ends."""

    config: Config
    source: Source
    observers: tuple[Observer, ...]
    judge: Judge
    until: int = LONGEST
    over: Callable[[], bool] = lambda: False

    def play(self, cell: Cell, *more: Observer) -> None:
        """To the end, under more observers."""
        run(cell, FreeRun(), self.source, (*self.observers, *more), until=self.until, stopped=self.over)


def play(episode: Episode) -> Record:
    """The record of an episode; one that raises is a record, too, with its `error`. Any process gives the same."""
    head = {"index": episode.index, "seed": episode.trial.seed, **episode.values}
    try:
        found = stage(episode)
        found.play(Cell(found.config))
        return {**head, **judged(episode, found), "error": None}
    except Exception as error:  # whatever it is, it belongs to this episode, and the others go on
        return {**head, "error": f"{type(error).__name__}: {' '.join(str(error).split())}"}


def stage(episode: Episode) -> Stage:
    """Make an episode ready. Raises HrcError if it cannot be."""
    trial, base_hz = _placed(episode), episode.trial.rates.base_hz
    judge = Judge(trial.config)
    if episode.script is not None:
        script = episode.script
        return Stage(trial.config, Inbox(script, base_hz), (judge,), judge, round(script.duration * base_hz))
    contacts = Contacts(trial, episode.seed)
    return Stage(trial.config, contacts, (contacts, judge), judge, over=contacts.over)


def judged(episode: Episode, found: Stage) -> Record:
    """The metrics of an episode that has been played."""
    drawn = found.source.described if isinstance(found.source, Contacts) else {}
    return {**drawn, **found.judge.record(episode.trial.situation.judged_from)}


def _placed(episode: Episode) -> Trial:
    """With its random posture, if it is to have one."""
    trial = episode.trial
    if episode.script is not None or trial.situation.posture == "task":
        return trial
    q, tip = places.posture(trial.situation.spread, np.random.default_rng([*episode.seed, 1]))
    task = trial.task.replace(kind="hold", centre=tuple(tip.tolist()), posture_deg=tuple(np.rad2deg(q).tolist()))
    return replace(trial, task=task)
