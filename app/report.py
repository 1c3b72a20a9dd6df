"""The figure of a run, after Fig. 5 of the paper: end effector, contact force, admittance error, state."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.metrics import clock, states
from app.record.signals import Columns
from hrc.messages import Mode

_COLOURS = {Mode.IDLE: "#b0bec5", Mode.RELAX: "#66bb6a", Mode.ABORT: "#ef5350", Mode.UNSEEN: "#ffa726",
            Mode.BLIND: "#2f5d8a", Mode.STOP: "#7f0000"}
_AXES = (("x", "C3"), ("y", "C2"), ("z", "C0"))


def figure(path: Path, columns: Columns, *, F_relax: float, F_abort: float, title: str = "") -> None:
    """Write a PNG. F_relax, F_abort: the thresholds [N] drawn beside the force."""
    comparison(path, {title: columns}, F_relax=F_relax, F_abort=F_abort)


def comparison(path: Path, runs: Mapping[str, Columns], *, F_relax: float, F_abort: float) -> None:
    """Write a PNG with a column for each run, under its title, on common scales."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure  # no pyplot: it would look for a display

    image = Figure(figsize=(2 + 10 * len(runs), 9), layout="constrained")
    FigureCanvasAgg(image)
    rows = image.subplots(4, len(runs), sharex=True, sharey="row", squeeze=False, height_ratios=[3, 3, 2, 0.6])
    for (title, columns), axes in zip(runs.items(), rows.T, strict=True):
        _column(axes, columns, F_relax, F_abort)
        axes[0].set_title(title)
    labels = ("end effector [m]", "contact force [N]", "admittance error [mm]", "state")
    for axes, label in zip(rows[:, 0], labels, strict=True):
        axes.set_ylabel(label)
    for axes in rows[:, -1]:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize="small")
    image.savefig(path, dpi=110)


def _column(rows: Sequence[Any], columns: Columns, F_relax: float, F_abort: float) -> None:
    place, force, error, state = rows
    t = clock(columns)
    for i, (axis, colour) in enumerate(_AXES):
        place.plot(t, columns["ee_desired"][:, i], color="black", linewidth=0.8, linestyle=(0, (4, 3)))
        place.plot(t, columns["ee"][:, i], color=colour, linewidth=1.2, label=axis)
        error.plot(t, 1000 * columns["admittance_error"][:, i], color=colour, linewidth=1.0, label=axis)
    place.plot([], [], color="black", linewidth=0.8, linestyle=(0, (4, 3)), label="reference")

    estimate = np.where(columns["contact_link_est"] >= 0, np.linalg.norm(columns["force_est"], axis=1), 0.0)
    force.plot(t, np.linalg.norm(columns["force_true"], axis=1), color="0.55", linewidth=1.0, label="truth")
    force.plot(t, estimate, color="C1", linewidth=1.2, label="estimate")
    for threshold, name in ((F_relax, "relax"), (F_abort, "abort")):
        force.axhline(threshold, color=_COLOURS[Mode(name)], linestyle="--", linewidth=1.0,
                      label=f"{name}, {threshold:g} N")

    spans = states(columns)
    for mode in Mode:
        own = [(start, end - start) for start, end, name in spans if name == mode]
        if own:
            state.broken_barh(own, (0, 1), facecolors=_COLOURS[mode], label=mode.value)
            for axes in (place, force, error):
                if mode is not Mode.IDLE:
                    for start, length in own:
                        axes.axvspan(start, start + length, color=_COLOURS[mode], alpha=0.15, linewidth=0)
    state.set_yticks([])
    state.set_xlabel("time [s]")
    if t.size:
        state.set_xlim(t[0], t[-1])
    for axes in rows:
        axes.grid(axis="x", alpha=0.3)
