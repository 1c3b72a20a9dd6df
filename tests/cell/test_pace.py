"""The pacer follows an injected clock: no test here waits."""

import pytest

from hrc.cell.pace import FreeRun, RealTime


class Clock:
    def __init__(self) -> None:
        self.t = 0.0

    def now(self) -> float:
        return self.t

    def sleep(self, seconds: float) -> None:
        self.t += seconds


def run_for(pacer: RealTime, clock: Clock, seconds: float, step: float = 0.004) -> int:
    total, end = 0, clock.t + seconds
    while clock.t < end:
        clock.t += step
        total += pacer.steps_due()
    return total


@pytest.mark.parametrize("speed", [0.25, 1.0, 2.0])
def test_it_keeps_the_speed_asked_for(speed):
    clock = Clock()
    pacer = RealTime(1000, speed, now=clock.now, sleep=clock.sleep)
    assert run_for(pacer, clock, 3.0) == pytest.approx(3000 * speed, abs=10)
    assert pacer.factor == pytest.approx(speed, rel=0.02)
    assert not pacer.capped


def test_lost_time_is_dropped_and_said():
    clock = Clock()
    pacer = RealTime(1000, now=clock.now, sleep=clock.sleep)
    clock.t += 5.0
    assert pacer.steps_due() <= 200
    run_for(pacer, clock, 0.5)
    assert pacer.capped


@pytest.mark.parametrize("jump", [3600.0, -3600.0])
def test_a_clock_that_jumps_by_an_hour_costs_a_moment(jump):
    clock = Clock()
    pacer = RealTime(1000, now=clock.now, sleep=clock.sleep)
    run_for(pacer, clock, 2.0)
    clock.t += jump
    assert pacer.steps_due() <= 200
    assert run_for(pacer, clock, 3.0) == pytest.approx(3000, abs=210)
    assert pacer.factor == pytest.approx(1.0, rel=0.02)


def test_a_pause_owes_nothing_and_can_be_stepped():
    clock = Clock()
    pacer = RealTime(1000, now=clock.now, sleep=clock.sleep)
    pacer.paused = True
    assert run_for(pacer, clock, 1.0) == 0
    pacer.step_once(10)
    assert pacer.steps_due() == 10
    pacer.paused = False
    assert pacer.steps_due() <= 2


def test_headless_never_waits():
    assert FreeRun(50).steps_due() == 50
