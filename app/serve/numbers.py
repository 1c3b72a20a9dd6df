"""The numbers behind the picture: residual against its thresholds, errors, conditioning, timing, and one link's own."""

import math
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
import viser

from hrc.config import Config
from hrc.messages import LINKS, Contact, Snapshot

FULL = 3.0
"""A residual bar is full at so many times its threshold."""
Row = tuple[str, str]


class NumbersView:
    """One block of HTML, made in the present container."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._html = server.gui.add_html("")

    def update(self, snapshot: Snapshot, config: Config, stages: Mapping[str, tuple[float, float]], selected: int) -> None:
        """stages: time of one run [s] and part of a core, by name. selected: the link whose numbers are shown."""
        parts = (
            _titled("Residual |r| and its threshold r_low", residual_bars(snapshot.residual, config.observer.r_low)),
            _titled("Errors and conditioning", _table(errors(snapshot))),
            _titled(f"{LINKS[selected].replace('_', ' ').capitalize()} (click a link to choose it)",
                    _table(link_numbers(snapshot, selected))),
            _titled("Time of each stage", timing_bars(stages)))
        self._html.content = f'<div id="eb-numbers" class="eb-numbers" data-link="{LINKS[selected]}">{"".join(parts)}</div>'


def residual_bars(residual: Sequence[float] | np.ndarray, r_low: Sequence[float]) -> str:
    """A bar for each joint; its mark is the threshold, and past it the bar is red."""
    rows = []
    for joint, (r, low) in enumerate(zip(residual, r_low, strict=True), start=1):
        share = abs(float(r)) / low
        rows.append(f'<div class="eb-row" data-joint="{joint}" data-share="{share:.2f}"><b>J{joint}</b>'
                    f'{_bar(share / FULL, "over" if share > 1.0 else "", mark=1.0 / FULL)}'
                    f"<span>{r:+.2f} of {low:g} N m</span></div>")
    return "".join(rows)


def errors(snapshot: Snapshot) -> list[Row]:
    """How well the task is kept, and how well the force can be known."""
    command, contact = snapshot.command, snapshot.contact
    rows = [("End effector off its reference", f"{1e3 * math.dist(command.x, command.x_d):.1f} mm"),
            ("Admittance error", f"{1e3 * math.hypot(*command.admittance_error):.1f} mm"),
            ("Speed along the path", f"{100.0 * command.path_speed:.0f} %"),
            ("Force not felt below", "-" if contact is None else f"{contact.F_gate:.1f} N"),
            ("Smallest singular value of J_c", "-" if contact is None else f"{contact.sigma_min:.3f} m"),
            ("Direction that is not felt", "-" if contact is None else _direction(contact))]
    if contact is not None and contact.F_covariance is not None:
        rows.append(("Force known to", f"{math.sqrt(np.linalg.eigvalsh(contact.F_covariance)[-1]):.1f} N (1 sigma, worst way)"))
    return rows


def link_numbers(snapshot: Snapshot, link: int) -> list[Row]:
    """Of a link 1 to 7, the joint before it, and what is near it."""
    state, joint = snapshot.state, link - 1
    x, y, z = snapshot.T_world_link[link][:3, 3]
    clearance = next((c.distance for c in snapshot.clearances if c.link == link), None)
    contact = next((c for c in snapshot.contacts if c.link == link), None)
    return [("Joint angle q", f"{math.degrees(state.q[joint]):.1f} deg"),
            ("Joint velocity", f"{math.degrees(state.dq[joint]):.1f} deg/s"),
            ("Joint torque", f"{state.tau[joint]:.2f} N m"),
            ("Residual r", f"{snapshot.residual[joint]:+.2f} N m"),
            ("Origin", f"({x:.2f}, {y:.2f}, {z:.2f}) m"),
            ("Nearest obstacle", "none in sight" if clearance is None else f"{100.0 * clearance:.0f} cm"),
            ("Contact", "-" if contact is None else f"{math.hypot(*contact.F_world):.1f} N")]


def timing_bars(stages: Mapping[str, tuple[float, float]]) -> str:
    """A bar for each stage: its part of one core."""
    rows = [f'<div class="eb-row" data-stage="{escape(stage)}"><b>{escape(stage)}</b>{_bar(share)}'
            f"<span>{1e3 * each:.2f} ms, {100.0 * share:.0f} %</span></div>" for stage, (each, share) in stages.items()]
    return "".join(rows)


def _bar(part: float, style: str = "", mark: float | None = None) -> str:
    line = "" if mark is None else f'<u style="left:{100.0 * mark:.1f}%"></u>'
    return f'<i class="{style}"><s style="width:{min(100.0, 100.0 * part):.1f}%"></s>{line}</i>'


def _table(rows: Sequence[Row]) -> str:
    return "".join(f'<div class="eb-pair"><span>{escape(name)}</span><b>{escape(value)}</b></div>' for name, value in rows)


def _titled(title: str, body: str) -> str:
    return f"<h4>{escape(title)}</h4>{body}"


def _direction(contact: Contact) -> str:
    x, y, z = contact.unobservable
    return f"({x:.2f}, {y:.2f}, {z:.2f})"
