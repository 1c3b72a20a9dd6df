"""The parts of the page that need no server: what the mailbox keeps, what the log says, what is drawn of an image."""

from dataclasses import replace

import numpy as np
import pytest

from app import palette
from app.serve import images
from app.serve.banner import Facts, banner, facts
from app.serve.distances import lines
from app.serve.driver import Phase, Status
from app.serve.journal import Journal
from app.serve.mailbox import PLOT_POINTS, Mailbox, Note
from app.serve.pictures import EMPTY, OBSTACLE, Pictures
from app.serve.session import Session
from app.serve.sight import MAX_POINTS, NEAR_BASE, VOXEL, Sight
from app.serve.signals import WINDOW, columns
from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.events import MoveObstacle, Pull, Reset, SetParameter, Stop
from hrc.geometry import apply
from hrc.messages import Aim, Clearance, DepthFrame, Mode, Nearest, RobotImage, Snapshot, Truth, View
from hrc.vision.camera import Camera, CameraConfig


@pytest.fixture(scope="module")
def snapshot() -> Snapshot:
    """A real one, to make others from."""
    return Cell().step()


def with_force(snapshot: Snapshot, tick: int, newtons: float) -> Snapshot:
    truth = Truth(np.array([newtons, 0.0, 0.0]), np.zeros(3), 4, np.zeros(7))
    return replace(snapshot, tick=tick, time=tick / 1000, truth=truth, fresh_control=True, events=(), refused=())


def test_a_force_peak_between_two_points_of_the_plot_is_kept(snapshot: Snapshot) -> None:
    mailbox = Mailbox()
    for tick in range(0, 1000, 5):
        mailbox.on_step(with_force(snapshot, tick, 42.0 if tick == 535 else 1.0))
    points = mailbox.forces()
    assert max(point.truth for point in points) == 42.0
    assert sum(point.truth == 42.0 for point in points) == 1
    assert len(points) == 10


def test_plot_is_bounded_and_starts_anew_after_a_reset(snapshot: Snapshot) -> None:
    mailbox = Mailbox()
    for tick in range(0, 40_000, 100):
        mailbox.on_step(with_force(snapshot, tick, 1.0))
    assert len(mailbox.forces()) == PLOT_POINTS
    mailbox.on_step(replace(with_force(snapshot, 5, 1.0), events=(Reset(),)))
    assert [point.time for point in mailbox.forces()] == [0.005]


def test_the_plot_tells_how_long_ago_and_fills_its_axis(snapshot: Snapshot) -> None:
    mailbox = Mailbox()
    for tick in range(0, 40_000, 5):
        mailbox.on_step(with_force(snapshot, tick, 1.0))
    ago, _, truth, f_relax, _ = columns(mailbox.forces(), 5.0, 25.0)
    assert ago[-1] == 0.0
    assert -WINDOW - 0.005 * PLOT_POINTS <= ago[0] <= -WINDOW + 0.1, "a point comes up to one control tick late"
    assert (np.diff(ago) > 0.0).all()
    assert truth.tolist() == [1.0] * PLOT_POINTS
    assert f_relax.tolist() == [5.0] * PLOT_POINTS


def test_no_event_refusal_or_mode_is_lost_between_two_looks(snapshot: Snapshot) -> None:
    mailbox = Mailbox()
    wrong = SetParameter("control.f_relax", -1.0)
    for tick in range(100):
        quiet = with_force(snapshot, tick, 0.0)
        mailbox.on_step(replace(quiet, events=(Stop(),), refused=((wrong, "too low"),)) if tick == 50 else quiet)
    notes = mailbox.take_notes()
    assert [note.subject for note in notes] == [Mode.IDLE, Stop(), wrong]
    assert notes[2].refused == "too low"
    assert mailbox.take_notes() == []


def test_log_joins_a_drag_into_one_line_and_escapes() -> None:
    journal = Journal(lambda: 7.0)
    for y in (0.1, 0.2, 0.3):
        journal.add(Note(1.0, Pull(4, (0.0, 0.0, 0.0), (0.0, y, 0.0))))
    for y in (0.1, 0.2):
        journal.add(Note(2.0, MoveObstacle("ball", (0.0, y, 0.0))))
    assert journal.html().count("<time>") == 2
    assert "(0.00, 0.20, 0.00)" in journal.html()
    journal.add(Note(2.0, MoveObstacle("slab", (0.0, 0.5, 0.0), (0.5, 0.0, 0.0, -0.866))))
    assert "slab to (0.00, 0.50, 0.00) m, turned 120 deg" in journal.html()
    journal.add(Note(3.0, Stop("<script>alert(1)</script>")))
    journal.refuse("<img src=x>")
    assert "<script>" not in journal.html()
    assert "<img" not in journal.html()
    assert journal.html().index("7.00 s") < journal.html().index("3.00 s"), "newest first"


def test_banner_escapes_and_changes_with_every_beat() -> None:
    known = Facts("stop", note='<b onclick="x">')
    assert "<b onclick" not in banner(known, 1)
    assert banner(known, 1) != banner(known, 2)
    assert 'data-mode="stop"' in banner(known, 1)
    assert "CAPPED" in banner(replace(known, capped=True), 1)


def test_banner_shows_the_force_as_a_part_of_what_a_hand_may_bear() -> None:
    known = Facts("relax", force=35.0, region="hand", limit=140.0)
    assert 'data-share="25.0"' in banner(known, 1)
    assert "25 % of 140 N, hand (indicative)" in banner(known, 1)
    assert 'width:100%"' in banner(replace(known, force=300.0), 1)
    assert "eb-bar" not in banner(Facts("starting"), 1)


def test_points_of_the_sight_are_where_the_camera_saw_them() -> None:
    camera = Camera()
    depth = np.full(camera.shape, np.inf, np.float32)
    p_world = np.array([-0.3, 0.2, 0.5])
    u, v, z = camera.project(apply(camera.T_camera_world, p_world))
    depth[round(float(v)), round(float(u))] = z
    depth[0, 0] = 50.0  # far from the robot: not shown
    points = Sight(camera).points(DepthFrame(0, depth))
    assert points.shape == (1, 3)
    assert np.linalg.norm(points[0] - p_world) < 0.005  # within a pixel


def test_points_are_few_and_near_even_when_the_view_is_full() -> None:
    camera = Camera()
    sight = Sight(camera)
    points = sight.points(DepthFrame(0, np.full(camera.shape, 2.2, np.float32)))
    assert MAX_POINTS / 2 < len(points) <= MAX_POINTS
    assert np.linalg.norm(points, axis=1).max() < NEAR_BASE
    assert len(sight.points(DepthFrame(0, np.full(camera.shape, np.inf, np.float32)))) == 0


def test_of_points_that_crowd_one_stands_for_its_voxel() -> None:
    camera = Camera()
    p_world = np.array([-0.3, 0.2, 0.5])
    u, v, z = camera.project(apply(camera.T_camera_world, p_world))
    depth = np.full(camera.shape, np.inf, np.float32)
    depth[round(float(v)) - 9:round(float(v)) + 9, round(float(u)) - 9:round(float(u)) + 9] = z
    points = Sight(camera).points(DepthFrame(0, depth))
    assert len({tuple(cell) for cell in np.floor((points + NEAR_BASE) / VOXEL).astype(int)}) == len(points) < 18 * 18
    far = np.linalg.norm(points[:, None] - points, axis=2) + np.eye(len(points))
    assert far.min(axis=1).max() < 2.0 * VOXEL, "none is left out between them"


def test_a_point_of_the_robot_is_in_the_picture_wherever_the_camera_stands() -> None:
    for eye in ((2.2, 0.0, 0.75), (-1.75, -1.35, 1.15), (0.3, 2.0, 2.0), (0.3, 0.2, 0.6)):
        camera = Camera(CameraConfig(eye=eye, target=(-0.3, 0.0, 0.5)))
        u, v, _ = camera.project(apply(camera.T_camera_world, np.array([-0.3, 0.0, 0.5])))
        drawn = Pictures(camera)
        ring = drawn.marked(drawn.blank, (float(u), float(v)), (9, 9, 9), 0.05)
        assert (ring == 9).all(axis=2).sum() > 20, eye
        assert max(drawn.blank.shape) <= 400


def around(camera: Camera, pixel: tuple[int, int], values: list[float]) -> np.ndarray:
    """A depth image, empty but for a square of 9 by 9 pixels at (u, v), its columns in equal shares of these depths."""
    image = np.full(camera.shape, np.inf, np.float32)
    u, v = pixel
    image[v - 4 : v + 5, u - 4 : u + 5] = np.repeat(values, 9 // len(values))
    return image


PIXEL = (255, 200)


def test_the_three_pictures_tell_robot_obstacle_and_holes_apart() -> None:
    camera = Camera()
    depth = around(camera, PIXEL, [2.0, 2.5, 3.0])
    link = np.where(np.isfinite(depth), 4, 255).astype(np.uint8)
    measured, expected, remaining = images.draw(
        View("camera", DepthFrame(0, depth), DepthFrame(0, depth), RobotImage(depth, link)), Pictures(camera), ()).values()
    ring = Pictures(camera).marked(Pictures(camera).blank, PIXEL, (9, 9, 9), 0.05)
    v, u = (round(float(x)) for x in np.argwhere((ring == 9).all(axis=2)).mean(axis=0))
    near, far = measured[v, u - 3], measured[v, u + 3]
    assert near[0] == near[1] == near[2] > far[0], "grey, and brighter where it is nearer"
    np.testing.assert_allclose(expected[v, u], palette.LINKS[4], atol=1)
    np.testing.assert_allclose(remaining[v, u], OBSTACLE, atol=1)
    for picture in (measured, expected, remaining):
        assert tuple(picture[0, 0]) == EMPTY
        assert (picture != EMPTY).any(axis=2).sum() == 81


def test_a_silent_camera_is_crossed_out_and_one_without_a_frame_is_empty() -> None:
    camera = Pictures(Camera())
    depth = np.full(Camera().shape, 2.0, np.float32)
    robot = RobotImage(depth, np.full(depth.shape, 3, np.uint8))
    alive = images.draw(View("camera", DepthFrame(0, depth), DepthFrame(0, depth), robot), camera, ())
    silent = images.draw(View("camera", DepthFrame(0, depth), DepthFrame(0, depth), robot, silent=True), camera, ())
    for name, picture in silent.items():
        red = (picture == (255, 59, 48)).all(axis=2)
        assert red[3, 3] or red[2, 2]
        assert picture[~red].max() < alive[name].max() / 2
    assert all((picture == EMPTY).all() for picture in images.draw(View("camera"), camera, ()).values())


def test_touches_are_marked_in_the_images_of_the_camera_that_sees_them(snapshot: Snapshot) -> None:
    def touch(camera: str, pixel: tuple[int, int], *, sure: bool) -> Nearest:
        return Nearest(0, 0, 4, np.zeros(3), np.zeros(3), 0.01, pixel, camera, sure)

    touched = replace(snapshot, touches=(touch("left", (250, 200), sure=True), touch("right", (260, 210), sure=False)))
    assert [mark[:2] for mark in images.contacts(touched, "left", Camera())] == [((250, 200), palette.TOUCH)]
    assert [mark[:2] for mark in images.contacts(touched, "right", Camera())] == [((260, 210), palette.UNSURE)]


def clearance(link: int, distance: float) -> Clearance:
    return Clearance(0, 0, link, distance, np.array([0.0, 0.0, link]), np.array([0.0, distance, link]))


def test_a_line_joins_the_two_witness_points_and_those_out_of_range_are_not_drawn() -> None:
    points, colours = lines([clearance(3, 0.1), clearance(5, 0.3), clearance(6, palette.FAR), clearance(7, np.inf)])
    assert points.shape == colours.shape == (2, 2, 3)
    np.testing.assert_allclose(points[:, 0], [(0, 0, 3), (0, 0, 5)])
    np.testing.assert_allclose(np.linalg.norm(points[:, 1] - points[:, 0], axis=1), [0.1, 0.3], atol=1e-6)
    assert (colours[:, 0] == colours[:, 1]).all()
    assert lines(())[0].shape == (0, 2, 3)


def test_lines_are_red_when_near_and_darker_the_farther_they_reach() -> None:
    shades = palette.by_distance(np.linspace(0.0, palette.FAR, 60)).astype(int)
    red, green, blue = shades[0]
    assert red > 3 * max(green, blue)
    assert (shades[:6] == shades[0]).all(), "all the same below 5 cm"
    assert (np.diff(shades[:, 0]) <= 0).all()
    assert shades[-1].max() < 60


def test_banner_names_the_nearest_link_and_the_cameras_that_are_silent() -> None:
    known = Facts("idle", nearest="link_4", clearance=0.123)
    assert "nearest obstacle: link 4, 12 cm" in banner(known, 1)
    assert "none in sight" in banner(Facts("idle"), 1)
    assert "silent</div>" not in banner(known, 1)
    assert "camera &quot;left&quot; is silent" in banner(replace(known, silent=("left",), cameras=3), 1)
    two = banner(replace(known, silent=("left", "<right>"), cameras=3), 1)
    assert "are silent" in two
    assert "<right>" not in two
    assert "no camera delivers images" in banner(replace(known, silent=("camera",)), 1)


def test_banner_says_what_the_arm_is_about(snapshot: Snapshot) -> None:
    session, config = Session(Mailbox(), say=lambda _: None), Config()
    session.status = Status(Phase.RUNNING)
    free = replace(snapshot, clearances=(), contact=None, command=replace(snapshot.command, mode=Mode.IDLE, path_speed=1.0),
                   aim=Aim("hexagon", snapshot.aim.q_d))
    assert facts(session, free, config).note == "following the path"
    held = replace(free, aim=replace(free.aim, kind="hold"))
    assert facts(session, held, config).note == "holding its place"
    assert facts(session, replace(free, aim=replace(free.aim, arrived=False)), config).note == "going to the path"
    slow = replace(free, clearances=(clearance(4, 0.2),), command=replace(free.command, path_speed=0.3))
    apart = config.replace(control=replace(config.control, separation=True, slow_from=0.25, stand_at=0.1))
    assert facts(session, slow, apart).note == "slower: an obstacle is 20 cm away"
    assert facts(session, replace(slow, clearances=(clearance(4, 0.09),)), apart).note.startswith("standing still")
    assert facts(session, slow, config).note == "going to the path", "nothing slows it but where it is"


def test_banner_says_when_the_cell_does_not_answer(snapshot: Snapshot) -> None:
    session, config = Session(Mailbox(), say=lambda _: None), Config()
    session.status = Status(Phase.RUNNING)
    assert facts(session, snapshot, config).mode != "not responding"
    session._alive -= 3.0
    known = facts(session, snapshot, config)
    assert (known.mode, known.factor) == ("not responding", 0.0)
    assert "3 s" in known.note


def test_banner_says_what_an_abort_waits_for(snapshot: Snapshot) -> None:
    session, config = Session(Mailbox(), say=lambda _: None), Config()
    session.status = Status(Phase.RUNNING)
    aborting = replace(snapshot, command=replace(snapshot.command, mode=Mode.ABORT), detected=False)
    near, far = (replace(aborting, clearances=(clearance(4, d),)) for d in (0.021, config.control.abort_distance + 0.001))
    assert "2.1 cm" in facts(session, near, config).note
    assert "waiting" in facts(session, near, config).note
    assert "waiting" not in facts(session, far, config).note
    assert "waiting" not in facts(session, replace(near, detected=True), config).note
