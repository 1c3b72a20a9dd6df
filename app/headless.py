"""A run without a screen: one scenario as fast as it goes, and what it leaves in a folder."""

import platform
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app import metrics, output, settings
from app.interrupt import Interrupt
from app.record.folder import METRICS, SESSION, EventLog, write_json
from app.record.signals import Columns
from app.record.spool import ROWS, Spool, done, gather
from app.record.tape import TapeTable
from hrc.cell import pace, scenario
from hrc.cell.cell import Cell
from hrc.cell.run import Inbox, Observer, run
from hrc.config import Config
from hrc.errors import HrcError
from hrc.parameters import keys
from hrc.vision.kernels import check_device

if TYPE_CHECKING:
    from app.record.recorder import Depth, Recorder

MAX_DURATION = 24 * 3600.0
"""Longest run [s of simulated time]."""
_SLICE = 0.1
"""Simulated time [s] between two looks at Ctrl-C and the progress bar."""


@dataclass(frozen=True)
class Job:
    """What to run and what to keep; the defaults of the command line."""

    scenario: str
    out: Path
    seed: int | None = None
    duration: float | None = None
    settings: Sequence[str] = ()
    preset: str = "default"
    device: str = "cpu"
    depth: "Depth" = "sampled"
    record: bool = True
    overwrite: bool = False
    quiet: bool = False
    settings_file: Path | None = None


@dataclass
class _Clock:
    """Wall times of the phases [s]."""

    started: float = field(default_factory=time.perf_counter)
    laps: dict[str, float] = field(default_factory=dict)

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = now - self.started
        self.started = now


def execute(job: Job) -> dict[str, Any]:
    """Run, write the output folder, and return the metrics.

    Raises HrcError before anything is written if the scenario, a setting, the device or the folder is refused. After
    Ctrl-C the folder holds the part that was run, and the metrics say `interrupted`. A kill leaves that to `recover`.
    """
    clock = _Clock()
    script = scenario.load(job.scenario)
    config = settings.configured(job.preset, script, job.settings, job.seed, job.settings_file)
    end = _end(job, script, config.rates.base_hz)
    output.check(job.out, overwrite=job.overwrite)
    check_device(job.device)
    _say(job, "building the cell (the very first time its kernels compile, about 5 s) ...")
    cell = Cell(config, job.device)
    about = {"scenario": script.name, "preset": job.preset, "seed": config.seed, "device": job.device, **versions()}
    tape = TapeTable()
    with output.folder(job.out, overwrite=job.overwrite) as folder:
        spool = Spool(folder, config, about)
        recording = recorder(folder / SESSION, cell, about, job.depth) if job.record else None
        observers: list[Observer] = [spool, tape, *([recording] if recording else [])]
        clock.lap("set_up")
        try:
            interrupted = _drive(job, cell, Inbox(script, config.rates.base_hz), observers, end)
        finally:
            problem = _close(recording)
            spool.close()
        clock.lap("run")
        columns = gather(folder)
        figures = {**about, "simulated_s": cell.tick / config.rates.base_hz, "interrupted": interrupted,
                   "recording_problem": problem, **metrics.compute(columns),
                   "counts": _counts(cell, len(columns["tick"]), spool.log, recording),
                   "refused": spool.log.refusals()}
        tape.write(folder)
        _draw(folder, script.name, columns, config)
        clock.lap("write")
        figures["wall_s"] = clock.laps
        figures["real_time_factor"] = figures["simulated_s"] / clock.laps["run"]
        figures["sizes_bytes"] = {path.name: path.stat().st_size for path in sorted(folder.iterdir()) if path.name != ROWS}
        write_json(folder / METRICS, figures)
        done(folder)
    return figures


def printed(figures: Mapping[str, Any], out: Path) -> Iterator[str]:
    """The metrics of a run in lines, for who has waited for it."""
    sizes = figures["sizes_bytes"]
    for start, end, mode in figures["states"]:
        yield f"{start:8.3f} to {end:8.3f} s  {mode}"
    for reason in figures["refused"]:
        yield f"refused: {reason}"
    if figures["interrupted"]:
        yield f"interrupted after {figures['simulated_s']:.1f} s; the folder holds that part"
    recording = f", session.rrd {sizes['session.rrd'] / 1e6:.1f} MB" if "session.rrd" in sizes else ""
    yield (f"{out}: {sum(sizes.values()) / 1e6:.1f} MB{recording}; {figures['simulated_s']:.1f} s simulated "
           f"at {figures['real_time_factor']:.2f} x real time")


def _end(job: Job, script: scenario.Scenario, base_hz: int) -> int:
    duration = script.duration if job.duration is None else job.duration
    if not 1.0 / base_hz <= duration <= MAX_DURATION:
        raise HrcError(f"the duration must be {1.0 / base_hz:g} to {MAX_DURATION:g} s, not {duration!r}")
    return round(duration * base_hz)


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    found = {"python": platform.python_version()}
    for name in ("elbowroom", "numpy", "mujoco", "pin", "warp-lang", "rerun-sdk"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def recorder(path: Path, cell: Cell, about: dict[str, Any], depth: "Depth") -> "Recorder":
    """Of a session into session.rrd; the run waits for it. about: goes into the file."""
    from app.record.recorder import Recorder  # here, because rerun takes half a second and is an extra
    from hrc.cell.eyes import rig
    from hrc.vision.camera import Camera

    config = cell.config
    cameras = {setup.name: Camera(setup.camera) for setup in rig(config, cell.scene)}
    return Recorder(path, base_hz=config.rates.base_hz, scene=cell.scene, cameras=cameras,
                    parameters=keys(config), about=about, depth=depth, wait=True)


def _close(recorder: "Recorder | None") -> str:
    """Finish the recording. A lost one must not cost the rest of the results: the problem goes into the metrics."""
    try:
        if recorder:
            recorder.close()
    except HrcError as error:
        return str(error)
    return ""


def _drive(job: Job, cell: Cell, inbox: Inbox, observers: list[Observer], end: int) -> bool:
    """Step the cell until its tick is `end`. Returns whether Ctrl-C came first."""
    from tqdm import tqdm

    base_hz, interrupt = cell.config.rates.base_hz, Interrupt()
    hidden = job.quiet or not sys.stderr.isatty()
    with interrupt.listening(), tqdm(total=end / base_hz, disable=hidden, desc=job.scenario,
                                     bar_format="{desc} {bar} {n:.1f}/{total:.1f} s simulated, {elapsed}") as bar:
        while cell.tick < end and not interrupt.set:
            before = cell.tick
            run(cell, pace.FreeRun(), inbox, observers, until=min(end, before + round(_SLICE * base_hz)))
            bar.update((cell.tick - before) / base_hz)
    return interrupt.set


def _counts(cell: Cell, rows: int, log: EventLog, recorder: "Recorder | None") -> dict[str, int]:
    counts = {"ticks": cell.tick, "control_ticks": rows, "events": log.taken, "refused": log.refused}
    if recorder:
        counts |= {"depth_images": recorder.images_kept, "depth_images_dropped": recorder.images_dropped}
    return counts


def _draw(folder: Path, name: str, columns: Columns, config: Config) -> None:
    from app.report import figure

    figure(folder / ("figure5.png" if name == "paper" else "figure.png"), columns, F_relax=config.control.f_relax,
           F_abort=config.control.f_abort, title=f"{name}, seed {config.seed}")


def _say(job: Job, text: str) -> None:
    if not job.quiet:
        print(text, file=sys.stderr)
