"""The banner: what the arm is doing, in one coloured card; the same facts stand in its data attributes for scripts."""

import math
from dataclasses import dataclass
from html import escape

from app.serve.session import Phase, Session
from hrc.messages import LINKS, Mode, Snapshot

SILENT = 500
"""A newest frame older than this many ticks means that no more are coming."""
STALE = '<div class="eb-stale">NO CONNECTION TO THE SERVER: WHAT YOU SEE IS OLD</div>'


@dataclass(frozen=True)
class Facts:
    """What the banner says. mode: of the arm, or of the session while there is no arm. force, truth: |F| [N]."""

    mode: str
    note: str = ""
    link: str = "-"
    force: float = 0.0
    truth: float = 0.0
    time: float = 0.0
    factor: float = 0.0
    capped: bool = False
    paused: bool = False


def facts(session: Session, snapshot: Snapshot | None) -> Facts:
    """What there is to say now."""
    status = session.status
    if status.phase is not Phase.RUNNING or snapshot is None:
        mode = status.phase.value if status.phase is not Phase.RUNNING else Phase.STARTING.value
        return Facts(mode, status.text, time=snapshot.time if snapshot else 0.0)
    contact, command = snapshot.contact, snapshot.command
    return Facts(
        mode=command.mode.value,
        note=_note(snapshot, session.paused),
        link="-" if contact is None else LINKS[contact.link],
        force=0.0 if contact is None else math.hypot(*contact.F_world),
        truth=math.hypot(*snapshot.truth.F_world),
        time=snapshot.time,
        factor=session.factor,
        capped=session.capped,
        paused=session.paused,
    )


def banner(known: Facts, beat: int) -> str:
    """The card as HTML. `beat` differs from call to call, so that the browser starts the stale animation again."""
    data = {"mode": known.mode, "link": known.link, "force": f"{known.force:.2f}", "truth": f"{known.truth:.2f}",
            "time": f"{known.time:.3f}", "factor": f"{known.factor:.2f}", "capped": str(known.capped).lower(),
            "paused": str(known.paused).lower(), "beat": str(beat)}
    attributes = " ".join(f'data-{key}="{escape(value)}"' for key, value in data.items())
    capped = ' <span class="eb-capped">CAPPED</span>' if known.capped else ""
    link = known.link.replace("_", " ")
    mode = "PAUSED" if known.paused and known.mode != Mode.STOP.value else known.mode
    return (
        f'<div id="eb-banner" class="eb-banner" role="status" {attributes}>{STALE}'
        f'<div class="eb-top"><span class="eb-mode">{escape(mode)}</span>'
        f'<span class="eb-force">{known.force:.1f} N</span></div>'
        f'<div class="eb-line"><span>contact: {escape(link)}</span><span>true {known.truth:.1f} N</span></div>'
        f'<div class="eb-line"><span>t = {known.time:.1f} s</span>'
        f"<span>real-time factor {known.factor:.2f}{capped}</span></div>"
        f'<div class="eb-note">{escape(known.note)}</div></div>'
    )


def _note(snapshot: Snapshot, paused: bool) -> str:
    command, frame = snapshot.command, snapshot.frame
    if command.mode is Mode.STOP:
        return f"{command.reason or 'stopped'}: press Resume to go on"
    if paused:
        return "the simulation is paused"
    if frame is not None and snapshot.tick - frame.tick > SILENT:
        return "the camera is silent: a contact will count as not seen"
    if command.mode is Mode.UNSEEN:
        return "a force is felt, but the camera sees nothing there: the arm gives way in its joints"
    if command.mode is Mode.RELAX:
        return "giving way; the tool stays on its path"
    if command.mode is Mode.ABORT:
        return "task abandoned; following the push"
    return "following the path" if command.path_speed > 0.99 else "rejoining the path"
