"""The recorder: an observer of snapshots that never holds the loop up.

The loop hands over references; a worker thread takes what it needs out of them, encodes and writes it. When the worker falls
behind, depth images are dropped and counted; signals, events and transitions never are.
"""

import contextlib
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from app import output
from app.record.repair import RepairError, repair
from app.record.signals import AT, WIDTH, row
from app.record.writer import SessionWriter
from hrc.errors import HrcError, unknown
from hrc.events import Reset, SetParameter, to_dict
from hrc.messages import Body, Clearance, DepthFrame, Mode, Nearest, RobotImage, Snapshot
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
_STEPS = 500
"""Steps that may wait for the worker with all that they hold; the images of later ones are let go, for they are large."""
_PERIOD = 0.05
"""The worker looks for work this often [s]: to wake it would cost the loop more than to leave it a note."""
RESERVE = 500_000_000
"""Bytes of disk below which the recording ends, while a footer still fits. The SDK itself would fail silently."""
FULL, LEAST = 1_000_000, 4_000_000
"""Bytes of disk below which a failure to write is one of room, and that any recording leaves free: where there is no room for
what is on its way, the SDK may wait for ever.
"""
ROTATE_S = 600.0
"""Simulated seconds [s] after which a recording goes on in another file: the viewer opens a finished one at once."""


class RecordingError(HrcError):
    """A session cannot be recorded."""


@dataclass(frozen=True, slots=True)
class _Image:
    camera: str
    tick: int
    frame: DepthFrame
    robot: RobotImage


class _Block:
    """What is gathered between two deliveries; fresh arrays each time, for the SDK keeps references."""

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
        self.places: list[tuple[int, str, Any]] = []


class Recorder:
    """Writes `path` (.rrd) while it observes a run; call `close`, or use it as a context manager.

    Its clock counts on where a Reset sets the cell's back to 0. After ROTATE_S it goes on in NAME_2.rrd, and so on.

    cameras: by name. depth: which depth images to keep. base_hz: ticks a second. wait: let the loop wait for the worker rather
    than drop depth images, for runs without a wall clock. reserve: bytes of disk that stay free. beside: told of every step,
    too, on the worker's thread. footer: end the file with an index, for which the SDK keeps 7 kB of memory for every chunk, or
    1 to 2 MB for every second: not for what has no end.
    Raises RecordingError if the file exists, as while another recorder writes it, or cannot be written.
    """

    def __init__(self, path: Path, *, base_hz: int, scene: Scene, cameras: Mapping[str, Camera],
                 parameters: Mapping[str, Any], about: Mapping[str, Any], depth: Depth = "sampled", wait: bool = False,
                 reserve: int = RESERVE, rotate: float = ROTATE_S, beside: Callable[[Snapshot], None] | None = None,
                 footer: bool = True) -> None:
        if depth not in get_args(Depth):
            raise RecordingError(unknown("choice of depth", depth, get_args(Depth)))
        self.paths, self._beside, self._all = [path.resolve()], beside, True  # all: the first one, in any case
        self._reserve, self._rotate = max(reserve, LEAST), round(rotate * base_hz)
        self._clock = _Clock()
        self._begun = -1
        self._seen = time.perf_counter()
        self._depth, self._wait = depth, wait
        self._image_gap = 1 if depth == "full" else base_hz // SAMPLED_HZ
        self._next_image = dict.fromkeys(cameras, 0)
        self._silent: dict[str, bool] = {}
        self._home = {name: camera.T_world_camera for name, camera in cameras.items()}
        self._stand = dict(self._home)
        self._mode: Mode | None = None
        self._block = _Block()
        self._control_ticks = 0
        self.images_kept = self.images_dropped = 0
        self.stopped = ""
        """Why the recording ended before the run did."""
        self._queue: deque[tuple[int, Snapshot, float, tuple[_Image, ...]]] = deque()
        self._images_in = self._images_out = 0
        """Images handed to the worker, and done with by it: each is counted by one thread alone."""
        self._wake, self._closing, self._over = threading.Event(), False, False
        self._failure: Exception | None = None
        self._own = contextlib.ExitStack()
        """Locks on the files, which a repair would cut."""
        self._claim(path)
        try:
            self._writer = SessionWriter(path, tick_ns=1_000_000_000 // base_hz, scene=scene, cameras=cameras,
                                         parameters=parameters, about=about, footer=footer)
        except (OSError, RuntimeError) as error:
            self._own.close()
            raise RecordingError(f"cannot record to {path}: {error}") from None
        self._worker = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._worker.start()

    def begin(self, changed: Mapping[str, Any]) -> None:
        """To be called before the first step of a session that goes on: parameters that are other than at its start, by key."""
        for key, value in changed.items():
            self._writer.set(key, value)

    def on_step(self, snapshot: Snapshot) -> None:
        """Take what this tick brought."""
        if self._over:  # nobody would take it from the queue
            return
        tick = self._clock.at(snapshot)
        if not (snapshot.fresh_control or snapshot.fresh_frame or snapshot.events or snapshot.refused or self._all):
            return  # four steps of five bring nothing that is kept
        self._all = self._beside is not None
        images = self._admitted(snapshot) if snapshot.fresh_frame and self._depth != "none" else ()
        if len(self._queue) >= _STEPS:
            if self._wait:
                self._until(lambda: len(self._queue) < _STEPS)
            else:
                snapshot = replace(snapshot, views=tuple(
                    replace(view, frame=None, foreground=None, robot_image=None) for view in snapshot.views))
        self._queue.append((tick, snapshot, time.perf_counter(), images))

    def close(self) -> None:
        """Write what is left and finish the file. Raises RecordingError if anything of the session was lost."""
        self._closing = True
        self._wake.set()
        self._worker.join()
        if not self.stopped:
            self._finish()
        self._own.close()
        if self.stopped:
            raise RecordingError(f"the recording ends early: {self.stopped}")
        if self._failure:
            raise RecordingError(self.problem) from self._failure

    @property
    def problem(self) -> str:
        """Why nothing more is recorded; empty while all is well."""
        return self.stopped or (f"the recording is not complete: {self._failure}" if self._failure else "")

    @property
    def bytes(self) -> int:
        """Size of all files so far."""
        return sum(path.stat().st_size for path in self.paths if path.exists())

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- on the loop's thread ---------------------------------------------------------------------------------------

    def _admitted(self, snapshot: Snapshot) -> tuple[_Image, ...]:
        """The images of this step to be kept."""
        images = []
        for view in snapshot.views:
            camera, frame, robot = view.camera, view.frame, view.robot_image
            if frame is None or robot is None:
                continue
            tick = frame.tick + self._clock.offset
            if tick < self._next_image[camera]:
                continue
            if self._wait:
                self._until(lambda: self._images_in - self._images_out < _IMAGES)
            elif self._images_in - self._images_out >= _IMAGES:
                self.images_dropped += 1
                self._next_image[camera] = tick + 1
                continue
            # The first frame in each gap, so that the mean rate is exact whatever the camera's.
            self._next_image[camera] = (tick // self._image_gap + 1) * self._image_gap
            self._images_in += 1
            images.append(_Image(camera, tick, frame, robot))
        return tuple(images)

    def _until(self, there_is_room: Callable[[], bool]) -> None:
        while not there_is_room() and not self._over:
            self._wake.set()
            time.sleep(0.0005)

    # -- on the worker's thread -------------------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            self._take_all()
        except Exception as error:
            self._failure = self._failure or error
        finally:
            self._over = True

    def _take_all(self) -> None:
        closing = False
        while not closing:
            self._wake.wait(_PERIOD)
            self._wake.clear()
            closing = self._closing  # no step comes after it
            while self._queue:
                tick, snapshot, seen, images = self._queue.popleft()
                self._guarded(self._take, tick, snapshot, seen)
                for image in images:
                    self._guarded(self._write_image, image)
                    self._images_out += 1  # whatever became of it: the loop may be waiting for its place
                try:
                    if self._beside is not None:
                        self._beside(snapshot)
                except Exception as error:
                    self._failure = self._failure or error
        self._guarded(self._deliver)

    def _guarded(self, job: Callable[..., None], *args: Any) -> None:
        if self._failure or self.stopped:
            return
        try:
            job(*args)
        except (OSError, RuntimeError, ValueError) as error:
            self._cut_off(str(error))
        except Exception as error:  # kept, and raised by close(): a broken recording must not end the run
            self._failure = error

    def _take(self, tick: int, snapshot: Snapshot, seen: float) -> None:
        if self._begun < 0:
            self._begun = tick
        for event in snapshot.events:
            self._writer.event(tick, _text(event))
            if isinstance(event, (SetParameter, Reset)):
                self._deliver()  # the rows until now belong to the value before
                self._writer.set(*((event.key, event.value) if isinstance(event, SetParameter) else ("", None)))
        for event, reason in snapshot.refused:
            self._writer.event(tick, _text(event), refused=reason)
        if snapshot.command.mode is not self._mode:
            self._mode = snapshot.command.mode
            self._writer.mode(tick, self._mode, snapshot.command.reason)
        if snapshot.fresh_control:
            self._take_row(snapshot, tick, seen)
        for view in snapshot.views:
            if view.silent is not self._silent.get(view.camera):
                self._silent[view.camera] = view.silent
                self._writer.camera(tick, view.camera, silent=view.silent)
            T = self._home[view.camera] if view.T_world_camera is None else view.T_world_camera
            if T is not self._stand[view.camera]:
                self._stand[view.camera] = T
                frame = None if view.silent else view.frame  # with one, the pose is that at its exposure
                since = tick if frame is None else tick - snapshot.tick + frame.tick
                self._block.places.append((since, view.camera, T))

    def _take_row(self, snapshot: Snapshot, tick: int, seen: float) -> None:
        block = self._block
        block.rows[block.n] = row(snapshot)
        block.rows[block.n, AT["tick"]] = tick
        block.periods[block.n], self._seen = seen - self._seen, seen
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

    def _deliver(self) -> None:
        if self._block.n:  # without a row, what else is in it waits for the next
            block, self._block = self._block, _Block()
            self._write_block(block)

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
        for place in block.places:
            self._writer.place(*place)
        self._writer.flush()  # a full disk is known by this alone

    def _go_on_in_another_file(self, tick: int) -> None:
        first = self.paths[0]
        path = first.with_name(f"{first.stem}_{len(self.paths) + 1}{first.suffix}")
        with self._own.pop_all():  # the file before is whole then, and nobody's
            self._claim(path)
            self.paths.append(path)
            self._writer.turn_over(path, tick)

    def _claim(self, path: Path) -> None:
        try:
            path.touch(exist_ok=False)
            self._own.enter_context(output.claimed(path))
        except FileExistsError:
            raise RecordingError(f"{path} exists; it may be another recorder's, so choose another name") from None
        except OSError as error:
            raise RecordingError(f"cannot record to {path}: {error.strerror}") from None

    def _finish(self) -> None:
        try:
            self._writer.flush()
            self._writer.close()
        except (OSError, RuntimeError, ValueError) as error:
            self._cut_off(str(error))

    def _cut_off(self, why: str) -> None:
        """The disk is full, or gone: end here, with a file that opens."""
        if not self.stopped:
            self.stopped = "the disk is full" if self._is_full() else why
        with contextlib.suppress(OSError, RuntimeError, ValueError):
            self._writer.close()
        with contextlib.suppress(RepairError):  # not even its beginning is there
            repair(self.paths[-1])

    def _is_full(self) -> bool:
        try:
            return shutil.disk_usage(self.paths[0].parent).free < FULL
        except OSError:  # it is gone
            return False

    def _write_image(self, image: _Image) -> None:
        self._writer.image(image.camera, image.tick, image.frame.depth, image.robot.link)
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


def _text(event: Any) -> str:
    values = to_dict(event)
    return f"{values.pop('type')} " + " ".join(f"{key}={value}" for key, value in values.items() if value is not None)
