"""What came of an episode, as one flat row: what was felt, when, where and how strong, beside what was done."""

from typing import Any

import numpy as np

from app.bench.pushes import DECAYED, Watch, dynamics, parts
from app.campaign import places
from hrc.cell.eyes import rig
from hrc.config import Config
from hrc.contact.force import estimate_force
from hrc.events import Push
from hrc.geometry import Array, apply, inverse
from hrc.messages import Mode, Snapshot

LEAST = 2.0
"""Force and place are judged while the true force is at least this [N]."""
EVERY = 4
"""Of the control cycles, one in so many is judged."""


class Judge:
    """An observer."""

    def __init__(self, config: Config) -> None:
        self._config, self._watch = config, Watch()
        self._cameras = tuple(setup.camera for setup in rig(config))
        self._began: float | None = None
        self._ended: float | None = None
        self._felt_before = self._was_felt = False
        self._delay: float | None = None
        self._first: Snapshot | None = None
        self._forces: list[float] = []
        self._touched: list[Snapshot] = []
        self._modes: list[Mode] = []
        self._ee_error = self._ddq = 0.0
        self._dq: Array | None = None

    def on_step(self, snapshot: Snapshot) -> None:
        """One step has been taken."""
        if self._began is None and (snapshot.truth.link >= 0 or any(isinstance(e, Push) for e in snapshot.events)):
            self._began, self._felt_before = snapshot.time, self._was_felt
        if not snapshot.fresh_control:
            return
        self._watch.on_step(snapshot)
        self._move(snapshot)
        if snapshot.truth.link >= 0:
            self._ended = snapshot.time
            self._forces.append(float(np.linalg.norm(snapshot.truth.F_world)))
            self._touched.append(snapshot)
            self._first = self._first or snapshot
        self._notice(snapshot)
        self._was_felt = snapshot.detected

    def record(self, judged_from: float) -> dict[str, Any]:
        """The row: every metric, None where there was nothing to judge, and where the contact was.

        judged_from: force and place are judged so long after the contact began [s].
        """
        began = self._began if self._began is not None else np.inf
        judged = [s for s in self._touched if s.time - began >= judged_from
                  and float(np.linalg.norm(s.truth.F_world)) >= LEAST][::EVERY]
        changes = sum(a is not b for a, b in zip(self._modes, self._modes[1:], strict=False))
        return {
            **self._where(), **self._detection(), **self._judged(judged),
            "force_mean_N": _mean(self._forces), "force_peak_N": max(self._forces, default=None),
            "relaxed": Mode.RELAX in self._modes, "aborted": Mode.ABORT in self._modes, "reflex": Mode.UNSEEN in self._modes,
            "mode_changes": changes, "ee_error_m": self._ee_error, "yield_m": self._yielded(), "ddq_max": self._ddq}

    def _move(self, snapshot: Snapshot) -> None:
        command = snapshot.command
        self._modes.append(command.mode)
        if command.mode in (Mode.IDLE, Mode.RELAX):
            self._ee_error = max(self._ee_error, float(np.linalg.norm(command.x - command.x_d)))
        if self._dq is not None:
            self._ddq = max(self._ddq, float(np.abs(command.dq - self._dq).max()) * self._config.rates.control_hz)
        self._dq = command.dq

    def _notice(self, snapshot: Snapshot) -> None:
        """The contact is felt in time until just after it has ended."""
        if self._began is None or self._felt_before or self._delay is not None or not snapshot.detected:
            return
        if self._ended is None or snapshot.time - self._ended <= DECAYED:
            self._delay = snapshot.time - self._began

    def _where(self) -> dict[str, Any]:
        """Link, point in its frame [m] and force's direction there, when the contact was first seen."""
        if self._first is None:
            return dict.fromkeys(("link", "p_link_m", "F_link", "in_view"), None)
        truth, T = self._first.truth, self._first.T_world_link
        F = T[truth.link, :3, :3].T @ truth.F_world
        return {"link": truth.link, "p_link_m": apply(inverse(T[truth.link]), truth.p_world).tolist(),
                "F_link": (F / np.linalg.norm(F)).tolist(), "in_view": places.seen(truth.p_world, T, self._cameras)}

    def _detection(self) -> dict[str, Any]:
        r_low = np.asarray(self._config.observer.r_low)
        touched = self._began is not None
        return {"missed": self._delay is None if touched and not self._felt_before else None, "delay_s": self._delay,
                "felt_before": self._felt_before if touched else None, "false_contacts": len(self._watch.false),
                "residual_ratio": float((self._watch.level / r_low).max())}

    def _judged(self, judged: list[Snapshot]) -> dict[str, Any]:
        found = {name: list[float]() for name in (
            "right_link", "seen", "point_error_m", "force_error_N", "force_error_share", "force_observable_N",
            "force_blind_N", "force_at_point_N", "sigma_min_m")}
        for s in judged:
            J_c = dynamics().terms(s.state.q, s.state.dq).J_contact(s.truth.link, s.truth.p_world)
            F = s.truth.F_world
            found["sigma_min_m"].append(float(np.linalg.svd(J_c, compute_uv=False)[-1]))
            found["force_at_point_N"].append(
                float(np.linalg.norm(estimate_force(J_c, s.residual, self._config.force).F - F)))
            if s.contact is not None:
                whole, observable, blind = parts(J_c, sum((c.F_world for c in s.contacts), np.zeros(3)) - F)
                found["force_error_N"].append(whole)
                found["force_error_share"].append(whole / float(np.linalg.norm(F)))
                found["force_observable_N"].append(observable)
                found["force_blind_N"].append(blind)
                found["right_link"].append(s.contact.link == s.truth.link)
                found["seen"].append(s.contact.seen)
                found["point_error_m"].append(float(np.linalg.norm(s.contact.p_world - s.truth.p_world)))
        return {
            "located": _mean([s.contact is not None for s in judged]),
            "contacts_found": _mean([len(s.contacts) for s in judged]),
            **{name: _mean(v) if name in ("right_link", "seen") else _median(v) for name, v in found.items()}}

    def _yielded(self) -> float | None:
        """The way of the first contact's point [m], along the force at its beginning."""
        if self._first is None:
            return None
        truth, T = self._first.truth, self._first.T_world_link[self._first.truth.link]
        p_link = apply(inverse(T), truth.p_world)
        last = self._touched[-1].T_world_link[truth.link]
        return float((apply(last, p_link) - truth.p_world) @ truth.F_world / np.linalg.norm(truth.F_world))


def _mean(values: "list[float] | list[bool] | list[int]") -> float | None:
    return float(np.mean(values)) if values else None


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None
