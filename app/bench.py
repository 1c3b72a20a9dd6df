"""How long the eye takes, beside what one would write without it, on the same frames in the same run."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from hrc import meshes
from hrc.config import Config
from hrc.geometry import Array, transform
from hrc.messages import Body, DepthFrame, RobotImage
from hrc.model import Dynamics, load_spec, pinocchio_model
from hrc.scene import load_scene
from hrc.sim.depth_camera import DepthCamera
from hrc.vision import kernels, reference
from hrc.vision.camera import Camera
from hrc.vision.localize import Localizer
from hrc.vision.render import Renderer, environment_depth

ROUNDS = 12
"""How often the frames are run through; the first round only warms up."""


@dataclass(frozen=True)
class Row:
    """One line of the table: times [ms], how many times slower than the cycle of the default mode, and a remark."""

    name: str
    median_ms: float
    p90_ms: float
    ratio: float | None = None
    remark: str = ""


@dataclass(frozen=True)
class Scene:
    """What is measured on: distinct frames of a moving arm and two moving obstacles."""

    camera: Camera
    eye: DepthCamera
    environment: Sequence[Any]
    frames: list[DepthFrame]
    T_world_link: list[Array]
    bodies: list[tuple[Body, ...]]


def bench_perception(frames: int = 24, device: str = "cpu") -> list[Row]:
    """Median times on one core. Raises DeviceError if there is no such device.

    A cycle is `filter` and `localize`: vertices, true and expanded raster, filter, distances, contact point and its
    back-projection, with all copies. The alternatives get both virtual images for nothing and do the rest.
    """
    config = Config()
    kernels.warm(device)
    with _one_core():
        scene = _scene(config, frames, device)
        localizer = Localizer(scene.camera, scene.environment, config.vision, device)
        rows, cycle = [], 0.0
        for mode in ("interval", "paper"):
            vision = config.vision.replace(mode=mode)
            localizer.configure(vision)
            filtering, localizing, error = _measure(localizer, scene, device)
            total = filtering + localizing
            cycle = cycle or float(np.median(total))
            rows += [_row(f"{mode}: cycle", total, cycle, f"max |d - brute force| {error:.1e} m"),
                     _row("  filter", filtering), _row("  localize", localizing)]
        localizer.configure(config.vision)
        rows += _alternatives(localizer, scene, cycle)
        expose = [_timed(lambda k=k: scene.eye.expose(k, scene.T_world_link[k], scene.bodies[k]))
                  for k in range(frames) for _ in range(2)]
        rows.append(_row("simulated camera: one frame", np.array(expose)))
    return rows


def bench(device: str = "cpu") -> None:
    """Print the table of `bench_perception`."""
    rows = bench_perception(device=device)
    print(f"perception on {device}, one core, 24 distinct frames of {Camera().shape[1]} x {Camera().shape[0]}\n")
    print(f"{'':44} {'median ms':>10} {'p90 ms':>9} {'ratio':>8}")
    for row in rows:
        ratio = "" if row.ratio is None else f"{row.ratio:7.1f}x"
        print(f"{row.name:44} {row.median_ms:10.3f} {row.p90_ms:9.3f} {ratio:>8}  {row.remark}")


def _scene(config: Config, frames: int, device: str) -> Scene:
    scene, camera = load_scene(), Camera(config.camera)
    dynamics = Dynamics(pinocchio_model(load_spec().compile(), armature=False))
    eye = DepthCamera(camera, scene.environment, scene.bodies, config.sensor, seed=config.seed, latency=0, device=device)
    spec = {body.name: body for body in scene.bodies}
    out = Scene(camera, eye, scene.environment, [], [], [])
    for k in range(frames):
        phase = 2 * np.pi * k / frames
        q = np.array([0.9, 0.6, 0.0, -1.3, 0.0, 0.6, 0.0]) + 0.3 * np.sin(phase + np.arange(7))
        T = np.asarray(dynamics.kinematics(q)[0])
        hand = T[5][:3, 3] + [0.04, 0.12 + 0.06 * np.sin(3 * phase), 0.05]
        slab = T[3][:3, 3] + [0.25, -0.25 - 0.1 * np.cos(2 * phase), 0.1]
        bodies = tuple(Body(n, spec[n].shape, spec[n].size, transform(np.eye(3), p))
                       for n, p in (("hand", hand), ("slab", slab)))
        eye.expose(k, T, bodies)
        frame = eye.latest(k)
        assert frame is not None
        out.frames.append(frame)
        out.T_world_link.append(T)
        out.bodies.append(bodies)
    return out


def _measure(localizer: Localizer, scene: Scene, device: str) -> tuple[Array, Array, float]:
    """Times of filter and localize [s] over all rounds, and the largest error of the distance map [m]."""
    config = localizer.config
    surface = Renderer(scene.camera, meshes.robot("filter" if config.mode == "paper" else "perception"), device)
    surface.expand(config.margin if config.mode == "paper" else 0.0)
    times, error = [], 0.0
    for i in range(ROUNDS):
        for frame, T in zip(scene.frames, scene.T_world_link, strict=True):
            first = _timed(lambda frame=frame, T=T: localizer.filter(frame, T))
            second = _timed(lambda frame=frame, T=T: localizer.localize(frame.tick, T))
            if i > 0:
                times.append((first, second))
                continue
            # With what is out of reach at the reach, a pixel that only one of the two finds counts as well.
            distances, brute = (np.minimum(d, config.reach) for d in
                                (localizer.distances(), _brute_force(localizer, surface.render(T))))
            error = max(error, float(np.abs(distances - brute).max()))
    filtering, localizing = np.array(times).T
    return filtering, localizing, error


def _brute_force(localizer: Localizer, robot: RobotImage) -> reference.Image:
    config = localizer.config
    assert localizer.foreground is not None
    candidates = np.where((robot.link >= config.first_link) & (robot.link < kernels.NO_LINK), robot.depth, np.inf)
    thickness = np.inf if config.mode == "paper" else config.thickness
    return reference.distance_map(localizer.camera, candidates, localizer.foreground.depth, config.reach, thickness)


def _alternatives(localizer: Localizer, scene: Scene, cycle: float) -> list[Row]:
    """Filter, distance and contact point in numpy, and with a k-d tree over the obstacle's points."""
    camera, config = scene.camera, localizer.config
    fixed = environment_depth(camera, scene.environment, config.environment_margin)
    expanded = Renderer(camera, meshes.robot("filter"))
    expanded.expand(config.margin)
    surface = Renderer(camera, meshes.robot("perception"))

    def filtered(frame: DepthFrame, cover: RobotImage) -> reference.Image:
        kept = reference.filtered(frame.depth, cover.depth, fixed)
        return reference.supported(frame.depth, kept, config.neighbours)

    def plain(frame: DepthFrame, cover: RobotImage, robot: RobotImage) -> None:
        depth = np.where(robot.link >= config.first_link, robot.depth, np.inf)
        distances = reference.distance_map(camera, depth, filtered(frame, cover), config.reach, config.thickness)
        reference.contact_point(camera, depth, robot.link, distances)

    def tree(frame: DepthFrame, cover: RobotImage, robot: RobotImage) -> None:
        from scipy.spatial import KDTree

        kept = filtered(frame, cover)
        (v, u), (ov, ou) = np.nonzero(np.isfinite(robot.depth)), np.nonzero(np.isfinite(kept))
        if len(ou):
            obstacle = KDTree(camera.unproject(ou, ov, kept[ov, ou]))
            distance, _ = obstacle.query(camera.unproject(u, v, robot.depth[v, u]), distance_upper_bound=config.reach)
            int(np.argmin(distance))

    ways: list[tuple[str, Callable[..., None], str]] = [
        ("numpy, brute force", plain, "the same rules"), ("numpy and a k-d tree of scipy", tree, "no occlusion rule")]
    rows = []
    for name, way, remark in ways:
        times = []
        for frame, T in list(zip(scene.frames, scene.T_world_link, strict=True))[::3]:
            images = expanded.render(T), surface.render(T)
            try:
                times.append(_timed(lambda frame=frame, images=images, way=way: way(frame, *images)))
            except ImportError as error:
                remark = f"not measured: {error}"
                break
        if times:
            rows.append(_row(name, np.array(times), cycle, remark + ", rendering not counted"))
    return rows


def _timed(call: Callable[[], Any]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def _row(name: str, seconds: Array, cycle: float | None = None, remark: str = "") -> Row:
    median = float(np.median(seconds))
    ratio = None if cycle is None else median / cycle
    return Row(name, 1e3 * median, 1e3 * float(np.percentile(seconds, 90)), ratio, remark)


@contextmanager
def _one_core() -> Iterator[None]:
    """Stay on one core, where the system lets a process choose."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
