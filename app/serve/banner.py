"""The banner: what the arm is doing, in one coloured card; the same facts stand in its data attributes for scripts."""

import math
import time
from dataclasses import dataclass
from html import escape

from app.serve.driver import Driver, Phase
from hrc.config import Config
from hrc.control.reaction import ReactionConfig
from hrc.geometry import Array
from hrc.messages import LINKS, Contact, Mode, Snapshot

STALE = '<div class="eb-stale">NO CONNECTION TO THE SERVER: WHAT YOU SEE IS OLD</div>'
HUNG, SILENT = "not responding", 1.5
"""What the banner says when the cell's thread has not come round for so long [s]."""
NEAR = 0.005
"""The end effector is at its target when it is this near [m]."""


@dataclass(frozen=True)
class Facts:
    """What the banner says. mode: of the arm, or of the session while there is no arm that moves. force, truth: |F| [N].

    task: its kind; off: of the end effector from the target that it follows [m], if it follows one.
    limit: of the quasi-static force on a region of the body [N]. nearest, clearance: the link that is nearest to an obstacle,
    and how near [m]. silent: which of the cameras are.
    """

    mode: str
    note: str = ""
    link: str = "-"
    place: str = ""
    force: float = 0.0
    truth: float = 0.0
    region: str = "hand"
    limit: float = math.inf
    nearest: str = "-"
    clearance: float = math.inf
    task: str = "-"
    off: float = math.nan
    silent: tuple[str, ...] = ()
    cameras: int = 1
    time: float = 0.0
    factor: float = 0.0
    capped: bool = False
    paused: bool = False


def facts(session: Driver, snapshot: Snapshot | None, config: Config) -> Facts:
    """What there is to say now. config: the parameters as they are now."""
    status = session.status
    if status.phase is not Phase.RUNNING or snapshot is None:
        mode = status.phase.value if status.phase is not Phase.RUNNING else Phase.STARTING.value
        return Facts(mode, status.text, time=snapshot.time if snapshot else 0.0)
    if session.silence > SILENT:
        return Facts(HUNG, f"the cell has not answered for {session.silence:.0f} s; what you see is old", time=snapshot.time)
    contact, command = snapshot.contact, snapshot.command
    nearest = min(snapshot.clearances, key=lambda c: c.distance, default=None)
    return Facts(
        mode=command.mode.value,
        note=_note(snapshot, session.paused, config.control),
        link="-" if contact is None else LINKS[contact.link],
        place=_place(contact),
        force=0.0 if contact is None else math.hypot(*contact.F_world),
        truth=math.hypot(*snapshot.truth.F_world),
        region=config.exposure.region,
        limit=config.exposure.limit,
        nearest="-" if nearest is None else LINKS[nearest.link],
        clearance=snapshot.clearance,
        task=snapshot.aim.kind,
        off=math.nan if snapshot.aim.target is None else math.dist(command.x, snapshot.aim.target),
        silent=tuple(view.camera for view in snapshot.views if view.silent),
        cameras=len(snapshot.views),
        time=snapshot.time,
        factor=session.factor,
        capped=session.capped,
        paused=session.paused,
    )


def banner(known: Facts, beat: int) -> str:
    """The card as HTML. `beat` differs from call to call, so that the browser starts the stale animation again.

    data-sent tells when [s since the epoch], for whoever measures how long it takes to arrive.
    """
    data = {
        "mode": known.mode, "link": known.link, "place": known.place, "force": f"{known.force:.2f}",
        "truth": f"{known.truth:.2f}", "nearest": known.nearest, "clearance": f"{known.clearance:.3f}",
        "task": known.task, "off": f"{known.off:.4f}",
        "silent": ",".join(known.silent), "time": f"{known.time:.3f}", "factor": f"{known.factor:.2f}",
        "capped": str(known.capped).lower(), "paused": str(known.paused).lower(), "beat": str(beat),
        "sent": f"{time.time():.4f}"}
    attributes = " ".join(f'data-{key}="{escape(value)}"' for key, value in data.items())
    capped = ' <span class="eb-capped">CAPPED</span>' if known.capped else ""
    link, near = (name.replace("_", " ") for name in (known.link, known.nearest))
    contact = f"{link} ({known.place})" if known.place else link
    obstacle = "none in sight" if known.nearest == "-" else f"{near}, {100.0 * known.clearance:.0f} cm"
    mode = "PAUSED" if known.paused and known.mode != Mode.STOP.value else known.mode
    return (
        f'<div id="eb-banner" class="eb-banner" role="status" {attributes}>{STALE}'
        f'<div class="eb-top"><span class="eb-mode">{escape(mode)}</span>'
        f'<span class="eb-force">{known.force:.1f} N</span></div>'
        f'<div class="eb-line"><span>contact: {escape(contact)}</span><span>true {known.truth:.1f} N</span></div>'
        f"{_exposure(known)}"
        f'<div class="eb-line"><span>nearest obstacle: {escape(obstacle)}</span></div>'
        f'<div class="eb-line"><span>t = {known.time:.1f} s</span>'
        f"<span>real-time factor {known.factor:.2f}{capped}</span></div>"
        f'<div class="eb-note">{escape(known.note)}</div>'
        f'<div class="eb-note eb-trouble">{escape(_trouble(known))}</div></div>'
    )


def _exposure(known: Facts) -> str:
    if not math.isfinite(known.limit):
        return ""
    share = 100.0 * known.force / known.limit
    return (
        f'<div class="eb-bar" data-share="{share:.1f}" title="Estimated force against the quasi-static limit of ISO/TS 15066, '
        f'Annex A. Indicative: no pressure, no transient, no risk assessment.">'
        f'<i style="width:{min(share, 100.0):.0f}%"></i>'
        f"<span>{share:.0f} % of {known.limit:g} N, {escape(known.region)} (indicative)</span></div>")


def _trouble(known: Facts) -> str:
    if not known.silent or known.mode == Mode.BLIND.value:  # there the note says so
        return ""
    if len(known.silent) == known.cameras:
        return "no camera delivers images: a contact will count as not seen"
    names = " and ".join(f'camera "{camera}"' for camera in known.silent)
    return f"{names} {'is' if len(known.silent) == 1 else 'are'} silent"


def _place(contact: Contact | None) -> str:
    if contact is None:
        return ""
    return "seen" if contact.seen else f"not seen, felt to {100.0 * contact.radius:.0f} cm"


def _doing(mode: Mode) -> str:
    return {Mode.RELAX: "gives way", Mode.ABORT: "follows the push"}.get(mode, "goes on")


def _note(snapshot: Snapshot, paused: bool, control: ReactionConfig) -> str:
    command = snapshot.command
    if command.mode is Mode.STOP:
        return f"{command.reason or 'stopped'}: press Resume to go on"
    if paused:
        return "the simulation is paused"
    if command.mode is Mode.BLIND:
        return "no camera delivers images: the arm stands still on its path; a push is answered in the joints"
    if command.mode is Mode.UNSEEN:
        return "a force is felt, but the camera sees nothing there: the arm gives way in its joints"
    if snapshot.contact is not None and not snapshot.contact.seen:
        return f"no camera sees this contact: its place is felt in the joints; the arm {_doing(command.mode)}"
    if command.mode is Mode.RELAX:
        return "giving way; the tool stays on its path"
    if command.mode is Mode.ABORT and not snapshot.detected and snapshot.clearance <= control.abort_distance:
        least = 100.0 * control.abort_distance
        return f"waiting: an obstacle is {100.0 * snapshot.clearance:.1f} cm away, nearer than {least:.0f} cm"
    if command.mode is Mode.ABORT:
        return "task abandoned; following the push"
    if snapshot.aim.goal is not None and snapshot.aim.target is not None:
        return _steered(command.x, snapshot.aim.target, snapshot.aim.goal)
    if snapshot.aim.arrived and control.separation and snapshot.clearance < control.slow_from:
        held = "standing still" if snapshot.clearance <= control.stand_at else "slower"
        return f"{held}: an obstacle is {100.0 * snapshot.clearance:.0f} cm away"
    if snapshot.aim.arrived and command.path_speed > 0.99:
        return "holding its place" if snapshot.aim.kind == "hold" else "following the path"
    return "going to the path" if snapshot.aim.kind != "hold" else "going to its place"


def _steered(x: Array, target: Array, goal: Array) -> str:
    if math.dist(x, goal) > NEAR:
        return "going to its target"
    return "at its target" if math.dist(goal, target) < NEAR else "as near to its target as it gets straight from here"
