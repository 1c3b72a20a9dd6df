"""The cycle taken apart: each stage replayed alone, in the order and with the buffers of the whole."""

from app.bench.frames import Take
from app.bench.timing import Contender
from hrc import meshes
from hrc.messages import LINKS
from hrc.vision import kernels
from hrc.vision.localize import VisionConfig
from hrc.vision.render import environment_depth

ENDLESS = 1e6
"""Thickness [m] of an obstacle under the paper's rule."""


class Stages(Contender):
    """What `Localizer.filter` and `localize` queue, stage by stage. One graph each costs some microseconds more in all.

    In mode paper only the expanded robot is drawn: it is also what distances are measured from.
    """

    def __init__(self, take: Take, config: VisionConfig, filter_detail: str, device: str = "cpu") -> None:
        paper, grid = config.mode == "paper", kernels.grid(take.camera)
        cover = kernels.Rasteriser(grid, meshes.robot(filter_detail), device)
        cover.expand(config.margin)
        robot = cover if paper else kernels.Rasteriser(grid, meshes.robot("perception"), device)
        filtered = kernels.Filter(grid, cover.keys, device)
        filtered.mask(environment_depth(take.camera, take.environment, config.environment_margin))
        filtered.neighbours = 0 if paper else config.neighbours
        distance = kernels.Distance(grid, robot.keys, filtered, device)
        distance.links, distance.reach = sum(1 << i for i in range(config.first_link, len(LINKS))), config.reach
        distance.thickness = ENDLESS if paper else config.thickness
        chords = kernels.Chords(filtered)
        chords.thickness = config.thickness
        if not paper:
            distance.back = chords.back
        point = kernels.ContactPoints(distance)
        point.centred, point.spread, point.patch = not paper, config.spread, config.patch
        T_camera_link = [take.camera.T_camera_world @ T for T in take.T_world_link]

        def load(k: int) -> None:
            filtered.load(take.frames[k].depth)
            for raster in {cover, robot}:
                raster.place(T_camera_link[k])

        queued = {
            "expanded robot": [cover.launch],
            "true robot": [] if paper else [robot.launch],
            "filter": [lambda: robot.surround(distance.links, config.reach, filtered.region, 0 if paper else chords.MORE),
                       filtered.launch],
            "depth of obstacles": [] if paper else [chords.launch],
            "distances": [distance.launch],
            "contact points": [point.launch],
        }
        graphs = {name: kernels.Graph(launches, device) for name, launches in queued.items() if launches}
        self.steps = {"load frame and poses": load}
        self.steps |= {name: lambda _, graph=graph: graph.replay() for name, graph in graphs.items()}
        self.steps["read back"] = lambda _: point.result()
