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


def test_what_a_slow_stretch_loses_is_made_good_afterwards():
    clock = Clock()
    pacer = RealTime(1000, now=clock.now, sleep=clock.sleep)
    run_for(pacer, clock, 1.0)
    taken, begun = 0, clock.t
    while clock.t < begun + 3.0:  # ticks that take a quarter longer than they last
        due = pacer.steps_due()
        taken += due
        clock.t += due * 0.00125
    assert taken == pytest.approx(2400, abs=60)
    assert run_for(pacer, clock, 6.0) == pytest.approx(6600, abs=60)
    assert not pacer.capped


def test_it_catches_up_smoothly():
    clock = Clock()
    pacer = RealTime(1000, now=clock.now, sleep=clock.sleep)
    run_for(pacer, clock, 1.0)
    clock.t += 0.5
    assert run_for(pacer, clock, 0.2) == pytest.approx(50 + 250, abs=10)  # little of it at once
    assert run_for(pacer, clock, 0.4) == pytest.approx(500, abs=10)
    assert run_for(pacer, clock, 3.0) == pytest.approx(3300, abs=20)
    assert not pacer.capped


def test_time_that_is_too_much_is_dropped_and_said():
    clock = Clock()
    pacer = RealTime(1000, now=clock.now, sleep=clock.sleep)
    clock.t += 5.0
    assert pacer.steps_due() <= 50
    assert run_for(pacer, clock, 8.0) == pytest.approx(9000, abs=10)
    clock.t += 5.0
    run_for(pacer, clock, 0.5)
    assert pacer.capped


@pytest.mark.parametrize("jump", [3600.0, -3600.0])
def test_a_clock_that_jumps_by_an_hour_costs_a_moment(jump):
    clock = Clock()
    pacer = RealTime(1000, now=clock.now, sleep=clock.sleep)
    run_for(pacer, clock, 2.0)
    clock.t += jump
    assert pacer.steps_due() <= 50
    assert run_for(pacer, clock, 6.0) == pytest.approx(6500, abs=510)
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
