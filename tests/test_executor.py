"""Frames that are rendered beside the loop are the frames that are rendered in it."""

import threading

import numpy as np
import pytest

from hrc.cell.cell import Cell
from hrc.cell.eyes import rig, simulated
from hrc.config import Config
from hrc.errors import SensorError
from hrc.events import MoveCamera, MoveObstacle, Push, Reset, SetParameter
from hrc.executor import Beside, Inline
from hrc.geometry import look_at
from hrc.messages import Body
from hrc.scene import load_scene

EVENTS = {20: Push(4, (0.0, 0.05, 0.0), (0.0, 30.0, 0.0)), 60: MoveObstacle("ball", (-0.3, 0.4, 0.6)),
          150: MoveCamera("camera", (-1.4, 0.2, 1.1), (0.0, 0.0, 0.5)), 260: SetParameter("sensor.noise", 2.0), 330: Reset(),
          520: SetParameter("sensor.frozen", True), 640: SetParameter("sensor.frozen", False)}
STEPS = 800


@pytest.mark.parametrize("executor", [Inline(), Beside()])
def test_jobs_are_done_in_their_order_and_give_what_they_give(executor: Inline | Beside) -> None:
    done: list[int] = []
    pending = [executor.do(lambda i=i: (done.append(i), i * i)[1]) for i in range(50)]
    executor.idle()
    assert done == list(range(50))
    assert [result() for result in pending] == [i * i for i in range(50)]


def test_a_job_beside_is_on_another_thread_and_its_error_comes_with_its_result() -> None:
    executor = Beside()
    executor.idle()
    assert executor.do(threading.get_ident)() != threading.get_ident()
    failing = executor.do(lambda: 1 // 0)
    executor.idle()
    with pytest.raises(ZeroDivisionError):
        failing()
    assert executor.do(lambda: "on")() == "on"


def test_the_cell_has_the_same_bits_whoever_renders() -> None:
    cells, seen = (Cell(Config()), Cell(Config(), executor=Beside())), 0
    for step in range(STEPS):
        if step in EVENTS:
            for cell in cells:
                cell.apply(EVENTS[step])
        one, other = (cell.step() for cell in cells)
        assert (one.tick, one.fresh_frame, one.truth.visible) == (other.tick, other.fresh_frame, other.truth.visible)
        assert one.state.tau.tobytes() == other.state.tau.tobytes()
        assert one.command.dq.tobytes() == other.command.dq.tobytes()
        if one.fresh_frame:
            (a,), (b,) = one.views, other.views
            assert a.frame is not None
            assert b.frame is not None
            assert a.foreground is not None
            assert b.foreground is not None
            assert a.frame.depth.tobytes() == b.frame.depth.tobytes()
            assert a.foreground.depth.tobytes() == b.foreground.depth.tobytes()
            seen += 1
    assert seen > 15


def test_a_body_that_nobody_knows_is_told_at_once() -> None:
    (setup,), scene = rig(Config()), load_scene()
    camera = simulated(Beside())(setup, scene, 0, "cpu")
    with pytest.raises(SensorError, match="teapot"):
        camera.expose(0, np.zeros((8, 4, 4)), [Body("teapot", "sphere", (0.1,), np.eye(4))])
    camera.move(look_at((-1.4, 0.2, 1.1), (0.0, 0.0, 0.5)))
    assert camera.expose(0, np.zeros((8, 4, 4)), [])
    assert not camera.sees(np.array([0.0, 0.0, 5.0]))
