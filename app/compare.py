"""`elbowroom compare`: one scenario with several presets, side by side in one figure and one table."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app import headless, output, report
from app.record.signals import read_parquet
from app.settings import configured
from hrc.cell import scenario
from hrc.errors import HrcError
from hrc.messages import Mode

COLUMNS = ("modes", "aborts", "longest abort", "largest force", "EE error idle", "EE error relax", "joint step")
UNITS = ("changes", "", "s", "N", "mm rms", "mm rms", "rad/s2")


@dataclass(frozen=True)
class Job:
    """What to compare; the defaults of the command line."""

    scenario: str
    out: Path
    presets: tuple[str, ...] = ("default", "literal")
    seed: int | None = None
    duration: float | None = None
    settings: Sequence[str] = ()
    overwrite: bool = False
    quiet: bool = False


def execute(job: Job) -> dict[str, dict[str, Any]]:
    """Run the scenario once with each preset; returns the row of each for the table, which is printed.

    Writes a folder with a run's folder for each preset, without its recording; compare.png, and compare.json. Raises HrcError
    before anything runs for a preset or scenario that there is not, and for fewer than two presets.
    """
    if len(set(job.presets)) < 2 or len(set(job.presets)) < len(job.presets):
        raise HrcError(f"compare takes two or more different presets, not {' '.join(job.presets) or 'none'}")
    script = scenario.load(job.scenario)
    configs = [configured(preset, script, job.settings, job.seed) for preset in job.presets]
    output.check(job.out, overwrite=job.overwrite)
    with output.folder(job.out, overwrite=job.overwrite) as folder:
        rows, runs = {}, {}
        for preset in job.presets:
            figures = headless.execute(headless.Job(
                job.scenario, folder / preset, job.seed, job.duration, job.settings, preset, record=False, quiet=job.quiet))
            columns = read_parquet(folder / preset / "signals.parquet")
            rows[preset], runs[f"{script.name}, preset {preset}"] = _row(figures), columns
            if figures["interrupted"]:
                raise HrcError("interrupted; nothing was kept")
        control = configs[0].control
        report.comparison(folder / "compare.png", runs, F_relax=control.f_relax, F_abort=control.f_abort)
        (folder / "compare.json").write_text(json.dumps(rows, indent=1, allow_nan=False) + "\n")
        (folder / output.MARK).write_text((folder / job.presets[0] / output.MARK).read_text())
    print(table(rows))
    return rows


def _row(figures: Mapping[str, Any]) -> dict[str, Any]:
    aborts = [end - start for start, end, mode in figures["states"] if mode == Mode.ABORT]
    return {"modes": len(figures["states"]) - 1, "aborts": len(aborts), "longest abort": max(aborts, default=0.0),
            "largest force": figures["force_true_max_N"],
            "EE error idle": _mm(figures["ee_error"]["idle"]["rms_m"]),
            "EE error relax": _mm(figures["ee_error"]["relax"]["rms_m"]),
            "joint step": figures["ddq_command_max"]}


def _mm(metres: float | None) -> float | None:
    return None if metres is None else 1000.0 * metres


def table(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """The rows as text, one for each preset."""
    width = max(map(len, rows)) + 2
    lines = [" " * width + "".join(f"{name:>16}" for name in COLUMNS), " " * width + "".join(f"{unit:>16}" for unit in UNITS)]
    for preset, row in rows.items():
        cells = ("-" if row[name] is None else f"{row[name]:.4g}" for name in COLUMNS)
        lines.append(f"{preset:<{width}}" + "".join(f"{cell:>16}" for cell in cells))
    return "\n".join(lines)
