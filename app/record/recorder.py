"""The recorder: an observer of snapshots that never holds the loop up.

The loop copies numbers into blocks; a worker thread encodes and writes them. When the worker falls behind, depth images
are dropped and counted; signals, events and transitions never are.
"""

import contextlib
import queue
import shutil
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from app.record.repair import RepairError, repair
from app.record.signals import AT, WIDTH, row
from app.record.writer import SessionWriter
from hrc.errors import HrcError, unknown
from hrc.events import Reset, SetParameter, to_dict
from hrc.messages import Body, Clearance, DepthFrame, Mode, Nearest, RobotImage, Snapshot, View
from hrc.scene import Scene
from hrc.vision.camera import Camera

Depth = Literal["none", "sampled", "full"]
SAMPLED_HZ = 5
"""Depth images a second that a sampled recording keeps of each camera."""
_BLOCK = 50
"""Rows a block: a quarter of a second of signals, which a crash may cost."""
_POSE_EVERY = 4
"""Poses are kept at every fourth control tick (50 Hz)."""
_IMAGES = 8
"""Depth images that may wait for the worker."""
RESERVE = 500_000_000
"""Bytes of disk below which the recording ends, while a footer still fits. The SDK itself would fail silently."""
FULL = 1_000_000
"""Bytes of disk below which a failure to write is one of room."""
ROTATE_S = 600.0
"""Simulated seconds [s] after which a recording goes on in another file: the viewer opens a finished one at once."""


class RecordingError(HrcError):
    """A session cannot be recorded."""


class _Block:
    """What the loop gathers between two deliveries; fresh arrays each time, for the SDK keeps references."""

    def __init__(self) -> None:
        self.rows = np.empty((_BLOCK, WIDTH))
        self.periods = np.empty(_BLOCK)
        self.n = 0
        self.pose_ticks: list[int] = []
        self.poses: list[Any] = []
        self.nearest: list[Any] = []
        self.pulls: list[Any] = []
        self.bodies: list[tuple[Body, ...]] = []
        self.clearances: list[tuple[Clearance, ...]] = []
        self.touches: list[tuple[Nearest, ...]] = []


class Recorder:
    """Writes `path` (.rrd) while it observes a run; call `close`, or use it as a context manager.

    Its clock counts on where a Reset sets the cell's back to 0. After ROTATE_S it goes on in NAME_2.rrd, and so on.

    cameras: by name. depth: which depth images to keep. base_hz: ticks a second. wait: let the loop wait for the worker rather
    than drop depth images, for runs without a wall clock. reserve: bytes of disk that stay free.
    Raises RecordingError if the file exists, as while another recorder writes it, or cannot be written.
    """

    def __init__(self, path: Path, *, base_hz: int, scene: Scene, cameras: Mapping[str, Camera],
                 parameters: Mapping[str, Any], about: Mapping[str, Any], depth: Depth = "sampled", wait: bool = False,
                 reserve: int = RESERVE, rotate: float = ROTATE_S) -> None:
        if depth not in get_args(Depth):
            raise RecordingError(unknown("choice of depth", depth, get_args(Depth)))
        self.paths = [path.resolve()]
        self._reserve, self._rotate = reserve, round(rotate * base_hz)
        self._clock = _Clock()
        self._begun = -1
        self._seen = time.perf_counter()
        self._depth, self._wait = depth, wait
        self._image_gap = 1 if depth == "full" else base_hz // SAMPLED_HZ
        self._next_image = dict.fromkeys(cameras, 0)
        self._silent: dict[str, bool] = {}
        self._mode: Mode | None = None
        self._block = _Block()
        self._control_ticks = 0
        self.images_kept = self.images_dropped = 0
        self.stopped = ""
        """Why the recording ended before the run did."""
        self._images = threading.BoundedSemaphore(_IMAGES)
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._failure: Exception | None = None
        _claim(path)
        try:
            self._writer = SessionWriter(path, tick_ns=1_000_000_000 // base_hz, scene=scene, cameras=cameras,
                                         parameters=parameters, about=about)
        except (OSError, RuntimeError) as error:
            raise RecordingError(f"cannot record to {path}: {error}") from None
        self._worker = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._worker.start()

    def on_step(self, snapshot: Snapshot) -> None:
        """Take what this tick brought."""
        tick = self._clock.at(snapshot)
        if self._begun < 0:
            self._begun = tick
        for event in snapshot.events:
            self._put(self._writer.event, tick, _text(event))
            if isinstance(event, (SetParameter, Reset)):
                self._deliver()  # the rows until now belong to the value before
                change = (event.key, event.value) if isinstance(event, SetParameter) else ("", None)
                self._put(self._writer.set, *change)
        for event, reason in snapshot.refused:
            self._put(self._writer.event, tick, _text(event), refused=reason)
        if snapshot.command.mode is not self._mode:
            self._mode = snapshot.command.mode
            self._put(self._writer.mode, tick, self._mode, snapshot.command.reason)
        if snapshot.fresh_control:
            self._take_row(snapshot, tick)
        for view in snapshot.views:
            if view.silent is not self._silent.get(view.camera):
                self._silent[view.camera] = view.silent
                self._put(self._writer.camera, tick, view.camera, silent=view.silent)
            if snapshot.fresh_frame and self._depth != "none":
                self._take_image(view)

    def close(self) -> None:
        """Write what is left and finish the file. Raises RecordingError if anything of the session was lost."""
        self._deliver()
        self._jobs.put(None)
        self._worker.join()
        if not self.stopped:
            self._finish()
        if self.stopped:
            raise RecordingError(f"the recording ends early: {self.stopped}")
        if self._failure:
            raise RecordingError(f"the recording is not complete: {self._failure}") from self._failure

    @property
    def bytes(self) -> int:
        """Size of all files so far."""
        return sum(path.stat().st_size for path in self.paths if path.exists())

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _take_row(self, snapshot: Snapshot, tick: int) -> None:
        block = self._block
        block.rows[block.n] = row(snapshot)
        block.rows[block.n, AT["tick"]] = tick
        now = time.perf_counter()
        block.periods[block.n], self._seen = now - self._seen, now
        block.n += 1
        if self._control_ticks % _POSE_EVERY == 0:
            block.pose_ticks.append(tick)
            block.poses.append(snapshot.T_world_link)
            block.nearest.append(snapshot.nearest.p_world if snapshot.nearest else None)
            block.pulls.append(snapshot.pull)
            block.bodies.append(snapshot.bodies)
            block.clearances.append(snapshot.clearances)
            block.touches.append(snapshot.touches)
        self._control_ticks += 1
        if block.n == _BLOCK:
            self._deliver()

    def _take_image(self, view: View) -> None:
        camera, frame, robot = view.camera, view.frame, view.robot_image
        if frame is None or robot is None:
            return
        tick = frame.tick + self._clock.offset
        if tick < self._next_image[camera]:
            return
        if not self._images.acquire(blocking=self._wait):
            self.images_dropped += 1
            self._next_image[camera] = tick + 1
            return
        # The first frame in each gap, so that the mean rate is exact whatever the camera's.
        self._next_image[camera] = (tick // self._image_gap + 1) * self._image_gap
        self._jobs.put(lambda: self._release_after(camera, tick, frame, robot))

    def _deliver(self) -> None:
        block, self._block = self._block, _Block()
        if block.n:
            self._put(self._write_block, block)

    def _put(self, job: Callable[..., None], *args: Any, **options: Any) -> None:
        self._jobs.put(lambda: self._guarded(job, *args, **options))

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                job()
            except (OSError, RuntimeError, ValueError) as error:
                self._cut_off(str(error))
            except Exception as error:  # kept, and raised by close(): a broken recording must not end the run
                self._failure = self._failure or error

    def _guarded(self, job: Callable[..., None], *args: Any, **options: Any) -> None:
        if not (self._failure or self.stopped):
            job(*args, **options)

    def _write_block(self, block: _Block) -> None:
        if shutil.disk_usage(self.paths[0].parent).free < self._reserve:
            self.stopped = f"less than {self._reserve / 1e6:g} MB of disk are free"
            self._finish()
            return
        first = int(block.rows[0, AT["tick"]][0])
        if first - self._begun >= self._rotate * len(self.paths):
            self._go_on_in_another_file(first)
        self._writer.rows(block.rows[: block.n], block.periods[: block.n])
        if block.pose_ticks:
            self._writer.poses(block.pose_ticks, block.poses, block.nearest, block.pulls)
            self._writer.bodies(block.pose_ticks, block.bodies)
            self._writer.distances(block.pose_ticks, block.clearances, block.touches)
        self._writer.flush()  # a full disk is known by this alone

    def _go_on_in_another_file(self, tick: int) -> None:
        first = self.paths[0]
        path = first.with_name(f"{first.stem}_{len(self.paths) + 1}{first.suffix}")
        _claim(path)
        self.paths.append(path)
        self._writer.turn_over(path, tick)

    def _finish(self) -> None:
        try:
            self._writer.flush()
            self._writer.close()
        except (OSError, RuntimeError, ValueError) as error:
            self._cut_off(str(error))

    def _cut_off(self, why: str) -> None:
        """The disk is full, or gone: end here, with a file that opens."""
        if self.stopped:
            return
        self.stopped = "the disk is full" if shutil.disk_usage(self.paths[0].parent).free < FULL else why
        self._writer.close()
        with contextlib.suppress(RepairError):  # not even its beginning is there
            repair(self.paths[-1])

    def _release_after(self, camera: str, tick: int, frame: DepthFrame, robot: RobotImage) -> None:
        try:
            self._guarded(self._write_image, camera, tick, frame, robot)
        finally:  # whatever became of the image: the loop may be waiting for its place
            self._images.release()

    def _write_image(self, camera: str, tick: int, frame: DepthFrame, robot: RobotImage) -> None:
        self._writer.image(camera, tick, frame.depth, robot.link)
        self.images_kept += 1


class _Clock:
    """Ticks that go on where a Reset sets the cell's own back to 0. offset: to them, now."""

    def __init__(self) -> None:
        self.offset = self._last = 0

    def at(self, snapshot: Snapshot) -> int:
        """The tick of a step; each must be asked for in order."""
        if snapshot.tick <= self._last:
            self.offset += self._last
        self._last = snapshot.tick
        return snapshot.tick + self.offset


def _claim(path: Path) -> None:
    try:
        path.touch(exist_ok=False)
    except FileExistsError:
        raise RecordingError(f"{path} exists; it may be another recorder's, so choose another name") from None
    except OSError as error:
        raise RecordingError(f"cannot record to {path}: {error.strerror}") from None


def _text(event: Any) -> str:
    values = to_dict(event)
    return f"{values.pop('type')} " + " ".join(f"{key}={value}" for key, value in values.items() if value is not None)
