"""The figures as a table, and as a JSON file."""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from app.output import OutputError

Figures = Mapping[str, Any]


def check(path: Path) -> None:
    """Raise OutputError if no file can be written there; what is there stays as it is."""
    partial = _partial(path)
    try:
        if path.is_dir():
            raise OutputError(f"{path} is a folder; name a file for the figures")
        partial.touch()
        partial.unlink()
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}; name a file in a folder that exists") from None


def write(path: Path, figures: Figures) -> None:
    """The figures as JSON: all of the file or nothing. Raises OutputError if it cannot be written."""
    partial = _partial(path)
    try:
        partial.write_text(json.dumps(figures, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from None
    finally:
        partial.unlink(missing_ok=True)


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.name}.partial")


def printed(figures: Figures) -> Iterator[str]:
    """The lines of the table. Ratios are to the cycle of the paper's rule, and to that of the default mode."""
    c, cycle, exact = figures["conditions"], figures["cycle"], figures["exact"]
    yield (f"{c['cpu']}, {c['cores']} cores, core {c['pinned_core']}; Python {c['python']}, "
           + ", ".join(f"{name} {version or 'missing'}" for name, version in c["packages"].items()))
    yield (f"{c['frames']} distinct frames of {c['resolution']}, {c['rounds']} rounds, reach {c['reach_m']} m; robot of "
           f"{c['triangles']['surface']} triangles, filter mesh of {c['triangles']['filter']} or "
           f"{c['triangles']['own_filter']}; graphics: {c['graphics'] or 'unknown'}")
    yield from ("", f"{'':60}{'median ms':>10}{'p90 ms':>10}{'to paper':>10}{'to default':>12}")
    for entry in (*cycle["rows"].values(), *cycle["stages"].values(), *figures["baselines"].values()):
        yield from _lines(entry)
    yield from ("", f"largest difference to brute force, of any pixel's distance: {exact['max_abs_error_m']:.1e} m")
    yield from _sweeps(figures["sweeps"])


def _lines(entry: Figures) -> Iterator[str]:
    """What took how long, and its steps."""
    if "missing" in entry:
        yield f"{entry['name']:60}{'missing':>10}  {entry['missing']}"
        return
    yield _line(entry["name"], entry)
    yield from (_line(f"    {step}", times) for step, times in entry["steps"].items())


def _line(name: str, times: Figures) -> str:
    line = f"{name:60}{times['median_ms']:10.3f}{times['p90_ms']:10.3f}"
    return f"{line}{times['ratio']:9.1f}x{times['ratio_to_default']:11.1f}x" if "ratio" in times else line


def _sweeps(rows: Sequence[Figures]) -> Iterator[str]:
    """One block for each sweep; a column that none of its rows has is left out."""
    for sweep in dict.fromkeys(row["sweep"] for row in rows):
        block = [row for row in rows if row["sweep"] == sweep]
        columns = dict.fromkeys(key for row in block for key in row if key not in ("sweep", "value"))
        heads = [column.removesuffix("_ms").replace("_", " ") for column in columns]
        widths = [max(len(head) + 2, 9) for head in heads]
        yield from ("", f"{sweep:28}" + "".join(f"{head:>{width}}" for head, width in zip(heads, widths, strict=True)))
        for row in block:
            cells = (f"{row[c]:{w}.{3 if c.endswith('_ms') else 1}f}" if c in row else " " * w
                     for c, w in zip(columns, widths, strict=True))
            yield f"  {row['value']:26}" + "".join(cells)
