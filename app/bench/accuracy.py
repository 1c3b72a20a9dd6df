"""How far the contact point is off, by viewing angle, obstacle and noise; and what is said of contacts that are not seen."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from app.bench import report
from app.bench.felt import FORCE, fuse
from app.bench.filter_quality import bench_filter, print_filter
from app.bench.touches import OBSTACLES, VIEWS, Touch, touches
from hrc.config import Config, paper
from hrc.messages import Nearest
from hrc.scene import load_scene
from hrc.sim.depth_camera import DepthCamera, SensorConfig
from hrc.vision.camera import Camera
from hrc.vision.localize import Localizer

PERFECT = SensorConfig(noise=0.0, flying=0.0, dropout=0.0, extrinsic_rotation_deg=0.0, extrinsic_translation=0.0)
CAMERAS = 8
"""So many draws of noise and of the camera's misplacement."""
CLEAR = 0.01
"""An obstacle nearer than this [m] to a second link counts in the rows "joint" and "all" alone."""
WRONG = 0.05
"""A point farther off than this [m] is wrong."""


@dataclass(frozen=True)
class Accuracy:
    """One line of the table: a mode, a sensor, an obstacle and a class of view; "all" means all of them.

    Modes paper and interval are vision alone; fused is interval with what the joints feel of a push of 20 N.

    found: contacts with any point within the tracker's reach. median_mm, p90_mm, right_link: of those found; sure_right_link:
    of those that are sure. flagged: share of all contacts that were not found or not sure; wrong: share of all whose point is
    over 5 cm off and sure.
    """

    mode: str
    noise: bool
    obstacle: str
    view: str
    contacts: int
    found: int
    median_mm: float | None
    p90_mm: float | None
    right_link: float | None
    sure_right_link: float | None
    flagged: float
    wrong: float


def bench_accuracy(number: int = 25, seed: int = 0, device: str = "cpu") -> list[Accuracy]:
    """Locate `number` contacts of each obstacle and class of view, in both modes, with and without sensor noise."""
    camera, config = Camera(), Config()
    contacts = touches(camera, number, seed)
    eye = Localizer(camera, load_scene().environment, config.vision, device)
    rows = []
    for noise in (False, True):
        for mode, vision in (("paper", paper().vision), ("interval", config.vision)):
            eye.configure(vision)
            seen = locate(eye, contacts, SensorConfig() if noise else PERFECT, seed, device)
            rows += _rows(mode, noise, contacts, [next(iter(near), None) for near in seen], config.tracker.reach)
        found = fuse(contacts, seen, config, seed, noise=noise)
        rows += _rows("fused", noise, contacts, found, config.tracker.reach)
    return rows


def locate(eye: Localizer, contacts: Sequence[Touch], sensor: SensorConfig, seed: int,
           device: str = "cpu") -> list[tuple[Nearest, ...]]:
    """What vision offers for each contact, the nearest first; a few cameras take turns, each misplaced in its own way."""
    cameras = [DepthCamera(eye.camera, load_scene().environment, OBSTACLES, sensor, 1000 * seed + k, latency=0, device=device)
               for k in range(CAMERAS)]
    found = []
    for i, contact in enumerate(contacts):
        source = cameras[i % CAMERAS]
        source.expose(i, contact.T_world_link, [contact.body])
        frame = source.latest(i)
        assert frame is not None
        eye.filter(frame, contact.T_world_link)
        found.append(eye.localize(i, contact.T_world_link))
    return found


def bench(device: str = "cpu", json: Path | None = None, quick: bool = False) -> None:
    """Print both tables, of the contact point and of the filter, and write them to a file with a plot beside it.

    Raises OutputError, before anything is measured, if the file cannot be written, and DeviceError if there is no such device.
    """
    if json is not None:
        report.check(json)
    number, each, seed = (3, 1, 0) if quick else (40, 3, 0)
    points, filters = bench_accuracy(number, seed, device), bench_filter(each, seed, device)
    print_accuracy(points)
    print()
    print_filter(filters)
    if json is not None:
        report.write(json, {"conditions": {"contacts_per_class": number, "seed": seed, "cameras": CAMERAS, "force_N": FORCE},
                            "contact_point": [asdict(row) for row in points], "filter": [asdict(row) for row in filters]})
        plot_accuracy(points, json.with_suffix(".png"))


def print_accuracy(rows: Sequence[Accuracy]) -> None:
    """Print the table of `bench_accuracy`."""
    print(f"{'mode':<9}{'noise':<7}{'obstacle':<9}{'view':<9}{'contacts':>8}{'found':>6}{'median mm':>10}{'p90 mm':>7}"
          f"{'right link %':>13}{'of sure %':>10}{'flagged %':>10}{'wrong %':>8}")
    for r in rows:
        median, p90, right, sure = ("-" if x is None else f"{x:.{n}f}" for x, n in (
            (r.median_mm, 1), (r.p90_mm, 1), (_percent(r.right_link), 1), (_percent(r.sure_right_link), 1)))
        print(f"{r.mode:<9}{'yes' if r.noise else 'no':<7}{r.obstacle:<9}{r.view:<9}{r.contacts:>8}{r.found:>6}{median:>10}"
              f"{p90:>7}{right:>13}{sure:>10}{100 * r.flagged:>10.0f}{100 * r.wrong:>8.1f}")


def plot_accuracy(rows: Sequence[Accuracy], path: Path) -> None:
    """Draw median and 90th percentile by class of view, all modes, with and without noise, over all obstacles."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    views = [view for view in VIEWS if view != "hidden"]
    for axes, noise in zip(figure.subplots(1, 2, sharey=True), (False, True), strict=True):
        for shift, mode, colour in ((-0.28, "paper", "#9aa5b1"), (0.0, "interval", "#e0701a"), (0.28, "fused", "#2f7ed8")):
            chosen = [next(r for r in rows if (r.mode, r.noise, r.obstacle, r.view) == (mode, noise, "all", v)) for v in views]
            median, p90 = (np.array([getattr(r, name) or np.nan for r in chosen]) for name in ("median_mm", "p90_mm"))
            at = np.arange(len(views)) + shift
            axes.bar(at, median, 0.26, color=colour, label=f"{mode}: median, line to 90 %")
            axes.vlines(at, median, p90, color=colour)
            for x, r in zip(at, chosen, strict=True):
                axes.text(x, 1.0, f"{100 * r.flagged:.0f} %", ha="center", fontsize=6)
        axes.set_xticks(range(len(views)), views)
        axes.set_title("with sensor noise" if noise else "without noise", fontsize=10)
        axes.set_ylim(0, 150)
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].set_ylabel("error of the point [mm]\n(in the bar: flagged as not sure)")
    figure.axes[0].legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=130)


def _rows(mode: str, noise: bool, contacts: Sequence[Touch], found: Sequence[Nearest | None], reach: float) -> list[Accuracy]:
    rows = []
    for obstacle in (*(b.name for b in OBSTACLES), "all"):
        for view in (*VIEWS, "joint", "all") if obstacle == "all" else VIEWS:
            chosen = [(c, n) for c, n in zip(contacts, found, strict=True) if obstacle in (c.obstacle.name, "all") and (
                view == "all" or (view == "joint" and c.clearance < CLEAR) or (view == c.view and c.clearance >= CLEAR))]
            rows.append(_row(mode, noise, obstacle, view, chosen, reach))
    return rows


def _row(mode: str, noise: bool, obstacle: str, view: str, chosen: Sequence[tuple[Touch, Nearest | None]],
         reach: float) -> Accuracy:
    seen = [(c, n, float(np.linalg.norm(n.p_world - c.point))) for c, n in chosen if n is not None and n.distance <= reach]
    errors, sure = [1e3 * error for *_, error in seen], [(c, n) for c, n, _ in seen if n.sure]
    return Accuracy(
        mode, noise, obstacle, view, len(chosen), len(seen),
        *(float(np.percentile(errors, p)) if seen else None for p in (50, 90)),
        right_link=float(np.mean([c.link == n.link for c, n, _ in seen])) if seen else None,
        sure_right_link=float(np.mean([c.link == n.link for c, n in sure])) if sure else None,
        flagged=1.0 - len(sure) / max(len(chosen), 1),
        wrong=sum(n.sure and error > WRONG for _, n, error in seen) / max(len(chosen), 1))


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share
