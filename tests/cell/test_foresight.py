"""A camera that renders ahead delivers the frames that it would deliver without."""

import threading

import numpy as np
import pytest

from hrc.cell.cell import Cell
from hrc.cell.clock import Rate
from hrc.cell.eyes import rig, simulated
from hrc.cell.foresight import ForeseenCamera
from hrc.errors import SensorError
from hrc.executor import Beside
from hrc.geometry import look_at
from hrc.messages import Body
from hrc.scene import load_scene
from hrc.sim.depth_camera import DepthCamera

STEPS = range(3, 400, 33)


@pytest.fixture(scope="module")
def scenes():
    """What stands before the camera at some steps: the arm on its way, and a ball that comes and goes."""
    cell, scenes = Cell(), {}
    for step in range(max(STEPS) + 1):
        snapshot = cell.step()
        if step in STEPS:
            T_ball = np.eye(4)
            T_ball[:3, 3] = -0.3, 0.4, 0.3 + 0.001 * step
            ball = Body("ball", "sphere", (0.06,), T_ball, present=step % 2 == 0)
            scenes[step] = snapshot.T_world_link, (ball,)
    return scenes


@pytest.fixture
def pair(scenes):
    """The plain camera, and the one that renders ahead with the step it is told."""
    config = Cell().config
    (setup,), scene = rig(config), load_scene(config.scene)
    now = [0]
    rate = Rate(1000, 1000)  # due at every step there is
    ahead = ForeseenCamera(simulated()(setup, scene, 3, "cpu"), scenes, rate, lambda: now[0], Beside())
    return simulated()(setup, scene, 3, "cpu"), ahead, now, setup.sensor


def frames(pair, scenes, steps, changes=None, moves=None):
    """Pairs of what both have delivered after each step; changes: of the sensor, by step; moves: where it is carried."""
    plain, ahead, now, sensor = pair
    for step in steps:
        if changes and step in changes:
            sensor = sensor.replace(**changes[step])
            plain.configure(sensor)
            ahead.configure(sensor)
        if moves and step in moves:
            plain.move(moves[step])
            ahead.move(moves[step])
        now[0] = step
        assert plain.expose(step, *scenes[step]) == ahead.expose(step, *scenes[step])
        yield plain.latest(step), ahead.latest(step)


def same(a, b):
    return (a is None) == (b is None) and (a is None or (a.tick == b.tick and np.array_equal(a.depth, b.depth)))


def test_every_frame_has_the_same_bits_and_all_but_the_first_are_rendered_ahead(pair, scenes, monkeypatch):
    threads, render = [], DepthCamera.render

    def noted(camera, *args):
        if camera is not pair[0]:
            threads.append(threading.current_thread().name.split("_")[0])
        return render(camera, *args)

    monkeypatch.setattr(DepthCamera, "render", noted)
    found = list(frames(pair, scenes, STEPS))
    assert all(same(a, b) for a, b in found)
    assert sum(a is not None for a, _ in found) > 5
    assert threads[1:] == ["beside"] * (len(STEPS) - 1)


def test_changes_of_the_sensor_take_hold_at_the_same_frame(pair, scenes):
    changes = {STEPS[3]: {"noise": 5.0}, STEPS[5]: {"unplugged": True}, STEPS[7]: {"unplugged": False, "latency": 0},
               STEPS[9]: {"frozen": True}}
    found = list(frames(pair, scenes, STEPS, changes))
    assert all(same(a, b) for a, b in found)
    assert found[5][0] is None
    assert found[11][0] is not None


def test_a_camera_that_is_moved_takes_its_next_frame_from_there(pair, scenes):
    moves = {STEPS[4]: look_at((-0.4, 1.9, 0.9), (-0.3, 0.0, 0.4)), STEPS[8]: look_at((0.3, -1.2, 2.0), (-0.3, 0.0, 0.4))}
    found = list(frames(pair, scenes, STEPS, moves=moves))
    assert all(same(a, b) for a, b in found)
    kinds = [np.isfinite(a.depth).sum() // 1000 for a, _ in found if a is not None]
    assert len({*kinds}) > 2, "it does see another room"


def test_another_step_than_the_one_foreseen_is_rendered_when_it_comes(pair, scenes):
    assert all(same(a, b) for a, b in frames(pair, scenes, [*STEPS[:4], *STEPS[6:9]]))


def test_it_knows_nothing_of_the_truth_and_fails_as_the_camera_does(pair, scenes):
    _, ahead, now, _ = pair
    with pytest.raises(SensorError, match="present truth"):
        ahead.sees(np.zeros(3))
    now[0] = STEPS[0]
    with pytest.raises(SensorError, match="unknown body"):
        ahead.expose(STEPS[0], scenes[STEPS[0]][0], [Body("bal", "sphere", (0.06,), np.eye(4), present=True)])
