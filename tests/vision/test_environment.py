"""The environment learned from images of the empty cell: no noise is left over, and little is lost before it."""

import functools

import numpy as np
import pytest
from eye_robot import PERFECT, POSTURE, poses, sphere_at

from hrc.errors import SensorError
from hrc.geometry import transform
from hrc.meshes import robot
from hrc.messages import Body, DepthFrame, RobotImage
from hrc.scene import BodySpec, load_scene
from hrc.sim.depth_camera import DepthCamera, SensorConfig
from hrc.vision.camera import Camera
from hrc.vision.environment import environment_mask, learned_environment
from hrc.vision.localize import Localizer, VisionConfig
from hrc.vision.reference import filtered, supported
from hrc.vision.render import Renderer, environment_depth

FIRST_JOINT = np.eye(7)[0]
ASIDE = np.array([1.2, -0.4, 0.5, 1.0, 0.0, -0.5, 0.0])
NO_ROBOT = np.zeros((8, 4, 4))  # zeros: not drawn
HAND = BodySpec("hand", "sphere", (0.04,))
NOTHING = np.full(Camera().shape, np.inf)
MARGIN = VisionConfig().environment_margin


def frame(*rows):
    return DepthFrame(0, np.array(rows, np.float32))


def hand_above_table(height):
    """Its lowest point so far above the table's top [m]."""
    return Body("hand", "sphere", (0.04,), transform(np.eye(3), (-0.3, 0.3, height + 0.04)))


@functools.cache
def kinect():
    return DepthCamera(Camera(), load_scene().environment, [HAND], SensorConfig(), seed=5, latency=0)


def newest(camera) -> DepthFrame:
    frame = camera.latest(10**6)
    assert frame is not None
    return frame


def shoot(number, T=NO_ROBOT, *bodies) -> list[DepthFrame]:
    frames = []
    for tick in range(number):
        kinect().expose(tick, T, bodies)
        frames.append(newest(kinect()))
    return frames


@functools.cache
def learned():
    return learned_environment(shoot(30))


def test_an_empty_cell_leaves_a_handful_of_pixels_and_no_patch():
    mask = environment_mask(Camera(), learned(), MARGIN)
    for empty in shoot(10):
        left = filtered(empty.depth, NOTHING, mask)
        assert np.isfinite(left).sum() <= 5
        assert np.isinf(supported(left, VisionConfig().neighbours)).all()


def test_a_single_image_of_the_same_cell_would_leave_hundreds():
    """The statistic earns its keep: without it depth edges flicker."""
    (only,) = shoot(1)
    mask = environment_mask(Camera(), only.depth, MARGIN)
    leaks = [np.isfinite(filtered(empty.depth, NOTHING, mask)).sum() for empty in shoot(3)]
    assert min(leaks) > 200


@pytest.mark.parametrize("height", [0.02, 0.06])
def test_a_hand_above_the_table_survives_no_less_than_before_the_models_boxes(height):
    """The camera is a quarter of a degree and 5 mm off its calibration: the boxes are, too, the learned image is not."""
    (with_hand,) = shoot(1, NO_ROBOT, hand_above_table(height))
    seen = kinect().perfect()
    kinect().expose(0, NO_ROBOT, ())
    hand = (seen < kinect().perfect() - 1e-4) & np.isclose(with_hand.depth, seen, atol=0.03)
    assert hand.sum() > 50
    kept = {}
    for name, environment in (("learned", learned()), ("boxes", load_scene().environment)):
        mask = environment_mask(Camera(), environment, MARGIN)
        kept[name] = np.isfinite(filtered(with_hand.depth, NOTHING, mask))[hand].mean()
    assert kept["learned"] > 0.97
    assert kept["learned"] >= kept["boxes"]


def test_the_robot_is_left_out_by_its_own_image():
    """It moves while the cell is learned; afterwards it stands elsewhere, and nothing of it or behind it is an obstacle."""
    own = Renderer(Camera(), robot("filter"))
    own.expand(0.03)
    turns = np.linspace(-0.8, 0.8, 12)
    pairs = [(shoot(1, T)[0], own.render(T)) for T in (poses(POSTURE + turn * FIRST_JOINT) for turn in turns)]
    environment = learned_environment(*zip(*pairs, strict=True))
    both = np.isfinite(environment) & np.isfinite(learned())
    assert np.isclose(environment, learned(), atol=0.03)[both].mean() > 0.97
    eye = Localizer(Camera(), environment)
    T = poses(ASIDE)
    eye.filter(shoot(1, T)[0], T)
    assert np.isfinite(eye.foreground.depth).sum() < 20
    assert eye.localize(1, T) == ()


def test_what_the_robot_always_hid_begins_to_be_environment_at_the_farthest_place_it_was():
    covers = [np.array([[1.0, 2.0, np.inf]]), np.array([[1.5, 2.0, np.inf]])]
    frames = [frame([1.03, 1.9, 3.0]), frame([1.53, 1.9, 3.0])]
    robots = [RobotImage(cover.astype(np.float32), np.zeros((1, 3), np.uint8)) for cover in covers]
    wide = [DepthFrame(0, np.repeat(f.depth, 5, axis=1)) for f in frames]  # 5 x 5 pixels count
    robots = [RobotImage(np.repeat(r.depth, 5, axis=1), np.repeat(r.link, 5, axis=1)) for r in robots]
    np.testing.assert_allclose(learned_environment(wide, robots)[0, [2, 7, 12]], [1.5, 1.9, 3.0])


def test_the_median_passes_over_a_passer_by_and_an_edge_takes_its_front():
    wall, hand, beyond = (np.full((9, 9), depth, np.float32) for depth in (3.0, 1.0, 4.0))
    for strays in ((hand, hand), (beyond, beyond), (hand, beyond)):
        environment = learned_environment([DepthFrame(0, image) for image in (wall, wall, wall, *strays)])
        assert (environment == 3.0).all()
    step = wall.copy()
    step[:, :4] = 2.0
    environment = learned_environment([DepthFrame(0, step)])
    np.testing.assert_array_equal(environment[4], [2.0] * 6 + [3.0] * 3)


def test_invalid_pixels_stay_open_and_rare_readings_count():
    never, once = np.full((9, 9), np.inf, np.float32), np.full((9, 9), np.inf, np.float32)
    once[4, 4] = 2.5
    assert np.isinf(learned_environment([DepthFrame(0, never)] * 3)).all()
    environment = learned_environment([DepthFrame(0, never), DepthFrame(0, once), DepthFrame(0, never)])
    assert (environment[2:7, 2:7] == 2.5).all()
    assert np.isfinite(environment).sum() == 25


def test_the_margin_is_live_for_boxes_and_for_an_image():
    camera = DepthCamera(Camera(), load_scene().environment, [HAND], PERFECT, latency=0)
    camera.expose(0, NO_ROBOT, (hand_above_table(0.02),))
    image = environment_depth(Camera(), load_scene().environment)
    far = poses(ASIDE)
    for environment in (load_scene().environment, image):
        eye, left = Localizer(Camera(), environment), []
        for margin in (0.02, 0.5):
            eye.configure(VisionConfig(environment_margin=margin))
            eye.filter(newest(camera), far)
            left.append(np.isfinite(eye.foreground.depth).sum())
        assert left[0] > 50
        assert left[1] == 0


def test_an_image_in_place_of_boxes_finds_the_same_contact():
    T = poses()
    camera = DepthCamera(Camera(), load_scene().environment, [BodySpec("sphere", "sphere", (0.05,))], PERFECT, latency=0)
    camera.expose(0, T, [sphere_at([-0.131, 0.038, 0.696])])
    found = []
    for environment in (load_scene().environment, environment_depth(Camera(), load_scene().environment)):
        eye = Localizer(Camera(), environment)
        eye.filter(newest(camera), T)
        found.append(eye.localize(0, T)[0])
    assert found[0].link == found[1].link == 4
    np.testing.assert_allclose(found[0].p_world, found[1].p_world, atol=1e-6)
    assert np.linalg.norm(found[0].p_world - [-0.174, 0.035, 0.671]) < 0.03


def test_what_is_no_environment_is_refused():
    with pytest.raises(SensorError, match="30"):
        learned_environment([])
    with pytest.raises(SensorError, match="same size"):
        learned_environment([frame([1.0, 2.0]), frame([1.0])])
    with pytest.raises(SensorError, match="as many robot images"):
        learned_environment([frame([1.0])], [])
    with pytest.raises(SensorError, match="must stay where it was"):
        Localizer(Camera(), np.ones(Camera().shape)).move(np.eye(4))
    with pytest.raises(SensorError, match="424, 512"):
        Localizer(Camera(), np.ones((240, 320)))
    for bad in (0.0, -1.0, np.nan):
        image = np.ones(Camera().shape)
        image[3, 4] = bad
        with pytest.raises(SensorError, match="> 0"):
            Localizer(Camera(), image)
