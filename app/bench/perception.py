"""Our perception cycle as a contender, and how exact its distances are."""

from collections.abc import Sequence

import numpy as np

from app.bench.frames import Take
from app.bench.timing import Contender
from hrc import meshes
from hrc.messages import Nearest
from hrc.vision import reference
from hrc.vision.localize import Localizer, VisionConfig
from hrc.vision.render import Renderer


class Cycle(Contender):
    """`filter` and `localize`, for each camera; with `monitored`, the separate touches and the monitored distances as well.

    filter_detail: of the meshes that remove the robot (`hrc.meshes.robot`).
    """

    def __init__(self, takes: Sequence[Take], config: VisionConfig, filter_detail: str, device: str = "cpu", *,
                 monitored: bool = False) -> None:
        self.takes, self.config, self.filter_detail, self.device = takes, config, filter_detail, device
        self.eyes = [Localizer(take.camera, take.environment, config, device, filter_detail=filter_detail) for take in takes]
        self.found: list[tuple[Nearest, ...]] = [() for _ in takes]
        self.steps = {"filter": self._filter, "localize": self._localize}
        if monitored:
            self.steps |= {"touches": self._touches, "monitoring": self._monitor}

    def _filter(self, k: int) -> None:
        for eye, take in zip(self.eyes, self.takes, strict=True):
            eye.filter(take.frames[k], take.T_world_link[k])

    def _localize(self, k: int) -> None:
        for i, (eye, take) in enumerate(zip(self.eyes, self.takes, strict=True)):
            self.found[i] = eye.localize(take.frames[k].tick, take.T_world_link[k])

    def _touches(self, _: int) -> None:
        for eye in self.eyes:
            eye.touches()

    def _monitor(self, _: int) -> None:
        for eye in self.eyes:
            eye.clearances()


def error(cycle: Cycle) -> float:
    """The largest difference [m] between the distance map and brute force over all frames.

    What is out of reach counts with the reach, so that a pixel which only one of the two finds counts as well.
    """
    config, paper, largest = cycle.config, cycle.config.mode == "paper", 0.0
    for eye, take in zip(cycle.eyes, cycle.takes, strict=True):
        surface = Renderer(take.camera, meshes.robot(cycle.filter_detail if paper else "perception"), cycle.device)
        surface.expand(config.margin if paper else 0.0)
        for frame, T in zip(take.frames, take.T_world_link, strict=True):
            eye.filter(frame, T)
            found = eye.localize(frame.tick, T)
            robot, foreground = surface.render(T), eye.foreground
            assert foreground is not None
            thickness = np.inf if paper else reference.depths(take.camera, foreground.depth, config.thickness)
            counts = (robot.link >= config.first_link) & (robot.link < reference.NO_LINK)
            brute = reference.distance_map(take.camera, np.where(counts, robot.depth, np.inf), foreground.depth,
                                           config.reach, thickness)
            least = min((near.distance for near in found), default=np.inf)
            for ours, theirs in ((eye.distances(), brute), (least, brute.min())):
                off = np.abs(np.minimum(ours, config.reach) - np.minimum(theirs, config.reach))
                largest = max(largest, float(np.max(off)))
    return largest
