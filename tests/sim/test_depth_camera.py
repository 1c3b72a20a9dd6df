import numpy as np
import pytest

from hrc.errors import DeviceError, SensorError
from hrc.geometry import transform
from hrc.messages import Body
from hrc.scene import BodySpec, load_scene
from hrc.sim.depth_camera import DepthCamera, SensorConfig
from hrc.vision.camera import Camera

SPECS = (BodySpec("ball", "sphere", (0.08,)), BodySpec("block", "box", (0.06, 0.12, 0.06)))
EXACT = SensorConfig(noise=0.0, flying=0.0, dropout=0.0, extrinsic_rotation_deg=0.0, extrinsic_translation=0.0)


def camera(config=None, seed=0, latency=0):
    return DepthCamera(Camera(), load_scene().environment, SPECS, config or SensorConfig(), seed=seed, latency=latency)


def upright():
    T = np.tile(np.eye(4), (8, 1, 1))
    T[1:, 2, 3] = [0.3105, 0.3105, 0.7105, 0.7105, 1.1005, 1.1005, 1.1005]
    return T


def body(spec, p, **options):
    return Body(spec.name, spec.shape, spec.size, transform(np.eye(3), p), **options)


def test_a_frame_is_the_perfect_image_up_to_quantisation_without_noise():
    eye = camera(EXACT)
    eye.expose(0, upright(), [body(SPECS[0], (0.8, 0.3, 0.6))])
    measured, perfect = eye.latest(0).depth, eye.perfect()
    both = np.isfinite(measured) & np.isfinite(perfect)
    assert both.mean() > 0.6
    assert np.abs(measured[both] - perfect[both]).max() <= 0.0005 + 1e-6
    u, v, z = (float(x) for x in Camera().project(Camera().T_camera_world[:3, :3] @ (0.8, 0.3, 0.6)
                                                  + Camera().T_camera_world[:3, 3]))
    assert measured[round(v), round(u)] == pytest.approx(z - 0.08, abs=0.003)


def test_the_same_seed_gives_the_same_bits_and_another_seed_others():
    frames = []
    for seed in (5, 5, 6):
        eye = camera(seed=seed)
        for tick in range(3):
            eye.expose(tick, upright(), [body(SPECS[1], (0.6, -0.3, 0.5))])
        frames.append(eye.latest(2).depth)
    np.testing.assert_array_equal(frames[0], frames[1])
    assert (frames[0] != frames[2]).mean() > 0.3


def test_frames_differ_from_each_other_and_repeat_after_a_reset():
    eye = camera()
    eye.expose(0, upright(), ())
    first = eye.latest(0).depth
    eye.expose(1, upright(), ())
    assert (eye.latest(1).depth != first).mean() > 0.3
    eye.reset()
    assert eye.latest(5) is None
    eye.expose(0, upright(), ())
    np.testing.assert_array_equal(eye.latest(0).depth, first)


@pytest.mark.parametrize("latency", [0, 1, 2, 5])
def test_a_frame_arrives_when_so_many_others_have_followed(latency):
    eye = camera(EXACT, latency=latency)
    ticks = [0, 33, 67, 100, 133, 167, 200]
    for i, tick in enumerate(ticks):
        eye.expose(tick, upright(), ())
        found = eye.latest(tick)
        assert (None if found is None else found.tick) == (ticks[i - latency] if i >= latency else None)
    before_last = eye.latest(ticks[-1] - 1)
    assert before_last is None if latency == len(ticks) - 1 else before_last.tick == ticks[-2 - latency]


def test_noise_has_the_sensors_size_and_no_bias():
    """The wall faces the camera 4.2 m away, and nothing stands before it on the left."""
    eye = camera(SensorConfig(extrinsic_rotation_deg=0.0, extrinsic_translation=0.0))
    errors = []
    for tick in range(5):
        eye.expose(tick, upright(), ())
        patch = np.s_[110:160, 90:150]
        errors.append((eye.latest(tick).depth[patch] - eye.perfect()[patch]).ravel())
    error = np.concatenate(errors)
    z = float(np.median(eye.perfect()[110:160, 90:150]))
    expected = 0.001 * (1.5 - 0.5 * z + 0.3 * z * z)
    assert abs(np.mean(error)) < 3e-4
    assert np.std(error) == pytest.approx(expected, rel=0.2)


def test_edges_fly_and_drop_but_surfaces_do_not():
    eye = camera(SensorConfig(noise=0.0, extrinsic_rotation_deg=0.0, extrinsic_translation=0.0))
    eye.expose(0, upright(), [body(SPECS[1], (1.0, 0.0, 0.6))])
    measured, perfect = eye.latest(0).depth, eye.perfect()
    with np.errstate(invalid="ignore"):
        wrong = ~(np.abs(measured - perfect) < 0.001) & np.isfinite(perfect) & (perfect > 0.5) & (perfect < 4.4)
    wrong[:, [0, -1]] = False
    jump = np.zeros(perfect.shape, bool)
    for axis in (0, 1):
        with np.errstate(invalid="ignore"):
            step = np.abs(np.diff(perfect, axis=axis)) > 0.02
        jump[(np.s_[:-1], np.s_[:])[axis], (np.s_[:], np.s_[:-1])[axis]] |= step
        jump[(np.s_[1:], np.s_[:])[axis], (np.s_[:], np.s_[1:])[axis]] |= step
    assert wrong.sum() > 50
    assert (wrong & jump).sum() > 0.98 * wrong.sum()


def test_nothing_is_measured_out_of_range():
    eye = camera(EXACT.replace(farthest=2.5, nearest=1.9))
    eye.expose(0, upright(), ())
    depth = eye.latest(0).depth
    seen = depth[np.isfinite(depth)]
    assert len(seen) > 1000
    assert seen.min() >= 1.9
    assert seen.max() <= 2.5


def test_the_true_pose_is_off_by_what_the_config_says():
    eye = camera(SensorConfig(extrinsic_rotation_deg=0.5, extrinsic_translation=0.01), seed=4)
    off = np.linalg.inv(Camera().T_world_camera) @ eye.true_camera.T_world_camera
    assert np.linalg.norm(off[:3, 3]) == pytest.approx(0.01)
    assert np.degrees(np.arccos((np.trace(off[:3, :3]) - 1) / 2)) == pytest.approx(0.5)
    np.testing.assert_array_equal(camera(EXACT).true_camera.T_world_camera, Camera().T_world_camera)


def test_it_sees_what_is_in_view_and_not_what_is_hidden():
    eye = camera(EXACT)
    assert not eye.sees((0.1, 0.0, 0.9))  # nothing rendered yet
    eye.expose(0, upright(), [body(SPECS[1], (1.2, 0.0, 0.8))])
    assert eye.sees((1.26, 0.0, 0.8))
    assert not eye.sees((1.14, 0.0, 0.8))  # the back of the block
    assert not eye.sees((0.07, 0.0, 0.85))  # on the arm, behind the block
    assert not eye.sees((5.0, 0.0, 0.8))  # behind the camera
    eye.expose(1, upright(), [body(SPECS[1], (1.2, 0.0, 0.8), present=False)])
    assert not eye.sees((1.26, 0.0, 0.8))


def test_what_it_was_not_built_for_is_refused():
    with pytest.raises(SensorError, match="ball"):
        camera().expose(0, upright(), [body(BodySpec("bal", "sphere", (0.1,)), (0, 0, 1))])
    with pytest.raises(DeviceError, match="cpu"):
        DepthCamera(Camera(), (), (), device="cuda:9")
