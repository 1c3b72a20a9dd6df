"""Contacts in recorded depth images: the eye alone, without cell or controller, over a folder of files."""

import csv
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from app.depth_folder import DepthFolder, Shot, read
from app.output import OutputError
from app.settings import configured, parse
from hrc import meshes
from hrc.errors import ConfigError, SensorError
from hrc.messages import LINKS, DepthFrame, Nearest
from hrc.model import Dynamics, load_spec, pinocchio_model
from hrc.scene import load_scene
from hrc.vision.camera_file import CalibratedCamera
from hrc.vision.environment import Environment, learned_environment
from hrc.vision.localize import Localizer, VisionConfig
from hrc.vision.render import Renderer

COLUMNS = ("file", "time", "touch", "link", "x", "y", "z", "distance", "sure")


@dataclass(frozen=True)
class Job:
    """What to look at and where the result goes; the defaults of the command line."""

    folder: Path
    out: Path | None = None
    settings: Sequence[str] = ()
    device: str = "cpu"
    overwrite: bool = False


@dataclass(frozen=True)
class Found:
    """One place in one image. touch: 1, 2, ... for separate touches; 0 for the nearest place of an image without any."""

    shot: Shot
    touch: int
    nearest: Nearest | None

    def row(self) -> tuple[Any, ...]:
        """As in `COLUMNS`: time [s], point in the world [m], distance [m]; empty where nothing is within reach."""
        n = self.nearest
        where = ("",) * 6 if n is None else (LINKS[n.link], *(round(float(p), 5) for p in n.p_world), round(n.distance, 5),
                                            int(n.sure))
        return (self.shot.path.name, self.shot.time, self.touch, *where)

    def __str__(self) -> str:
        head = f"{self.shot.path.name:<16} {self.shot.time:10.3f} s  "
        if (n := self.nearest) is None:
            return head + "nothing within reach"
        x, y, z = n.p_world
        kind = f"touch {self.touch}" if self.touch else "near"
        return (f"{head}{kind:<8} {LINKS[n.link]}  {x:+.3f} {y:+.3f} {z:+.3f} m  distance {n.distance:.3f} m"
                + ("" if n.sure else "  not sure"))


def execute(job: Job) -> None:
    """Print what is found in each image, and write it as a table.

    Raises HrcError if folder, settings, device or output file are refused, or if no image at all could be used; one that
    cannot be used is named on stderr and left out.
    """
    folder, vision = read(job.folder), _vision(job.settings)
    if job.out and job.out.exists() and not job.overwrite:
        raise OutputError(f"{job.out} exists; choose another file, or replace it with --overwrite")
    robot = Dynamics(pinocchio_model(load_spec().compile(), armature=False))
    localizer = Localizer(folder.camera.camera, _environment(folder, robot, vision, job.device), vision, job.device)
    if job.out is None:
        return _report(folder, localizer, robot, None)
    try:
        with job.out.open("w", newline="", encoding="utf-8") as table:
            return _report(folder, localizer, robot, table)
    except OSError as error:
        raise OutputError(f"cannot write {job.out}: {error.strerror}") from None


def _report(folder: DepthFolder, localizer: Localizer, robot: Dynamics, table: TextIO | None) -> None:
    writer = csv.writer(table) if table else None
    if writer:
        writer.writerow(COLUMNS)
    for found in look(folder.camera, folder.shots, localizer, robot):
        print(found)
        if writer:
            writer.writerow(found.row())


def look(camera: CalibratedCamera, shots: Sequence[Shot], localizer: Localizer, robot: Dynamics) -> Iterator[Found]:
    """What is found in each image that can be used: its touches, or else the nearest place.

    Raises SensorError at the end if there was none to use.
    """
    for shot, frame in _frames(camera, shots):
        T_world_link = robot.kinematics(shot.q)[0]
        localizer.filter(frame, T_world_link)
        nearest = localizer.localize(frame.tick, T_world_link)
        touches = localizer.touches()
        for number, touch in enumerate(touches, 1):
            yield Found(shot, number, touch)
        if not touches:
            yield Found(shot, 0, nearest[0] if nearest else None)


def _frames(camera: CalibratedCamera, shots: Sequence[Shot]) -> Iterator[tuple[Shot, DepthFrame]]:
    """The images that can be used; its place in the order is a frame's tick."""
    used = 0
    for tick, shot in enumerate(shots):
        try:
            frame = shot.frame(tick, camera)
        except SensorError as error:
            print(f"elbowroom: {shot.path} is left out: {error}", file=sys.stderr)
            continue
        used += 1
        yield shot, frame
    if not used:
        raise SensorError(f"none of the {len(shots)} images in {shots[0].path.parent} could be used")


def _environment(folder: DepthFolder, robot: Dynamics, vision: VisionConfig, device: str) -> Environment:
    """Learned from images of the empty cell if there are any; else boxes: the folder's own, or those of the project's cell."""
    if not folder.empty:
        if folder.scene is None:
            print("elbowroom: table, floor and wall are taken to be those of the simulated cell; put images of the real one, "
                  "empty, into the folder empty/, or its boxes into scene.toml", file=sys.stderr)
        return load_scene(folder.scene or "cell").environment
    shots, frames = zip(*_frames(folder.camera, folder.empty), strict=True)
    if not folder.robot_in_empty:
        return learned_environment(frames)
    renderer = Renderer(folder.camera.camera, meshes.robot("filter"), device)
    renderer.expand(vision.margin)
    return learned_environment(frames, [renderer.render(robot.kinematics(shot.q)[0]) for shot in shots])


def _vision(settings: Sequence[str]) -> VisionConfig:
    for key, _ in map(parse, settings):
        if not key.startswith("vision."):
            raise ConfigError(f"{key} has no effect on recorded images; the parameters of the eye are vision.*")
    return configured(settings=settings).vision
