"""The worst episodes of a campaign as sessions: played once more, this time with everything kept."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from app import output
from app.campaign.episode import Episode, stage
from app.campaign.metrics import METRICS
from app.campaign.plan import Campaign
from app.headless import recorder, versions
from app.record.folder import EventLog, write
from app.record.signals import SignalTable
from app.record.tape import TapeTable
from hrc.cell.cell import Cell

FOLDER = "worst"


def ranked(campaign: Campaign, records: Sequence[Mapping[str, Any]], number: int) -> list[int]:
    """The indices of so many episodes, the worst by the campaign's metric first; those without a value do not count."""
    judged = [r for r in records if r.get(campaign.worst) is not None]
    sign = -1.0 if METRICS[campaign.worst].worse else 1.0
    return [r["index"] for r in sorted(judged, key=lambda r: (sign * r[campaign.worst], r["index"]))[:number]]


def keep(campaign: Campaign, indices: Sequence[int], folder: Path) -> None:
    """A session for each of these episodes in a folder of its own, for `replay`, `review` and `report`.

    What is there from an earlier time stays if it is of the same episode, and goes if it is of another. Raises OutputError if
    one cannot be written.
    """
    paths = {index: folder / name(index) for index in indices}
    for old in folder.glob("*/"):
        if old not in paths.values() and (old / output.MARK).is_file():
            shutil.rmtree(old)
    for episode in campaign.chosen(paths.__contains__):
        path = paths[episode.index]
        if not (path / output.MARK).is_file():
            record(episode, path, f"{campaign.name}, episode {episode.index}")


def name(index: int) -> str:
    """Of the folder of an episode."""
    return f"{index:06d}"


def record(episode: Episode, out: Path, title: str) -> None:
    """Play an episode and write its session. Raises OutputError if it cannot be written."""
    found = stage(episode)
    cell = Cell(found.config)
    about = {"scenario": title, "preset": "campaign", "seed": found.config.seed,
             "device": cell.device, **versions()}
    table, log, tape = SignalTable(), EventLog(), TapeTable()
    with output.folder(out) as partial:
        with recorder(partial / "session.rrd", cell, about, "full") as recording:
            found.play(cell, table, log, tape, recording)
        write(partial, found.config, about, table.columns(), log.lines())
        tape.write(partial)
