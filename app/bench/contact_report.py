"""The table of pushes, and its plot."""

import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

Figures = Mapping[str, Any]
PARTS = ("whole", "inside", "outside")
COLOURS = {"ideal": "#8bb174", "realistic": "#2f7ed8", "calibrated": "#1b4f8a", "harsh": "#e0701a"}


def printed(figures: Figures) -> Iterator[str]:
    """The lines of the tables: detection and place; the force; false contacts."""
    rows = figures["rows"]
    yield f"{'':36}{'delay ms':>14}{'missed':>8}{'felt':>8}{'placed':>8}{'right':>8}{'seen':>6}{'point':>7}"
    yield (f"{'preset':<12}{'task':<8}{'link':<6}{'force':<6}{'n':>4}{'median':>8}{'95 %':>6}{'%':>8}{'before':>8}{'%':>8}"
           f"{'link %':>8}{'%':>6}{'mm':>7}")
    for r in rows:
        counts = (f"{_cell(r[key], scale):>{width}}" for key, scale, width in (
            ("delay_median", 1e3, 8), ("delay_p95", 1e3, 6), ("missed", 1e2, 8), ("felt_before", 1, 8), ("located", 1e2, 8),
            ("right_link", 1e2, 8), ("seen", 1e2, 6), ("point", 1e3, 7)))
        yield _name(r) + "".join(counts)
    yield from ("", f"{'error of the force [N] and [%],':40}{'as the cell says':>36}{'at the true point':>70}",
                f"{'median / 95 %':40}" + 2 * "".join(f"{part:>25}" for part in PARTS))
    for r in rows:
        yield _name(r) + "".join(f"{_error(r[f'{source}_{part}']):>25}" for source in ("said", "given") for part in PARTS)
    yield ""
    for c in figures["calm"]:
        yield (f"{c['preset']}: {c['false']} false contacts in {c['seconds']:.0f} s between the pushes, "
               f"{100 * c['felt'] / max(c['seconds'], 1e-9):.1f} % of this time")
    if "hour" in figures:
        yield from _hour(figures["hour"])


def _name(r: Figures) -> str:
    return f"{r['preset']:<12}{r['task']:<8}{r['link'] or '4-7':<6}{r['force'] or 'all':<6}{r['pushes']:>4}"


def _cell(value: float | None, scale: float) -> str:
    return "-" if value is None else f"{scale * value:.0f}"


def _error(error: Figures | None) -> str:
    if error is None:
        return "-"
    return (f"{error['median_N']:.2f} / {error['p95_N']:.2f}, {100 * error['median_share']:.0f} / "
            f"{100 * error['p95_share']:.0f} %")


def _hour(hour: Figures) -> Iterator[str]:
    yield ""
    for f in hour["free"]:
        yield (f"robot {f['robot']}, {f['kind']} at {f['speed']:g} m/s, {f['seconds']:.0f} s: "
               f"{len(f['false'])} false contacts, residual up to {max(f['worst']):.2f} of its threshold")
    yield (f"{hour['seconds']:.0f} s of free motion, calibrated: {hour['false']} false contacts, residual up to "
           f"{hour['worst_ratio']:.2f} of its threshold")
    yield (f"{hour['pushed']} pushes of {hour['conditions']['force_N']:g} N on links 4 to 7: {hour['missed']} missed, "
           f"{hour['felt_before']} with something felt before; detected after {_cell(hour['delay_median'], 1e3)} ms (median), "
           f"{_cell(hour['delay_p95'], 1e3)} ms (95 %)")


def plot(figures: Figures, path: Path) -> None:
    """Draw the error of the force by link and preset: in the observable directions, at the true point and as the cell says."""
    from matplotlib.figure import Figure

    image = Figure(figsize=(9.0, 6.0), layout="constrained")
    rows = [r for r in figures["rows"] if r["link"]]
    presets, tasks, links = (list(dict.fromkeys(r[key] for r in rows)) for key in ("preset", "task", "link"))
    panels = image.subplots(2, 2, sharex=True, sharey=True)
    sources = {"given": "Eq. (5) at the true point", "said": "as the cell says"}
    for axes, (source, task) in zip(panels.flat, itertools.product(sources, tasks), strict=True):
        for i, preset in enumerate(presets):
            at = np.arange(len(links)) + 0.16 * (i - (len(presets) - 1) / 2)
            chosen = {r["link"]: r[f"{source}_inside"] or {} for r in rows if (r["preset"], r["task"]) == (preset, task)}
            median, p95 = (np.array([chosen[link].get(key, np.nan) for link in links]) for key in ("median_N", "p95_N"))
            axes.vlines(at, median, p95, color=COLOURS[preset], linewidth=2)
            axes.plot(at, median, "o", color=COLOURS[preset], label=preset)
        axes.set_title(f"{sources[source]}, {task}", fontsize=10)
        axes.set_xticks(range(len(links)), [f"link {link}" for link in links])
        axes.set_yscale("log")
        axes.grid(axis="y", alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel("error in the observable directions [N]\nmedian, line to 95 %")
    panels[0, 0].legend(frameon=False, fontsize=8, ncols=len(presets))
    image.savefig(path, dpi=110)
