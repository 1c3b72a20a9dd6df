"""`elbowroom replay --set`: the recorded robot and images again, seen, felt and decided upon with other parameters.

What the robot measured is on the tape that `run` keeps; without one, as beside a recording of the page, the session runs again
first. Depth images are rendered anew, with the noise of the seed, or come from the recording. Only perception, estimation and
the reaction's decisions are new. What the arm would have done next nobody can tell from a recording: the decisions are answers
to the recorded motion.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from app import metrics, output, settings
from app.record.clock import Clock
from app.record.folder import Session, SessionError, line, write, write_json
from app.record.signals import Columns
from app.record.tape import ROBOT, TapeTable, read_tape
from app.replay import OPEN_LOOP, Difference, again, difference, opened, other_versions, tail
from app.review import recordings
from hrc.cell.cell import Cell
from hrc.cell.eyes import rig
from hrc.cell.playback import Images, PlayedCell, Tape
from hrc.config import Config
from hrc.errors import ConfigError, unknown
from hrc.parameters import keys, replaced
from hrc.scene import load_scene
from hrc.vision.kernels import check_device

GROUPS = ("model", "vision", "observer", "zero", "friction", "proprioception", "tracker", "pair", "force", "control")
KEYS = ("rates.localize_hz", "rates.localize_latency_s")
"""What may be other than recorded: all that neither robot nor camera knows of."""
GIVEN = ("tick", "t", "q", "dq", "tau", "force_true", "contact_point_true", "contact_link_true")
"""Signals that are none of the estimator's: a replay that does not give them again is none of this session."""
SHOWN = (
    "aborts", "localisation.ticks_with_estimate", "localisation.right_link",
    "localisation.median_point_error_m", "localisation.any.right_link", "localisation.any.median_point_error_m",
    "force.any.links_4_to_7.ticks", "force.any.links_4_to_7.median_error_N", "force.any.links_4_to_7.median_relative_error",
    "clearance_min_m", "contact_power_min_relax_W")


@dataclass(frozen=True)
class Job:
    """What to replay; the defaults of the command line. out: folder to write; None prints alone."""

    folder: Path
    settings: Sequence[str] = ()
    out: Path | None = None
    device: str | None = None
    overwrite: bool = False
    depth: Literal["rendered", "recorded"] = "rendered"


@dataclass(frozen=True)
class Replay:
    """What came of it. figures, recorded: metrics of replay and recording. changed: where any signal differs, None if nowhere.

    factor: simulated time over wall time.
    """

    session: Session
    columns: Columns
    figures: dict[str, Any]
    recorded: dict[str, Any]
    changed: Difference | None
    factor: float


def execute(job: Job) -> Replay:
    """Replay, and write the output folder if there is to be one.

    Raises ConfigError for a parameter that there is not or that cannot change, SessionError for what is no session or does not
    come out again on this machine, OutputError for a folder that cannot be written.
    """
    if job.out is not None:
        output.apart(job.out, job.folder)
        output.check(job.out, overwrite=job.overwrite)
    session = opened(job.folder)
    changes = dict(map(settings.parse, job.settings))
    config = session.config
    for key, value in changes.items():
        config = replaced(config, free(key, keys(config)), value)
    device = job.device or session.about.get("device", "cpu")
    check_device(device)
    tape = _tape(session, device)
    with _images(job.depth, session) as images:
        cell = PlayedCell(config, tape, device, changes, images, {entry.tick for entry in session.events})
        begin = time.perf_counter()
        every = again(cell, session)
        wall = time.perf_counter() - begin
    columns = tail(every, session.skipped)
    if (given := difference(session.columns, columns, GIVEN.__contains__)) is not None:
        raise SessionError(f"the recorded motion does not come out again: {given}{other_versions(session)}")
    seconds = len(every["t"]) / config.rates.control_hz
    replay = Replay(session, columns, _figures(columns), _figures(session.columns), difference(session.columns, columns),
                    seconds / wall)
    if job.out is not None:
        _write(job.out, replay, {**session.about, "device": device, OPEN_LOOP: str(job.folder), "changes": changes}, config,
               overwrite=job.overwrite)
    return replay


def _tape(session: Session, device: str) -> Tape:
    """What `run` has kept, or what comes of running the session again."""
    scene = load_scene(session.config.scene)
    if (session.folder / ROBOT).is_file() and not session.skipped:
        try:
            return read_tape(session.folder, session.columns, scene)
        except (OSError, ValueError, KeyError) as error:
            raise SessionError(f"{session.folder / ROBOT} cannot be read: {error}") from None
    table = TapeTable()
    columns = again(Cell(session.config, device), session, table)
    if (found := difference(session.columns, tail(columns, session.skipped))) is not None:
        raise SessionError(f"the session does not come out again: {found}{other_versions(session)}")
    return table.tape(columns, scene)


def _in_millimetres(config: Config) -> bool:
    """Whether recorded depth is all that the cameras have measured."""
    return all(setup.sensor.quantum == 0.001 for setup in rig(config))


@contextmanager
def _images(depth: str, session: Session) -> Iterator[Images | None]:
    """Where depth images come from: None renders them."""
    if depth == "rendered":
        yield None
        return
    from app.record.images import RecordedImages  # here, because rerun takes half a second and is an extra

    if session.skipped:
        raise SessionError(f"{session.folder} was recorded from its middle on; --depth rendered has the images before, too")
    if not _in_millimetres(session.config):
        raise SessionError(f"{session.folder} has its depth in whole mm, which is not all that its cameras measured; "
                           "--depth rendered has")
    with RecordedImages(recordings([session.folder])) as images:
        yield images


def free(key: str, known: Mapping[str, Any]) -> str:
    """The key, if it may be other than recorded. Raises ConfigError."""
    if key not in known:
        raise ConfigError(unknown("parameter", key, known))
    if key not in KEYS and key.partition(".")[0] not in GROUPS:
        raise ConfigError(f"{key} has made the recorded session what it is; a replay can change {', '.join(GROUPS)}, "
                          f"{' and '.join(KEYS)}, and `run --set` any other")
    return key


def _figures(columns: Columns) -> dict[str, Any]:
    """Without the end effector's error: a reference that waits for an arm which moves as recorded says nothing."""
    return {name: value for name, value in metrics.compute(columns).items() if name != "ee_error"}


def _write(out: Path, replay: Replay, about: Mapping[str, Any], config: Config, *, overwrite: bool) -> None:
    with output.folder(out, overwrite=overwrite) as folder:
        write(folder, config, about, replay.columns, map(line, replay.session.events))
        write_json(folder / "metrics.json", {
            **about, "real_time_factor": replay.factor, **replay.figures,
            "changed_control_ticks": replay.changed.ticks if replay.changed else 0})
        if (recording := replay.session.folder / "session.rrd").is_file():
            from app.record import overlay  # here, because rerun takes half a second and is an extra

            overlay.write(folder / recording.name, recording, Clock(replay.session).rows, replay.columns, keys(config),
                          tick_ns=1_000_000_000 // config.rates.base_hz, cameras=[setup.name for setup in rig(config)])


def table(replay: Replay) -> str:
    """What changed, in lines: how many control ticks, and each figure before and after where they differ."""
    old, new = replay.session.columns, replay.columns
    rows = len(new["tick"])
    other = int((old["state"] != new["state"]).sum())
    contact = (old["contact_link_est"] >= 0) | (new["contact_link_est"] >= 0)
    links = int((old["contact_link_est"] != new["contact_link_est"]).sum())
    lines = [f"{'mode':<46}{other} of {rows} control ticks are in another mode",
             f"{'contact':<46}{links} of {int(contact.sum())} control ticks with a contact have another link, or none"]
    strength = [np.linalg.norm(c["force_est"], axis=1) for c in (old, new)]
    both = (old["contact_link_est"] >= 0) & (new["contact_link_est"] >= 0)
    if both.any():
        shift = np.linalg.norm(old["force_est"] - new["force_est"], axis=1)[both]
        apart = np.linalg.norm(old["contact_point_est"] - new["contact_point_est"], axis=1)[both]
        lines += [f"{'force':<46}changed by {np.median(shift):.2f} N (median), {shift.max():.2f} N (most)",
                  f"{'point':<46}changed by {1e3 * np.median(apart):.1f} mm (median), {1e3 * apart.max():.1f} mm (most)"]
    lines.append(f"{'':<46}{'recorded':>16}{'replayed':>16}")
    lines.append(f"{'largest estimated force [N]':<46}" + "".join(
        f"{_shown(float(np.nanmax(s)) if np.isfinite(s).any() else None):>16}" for s in strength))
    for name in SHOWN:
        lines.append(f"{name:<46}{_shown(at(replay.recorded, name)):>16}{_shown(at(replay.figures, name)):>16}")
    lines += [f"story, {name}: {' > '.join(figures['story'])}"
              for name, figures in (("recorded", replay.recorded), ("replayed", replay.figures))]
    return "\n".join(lines)


def at(figures: Mapping[str, Any], name: str) -> Any:
    """The figure with a dotted name."""
    value: Any = figures
    for part in name.split("."):
        value = value[part]
    return value


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(f"{x:.4g}" for x in value) if 0 < len(value) < 3 else str(len(value))
    return "-" if value is None else f"{value:.4g}"
