"""How the cycle's time depends on what it is given, one thing changed at a time, and what the paper claims about that."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from app.bench.baselines import Tree, assemble
from app.bench.frames import Condition, Take, record
from app.bench.perception import Cycle
from app.bench.timing import Contender, by_turns, hold
from hrc.vision.localize import VisionConfig

COMPARED = "mujoco_ckdtree"
"""The baseline that goes through the sweeps as well."""


@dataclass(frozen=True)
class Point:
    """One condition of a sweep: what it says in the table, and in what it differs from the bench's own condition."""

    sweep: str
    label: str
    condition: Condition = field(default_factory=Condition)
    filter_detail: str = "perception"
    changes: Mapping[str, Any] = field(default_factory=dict)
    compared: bool = True


POINTS = (
    *(Point("resolution", label, Condition(scale=scale))
      for label, scale in (("256 x 212", 0.5), ("512 x 424", 1.0), ("1024 x 848", 2.0))),
    *(Point("triangles of the filter mesh", label, filter_detail=detail, compared=False)
      for label, detail in (("2.9k", "filter"), ("10k", "perception"), ("41k", "plant"))),
    *(Point("cameras", str(number), Condition(cameras=number)) for number in (1, 2, 4)),
    Point("obstacle", "hand", Condition(obstacle="hand")),
    *(Point("obstacle", f"board, {coverage:.0%} of the image", Condition(obstacle="board", coverage=coverage))
      for coverage in (0.01, 0.1, 0.4)),
    *(Point("contacts", str(number), Condition(obstacle="balls", balls=number), compared=False) for number in (1, 4)),
    *(Point("candidate links", str(8 - first), changes={"first_link": first}, compared=False) for first in (3, 1)),
    Point("contact", "at a point", Condition(obstacle="hand"), compared=False),
    Point("contact", "a slab flat on the forearm", Condition(obstacle="flat"), compared=False),
    *(Point("camera", f"{distance} m away", Condition(distance=distance), compared=False) for distance in (1.2, 3.5)),
)
QUICK = ("contacts",)
"""The sweeps that a quick run goes through."""


def swept(config: VisionConfig, frames: int, rounds: int, seed: int, device: str, *, quick: bool) -> Iterator[dict[str, Any]]:
    """One entry for each point: medians [ms] of the cycle in both modes, of touches and monitoring in the default one, and of
    the baseline where it is compared; and what the frames show in the mean: pixels of the robot, obstacle, touches.
    """
    for point in POINTS:
        if quick and point.sweep not in QUICK:
            continue
        takes = record(point.condition, frames, seed)
        config_here = config.replace(**point.changes)
        contenders: dict[str, Contender] = {}
        for name in dict.fromkeys(("cpu", device)):
            suffix = "" if name == "cpu" else f"_{name}"
            contenders["paper" + suffix] = Cycle(takes, config_here.replace(mode="paper"), point.filter_detail, name)
            contenders["default" + suffix] = Cycle(takes, config_here, point.filter_detail, name)
            contenders["monitored" + suffix] = Cycle(takes, config_here, point.filter_detail, name, monitored=True)
        every = [assemble(COMPARED, take, config_here) for take in takes] if point.compared else []
        together = [tree for tree in every if isinstance(tree, Tree)]
        if together and len(together) == len(takes):
            contenders[COMPARED] = _Together(together)
        hold()
        times = by_turns(contenders, frames, rounds)
        row: dict[str, Any] = {"sweep": point.sweep, "value": point.label}
        for name, t in times.items():
            if name.startswith("monitored"):
                suffix = name.removeprefix("monitored")
                row |= {f"{step}{suffix}_ms": t.median_ms(step) for step in ("touches", "monitoring")}
            else:
                row[f"{name}_ms"] = t.median_ms()
        yield row | _covered(contenders["monitored"], takes)
        for tree in together:
            tree.close()


class _Together(Contender):
    """One after another, for each camera."""

    def __init__(self, trees: list[Tree]) -> None:
        self.steps = {step: lambda k, step=step: [tree.steps[step](k) for tree in trees] for step in trees[0].steps}


def _covered(cycle: Contender, takes: list[Take]) -> dict[str, float]:
    """Pixels of the robot, share of the image that is obstacle [%], and touches found, each a mean over the frames."""
    assert isinstance(cycle, Cycle)
    robot, obstacle, touches = [], [], []
    for k in range(len(takes[0].frames)):
        cycle(k)
        for eye in cycle.eyes:
            assert eye.robot_image is not None
            assert eye.foreground is not None
            robot.append(np.isfinite(eye.robot_image.depth).sum())
            obstacle.append(np.isfinite(eye.foreground.depth).mean())
            touches.append(len(eye.touches()))
    return {"robot_pixels": float(np.mean(robot)), "obstacle_percent": 100.0 * float(np.mean(obstacle)),
            "touches_found": float(np.mean(touches))}
