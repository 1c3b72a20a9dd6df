"""The parts of the page that need no server: what the mailbox keeps, what the log says, what the sight shows."""

from dataclasses import replace

import numpy as np
import pytest

from app.serve.banner import Facts, banner
from app.serve.journal import Journal
from app.serve.mailbox import PLOT_POINTS, Mailbox, Note
from app.serve.sight import MAX_POINTS, NEAR_BASE, OBSTACLE, Sight
from hrc.cell.cell import Cell
from hrc.events import MoveObstacle, Pull, Reset, SetParameter, Stop
from hrc.geometry import apply
from hrc.messages import DepthFrame, Mode, RobotImage, Snapshot, Truth
from hrc.vision.camera import Camera


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


def test_picture_tells_robot_obstacle_and_holes_apart() -> None:
    camera = Camera()
    depth, foreground = np.full(camera.shape, 2.0, np.float32), np.full(camera.shape, np.inf, np.float32)
    link = np.full(camera.shape, 255, np.uint8)
    depth[:100], foreground[100:200], link[200:300] = np.inf, 2.0, 3
    robot = RobotImage(np.where(link == 255, np.inf, depth).astype(np.float32), link)
    picture = Sight(camera).picture(DepthFrame(0, depth), DepthFrame(0, foreground), robot)
    assert picture.shape == (camera.shape[0] // 2, camera.shape[1] // 2, 3)
    hole, obstacle, arm, scene = picture[10, 10], picture[75, 10], picture[125, 10], picture[200, 10]
    assert tuple(obstacle) == OBSTACLE
    assert arm[0] > arm[2]
    assert scene[0] == scene[2]
    assert hole.max() < scene.min()
