"""The same kernels for CUDA: they compile on a machine without a GPU, and agree with the CPU on one that has it."""

import importlib
import pkgutil

import numpy as np
import pytest
import warp as wp
from eye_random import name_of, scene
from eye_scenes import DeviceStages, random_images, random_meshes, random_poses, representable, small_camera, tied_images

from hrc.messages import DepthFrame
from hrc.vision import kernels
from hrc.vision.localize import Localizer

gpu = pytest.mark.skipif(not any(d.is_cuda for d in wp.get_devices()), reason="no CUDA device here")


def every_kernel():
    modules = [importlib.import_module(f"{kernels.__name__}.{m.name}") for m in pkgutil.iter_modules(kernels.__path__)]
    return {k.key: k for module in modules for k in vars(module).values() if isinstance(k, wp.Kernel)}


def test_every_kernel_compiles_for_cuda(tmp_path):
    found = every_kernel()
    assert len(found) >= 10
    assert {k.module.name for k in found.values()} == {kernels.MODULE.name}
    wp.compile_aot_module(kernels.MODULE, arch=80, module_dir=tmp_path, use_ptx=True)
    ptx = next(tmp_path.glob("*.ptx")).read_text()
    for name in found:
        assert f".entry {name}_" in ptx, name
    draw = ptx[ptx.index(".entry draw_"):]
    assert "max.u32" in draw[: draw.index("\n}")]  # the raster's atomic maximum


@pytest.fixture(scope="module")
def devices():
    return DeviceStages(small_camera()), DeviceStages(small_camera(), "cuda:0")


@gpu
@pytest.mark.parametrize("seed", range(4))
def test_cuda_draws_what_the_cpu_draws(devices, seed):
    """A pixel whose ray passes within the rounding of an edge may differ; its neighbours may not."""
    rng = np.random.default_rng(seed)
    shapes, where = random_meshes(9, rng), random_poses(9, rng)
    for margin in (0.0, 0.03):
        (depth, link), (cuda_depth, cuda_link) = (device.render(shapes, where, margin) for device in devices)
        same = link == cuda_link
        assert (~same).mean() < 1e-3
        seen = same & np.isfinite(depth)
        np.testing.assert_allclose(cuda_depth[seen], depth[seen], atol=1e-5)


@gpu
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("neighbours", [0, 3])
def test_cuda_filters_bit_for_bit(devices, seed, neighbours):
    """From the same images: every operation of the filter rounds the same way everywhere."""
    rng, shape = np.random.default_rng(seed), small_camera().shape
    robot, link, _ = random_images(small_camera(), rng, 0.1)
    robot, _ = representable(small_camera(), robot, np.where(link < 255, 0, 255).astype(np.uint8))
    real = (rng.uniform(0.5, 2.5, (shape[0] // 5 + 1, shape[1] // 5 + 1))).repeat(5, 0).repeat(5, 1)[: shape[0], : shape[1]]
    real = (real + rng.normal(0, 0.01, shape)).astype(np.float32)
    real[rng.random(shape) < 0.1] = 0.0
    cpu, cuda = (device.filtered(real, robot, rng.uniform(1.0, 3.0, shape), neighbours)
                 for device, rng in zip(devices, (np.random.default_rng(9), np.random.default_rng(9)), strict=True))
    assert np.isfinite(cpu).any()
    np.testing.assert_array_equal(cpu, cuda)


@gpu
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("thickness", [0.0, 0.12, 1e6])
def test_cuda_measures_what_the_cpu_measures(devices, seed, thickness):
    robot, link, foreground = random_images(small_camera(), np.random.default_rng(seed), 0.1)
    robot, link = representable(small_camera(), robot, link)
    cpu, cuda = (np.minimum(d.distance_map(robot, link, foreground, 0.1, thickness), 0.1) for d in devices)
    np.testing.assert_allclose(cuda, cpu, atol=1e-6)
    points, cuda_points = ({p.link: p for p in d.points(robot, link, foreground, 0.1, thickness)} for d in devices)
    assert points.keys() == cuda_points.keys()
    for on, p in points.items():
        assert cuda_points[on].distance == pytest.approx(p.distance, abs=1e-6)


@gpu
@pytest.mark.parametrize("pixels", [0, 4])
@pytest.mark.parametrize("centred", [False, True])
def test_cuda_resolves_ties_like_the_cpu(pixels, centred):
    """Where the arithmetic is exact, every bit is the same: the map, the pixels, the distances."""
    camera, robot, link, foreground = tied_images(pixels)
    maps, points = [], []
    for stages in (DeviceStages(camera), DeviceStages(camera, "cuda:0"), DeviceStages(camera, "cuda:0")):
        maps.append(stages.distance_map(robot, link, foreground, 0.1, 0.12))
        points.append(stages.points(robot, link, foreground, centred=centred))
    np.testing.assert_array_equal(maps[1], maps[0])
    np.testing.assert_array_equal(maps[2], maps[0])
    assert points[0] == points[1] == points[2]


@gpu
@pytest.mark.parametrize("number", [1, 8, 30, 49], ids=name_of)
def test_cuda_gives_the_same_bits_on_every_run(number):
    s, runs = scene(number), []
    for _ in range(2):
        eye = Localizer(s.camera, s.environment, s.config, "cuda:0")
        for _ in range(5):
            eye.filter(DepthFrame(3, s.real.copy()), s.T_stamp)
            nearest = [(n.link, n.pixel, n.distance, *n.p_world) for n in eye.localize(5, s.T_now)]
            touches = [(n.link, n.pixel, n.distance, *n.p_world) for n in eye.touches()]
            clearances = [(c.link, c.distance, *c.p_robot, *c.p_obstacle) for c in eye.clearances()]
            runs.append((nearest, touches, clearances, eye.distances().tobytes(), eye.foreground.depth.tobytes()))
    assert all(run == runs[0] for run in runs[1:])


@gpu
@pytest.mark.parametrize("number", [1, 8, 30, 49], ids=name_of)
def test_cuda_sees_what_the_cpu_sees(number):
    """The whole cycle. Two rasters may differ in single pixels, and so may what follows from them."""
    s, seen = scene(number), []
    for device in ("cpu", "cuda:0"):
        eye = Localizer(s.camera, s.environment, s.config, device)
        eye.filter(DepthFrame(3, s.real.copy()), s.T_stamp)
        eye.localize(5, s.T_now)
        seen.append((np.minimum(eye.distances(), s.config.reach), np.isfinite(eye.foreground.depth),
                     {c.link: c.distance for c in eye.clearances()}))
    assert (np.abs(seen[0][0] - seen[1][0]) > 1e-5).mean() < 2e-3
    assert (seen[0][1] != seen[1][1]).mean() < 2e-3
    assert seen[0][2].keys() == seen[1][2].keys()
    for link, distance in seen[0][2].items():
        assert seen[1][2][link] == pytest.approx(distance, abs=2e-3)
