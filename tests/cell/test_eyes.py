"""Several cameras: each with its own parameters, one picture of the surroundings."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from hrc import meshes
from hrc.cell.cell import Cell
from hrc.cell.eyes import Sighting, rig
from hrc.config import PRESETS, Config
from hrc.errors import AssetError
from hrc.events import MoveObstacle, SetParameter
from hrc.geometry import apply
from hrc.messages import Nearest
from hrc.vision.camera import Camera


def scene(tmp_path, *cameras: str) -> Config:
    file = tmp_path / "scene.toml"
    file.write_text('extends = "cell"\n' + "".join(f"[[camera]]\n{camera}\n" for camera in cameras))
    return Config(scene=str(file))


def test_a_scene_without_cameras_has_the_one_of_the_config():
    setup, = rig(Config())
    assert (setup.camera, setup.sensor, setup.hz) == (Config().camera, Config().sensor, 30)


def test_each_camera_has_its_own_parameters(tmp_path):
    first, second = rig(scene(tmp_path, 'name = "a"', 'name = "b"\nhz = 15\nwidth = 256\nlatency = 1\nnoise = 2.0'))
    assert first.camera.width == 512
    assert (second.camera.width, second.sensor.latency, second.sensor.noise, second.hz) == (256, 1, 2.0, 15)


@pytest.mark.parametrize(("entry", "complaint"), [
    ("fxx = 3.0", 'camera "a": unknown parameter "fxx"; did you mean fx'),
    ("fx = 0.0", 'camera "a": fx must be a number from 10'),
    ("hz = 0", 'camera "a": camera_hz must be'),
    ("eye = [0.0, 0.0, 2.0]\ntarget = [0.0, 0.0, 0.0]", 'camera "a": the camera must not look straight up or down'),
])
def test_an_impossible_camera_is_one_clear_error(tmp_path, entry, complaint):
    with pytest.raises(AssetError, match=complaint):
        Cell(scene(tmp_path, f'name = "a"\n{entry}'))


def test_frames_come_at_each_cameras_rate_and_delay(tmp_path):
    cell = Cell(scene(tmp_path, 'name = "fast"\nlatency = 0', 'name = "slow"\nhz = 10\nlatency = 1\nwidth = 128\nheight = 106'))
    stamps = {"fast": set(), "slow": set()}
    for _ in range(1000):
        for view in cell.step().views:
            if view.frame is not None:
                stamps[view.camera].add(view.frame.tick)
                assert view.frame.depth.shape == ((424, 512) if view.camera == "fast" else (106, 128))
    assert len(stamps["fast"]) == 30
    assert stamps["slow"] == {100 * k for k in range(1, 10)}


def test_one_of_two_cameras_may_fail(tmp_path):
    cell = Cell(scene(tmp_path, 'name = "a"\nunplugged = true', 'name = "b"'))
    cell.apply(MoveObstacle("ball", (-0.2, 0.5, 0.6)))
    for _ in range(700):
        snapshot = cell.step()
    assert [view.silent for view in snapshot.views] == [True, False]
    assert snapshot.command.mode == "idle"
    assert {c.camera for c in snapshot.clearances} == {"b"}


def test_what_an_obstacle_removed_leaves_is_forgotten():
    cell = Cell(PRESETS["two_cameras"]())
    cell.apply(MoveObstacle("ball", (-0.2, 0.45, 0.6)))
    for _ in range(600):
        snapshot = cell.step()
    assert 0.05 < snapshot.clearance < 0.5
    for camera in ("behind", "before"):
        assert camera in {view.camera for view in snapshot.views}
    cell.apply(MoveObstacle("ball", (2.0, 3.5, 0.1)))
    for _ in range(9000):
        snapshot = cell.step()
        if snapshot.clearance == np.inf:
            break
    assert snapshot.clearance == np.inf
    assert snapshot.clearances == ()


def test_a_sighting_forgets_what_old_images_say():
    old, new = (Nearest(9, stamp, 4, np.zeros(3), np.zeros(3), 0.1, (0, 0)) for stamp in (3, 7))
    assert Sighting((old, new), (old,)).since(5) == Sighting((new,), ())


def test_a_live_change_of_the_sensor_reaches_every_camera_but_what_the_scene_sets(tmp_path):
    config = scene(tmp_path, 'name = "a"', 'name = "b"\nnoise = 0.0')
    cell = Cell(config)
    cell.apply(SetParameter("sensor.noise", 3.0))
    first, second = rig(cell.config)
    assert (first.sensor.noise, second.sensor.noise) == (3.0, 0.0)


def test_the_camera_sees_what_a_visitor_may_bring():
    """Foreground on the body's surface, and only there."""
    cell, T = Cell(), Camera().T_world_camera
    places = {"hand": (0.15, 0.55, 0.35), "forearm": (0.15, -0.55, 0.35), "figure": (-1.1, -0.7, 0.5)}
    for name, position in places.items():
        cell.apply(MoveObstacle(name, position, (0.8, 0.0, 0.0, 0.6)))
    for _ in range(300):
        snapshot = cell.step()
    foreground = snapshot.views[0].foreground
    assert foreground is not None
    v, u = np.nonzero(np.isfinite(foreground.depth) & (foreground.depth > 0.0))
    seen = apply(T, Camera().unproject(u, v, foreground.depth[v, u]))
    bodies = [body for body in snapshot.bodies if body.name in places]
    parts = {"hand": 100, "forearm": 200, "figure": 1000}
    left = np.ones(len(seen), bool)
    for body in bodies:
        mesh = meshes.shape(body.shape, body.size)
        surface = trimesh.sample.sample_surface(trimesh.Trimesh(mesh.vertices, mesh.faces), 20_000, seed=0)[0]
        near = KDTree(apply(body.T_world_body, surface)).query(seen)[0] < 0.05
        assert near.sum() > parts[body.name], body.name
        left &= ~near
    assert left.mean() < 0.02
