"""The figures of a run, computed from its signals alone: so a table read back gives the same ones."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.record.signals import Columns, digest
from hrc.messages import Mode

FIRM = 8.0
"""True contact force [N] above which localisation and force estimate are judged."""
SETTLING = 2.0
"""Time after an ABORT [s] that does not count for the end effector's error: the arm is coming back to its path."""
GLIMPSE, RISE = 0.05, 0.5
"""Visits to a mode [s] that are no part of the story: any so short, and RELAX so short on the way to ABORT."""
ALWAYS_FINITE = ("q", "dq", "dq_command", "tau", "residual", "ee", "ee_desired", "force_true", "admittance_error")
FINITE_IN_CONTACT = ("force_est", "contact_point_est", "contact_power", "contact_radius", "sigma_min")

Mask = NDArray[np.bool_]


def compute(columns: Columns) -> dict[str, Any]:
    """All figures, ready for JSON; a figure without a single tick to judge, or of what is not finite, is None."""
    spans = states(columns)
    return {
        "states": spans,
        "story": [mode for _, _, mode in story(spans)],
        "aborts": [start for start, _, mode in spans if mode == Mode.ABORT],
        "ee_error": {mode.value: _ee_error(columns, mode) for mode in (Mode.IDLE, Mode.RELAX)},
        "localisation": _localisation(columns),
        "force": _force(columns),
        "contact_power_min_relax_W": _least(columns["contact_power"][columns["state"] == Mode.RELAX]),
        "clearance_min_m": _least(np.stack([columns[f"clearance_{link}"] for link in range(1, 8)])),
        "force_true_max_N": _largest(np.linalg.norm(columns["force_true"], axis=1)),
        "ddq_command_max": _ddq(columns, "dq_command"),
        "ddq_measured_max": _ddq(columns, "dq"),
        "ticks_by_state": {mode.value: int((columns["state"] == mode).sum()) for mode in Mode},
        "everything_finite": _finite(columns),
        "signals_sha256": digest(columns),
    }


def clock(columns: Columns) -> NDArray[np.float64]:
    """Time of each row [s]; it goes on where a Reset has set the cell's own back to 0."""
    t = columns["t"]
    again = np.diff(t, prepend=-np.inf) <= 0.0
    return t + np.cumsum(np.where(again, np.r_[0.0, t[:-1]], 0.0))


def states(columns: Columns) -> list[list[Any]]:
    """The run as [from, to, mode] in order [s] of its clock; each span ends where the next begins."""
    t, mode = clock(columns), columns["state"]
    if not t.size:
        return []
    starts = np.flatnonzero(np.r_[True, mode[1:] != mode[:-1]])
    ends = np.r_[t[starts[1:]], t[-1]]
    return [[float(t[i]), float(end), str(mode[i])] for i, end in zip(starts, ends, strict=True)]


def story(spans: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """The spans that matter: without those of up to `GLIMPSE`, and without a RELAX of up to `RISE` on the way to an ABORT."""
    kept: list[list[Any]] = []
    for i, (start, end, mode) in enumerate(spans):
        rising = mode == Mode.RELAX and end - start < RISE and i + 1 < len(spans) and spans[i + 1][2] == Mode.ABORT
        if end - start <= GLIMPSE or rising:
            continue
        if kept and kept[-1][2] == mode:
            kept[-1][1] = end
        else:
            kept.append([start, end, mode])
    return kept


def settled(columns: Columns) -> Mask:
    """Ticks outside ABORT and at least `SETTLING` after one."""
    t, aborted = clock(columns), columns["state"] == Mode.ABORT
    last = np.maximum.accumulate(np.where(aborted, t, -np.inf))
    return t - last > SETTLING


def _ee_error(columns: Columns, mode: Mode) -> dict[str, Any]:
    judged = (columns["state"] == mode) & settled(columns)
    error = np.linalg.norm(columns["ee"] - columns["ee_desired"], axis=1)[judged]
    return {"ticks": int(error.size), "max_m": _largest(error),
            "rms_m": _figure(lambda error: np.sqrt(np.mean(error**2)), error)}


def pressed(columns: Columns) -> Mask:
    """Ticks with a true contact force above `FIRM`."""
    return np.linalg.norm(columns["force_true"], axis=1) > FIRM


def firm(columns: Columns) -> Mask:
    """Those of them whose point a noise-free camera would see."""
    return pressed(columns) & columns["contact_visible"]


def _localisation(columns: Columns) -> dict[str, Any]:
    truth = columns["contact_link_true"]
    judged, hidden_too = firm(columns), pressed(columns)
    return {**_places(columns, judged), "ticks_firm": int(hidden_too.sum()), "any": _places(columns, hidden_too),
            "by_link": {int(link): _places(columns, judged & (truth == link)) for link in np.unique(truth[judged])}}


def _places(columns: Columns, judged: Mask) -> dict[str, Any]:
    estimate, truth = columns["contact_link_est"][judged], columns["contact_link_true"][judged]
    distance = np.linalg.norm(columns["contact_point_est"] - columns["contact_point_true"], axis=1)[judged]
    located = estimate >= 0
    return {"ticks": int(judged.sum()), "ticks_with_estimate": int(located.sum()),
            "right_link": _mean(estimate == truth),  # a tick without an estimate counts as wrong
            "right_link_of_estimates": _mean((estimate == truth)[located]),
            "median_point_error_m": _median(distance[located])}


def _force(columns: Columns) -> dict[str, Any]:
    truth, located = columns["contact_link_true"], columns["contact_link_est"] >= 0
    judged, hidden_too = firm(columns) & located, pressed(columns) & located
    return {"links_4_to_7": _forces(columns, judged & (truth >= 4)),
            "by_link": {link: _forces(columns, judged & (truth == link)) for link in range(4, 8)},
            "any": {"links_4_to_7": _forces(columns, hidden_too & (truth >= 4))}}


def _forces(columns: Columns, judged: Mask) -> dict[str, Any]:
    estimate, truth = columns["force_est"][judged], columns["force_true"][judged]
    error = np.linalg.norm(estimate - truth, axis=1)
    return {"ticks": int(judged.sum()), "median_error_N": _median(error),
            "median_relative_error": _median(error / np.linalg.norm(truth, axis=1))}


def _ddq(columns: Columns, name: str) -> float | None:
    """The largest joint acceleration [rad/s2], from one control tick to the next; a Reset is none."""
    step = np.diff(columns["t"])
    change = np.abs(np.diff(columns[name], axis=0)).max(axis=1)
    return _largest(change[step > 0.0] / step[step > 0.0])


def _finite(columns: Columns) -> bool:
    contact = columns["contact_link_est"] >= 0
    return all(np.isfinite(columns[name]).all() for name in ALWAYS_FINITE) \
        and all(np.isfinite(columns[name][contact]).all() for name in FINITE_IN_CONTACT)


def _figure(of: Callable[[NDArray[Any]], Any], values: NDArray[Any]) -> float | None:
    """None where there is nothing to judge, or a value that is not finite, for JSON has none."""
    found = float(of(values)) if values.size else np.nan
    return found if np.isfinite(found) else None


def _mean(values: NDArray[Any]) -> float | None:
    return _figure(np.mean, values)


def _median(values: NDArray[np.float64]) -> float | None:
    return _figure(np.median, values)


def _largest(values: NDArray[np.float64]) -> float | None:
    return _figure(np.max, values)


def _least(values: NDArray[np.float64]) -> float | None:
    return _figure(np.min, values[np.isfinite(values)])
