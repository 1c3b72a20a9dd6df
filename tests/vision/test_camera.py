import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrc.errors import ConfigError
from hrc.geometry import apply
from hrc.vision.camera import Camera, CameraConfig

coordinate = st.floats(-3.0, 3.0)


@given(coordinate, coordinate, st.floats(0.1, 10.0))
def test_unproject_inverts_project(x, y, z):
    camera = Camera()
    np.testing.assert_allclose(camera.unproject(*camera.project([x, y, z])), [x, y, z], atol=1e-12)


@given(st.floats(-50, 600), st.floats(-50, 500), st.floats(0.1, 10.0))
def test_project_inverts_unproject(u, v, d):
    camera = Camera()
    np.testing.assert_allclose(camera.project(camera.unproject(u, v, d)), [u, v, d], atol=1e-9)


def test_target_is_on_the_optical_axis_and_up_is_up():
    config = CameraConfig()
    camera = Camera(config)
    u, v, z = camera.project(apply(camera.T_camera_world, config.target))
    np.testing.assert_allclose([u, v], [config.cx, config.cy])
    assert z == pytest.approx(np.linalg.norm(np.subtract(config.eye, config.target)))
    above = camera.project(apply(camera.T_camera_world, np.add(config.target, [0, 0, 0.1])))
    assert above[1] < v
    assert above[0] == pytest.approx(u)


def test_rays_are_the_unprojected_pixel_grid():
    camera = Camera()
    assert camera.rays().shape == (*camera.shape, 3)
    np.testing.assert_allclose(camera.rays()[100, 300], camera.unproject(300, 100, 1.0))


def test_a_vertical_camera_is_refused():
    with pytest.raises(ConfigError, match="straight up or down"):
        CameraConfig(eye=(0.0, 0.0, 2.0), target=(0.0, 0.0, 0.0))
