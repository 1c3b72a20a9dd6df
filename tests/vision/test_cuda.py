"""The same kernels for CUDA: they compile on a machine without a GPU, and agree with the CPU on one that has it."""

import numpy as np
import pytest
import warp as wp
from eye_scenes import DeviceStages, random_images, random_meshes, random_poses, representable, small_camera

from hrc.vision import kernels

gpu = pytest.mark.skipif(not any(d.is_cuda for d in wp.get_devices()), reason="no CUDA device here")


def test_every_kernel_compiles_for_cuda(tmp_path):
    wp.compile_aot_module(kernels.MODULE, arch=80, module_dir=tmp_path, use_ptx=True)
    ptx = next(tmp_path.glob("*.ptx")).read_text()
    for kernel in ("project", "draw", "filter_depth", "drop_unsupported", "list_candidates", "measure", "gather", "snap",
                   "report", "spoil"):
        assert f".entry {kernel}_" in ptx, kernel
    draw = ptx[ptx.index(".entry draw_"):]
    assert "max.u32" in draw[: draw.index("\n}")]  # the raster's atomic maximum


@gpu
def test_cuda_agrees_with_the_cpu():
    camera, rng = small_camera(), np.random.default_rng(2)
    shapes, where = random_meshes(9, rng), random_poses(9, rng)
    robot, link, foreground = random_images(camera, rng, 0.1)
    robot, link = representable(camera, robot, link)
    cpu, cuda = DeviceStages(camera), DeviceStages(camera, "cuda:0")
    for a, b in zip(cpu.render(shapes, where), cuda.render(shapes, where), strict=True):
        assert (a != b).mean() < 1e-3
    np.testing.assert_allclose(cuda.distance_map(robot, link, foreground, 0.1, 0.12),
                               cpu.distance_map(robot, link, foreground, 0.1, 0.12), atol=1e-6)
    assert cuda.contact_point(robot, link, foreground, 0.1, 0.12)[:3] == \
        cpu.contact_point(robot, link, foreground, 0.1, 0.12)[:3]
