"""The camera file: what it says is what the camera does, and every mistake is named with file and key."""

import numpy as np
import pytest

from hrc.errors import AssetError, ConfigError
from hrc.geometry import look_at
from hrc.vision.camera import Camera
from hrc.vision.camera_file import load_camera
from hrc.vision.depth_image import Distortion, Rectifier, depth_frame

INTRINSICS = "width = 512\nheight = 424\nfx = 365.456\nfy = 365.456\ncx = 254.878\ncy = 205.395\n"
PLACE = "eye = [2.2, 0.0, 0.75]\ntarget = [0.0, 0.0, 0.55]\n"
KINECT = Distortion(k1=0.0905474, k2=-0.26819, k3=0.0950862)
LENS = "[distortion]\nk1 = 0.0905474\nk2 = -0.26819\nk3 = 0.0950862\n"
DOWN = np.array([[0.0, -1.0, 0.0, 0.5], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 2.0], [0.0, 0.0, 0.0, 1.0]])


def written(folder, text):
    path = folder / "camera.toml"
    path.write_text(text)
    return path


def matrix(T):
    return f"T_world_camera = {np.asarray(T).tolist()}\n"


def test_a_file_with_the_defaults_is_the_default_camera(tmp_path):
    found = load_camera(written(tmp_path, INTRINSICS + PLACE + "unit = 0.001\n" + LENS))
    assert found.camera.config == Camera().config
    np.testing.assert_array_equal(found.camera.T_world_camera, Camera().T_world_camera)
    assert (found.unit, found.distortion.k2) == (0.001, -0.26819)
    frame = found.frame(3, np.full((424, 512), 2200, np.uint16))
    assert frame.tick == 3
    assert frame.depth[200, 250] == pytest.approx(2.2)
    straight = depth_frame(3, np.full((424, 512), 2200, np.uint16), rectify=Rectifier(Camera(), KINECT))
    np.testing.assert_array_equal(frame.depth, straight.depth)


def test_a_camera_without_a_lens_leaves_the_image_alone(tmp_path):
    found = load_camera(written(tmp_path, INTRINSICS + PLACE))
    assert (found.rectifier, found.unit) == (None, None)
    assert (found.frame(0, np.full((424, 512), 2.2)).depth == np.float32(2.2)).all()


def test_a_pose_may_be_a_matrix_and_look_straight_down(tmp_path):
    found = load_camera(written(tmp_path, INTRINSICS + matrix(look_at((2.2, 0, 0.75), (0, 0, 0.55)))))
    np.testing.assert_allclose(found.camera.T_world_camera, Camera().T_world_camera, atol=1e-12)
    np.testing.assert_allclose(load_camera(written(tmp_path, INTRINSICS + matrix(DOWN))).camera.T_world_camera, DOWN)


def test_a_pose_of_a_few_digits_becomes_a_rotation(tmp_path):
    T = look_at((1.1, 0.7, 1.3), (0, 0, 0.5))
    R = load_camera(written(tmp_path, INTRINSICS + matrix(T.round(3)))).camera.T_world_camera[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(R, T[:3, :3], atol=2e-3)


MIRRORED, SHEARED, FAR, TURNED = DOWN.copy(), DOWN.copy(), DOWN.copy(), DOWN.T.copy()
MIRRORED[:3, 0] *= -1
SHEARED[0, 0] = 0.1
FAR[:3, 3] *= 1000


@pytest.mark.parametrize(("text", "told"), [
    (INTRINSICS.replace("fx = 365.456", "fx = 0.0") + PLACE, "fx must be a number from 10"),
    (INTRINSICS.replace("fy = 365.456", "fy = nan") + PLACE, "fy"),
    (INTRINSICS.replace("width = 512", "width = 512.5") + PLACE, "width must be a whole number"),
    (INTRINSICS.replace("cx = 254.878", 'cx = "mid"') + PLACE, "cx"),
    (INTRINSICS.replace("fx = 365.456\n", "") + PLACE, "fx missing"),
    (INTRINSICS + PLACE + "fz = 1.0", '"fz".*fx'),
    (INTRINSICS, "eye and target .* missing"),
    (INTRINSICS + "eye = [2.2, 0.0, 0.75]", "not eye"),
    (INTRINSICS + PLACE + matrix(DOWN), "not eye and target and T_world_camera"),
    (INTRINSICS + "eye = [0, 0, 2]\ntarget = [0, 0, 0]", "straight up or down"),
    (INTRINSICS + "eye = [2200, 0, 750]\ntarget = [0, 0, 550]", "eye"),
    (INTRINSICS + matrix(MIRRORED), "mirrors"),
    (INTRINSICS + matrix(SHEARED), "shears"),
    (INTRINSICS + matrix(np.zeros((4, 4))), "0 0 0 1"),
    (INTRINSICS + matrix(TURNED), "transposed"),
    (INTRINSICS + matrix(FAR), "millimetres"),
    (INTRINSICS + matrix(DOWN[:3]), "four rows"),
    (INTRINSICS + "T_world_camera = [[1.0, 0.0], [2.0]]", "four rows"),
    (INTRINSICS + matrix(np.where(DOWN == 2.0, np.nan, DOWN)), "four rows"),
    (INTRINSICS + PLACE + "unit = 0.0", "unit must be"),
    (INTRINSICS + PLACE + 'unit = "mm"', "0.001 is a millimetre"),
    (INTRINSICS + PLACE + "distortion = [0.1, 0.2]", "table of k1"),
    (INTRINSICS + PLACE + LENS + "k4 = 0.1", "k4"),
    (INTRINSICS + PLACE + "[distortion]\nk1 = inf", "distortion: k1"),
])
def test_a_file_that_cannot_be_is_refused_with_its_name_and_key(tmp_path, text, told):
    with pytest.raises(ConfigError, match=told) as refused:
        load_camera(written(tmp_path, text))
    assert "camera.toml" in str(refused.value)


def test_a_missing_or_broken_file_is_named(tmp_path):
    with pytest.raises(AssetError, match=r"none\.toml"):
        load_camera(tmp_path / "none.toml")
    with pytest.raises(AssetError, match="line 1"):
        load_camera(written(tmp_path, "width == 3"))
