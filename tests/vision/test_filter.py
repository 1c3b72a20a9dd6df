import numpy as np
import pytest
from eye_scenes import DeviceStages, random_images, representable, small_camera

from hrc.vision import reference


@pytest.mark.parametrize("neighbours", [0, 3])
@pytest.mark.parametrize("seed", range(4))
def test_the_filter_is_that_of_the_reference(seed, neighbours):
    rng = np.random.default_rng(seed)
    camera = small_camera()
    robot, link, _ = random_images(camera, rng, 0.1)
    robot, _ = representable(camera, robot, np.where(link < 255, 0, 255).astype(np.uint8))
    environment = rng.uniform(1.0, 3.0, camera.shape)
    real = (rng.uniform(0.5, 2.5, (camera.shape[0] // 5 + 1, camera.shape[1] // 5 + 1))).repeat(5, 0).repeat(5, 1)
    real = (real[: camera.shape[0], : camera.shape[1]] + rng.normal(0, 0.01, camera.shape)).astype(np.float32)
    real[rng.random(camera.shape) < 0.2] = 0.0
    real[rng.random(camera.shape) < 0.1] = np.inf
    expected = reference.filtered(real, robot, environment)
    if neighbours:
        expected = reference.supported(expected, neighbours)
    found = DeviceStages(camera).filtered(real, robot, environment, neighbours)
    differ = np.isfinite(found) != np.isfinite(expected)
    assert differ.sum() <= 1  # float32 against float64 on the boundary
    kept = np.isfinite(found) & ~differ
    assert 0.05 < kept.mean() < 0.6
    np.testing.assert_array_equal(found[kept], real[kept])


def test_nothing_measured_is_never_an_obstacle():
    camera = small_camera()
    nothing = np.full(camera.shape, np.inf)
    for value in (0.0, np.inf):
        found = DeviceStages(camera).filtered(np.full(camera.shape, value, np.float32), nothing, nothing)
        assert not np.isfinite(found).any()


def test_a_pixel_that_floats_alone_between_two_surfaces_is_dropped():
    camera = small_camera()
    nothing = np.full(camera.shape, np.inf)
    real = np.full(camera.shape, 2.0, np.float32)
    real[10:20, 10:20] = 1.0
    real[15, 20] = 1.5
    found = DeviceStages(camera).filtered(real, nothing, nothing, 3)
    assert not np.isfinite(found[15, 20])
    assert np.isfinite(found).sum() == real.size - 1
