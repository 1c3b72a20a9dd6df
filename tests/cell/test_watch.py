"""Readings that repeat: when that is a fault, and when not."""

import numpy as np

from hrc.cell.watch import LED, MOVED, Watch
from hrc.messages import RobotState

DT = 0.005


def state(tick: int, q: float = 0.0, tau: float = 1.0) -> RobotState:
    return RobotState(tick, np.full(7, q), np.zeros(7), np.full(7, tau))


def told(watch: Watch, states: list[RobotState], dq: float) -> str:
    return next((text for text in (watch.update(s, np.full(7, dq)) for s in states) if text), "")


def test_an_arm_that_stands_may_repeat_itself_for_ever() -> None:
    assert told(Watch(DT), [state(i) for i in range(1000)], 0.0) == ""


def test_a_torque_that_repeats_in_motion_is_stuck_and_one_that_changes_is_not() -> None:
    steps = [0.5 * MOVED * i for i in range(5)]
    assert "torque sensor of joint 1 repeats 1.000" in told(Watch(DT), [state(i, q) for i, q in enumerate(steps)], 0.0)
    assert told(Watch(DT), [state(i, q, tau=1.0 + 1e-12 * i) for i, q in enumerate(steps)], 0.0) == ""


def test_motion_to_and_fro_counts_in_full() -> None:
    shaking = [state(i, 0.001 * (i % 2)) for i in range(round(MOVED / 0.001) + 3)]
    assert "torque sensor" in told(Watch(DT), shaking, 0.0)


def test_a_position_that_repeats_under_a_command_is_stuck() -> None:
    states = [state(i, tau=float(i)) for i in range(round(2 * LED / (0.2 * DT)))]
    assert "position sensor of joint 1 repeats 0.000" in told(Watch(DT), states, 0.2)
    assert told(Watch(DT), [state(i, 1e-9 * i, tau=float(i)) for i in range(100)], 0.2) == ""
