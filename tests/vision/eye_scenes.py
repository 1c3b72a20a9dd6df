"""Small random scenes for the tests of the eye."""

from dataclasses import dataclass

import numpy as np

from hrc.geometry import rotation_about, transform
from hrc.meshes import Mesh, box, sphere
from hrc.vision import kernels
from hrc.vision.camera import Camera, CameraConfig


def small_camera(width=90, height=70):
    """An odd size on purpose: no whole number of tiles."""
    return Camera(CameraConfig(width=width, height=height, fx=64.3, fy=65.1, cx=width / 2.07, cy=height / 1.93))


def random_poses(n, rng, near=1.2, far=3.0, spread=0.5):
    poses = []
    for _ in range(n):
        z = rng.uniform(near, far)
        p = np.array([rng.uniform(-spread, spread) * z, rng.uniform(-spread, spread) * z, z])
        poses.append(transform(rotation_about(rng.normal(size=3), rng.uniform(0, np.pi)), p))
    return np.array(poses)


def random_meshes(n, rng) -> list[Mesh]:
    return [sphere(rng.uniform(0.1, 0.4), 2) if rng.random() < 0.5 else box(rng.uniform(0.05, 0.4, 3)) for _ in range(n)]


def random_images(camera, rng, cover):
    """Robot depth, its link image and a foreground: blobs that touch and cross the border, holes included."""
    shape = camera.shape
    v, u = np.mgrid[: shape[0], : shape[1]]
    robot, link = np.full(shape, np.inf), np.full(shape, 255, np.uint8)
    for i in range(3, 8):
        cu, cv, r, z = rng.uniform(0, shape[1]), rng.uniform(0, shape[0]), rng.uniform(3, 14), rng.uniform(0.5, 1.6)
        inside = ((u - cu) ** 2 + (v - cv) ** 2 < r * r) & (z < robot)
        robot[inside] = z + 0.002 * (u - cu)[inside]
        link[inside] = i
    foreground = np.where(rng.random(shape) < cover, rng.uniform(0.4, 1.8, shape), np.inf)
    return robot, link, foreground.astype(np.float32)


@dataclass
class DeviceStages:
    """The kernels' stages behind the contract of hrc.vision.reference."""

    camera: Camera
    device: str = "cpu"

    def render(self, meshes, poses, margin=0.0):
        raster = kernels.Rasteriser(kernels.grid(self.camera), meshes, self.device)
        raster.expand(margin)
        raster.place(poses)
        kernels.Graph([raster.launch], self.device).replay()
        return raster.image()

    def _filter(self, real, robot, environment, neighbours=0):
        grid = kernels.grid(self.camera)
        keys = kernels.upload(kernels.pack(robot, np.zeros(robot.shape, np.uint8), grid), "uint32", self.device)
        stage = kernels.Filter(grid, keys, self.device)
        stage.neighbours = neighbours
        stage.mask(environment)
        stage.load(real)
        stage.launch()
        return stage

    def filtered(self, real, robot, environment, neighbours=0):
        return self._filter(real, robot, environment, neighbours).image()

    def distance(self, robot, link, foreground, reach, thickness):
        nothing = np.full(robot.shape, np.inf)
        passed = self._filter(foreground, nothing, nothing)
        keys = kernels.upload(kernels.pack(robot, link, passed.grid), "uint32", self.device)
        stage = kernels.Distance(passed.grid, keys, passed, self.device)
        stage.reach, stage.thickness = reach, thickness
        stage.launch()
        return stage

    def distance_map(self, robot, link, foreground, reach, thickness):
        return self.distance(robot, link, foreground, reach, thickness).image()

    def points(self, robot, link, foreground, reach=0.1, thickness=0.12, **options):
        point = kernels.ContactPoints(self.distance(robot, link, foreground, reach, thickness))
        for name, value in options.items():
            setattr(point, name, value)
        point.launch()
        return point.result()

    def contact_point(self, robot, link, foreground, reach, thickness, **options):
        return next(iter(self.points(robot, link, foreground, reach, thickness, **options)), None)


def representable(camera, robot, link):
    """The same robot image as a raster key can hold it."""
    grid = kernels.grid(camera)
    return kernels.unpack(kernels.pack(robot, link, grid), grid)


def tied_images(pixels):
    """A camera, robot, link and foreground: three links of single pixels, each with an obstacle so many pixels to the right.

    Every coordinate is a short binary fraction, so that all distances are the same number on every device. The first pixel
    of a link lies in the right one of two tiles side by side.
    """
    camera = Camera(CameraConfig(width=96, height=64, fx=64.0, fy=64.0, cx=48.0, cy=32.0))
    robot, link = np.full(camera.shape, np.inf, np.float32), np.full(camera.shape, 255, np.uint8)
    foreground = robot.copy()
    for on, v, u in ((3, 42, 16), (4, 9, 0), (7, 25, 48)):
        for row, column in ((0, 20), (1, 5), (4, 31), (9, 3), (12, 30)):
            robot[v + row, u + column], link[v + row, u + column] = 1.0, on
            foreground[v + row, u + column + pixels] = 1.0
    return camera, robot, link, foreground
