"""The figure of a run, after Fig. 5 of the paper: end effector, contact force, admittance error, state."""

from pathlib import Path

import numpy as np

from app.metrics import states
from app.record.signals import Columns
from hrc.messages import Mode

_COLOURS = {Mode.IDLE: "#b0bec5", Mode.RELAX: "#66bb6a", Mode.ABORT: "#ef5350", Mode.UNSEEN: "#ffa726",
            Mode.BLIND: "#2f5d8a", Mode.STOP: "#7f0000"}
_AXES = (("x", "C3"), ("y", "C2"), ("z", "C0"))


def figure(path: Path, columns: Columns, *, F_relax: float, F_abort: float, title: str = "") -> None:
    """Write a PNG. F_relax, F_abort: the thresholds [N] drawn beside the force."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure  # no pyplot: it would look for a display

    t = columns["t"]
    image = Figure(figsize=(12, 9), layout="constrained")
    FigureCanvasAgg(image)
    place, force, error, state = image.subplots(4, 1, sharex=True, height_ratios=[3, 3, 2, 0.6])

    for i, (axis, colour) in enumerate(_AXES):
        place.plot(t, columns["ee_desired"][:, i], color="black", linewidth=0.8, linestyle=(0, (4, 3)))
        place.plot(t, columns["ee"][:, i], color=colour, linewidth=1.2, label=axis)
        error.plot(t, 1000 * columns["admittance_error"][:, i], color=colour, linewidth=1.0, label=axis)
    place.plot([], [], color="black", linewidth=0.8, linestyle=(0, (4, 3)), label="reference")
    place.set_ylabel("end effector [m]")
    error.set_ylabel("admittance error [mm]")

    estimate = np.where(columns["contact_link_est"] >= 0, np.linalg.norm(columns["force_est"], axis=1), 0.0)
    force.plot(t, np.linalg.norm(columns["force_true"], axis=1), color="0.55", linewidth=1.0, label="truth")
    force.plot(t, estimate, color="C1", linewidth=1.2, label="estimate")
    for threshold, name in ((F_relax, "relax"), (F_abort, "abort")):
        force.axhline(threshold, color=_COLOURS[Mode(name)], linestyle="--", linewidth=1.0,
                      label=f"{name}, {threshold:g} N")
    force.set_ylabel("contact force [N]")

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
    state.set_ylabel("state")
    state.set_xlabel("time [s]")
    if t.size:
        state.set_xlim(t[0], t[-1])
    for axes in (place, force, error, state):
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize="small")
        axes.grid(axis="x", alpha=0.3)
    place.set_title(title)
    image.savefig(path, dpi=110)
