"""From a camera's raw image to a depth frame: types, units, invalid pixels, and the lens."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrc.errors import ConfigError, SensorError
from hrc.vision.camera import Camera, CameraConfig
from hrc.vision.depth_image import Distortion, Rectifier, depth_frame

KINECT = Distortion(k1=0.0905474, k2=-0.26819, k3=0.0950862)
FOLDING = Distortion(k1=0.11926, k2=-0.53343, p1=-0.00021, p2=0.0073)  # turns round within the image
LENSES = [KINECT, FOLDING, Distortion(k1=-0.3, k2=0.1, p1=0.002, p2=-0.001), Distortion()]


@pytest.mark.parametrize("dtype", ["<u2", ">u2", "f4", "f8"])
def test_what_was_measured_is_metres_and_what_was_not_is_infinite(dtype):
    steps = np.array([[0, 1, 500], [2200, 65535, 0]])
    image = (steps if dtype.endswith("u2") else steps / 1000).astype(dtype)
    frame = depth_frame(7, image)
    assert (frame.tick, frame.depth.dtype) == (7, np.float32)
    np.testing.assert_allclose(frame.depth, np.where(steps > 0, steps / 1000, np.inf), rtol=1e-6)


@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_every_float_that_is_no_depth_is_an_invalid_pixel(dtype):
    image = np.array([[np.nan, np.inf, -np.inf, -1.0, -0.0, 1.5]], dtype)
    np.testing.assert_array_equal(depth_frame(0, image).depth, [[np.inf] * 5 + [1.5]])


@pytest.mark.parametrize("image", [np.zeros((3, 4), np.uint16), np.full((3, 4), np.nan), np.full((3, 4), np.inf, np.float32)])
def test_an_image_in_which_nothing_was_measured_is_a_frame_like_any_other(image):
    assert np.isinf(depth_frame(0, image).depth).all()


def test_the_unit_scales():
    np.testing.assert_allclose(depth_frame(0, np.array([[8800, 0]], np.uint16), unit=0.00025).depth, [[2.2, np.inf]])
    np.testing.assert_allclose(depth_frame(0, np.array([[2200.0, 0.0]]), unit=0.001).depth, [[2.2, np.inf]])


@pytest.mark.parametrize(("image", "options", "told"), [
    (np.zeros((3, 4), np.uint8), {}, "8 bits"),
    (np.zeros((3, 4), np.int32), {}, "uint16"),
    (np.zeros((3, 4), np.float16), {}, "float32"),
    (np.zeros((3, 4), bool), {}, "uint16"),
    (np.zeros((3, 4), complex), {}, "uint16"),
    (np.zeros((3, 4, 1), np.uint16), {}, r"\(H, W\)"),
    (np.zeros(12, np.uint16), {}, r"\(H, W\)"),
    (np.zeros((0, 4), np.uint16), {}, r"\(H, W\)"),
    (np.full((3, 4), 2200.0), {}, "0.001 for millimetres"),
    (np.full((3, 4), 2200, np.uint16), {"unit": 1.0}, "0.001 for millimetres"),
    (np.full((3, 4), 2.2), {"unit": 0.001}, "metres in one step"),
    (np.full((3, 4), 2.2), {"unit": 0.0}, "metres in one step"),
    (np.full((3, 4), 2.2), {"unit": float("nan")}, "metres in one step"),
])
def test_what_is_no_depth_image_is_refused_with_what_would_be_right(image, options, told):
    with pytest.raises(SensorError, match=told):
        depth_frame(0, image, **options)


def test_the_driver_may_use_its_buffer_again():
    for buffer in (np.full((3, 4), 1.5, np.float32), np.full((3, 4), 1500, np.uint16)):
        frame = depth_frame(0, buffer)
        buffer[:] = 0
        np.testing.assert_allclose(frame.depth, 1.5, rtol=1e-6)
        assert not frame.depth.flags.writeable


@pytest.mark.parametrize("lens", LENSES)
@given(st.floats(0.0, 0.95), st.floats(-np.pi, np.pi))
def test_undistort_inverts_distort(lens, part, angle):
    r = part * min(lens.limit, 0.9)
    x, y = r * np.cos(angle), r * np.sin(angle)
    np.testing.assert_allclose(lens.undistort(*lens.distort(x, y)), [x, y], atol=1e-9)


def test_distortion_has_the_signs_of_the_usual_model():
    x, y = Distortion(k1=0.1).distort(0.5, 0.0)
    assert (float(x), float(y)) == pytest.approx((0.5 * 1.025, 0.0))
    x, y = Distortion(p1=0.01).distort(0.5, 0.2)  # x + 2 p1 x y, y + p1 (r^2 + 2 y^2)
    assert (float(x), float(y)) == pytest.approx((0.5 + 0.002, 0.2 + 0.01 * (0.29 + 0.08)))
    x, y = Distortion(p2=0.01).distort(0.5, 0.2)  # x + p2 (r^2 + 2 x^2), y + 2 p2 x y
    assert (float(x), float(y)) == pytest.approx((0.5 + 0.01 * (0.29 + 0.5), 0.2 + 0.002))


def test_the_model_is_used_up_to_where_it_folds():
    assert Distortion().limit == np.inf
    assert Distortion(k1=0.5).limit == np.inf
    limit = FOLDING.limit
    radius = np.linspace(0, limit, 1000)
    radial = Distortion(k1=FOLDING.k1, k2=FOLDING.k2)
    assert (np.diff(radial.distort(radius, 0)[0]) > 0).all()
    assert radial.distort(1.02 * limit, 0)[0] < radial.distort(limit, 0)[0]
    assert np.isnan(radial.undistort(2.0, 0.0)).any()  # nothing is shown there


def cast(rays, centre, radius):
    """Depth of a sphere before a slanted plane, for rays (..., 3) at depth 1; in closed form."""
    plane = 2.5 / (rays @ [0.2, -0.3, 1.0])
    b, a = rays @ centre, (rays * rays).sum(axis=-1)
    root = b * b - a * (centre @ centre - radius * radius)
    sphere = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)
    return np.minimum(plane, sphere)


@pytest.mark.parametrize("lens", [KINECT, FOLDING, LENSES[2]])
def test_a_rectified_image_is_the_pinhole_image_to_within_a_pixel(lens):
    camera = Camera()
    c, (v, u) = camera.config, np.mgrid[: camera.shape[0], : camera.shape[1]]
    x, y = lens.undistort((u - c.cx) / c.fx, (v - c.cy) / c.fy)
    centre, radius = np.array([0.45, 0.35, 1.6]), 0.2  # off the axis, where a lens bends most
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    raw = np.nan_to_num(cast(rays, centre, radius), nan=0.0, posinf=0.0)
    depth = depth_frame(0, raw, rectify=Rectifier(camera, lens)).depth
    true = cast(camera.rays(), centre, radius)
    seen = np.isfinite(depth)
    assert seen.mean() > 0.75
    # Not at the border, where half of what is around is missing, nor near a fold, where one pixel shows many.
    seen &= np.hypot(*np.moveaxis(camera.rays()[..., :2], -1, 0)) < 0.7 * lens.limit
    seen[[0, -1]] = seen[:, [0, -1]] = False
    # Within a pixel: the value lies between the least and the largest of the 3 x 3 true ones around.
    around = np.lib.stride_tricks.sliding_window_view(np.pad(true, 1, mode="edge"), (3, 3))
    low, high = around.min(axis=(2, 3)), around.max(axis=(2, 3))
    assert ((depth >= low - 1e-3) & (depth <= high + 1e-3))[seen].all()
    # ... which an image left as it is would not.
    assert not ((raw >= low - 1e-3) & (raw <= high + 1e-3))[seen].all()


def test_a_pixel_beyond_the_fold_or_the_image_is_invalid():
    camera = Camera()
    depth = depth_frame(0, np.full(camera.shape, 1500, np.uint16), rectify=Rectifier(camera, FOLDING)).depth
    radius = np.hypot(*np.moveaxis(camera.rays()[..., :2], -1, 0))
    assert np.isinf(depth[radius >= FOLDING.limit]).all()
    pincushion = depth_frame(0, np.full(camera.shape, 1500, np.uint16),
                             rectify=Rectifier(camera, Distortion(k1=0.3))).depth
    assert np.isinf(pincushion[[0, 0, -1, -1], [0, -1, 0, -1]]).all()
    assert np.isfinite(pincushion[200:220, 250:260]).all()


def test_without_distortion_rectifying_changes_nothing():
    camera, rng = Camera(), np.random.default_rng(0)
    image = rng.integers(1, 60000, camera.shape).astype(np.uint16)
    np.testing.assert_array_equal(Rectifier(camera, Distortion())(image), image)


def test_a_rectifier_refuses_another_size():
    with pytest.raises(SensorError, match="424, 512"):
        Rectifier(Camera(), KINECT)(np.ones((240, 320), np.uint16))
    with pytest.raises(ConfigError, match="k1"):
        Distortion(k1=float("nan"))
    assert Rectifier(Camera(CameraConfig(width=64, height=48, cx=32, cy=24)), KINECT)(np.ones((48, 64))).shape == (48, 64)
