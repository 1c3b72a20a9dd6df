"""Records as tables: Parquet, and for each point of the sweep and each metric the mean, its 95 % interval and the p95."""

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.campaign.metrics import METRICS
from app.campaign.plan import Campaign
from app.output import OutputError

Record = Mapping[str, Any]
Row = dict[str, Any]
_Z = 1.959963984540054


def rows(campaign: Campaign, records: Sequence[Record]) -> list[Row]:
    """For each point, in order, and each metric of the campaign: n, mean, low and high of its interval, p95; and how far the
    mean is from that at the first point, over the pairs of episodes with a value at both, with the interval of that.

    Yes or no counts as 1 or 0. n: episodes with a value. Without a sweep there is one point.
    """
    out, points = [], campaign.points
    first = [r for r in records if r["index"] % len(points) == 0]
    for p, point in enumerate(points):
        chosen = [r for r in records if r["index"] % len(points) == p]
        failed = sum(r["error"] is not None for r in chosen)
        for metric in campaign.metrics:
            here, share = _by_episode(chosen, metric), METRICS[metric].unit == "bool"
            row = {**point, "metric": metric, "unit": METRICS[metric].unit, "episodes": len(chosen), "failed": failed,
                   **described(list(here.values()), wilson if share else student),
                   "p95": float(np.percentile(list(here.values()), 95)) if here and not share else None}
            there = _by_episode(first, metric)
            pairs = described([float(here[k]) - float(there[k]) for k in sorted(here.keys() & there.keys())] if p else [],
                              agresti_min if share else student)
            out.append({**row, **{f"difference_{key}": pairs[key] for key in ("n", "mean", "low", "high")}})
    return out


def _by_episode(records: Sequence[Record], metric: str) -> dict[int, float]:
    return {r["episode"]: r[metric] for r in records if r.get(metric) is not None}


Interval = tuple[float | None, float | None]


def student(values: Sequence[float]) -> Interval:
    """Student's interval of a mean."""
    from scipy.special import stdtrit

    n = len(values)
    if n < 2:
        return None, None
    mean, half = float(np.mean(values)), float(stdtrit(n - 1, 0.975) * np.std(values, ddof=1) / math.sqrt(n))
    return mean - half, mean + half


def wilson(values: Sequence[float]) -> Interval:
    """Wilson's interval of a share, of values 0 and 1: it holds where all or none are."""
    n, p = len(values), float(np.mean(values))
    centre, half = p + _Z**2 / (2 * n), _Z * math.sqrt(p * (1 - p) / n + _Z**2 / (4 * n * n))
    return max(0.0, (centre - half) / (1 + _Z**2 / n)), min(1.0, (centre + half) / (1 + _Z**2 / n))


def agresti_min(values: Sequence[float]) -> Interval:
    """The interval of a difference of two shares over pairs, of values -1, 0 and 1: it has a width where all pairs agree.

    Agresti & Min, "Simple improved confidence intervals for comparing matched proportions" (Statistics in Medicine 24, 2005):
    half a pair more of each of the four kinds.
    """
    n, up, down = len(values) + 2, sum(v > 0 for v in values) + 0.5, sum(v < 0 for v in values) + 0.5
    d = (up - down) / n
    half = _Z * math.sqrt(up + down - (up - down) ** 2 / n) / n
    return max(-1.0, d - half), min(1.0, d + half)


def described(values: Sequence[float], interval: Callable[[Sequence[float]], Interval] = student) -> Row:
    """n, mean and its 95 % interval; None where there is none."""
    if not values:
        return {"n": 0, "mean": None, "low": None, "high": None}
    low, high = interval(values)
    return {"n": len(values), "mean": float(np.mean(values)), "low": low, "high": high}


def printed(campaign: Campaign, table: Sequence[Row]) -> Iterator[str]:
    """The table as lines, one for each metric of each point."""
    for point in campaign.points:
        here = [row for row in table if all(row[key] == value for key, value in point.items())]
        yield ""
        yield ", ".join(f"{key} = {value}" for key, value in point.items()) or campaign.title
        yield f"  {'':28}{'n':>6}{'mean':>11}{'95 % interval':>24}{'p95':>11}"
        for row in here:
            name = f"{row['metric']}"
            interval = "-" if row["low"] is None else f"{row['low']:.4g} .. {row['high']:.4g}"
            yield f"  {name:28}{row['n']:>6}{_cell(row['mean']):>11}{interval:>24}{_cell(row['p95']):>11}"


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def write(path: Path, table: Sequence[Mapping[str, Any]], units: Mapping[str, str] | None = None) -> None:
    """A table as Parquet, all of it or nothing. Raises OutputError if it cannot be written."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = list(dict.fromkeys(key for row in table for key in row))
    columns = [pa.array([row.get(name) for row in table]) for name in names]
    fields = [pa.field(name, column.type, metadata={"unit": (units or {}).get(name, "")})
              for name, column in zip(names, columns, strict=True)]
    partial = path.with_name(f".{path.name}.partial")
    try:
        pq.write_table(pa.Table.from_arrays(columns, schema=pa.schema(fields)), partial, compression="zstd")
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from None
