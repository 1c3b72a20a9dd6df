"""What a skilled user would put together instead: a renderer for the robot, numpy for the filter, a k-d tree for the distance.

All of it honestly: renderers, images and rays are made once; only the rectangle around the links that count is looked at;
the tree is built over the obstacle's points, which are few, and asked for the robot's; float32 throughout, but for scipy,
which knows float64 alone. A k-d tree has no occlusion rule (Sec. III-C): nothing in front of the robot reaches back to it.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from scipy.spatial import KDTree

from app.bench.frames import Take
from app.bench.renderers import FAR, Images, MujocoDirect, MujocoImages, Open3dImages, UnavailableError
from app.bench.timing import Contender
from app.bench.window import corners, rectangle
from hrc import meshes
from hrc.geometry import Array, apply
from hrc.messages import RobotImage
from hrc.vision import reference
from hrc.vision.localize import VisionConfig
from hrc.vision.render import Renderer, environment_depth


class RobotImages(Protocol):
    """A source of virtual depth images."""

    def render(self, T_world_link: Array) -> Images:
        """With the links at these poses (8, 4, 4)."""
        ...

    def close(self) -> None:
        """Free what it holds."""
        ...


class Tree(Contender):
    """Virtual depth images from somewhere, then numpy and scipy. `least` is the distance found last [m], `point` its place."""

    def __init__(self, take: Take, config: VisionConfig, images: RobotImages) -> None:
        camera = take.camera
        self._take, self._config, self._source = take, config, images
        self._rays = camera.rays().astype(np.float32)
        self._environment = environment_depth(camera, take.environment, config.environment_margin).astype(np.float32)
        self._corners = corners(config.margin)
        self.least: float = np.inf
        self.point = np.full(3, np.nan)
        self.steps = {"render": self._render, "filter": self._filter, "search": self._search}

    def close(self) -> None:
        """Free the graphics contexts."""
        self._source.close()

    def _render(self, k: int) -> None:
        self._images = self._source.render(self._take.T_world_link[k])

    def _filter(self, k: int) -> None:
        """Points of the obstacle and of the robot, both float32 (n, 3), in the camera's frame [m]."""
        cover, robot, link = self._images
        first = self._config.first_link
        T_camera_link = self._take.camera.T_camera_world @ self._take.T_world_link[k][first:]
        window = rectangle(self._take.camera, T_camera_link, self._corners[first:], self._config.reach)
        real, rays = self._take.frames[k].depth[window], self._rays[window]
        kept = (real > 0) & (real < np.minimum(cover[window], self._environment[window]))
        self._obstacle = rays[kept] * real[kept][:, None]
        here = robot[window]
        counts = here < FAR if link is None else link[window] >= first
        self._surface = rays[counts] * here[counts][:, None]

    def _search(self, _: int) -> None:
        self.least = np.inf
        if not len(self._obstacle) or not len(self._surface):
            return
        tree = KDTree(self._obstacle, balanced_tree=False)
        distances = np.asarray(tree.query(self._surface, distance_upper_bound=self._config.reach, workers=1)[0])
        nearest = np.argmin(distances)
        self.least = float(distances[nearest])
        self.point = apply(self._take.camera.T_world_camera, self._surface[nearest])


class BruteForce(Contender):
    """The rules of mode paper in plain numpy, every robot pixel against every obstacle pixel; the rendering is not counted."""

    def __init__(self, take: Take, config: VisionConfig) -> None:
        self._take, self._config = take, config
        self._environment = environment_depth(take.camera, take.environment, config.environment_margin)
        renderer = Renderer(take.camera, meshes.robot("perception"))
        renderer.expand(config.margin)
        self._images = [renderer.render(T) for T in take.T_world_link]
        self.steps = {"filter": self._filter, "search": self._search}

    def _filter(self, k: int) -> None:
        self._kept = reference.filtered(self._take.frames[k].depth, self._images[k].depth, self._environment)

    def _search(self, k: int) -> None:
        self._result = self._nearest(self._images[k])

    def _nearest(self, robot: RobotImage) -> object:
        camera, config = self._take.camera, self._config
        depth = np.where((robot.link >= config.first_link) & (robot.link < reference.NO_LINK), robot.depth, np.inf)
        distances = reference.distance_map(camera, depth, self._kept, config.reach, np.inf)
        return reference.contact_point(camera, depth, robot.link, distances, centred=False)


BASELINES: dict[str, tuple[str, Callable[[Take, VisionConfig], Contender]]] = {
    "mujoco_ckdtree": (
        "MuJoCo: two depth images and link ids; k-d tree",
        lambda take, config: Tree(take, config, MujocoImages(take.camera, config.margin, ids=True))),
    "mujoco_ckdtree_no_ids": (
        "MuJoCo: one depth image, no link ids; k-d tree",
        lambda take, config: Tree(take, config, MujocoImages(take.camera, config.margin, ids=False))),
    "mujoco_direct_ckdtree": (
        "MuJoCo's mjr_ functions: depth and ids in one pass; k-d tree",
        lambda take, config: Tree(take, config, MujocoDirect(take.camera, config.margin, config.reach))),
    "mujoco_ckdtree_antialiased": (
        "MuJoCo as it comes, 4 samples a pixel; k-d tree",
        lambda take, config: Tree(take, config, MujocoImages(take.camera, config.margin, ids=True, samples=4))),
    "open3d_ckdtree": (
        "Open3D: rays at two robots, link ids; k-d tree",
        lambda take, config: Tree(take, config, Open3dImages(take.camera, config.margin))),
    "brute_force": ("numpy, brute force, the same rules, not rendered", BruteForce),
}
"""By their names in the JSON: a line for the table, and how to make it."""


def assemble(name: str, take: Take, config: VisionConfig) -> Contender | str:
    """The contender, or in one line why it cannot be had here."""
    try:
        return BASELINES[name][1](take, config)
    except UnavailableError as error:
        return str(error)
