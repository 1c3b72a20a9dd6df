"""Recordings of a running cell, one at a time, each in a folder of its own."""

import contextlib
import gc
import importlib
import re
import shutil
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app import output
from app.record.folder import SESSION, SKIPPED, EventLog
from app.record.recover import complete
from app.record.shelf import ArchiveError, Progress, Shelf
from app.record.spool import Spool
from hrc.cell.eyes import rig
from hrc.config import Config
from hrc.errors import HrcError
from hrc.events import Reset, SetParameter
from hrc.messages import Snapshot
from hrc.parameters import keys
from hrc.scene import load_scene
from hrc.vision.camera import Camera

if TYPE_CHECKING:
    from app.record.recorder import Depth

MOST_S = 3600.0
"""Simulated seconds of the longest recording [s]: its signals pass through memory at the end, 0.6 GB an hour."""


class _Unhurried:
    """Asked for each module that a thread loads, it lets the thread rest: four times as long as it has worked since."""

    def __init__(self) -> None:
        self._thread, self._worked = threading.get_ident(), time.thread_time()

    def find_spec(self, *_: object) -> None:
        """None: others shall find it."""
        if threading.get_ident() == self._thread:
            time.sleep(4.0 * (time.thread_time() - self._worked))
            self._worked = time.thread_time()


def load() -> None:
    """Load what the first recording needs, half a second of work, while a cell runs; without the extra, nothing happens.

    In small pieces, since the cell waits for the interpreter meanwhile; at one go, it lost 0.3 s. The collector waits, too:
    with all that a page has in memory, it would hold the cell up for 60 ms.
    """
    collects, unhurried = gc.isenabled(), _Unhurried()
    gc.disable()
    sys.meta_path.insert(0, unhurried)
    try:
        with contextlib.suppress(ModuleNotFoundError):
            importlib.import_module("app.record.recorder")
    finally:
        sys.meta_path.remove(unhurried)
        if collects:
            gc.enable()


class Recording:
    """One that is being made: the observer of its cell. problem: why it will not run again, if so."""

    def __init__(self, folder: Path, config: Config, about: Mapping[str, Any], depth: "Depth") -> None:
        """Raises RecordingError if the file cannot be written, OutputError if somebody else has the folder."""
        from app.record.recorder import Recorder  # here, because rerun takes half a second and is an extra

        self.folder, self.problem, self._rows = folder, "", 0
        self._config, self._about = config, about
        self._spool: Spool | None = None
        scene = load_scene(config.scene)
        cameras = {setup.name: Camera(setup.camera) for setup in rig(config, scene)}
        with contextlib.ExitStack() as own:
            own.enter_context(output.claimed(folder))
            self.recorder = Recorder(folder / SESSION, base_hz=config.rates.base_hz, scene=scene, cameras=cameras,
                                     parameters=keys(config), about=about, depth=depth, beside=self._keep, footer=False)
            self._own = own.pop_all()

    @property
    def seconds(self) -> float:
        """Simulated length so far [s]."""
        return self._rows / self._config.rates.control_hz

    @property
    def progress(self) -> Progress:
        """How far it has come."""
        return Progress(self.folder, self.seconds, self.recorder.bytes, self.recorder.images_dropped)

    def begin(self, before: EventLog, changed: Mapping[str, Any], cycles: int) -> None:
        """To be called before the first step. before: events of the cell; changed: parameters that they have set, by key;
        cycles: control ticks that it has taken.
        """
        self.recorder.begin(changed)
        self._spool = Spool(self.folder, self._config, {**self._about, SKIPPED: cycles}, before)

    def on_step(self, snapshot: Snapshot) -> None:
        """One step has been taken."""
        self._rows += snapshot.fresh_control
        self.recorder.on_step(snapshot)

    def finish(self) -> str:
        """Write what is left; the problem, if there was one."""
        problems = []
        try:
            self.recorder.close()
        except HrcError as error:
            problems.append(str(error))
        if self._spool is not None:
            self._try(self._spool.close)
        self._try(complete, self.folder, "; ".join(problems), {
            "depth_images": self.recorder.images_kept, "depth_images_dropped": self.recorder.images_dropped})
        self._own.close()
        return "; ".join([*problems, *filter(None, [self.problem])])

    def _keep(self, snapshot: Snapshot) -> None:
        if self._spool is not None and not self.problem:
            self._try(self._spool.on_step, snapshot)

    def _try(self, write: Callable[..., object], *args: object) -> None:
        try:
            write(*args)
        except (OSError, ValueError, HrcError) as error:
            self.problem = self.problem or f"what a replay needs could not be written: {error}"


class Archive(Shelf):
    """An observer of a cell, and of the next one in its place. root: folder of the recordings, made with the first."""

    def __init__(self, root: Path, device: str = "cpu") -> None:
        super().__init__(root)
        self._device = device
        self._lock = threading.Lock()  # a recording must not end in the middle of a step
        self._log, self._cycles = EventLog(), 0
        self._changed: dict[str, Any] = {}
        self._now: Recording | None = None
        self.over: Callable[[str], None] = lambda _: None
        """Told, on another thread, when a recording has ended by itself, and why."""

    @property
    def now(self) -> Progress | None:
        """The recording that is being made, which is not among the others yet."""
        return self._now.progress if self._now is not None else None

    def warm(self) -> None:
        """Load what the first recording needs, so that whoever asks for it need not wait."""
        load()

    def on_step(self, snapshot: Snapshot) -> None:
        """One step has been taken."""
        with self._lock:
            if snapshot.tick == 1 and not any(isinstance(event, Reset) for event in snapshot.events):  # another cell
                self._end("another cell has begun")
                self._log, self._cycles = EventLog(), 0
                self._changed.clear()
            for event in snapshot.events:
                if isinstance(event, SetParameter):
                    self._changed[event.key] = event.value
                elif isinstance(event, Reset):
                    self._changed.clear()
            resets = [i for i, event in enumerate(snapshot.events) if isinstance(event, Reset)]
            if resets and self._now is None:  # the cell is as at its start: nothing before it matters to a later recording
                self._log, self._cycles = EventLog(), 0
                self._log.on_step(replace(snapshot, events=snapshot.events[resets[-1] + 1 :]))
            else:
                self._log.on_step(snapshot)
            if (now := self._now) is not None:
                now.on_step(snapshot)
                if why := now.recorder.problem or now.problem:
                    self._end(why)
                elif now.seconds >= MOST_S:
                    self._end(f"it is {MOST_S / 3600:g} h long")
            self._cycles += snapshot.fresh_control

    def start(self, scenario: str, config: Config, about: Mapping[str, Any], depth: "Depth") -> str:
        """Record from the next step on; the name. Raises ArchiveError or RecordingError if that cannot be."""
        if self._now is not None:
            raise ArchiveError(f"{self._now.folder.name} is being recorded")
        folder = self._made(re.sub(r"[^\w-]+", "-", Path(scenario).stem)[:40] or "session")
        about = {"scenario": scenario, "seed": config.seed, "device": self._device, **about}
        try:
            made = Recording(folder, config, about, depth)
        except HrcError:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        with self._lock:
            made.begin(self._log, self._changed, self._cycles)
            self._now = made
        return folder.name

    def _made(self, stem: str) -> Path:
        """A new folder, named by the time; a second one of the same second gets a number."""
        folder = first = self.root / f"{stem}-{time.strftime('%Y%m%d-%H%M%S')}"
        number = 1
        try:
            self.root.mkdir(parents=True, exist_ok=True)  # a link that leads nowhere exists, too
            while True:
                try:
                    folder.mkdir()
                    return folder
                except FileExistsError:
                    number += 1
                    folder = first.with_name(f"{first.name}-{number}")
        except OSError as error:
            raise ArchiveError(f"cannot record to {folder}: {error.strerror}") from None

    def stop(self) -> str:
        """Finish the recording; the problem, if there was one. Raises ArchiveError if there is none."""
        with self._lock:
            now, self._now = self._now, None
        if now is None:
            raise ArchiveError("nothing is being recorded")
        return now.finish()

    def close(self) -> None:
        """Finish what is being recorded."""
        if self._now is not None:
            self.stop()

    def _end(self, why: str) -> None:
        now, self._now = self._now, None
        if now is not None:
            threading.Thread(target=self._say_over, args=(now, why), name="end of recording").start()

    def _say_over(self, now: Recording, why: str) -> None:
        problem = now.finish()
        self.over(f"recording {now.folder.name} has ended: {problem or why}")
