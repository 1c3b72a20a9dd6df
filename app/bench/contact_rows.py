"""Pushes and what came of them, as rows of a table."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from app.bench.pushes import Errors, Outcome
from hrc.geometry import Array


@dataclass(frozen=True)
class Spread:
    """Median and 95th percentile of an error [N], and of its share of the true force."""

    median_N: float
    p95_N: float
    median_share: float
    p95_share: float


@dataclass(frozen=True)
class Row:
    """What came of the pushes of one kind. link 0: links 4 to 7. force 0: all forces. task "both": at rest and moving.

    delay [s], of those detected; missed: share of those not detected while they lasted; felt_before: pushes that began while
    something was still felt, which count in neither. located, right_link, seen: shares of the judged moments with a place, and
    of these with the right link, and with a camera that sees it; point: median error [m]. given_*: Eq. (5) at the true point;
    said_*: the cell's contact; whole vector, observable directions, the others.
    """

    preset: str
    task: str
    link: int
    force: float
    pushes: int
    delay_median: float | None
    delay_p95: float | None
    missed: float | None
    felt_before: int
    located: float
    right_link: float | None
    seen: float | None
    point: float | None
    given_whole: Spread | None
    given_inside: Spread | None
    given_outside: Spread | None
    said_whole: Spread | None
    said_inside: Spread | None
    said_outside: Spread | None


def rows(every: Sequence[tuple[str, str, Outcome]]) -> Iterator[Row]:
    """Of pushes with their preset and task: by both and link over all forces; then by preset and force over links 4 to 7."""
    presets, tasks = list(dict.fromkeys(p for p, _, _ in every)), list(dict.fromkeys(t for _, t, _ in every))
    for preset, task in itertools.product(presets, tasks):
        chosen = [o for p, t, o in every if (p, t) == (preset, task)]
        for link in sorted({o.link for o in chosen}):
            yield row(preset, task, link, 0.0, [o for o in chosen if o.link == link])
    forces = sorted({round(_size(o), 6) for *_, o in every})
    for preset, force in itertools.product(presets, (*forces, 0.0)):
        outer = [o for p, _, o in every if p == preset and o.link >= 4 and force in (0.0, round(_size(o), 6))]
        if outer:
            yield row(preset, "both", 0, force, outer)


def row(preset: str, task: str, link: int, force: float, outcomes: Sequence[Outcome]) -> Row:
    """One line of the table."""
    delays = [o.delay for o in outcomes if o.delay is not None]
    found = [delay for delay in delays if np.isfinite(delay)]
    placed = [o for o in outcomes if o.point is not None]
    spreads = {f"{source}_{part}": _spread_of(outcomes, source, part)
               for source in ("given", "said") for part in ("whole", "inside", "outside")}
    return Row(
        preset, task, link, force, len(outcomes), *(_percentile(found, p) for p in (50, 95)),
        missed=1.0 - len(found) / len(delays) if delays else None, felt_before=len(outcomes) - len(delays),
        located=float(np.mean([o.located for o in outcomes])),
        right_link=_percentile([o.right_link for o in placed], None), seen=_percentile([o.seen for o in placed], None),
        point=_percentile([o.point for o in placed], 50), **spreads)


def _spread_of(outcomes: Sequence[Outcome], source: str, part: str) -> Spread | None:
    errors: list[Array] = []
    shares: list[Array] = []
    for o in outcomes:
        of: Errors = getattr(o, source)
        errors.append(getattr(of, part))
        shares.append(errors[-1] / _size(o))
    if not sum(map(len, errors)):
        return None
    newton, share = (np.percentile(np.concatenate(x), [50, 95]).tolist() for x in (errors, shares))
    return Spread(*newton, *share)


def _size(outcome: Outcome) -> float:
    return float(np.linalg.norm(outcome.force))


def _percentile(values: Sequence[float | None], percent: float | None) -> float | None:
    """The mean for percent None; None without values."""
    known = [x for x in values if x is not None]
    if not known:
        return None
    return float(np.mean(known) if percent is None else np.percentile(known, percent))
