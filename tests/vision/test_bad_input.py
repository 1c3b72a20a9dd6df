"""What is no measurement, no camera or no mesh is refused by name, or has a defined result: no contact."""

import numpy as np
import pytest
from eye_robot import depth_camera, poses, sphere_at
from eye_scenes import small_camera

from hrc import meshes
from hrc.errors import AssetError, ConfigError, SensorError
from hrc.geometry import look_at
from hrc.meshes import Mesh
from hrc.messages import DepthFrame
from hrc.vision.camera import Camera, CameraConfig
from hrc.vision.localize import Localizer, VisionConfig
from hrc.vision.render import Renderer

MODES = ("interval", "paper")
BOX = meshes.box((0.1, 0.2, 0.3))


def image(value):
    return np.full(Camera().shape, value, np.float32)


@pytest.fixture(scope="module", params=MODES)
def eye(request):
    return Localizer(Camera(), (), VisionConfig(mode=request.param))


@pytest.mark.parametrize(("depth", "says"), [
    (image(1.0).astype(np.float64), "float64"),
    (image(1000.0).astype(np.uint16), "uint16"),
    (image(1.0).ravel(), r"\(217088,\)"),
    (image(1.0)[..., None], r"\(424, 512, 1\)"),
    (np.zeros((0, 0), np.float32), r"\(0, 0\)"),
    (np.where(np.arange(512) == 7, np.float32(np.nan), image(1.0)), "NaN"),
], ids=["double", "integer", "flat", "channels", "empty", "NaN"])
def test_what_is_no_depth_image_is_refused(depth, says):
    with pytest.raises(SensorError, match=says):
        DepthFrame(0, depth)


@pytest.mark.parametrize("shape", [(512, 424), (424, 511), (1, 1), (848, 1024)], ids=str)
def test_a_frame_of_another_size_is_refused_and_the_last_one_stays(eye, shape):
    eye.filter(DepthFrame(4, image(np.inf)), poses())
    with pytest.raises(SensorError, match=r"424, 512"):
        eye.filter(DepthFrame(5, np.ones(shape, np.float32)), poses())
    assert eye.foreground.tick == 4


@pytest.mark.parametrize("value", [0.0, -0.0, np.inf, -np.inf, -1.0, -1e-30, 1e-45, 1e30, 3.4e38, 1e3, 100.0])
def test_an_image_without_a_surface_near_the_robot_gives_no_contact(eye, value):
    eye.filter(DepthFrame(3, image(value)), poses())
    # A sheet against the lens is in front of everything: by the printed rule it reaches back to the robot.
    covered = value == np.float32(1e-45) and eye.config.mode == "paper"
    assert bool(eye.localize(4, poses())) == covered
    assert np.isfinite(eye.distances()).any() == covered


@pytest.mark.parametrize("value", [0.0, -1.0, np.inf], ids=str)
def test_pixels_without_a_measurement_beside_an_obstacle_change_nothing(value):
    T = poses()
    camera, eye = depth_camera(), Localizer(Camera(), ())
    camera.reset()
    camera.expose(7, T, [sphere_at(T[5][:3, 3] + [0.0, 0.15, 0.0])])
    depth = camera.latest(7).depth.copy()
    results = []
    for nothing in (np.inf, value):
        depth[~np.isfinite(depth) | (depth <= 0)] = nothing
        eye.filter(DepthFrame(7, depth.copy()), T)
        results.append([(n.link, n.pixel, n.distance) for n in eye.localize(8, T)])
    assert results[0]
    assert results[0] == results[1]


def test_after_bad_frames_a_good_one_is_seen_as_ever(eye):
    T = poses()
    camera = depth_camera()
    camera.reset()
    camera.expose(7, T, [sphere_at(T[5][:3, 3] + [0.0, 0.13, 0.0])])
    good = camera.latest(7)
    eye.filter(good, T)
    expected = [(n.link, n.pixel, n.distance) for n in eye.localize(8, T)]
    assert expected
    for value in (0.0, -np.inf, 1e-45, 3.4e38):
        eye.filter(DepthFrame(7, image(value)), T)
        eye.localize(8, T)
    eye.filter(good, T)
    assert [(n.link, n.pixel, n.distance) for n in eye.localize(8, T)] == expected


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("link", range(8))
def test_a_camera_inside_the_robot_has_a_defined_result(link, mode):
    """It sees what is in front of it; whatever is found is a finite point at a distance within reach."""
    T, rng = poses(), np.random.default_rng(link)
    inside = T[link][:3, :3] @ meshes.robot("perception")[link].vertices.mean(axis=0) + T[link][:3, 3]
    camera = small_camera().moved(look_at(inside, np.add(inside, [1.0, 0.3, 0.1])))
    eye = Localizer(camera, (), VisionConfig(mode=mode, first_link=0))
    for far in (0.02, 0.5, rng.uniform(0.0, 1.0, camera.shape), np.inf):
        eye.filter(DepthFrame(1, np.full(camera.shape, far, np.float32)), T)
        found = eye.localize(2, T)
        for n in found:
            assert np.isfinite(n.p_world).all()
            assert 0.0 <= n.distance < 0.1
            assert np.isfinite(eye.distances()[n.pixel[1], n.pixel[0]])
    assert found == ()


@pytest.mark.parametrize("bad", [
    np.full((8, 4, 4), np.nan), np.where(np.arange(4) == 3, np.inf, poses()), poses()[:7], np.eye(4),
], ids=["NaN", "infinite", "seven", "one"])
def test_poses_that_are_none_are_refused(eye, bad):
    eye.filter(DepthFrame(3, image(np.inf)), poses())
    with pytest.raises(SensorError, match="T_world_link"):
        eye.filter(DepthFrame(3, image(np.inf)), bad)
    with pytest.raises(SensorError, match="T_world_link"):
        eye.localize(4, bad)


@pytest.mark.parametrize("field", ["fx", "fy"])
@pytest.mark.parametrize("value", [0.0, -365.0, 1e-9, np.nan, np.inf])
def test_a_focal_length_that_is_none_is_refused(field, value):
    with pytest.raises(ConfigError, match=f"{field} must be a number from 10 to 10000 px"):
        CameraConfig(**{field: value})


@pytest.mark.parametrize("changes", [{"width": 0}, {"height": -424}, {"width": 512.5}, {"cx": np.nan}, {"eye": (0.0, 0.0)},
                                     {"eye": (np.nan, 0.0, 1.0)}], ids=str)
def test_other_intrinsics_and_places_that_are_none_are_refused(changes):
    with pytest.raises(ConfigError, match=next(iter(changes))):
        CameraConfig(**changes)


@pytest.mark.parametrize(("mesh", "says"), [
    (Mesh(BOX.vertices, BOX.faces[:0], BOX.normals), "no triangles"),
    (Mesh(BOX.vertices[:0], BOX.faces[:0], BOX.normals[:0]), "no triangles"),
    (Mesh(BOX.vertices[:0], BOX.faces, BOX.normals[:0]), "0 vertices"),
    (Mesh(BOX.vertices, BOX.faces + 1, BOX.normals), "index 0 to 7, not 1 to 8"),
    (Mesh(BOX.vertices, BOX.faces - 1, BOX.normals), "index 0 to 7, not -1 to 6"),
    (Mesh(np.where(BOX.vertices > 0.15, np.nan, BOX.vertices), BOX.faces, BOX.normals), "not finite"),
    (Mesh(BOX.vertices, BOX.faces, BOX.normals * np.inf), "not finite"),
    (Mesh(BOX.vertices, BOX.faces, BOX.normals[1:]), "normals"),
    (Mesh(BOX.vertices[:, :2], BOX.faces, BOX.normals[:, :2]), "vertices"),
    (Mesh(BOX.vertices, BOX.faces[:, :2], BOX.normals), "faces"),
], ids=["no triangles", "nothing", "no vertices", "index too high", "index negative", "vertex NaN", "normal infinite",
        "normal missing", "flat", "edges"])
@pytest.mark.filterwarnings("ignore:invalid value encountered in multiply")
def test_a_mesh_that_cannot_be_drawn_is_refused_by_its_number(mesh, says):
    with pytest.raises(AssetError, match=f"mesh 1 .*{says}"):
        Renderer(Camera(), [BOX, mesh])


def test_no_meshes_at_all_are_refused():
    with pytest.raises(AssetError, match="at least one"):
        Renderer(Camera(), [])


def test_a_mesh_of_a_single_point_draws_nothing():
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.tile([0.0, 0.0, 1.0], (3, 1)))
    T = Camera().T_world_camera.copy()
    T[:3, 3] += T[:3, 2]
    assert not np.isfinite(Renderer(Camera(), [flat]).render(T[None]).depth).any()
