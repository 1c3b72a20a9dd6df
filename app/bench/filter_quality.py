"""How much of the robot the filter removes, and how much of an obstacle, also when pose and frame are not of one moment."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.bench.touches import OBSTACLES, Touch, poses, touches
from hrc import meshes
from hrc.config import Config
from hrc.geometry import Array
from hrc.messages import LINKS, DepthFrame
from hrc.model import joint_limits, load_spec
from hrc.scene import load_scene
from hrc.sim.depth_camera import DepthCamera, SensorConfig
from hrc.vision.camera import Camera
from hrc.vision.localize import Localizer
from hrc.vision.margin import margins
from hrc.vision.render import Renderer

MARGINS = (0.01, 0.02, 0.03, 0.04)
SKEWS = (0.0, 0.010, 0.033, 0.066)
"""The robot's pose is older than the frame by this [s]."""
SENSORS = (SensorConfig(), SensorConfig(extrinsic_rotation_deg=0.5, extrinsic_translation=0.01))
CAMERAS = 8
"""So many draws of noise and of the camera's misplacement."""


@dataclass(frozen=True)
class Quality:
    """One line of the table, over all frames. margin_mm: None for the default, base + |v| t for each link.

    fast: every joint at its limit, in a random direction; else at rest. recall: robot pixels removed over robot pixels.
    ghosts: share of the frames in which a pixel of the robot is left, not counting those at the obstacle's very edge, where the
    sensor mixes the two. loss: pixels of the touching obstacle that are
    removed, over all that the camera sees.
    """

    margin_mm: float | None
    fast: bool
    skew_ms: float
    extrinsic_deg: float
    extrinsic_mm: float
    recall: float
    ghosts: float
    loss: float


@dataclass(frozen=True, eq=False)
class _Shot:
    """A frame of a touch, and whether the robot (H, W) or the obstacle (H, W) was measured at each pixel."""

    touch: Touch
    dq: Array
    frame: DepthFrame
    robot: np.ndarray
    obstacle: np.ndarray


def bench_filter(each: int = 3, seed: int = 0, device: str = "cpu") -> list[Quality]:
    """Filter frames of the arm, each with an obstacle that touches it: `each` for each obstacle and class of view."""
    config, camera = Config(), Camera()
    eye = Localizer(camera, load_scene().environment, config.vision, device)
    contacts = touches(camera, each, seed)
    rows = []
    for sensor in SENSORS:
        shots = _shots(camera, contacts, sensor, seed, device)
        for fast in (False, True):
            for skew in SKEWS if fast else SKEWS[:1]:
                rows += [_quality(eye, shots, sensor, margin, fast, skew) for margin in (*MARGINS, None)]
    return rows


def print_filter(rows: Sequence[Quality]) -> None:
    """Print the table of `bench_filter`."""
    print(f"{'camera off by':<15}{'speed':<7}{'skew ms':>8}{'margin':>10}{'recall %':>10}{'ghosts %':>10}{'loss %':>8}")
    for r in rows:
        margin = "default" if r.margin_mm is None else f"{r.margin_mm:.0f} mm"
        off = f"{r.extrinsic_deg} deg {r.extrinsic_mm:.0f} mm"
        print(f"{off:<15}{'full' if r.fast else 'rest':<7}{r.skew_ms:>8.0f}{margin:>10}"
              f"{100 * r.recall:>10.2f}{100 * r.ghosts:>10.0f}{100 * r.loss:>8.1f}")


def _shots(camera: Camera, contacts: Sequence[Touch], sensor: SensorConfig, seed: int, device: str) -> list[_Shot]:
    rng, dq_max = np.random.default_rng(seed), joint_limits(load_spec().compile()).dq_max
    surfaces = [*meshes.robot("plant"), *(meshes.shape(b.shape, b.size) for b in OBSTACLES)]
    names = [b.name for b in OBSTACLES]
    cameras = [DepthCamera(camera, load_scene().environment, OBSTACLES, sensor, 1000 * seed + k, latency=0, device=device)
               for k in range(CAMERAS)]
    truths = [Renderer(source.true_camera, surfaces, device) for source in cameras]
    shots = []
    for i, touch in enumerate(contacts):
        source, bodies = cameras[i % CAMERAS], np.zeros((len(OBSTACLES), 4, 4))
        bodies[names.index(touch.obstacle.name)] = touch.T_world_body
        source.expose(i, touch.T_world_link, [touch.body])
        frame = source.latest(i)
        assert frame is not None
        drawn = truths[i % CAMERAS].render(np.concatenate([touch.T_world_link, bodies])).link
        measured = np.isfinite(frame.depth)
        shots.append(_Shot(touch, dq_max * rng.choice([-1.0, 1.0], 7), frame, measured & (drawn < len(LINKS)),
                           measured & (drawn >= len(LINKS)) & (drawn < len(surfaces))))
    return shots


def _quality(eye: Localizer, shots: Sequence[_Shot], sensor: SensorConfig, margin: float | None, fast: bool,
             skew: float) -> Quality:
    removed, robot, lost, obstacle, ghosts = 0, 0, 0, 0, 0
    for shot in shots:
        dq = shot.dq if fast else np.zeros(7)
        q = shot.touch.q - skew * dq
        T = poses(q)
        later, rest = poses(q + eye.config.skew * dq), eye.config.margin
        grown = margins(T, later, rest) if margin is None else np.full(len(LINKS), margin)
        eye.filter(shot.frame, T, grown)
        assert eye.foreground is not None
        left = np.isfinite(eye.foreground.depth)
        ghosts += bool((left & shot.robot & ~_near(shot.obstacle, 2)).any())
        removed, robot = removed + int((shot.robot & ~left).sum()), robot + int(shot.robot.sum())
        lost, obstacle = lost + int((shot.obstacle & ~left).sum()), obstacle + int(shot.obstacle.sum())
    return Quality(None if margin is None else 1e3 * margin, fast, 1e3 * skew, sensor.extrinsic_rotation_deg,
                   1e3 * sensor.extrinsic_translation, removed / robot, ghosts / len(shots), lost / obstacle)


def _near(mask: np.ndarray, pixels: int) -> np.ndarray:
    """The mask and so many pixels around it."""
    for axis in (0, 1):
        mask = np.any([np.roll(mask, shift, axis) for shift in range(-pixels, pixels + 1)], axis=0)
    return mask
