"""Beside the cell of a soak: counts its steps, and records them into files of which the newest stay."""

import threading
import time
from dataclasses import dataclass
from pathlib import Path

from app.endurance.health import Counted
from app.record.recorder import Recorder
from hrc.cell.eyes import rig
from hrc.config import Config
from hrc.errors import HrcError
from hrc.messages import Snapshot
from hrc.parameters import keys
from hrc.scene import load_scene
from hrc.vision.camera import Camera

KEPT = 3
"""Files of the recording that stay; older ones are deleted."""


@dataclass(frozen=True)
class Recorded:
    """What became of the recording. files: how many were begun. kept_bytes: of those that stay. trouble: if there was any."""

    files: int
    kept_bytes: int
    trouble: str


class Keeper:
    """A `Witness`."""

    def __init__(self, config: Config, scenario: str, folder: Path, rotate: float) -> None:
        """rotate: time that one file holds [s]. Raises RecordingError if none can be written."""
        scene = load_scene(config.scene)
        cameras = {setup.name: Camera(setup.camera) for setup in rig(config, scene)}
        self._recorder = Recorder(
            folder / "soak.rrd", base_hz=config.rates.base_hz, scene=scene, cameras=cameras, parameters=keys(config),
            about={"scenario": scenario, "seed": config.seed}, rotate=rotate, footer=False)
        self._lock = threading.Lock()  # the recording must not end in the middle of a step
        self._steps, self._over = 0, False

    def on_step(self, snapshot: Snapshot) -> None:
        """One more."""
        self._steps += 1
        with self._lock:
            if not self._over:
                self._recorder.on_step(snapshot)

    def counted(self) -> Counted:
        """What has come together so far."""
        self._prune()
        return Counted(time.monotonic(), self._steps, self._recorder.images_dropped)

    def finish(self) -> Recorded:
        """End the recording."""
        trouble = ""
        with self._lock:
            self._over = True
        try:
            self._recorder.close()
        except HrcError as error:
            trouble = str(error)
        self._prune()
        return Recorded(len(self._recorder.paths), self._recorder.bytes, trouble)

    def _prune(self) -> None:
        """Only the newest files stay."""
        for path in self._recorder.paths[:-KEPT]:
            path.unlink(missing_ok=True)
