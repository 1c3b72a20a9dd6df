"""Records as tables: Parquet, and for each point of the sweep and each metric the mean, its 95 % interval and the p95."""

import math
import os
from collections.abc import Iterator, Mapping, Sequence
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
            here = _by_episode(chosen, metric)
            row = {**point, "metric": metric, "unit": METRICS[metric].unit, "episodes": len(chosen), "failed": failed,
                   **described(list(here.values()), share=METRICS[metric].unit == "bool")}
            there = _by_episode(first, metric)
            pairs = described([float(here[k]) - float(there[k]) for k in sorted(here.keys() & there.keys())] if p else [])
            out.append({**row, **{f"difference_{key}": pairs[key] for key in ("n", "mean", "low", "high")}})
    return out


def _by_episode(records: Sequence[Record], metric: str) -> dict[int, float]:
    return {r["episode"]: r[metric] for r in records if r.get(metric) is not None}


def described(values: Sequence[float], *, share: bool = False) -> Row:
    """n, mean, its 95 % interval (Wilson's for a share, else Student's), and the 95th percentile; None where there is none."""
    n = len(values)
    if not n:
        return {"n": 0, "mean": None, "low": None, "high": None, "p95": None}
    mean = float(np.mean(values))
    low, high = _wilson(mean, n) if share else _student(values, mean)
    return {"n": n, "mean": mean, "low": low, "high": high, "p95": None if share else float(np.percentile(values, 95))}


def _wilson(p: float, n: int) -> tuple[float, float]:
    """The interval of a share p of n: it holds where all or none are."""
    centre, half = p + _Z**2 / (2 * n), _Z * math.sqrt(p * (1 - p) / n + _Z**2 / (4 * n * n))
    return max(0.0, (centre - half) / (1 + _Z**2 / n)), min(1.0, (centre + half) / (1 + _Z**2 / n))


def _student(values: Sequence[float], mean: float) -> tuple[float | None, float | None]:
    from scipy.special import stdtrit

    n = len(values)
    if n < 2:
        return None, None
    half = float(stdtrit(n - 1, 0.975) * np.std(values, ddof=1) / math.sqrt(n))
    return mean - half, mean + half


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
