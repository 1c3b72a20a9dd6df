import numpy as np
import pytest
from eye_scenes import DeviceStages, random_meshes, random_poses, small_camera

from hrc import meshes
from hrc.errors import DeviceError
from hrc.geometry import transform
from hrc.scene import Box
from hrc.vision import kernels, reference
from hrc.vision.camera import Camera
from hrc.vision.render import Renderer, environment_depth


@pytest.mark.parametrize("margin", [0.0, 0.03])
@pytest.mark.parametrize("seed", range(6))
def test_raster_agrees_with_ray_casting(seed, margin):
    """No pixel of the silhouette and no link differs, and depth only by the bits a key gives up."""
    rng = np.random.default_rng(seed)
    camera, shapes = small_camera(), random_meshes(9, rng)
    poses = random_poses(9, rng)
    depth, link = DeviceStages(camera).render(shapes, poses, margin)
    cast_depth, cast_link = reference.render(camera, shapes, poses, margin)
    np.testing.assert_array_equal(np.isfinite(depth), np.isfinite(cast_depth))
    seen = np.isfinite(depth)
    assert seen.sum() > 200
    assert np.abs(depth[seen] - cast_depth[seen]).max() < 2e-5
    np.testing.assert_array_equal(link, cast_link)


def test_nothing_leaks_over_the_right_border():
    """A triangle that leaves the image on the right must not appear in the next row on the left."""
    camera = small_camera(96, 64)
    wall = meshes.box((0.5, 2.0, 0.1))
    pose = transform(np.eye(3), [camera.unproject(90, 0, 2.0)[0] + 0.5, 0.0, 2.0])[None]
    depth, _ = DeviceStages(camera).render([wall], pose)
    assert np.isfinite(depth[:, 95]).all()
    assert not np.isfinite(depth[:, :80]).any()


@pytest.mark.parametrize("size", [(96, 64), (90, 60)])
@pytest.mark.parametrize("radius", [0.02, 0.3])
def test_nothing_leaks_over_the_last_corner(size, radius):
    """Triangles are drawn in whole vectors, which may end below the image; what is there stays empty."""
    camera, ball = small_camera(*size), meshes.sphere(radius, 3)
    raster = kernels.Rasteriser(kernels.grid(camera), [ball], "cpu")
    pose = transform(np.eye(3), camera.unproject(size[0] - 1, size[1] - 1, 1.0))[None]
    raster.place(pose)
    raster.launch()
    depth, _ = raster.image()
    cast, _ = reference.render(camera, [ball], pose)
    np.testing.assert_array_equal(np.isfinite(depth), np.isfinite(cast))
    assert np.isfinite(depth[-1, -1])
    rows = raster.keys.numpy()
    width = raster.grid.stride
    assert not rows[width * size[1]:].any()
    assert not rows[: width * size[1]].reshape(-1, width)[:, size[0]:].any()


def test_a_mesh_at_the_zero_pose_or_behind_the_camera_is_not_drawn():
    camera = small_camera()
    ball = meshes.sphere(0.2, 2)
    poses = np.stack([np.zeros((4, 4)), transform(np.eye(3), [0.0, 0.0, -1.0])])
    depth, link = DeviceStages(camera).render([ball, ball], poses)
    assert not np.isfinite(depth).any()
    assert (link == 255).all()


def test_a_margin_only_brings_surfaces_nearer():
    camera = Camera()
    poses = np.tile(np.eye(4), (8, 1, 1))
    poses[1:, 2, 3] = [0.3105, 0.3105, 0.7105, 0.7105, 1.1005, 1.1005, 1.1005]
    renderer = Renderer(camera, meshes.robot("perception"))
    true = renderer.render(poses)
    renderer.expand(0.03)
    expanded = renderer.render(poses)
    on = np.isfinite(true.depth)
    assert on.sum() > 3000
    assert (expanded.depth[on] < true.depth[on] - 0.005).all()


@pytest.mark.parametrize("grow", [0.0, 0.04])
def test_boxes_are_seen_where_a_ray_caster_sees_them(grow):
    camera = Camera()
    boxes = [Box("table", (-0.3, 0.0, -0.02), (0.9, 0.9, 0.02)), Box("wall", (-2.02, 0.0, 1.0), (0.02, 0.5, 1.0))]
    shapes = [meshes.box(np.add(b.half, grow)) for b in boxes]
    poses = np.array([camera.T_camera_world @ transform(np.eye(3), b.centre) for b in boxes])
    cast, _ = reference.render(camera, shapes, poses)
    depth = environment_depth(camera, boxes, grow)
    assert (np.isfinite(cast) != np.isfinite(depth)).mean() < 1e-4  # a ray may graze an edge
    both = np.isfinite(cast) & np.isfinite(depth)
    np.testing.assert_allclose(depth[both], cast[both], atol=1e-9)


def test_a_floor_beneath_the_camera_fills_the_lower_image():
    camera = Camera()
    depth = environment_depth(camera, [Box("floor", (0.0, 0.0, -0.82), (8.0, 8.0, 0.02))])
    assert np.isfinite(depth[-1]).all()
    eye_height = camera.config.eye[2] + 0.8
    world_down = (camera.rays()[-1] @ camera.T_world_camera[:3, :3].T)[:, 2]
    np.testing.assert_allclose(depth[-1], -eye_height / world_down)


def test_an_unknown_device_is_named_with_the_known_ones():
    with pytest.raises(DeviceError, match="cpu"):
        kernels.warm("npu:7")
