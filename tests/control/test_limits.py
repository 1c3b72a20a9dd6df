"""No command leaves the limits, and the task is the last to give way."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hrc.control.limits import limited, velocity_bounds

Q_MAX = np.deg2rad([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 170.0])
DQ_MAX = np.deg2rad([110.0, 110.0, 128.0, 128.0, 204.0, 184.0, 184.0])
DDQ_MAX = 25.0
STEP = DDQ_MAX * 0.005
velocities = arrays(float, 7, elements=st.floats(-20, 20))
positions = arrays(float, 7, elements=st.floats(-1.2, 1.2)).map(lambda x: x * Q_MAX)


@given(positions, velocities, velocities, arrays(float, 7, elements=st.floats(-1, 1)))
def test_the_command_is_within_every_bound(q, task, null, issued):
    lower, upper = velocity_bounds(q, -Q_MAX, Q_MAX, DQ_MAX, DDQ_MAX)
    issued = np.clip(issued, lower, upper)
    dq = limited(task, null, (lower, upper), issued, STEP).dq
    assert np.all(dq >= lower - 1e-9)
    assert np.all(dq <= upper + 1e-9)
    assert np.all(np.abs(dq - issued) <= STEP + 1e-9)


@given(velocities)
def test_the_null_space_gives_way_first(null):
    task = 0.5 * DQ_MAX
    result = limited(task, null, (-DQ_MAX, DQ_MAX), task, 100.0)
    assert result.task == 1.0
    extra = result.dq - task
    kept = float(extra @ null) / max(float(null @ null), 1e-30)
    np.testing.assert_allclose(extra, kept * null, atol=1e-9)
    assert -1e-6 <= kept <= 1.0 + 1e-3  # the ratio of two tiny numbers may be off


@given(velocities, velocities)
def test_a_null_motion_under_way_may_go_on(task, null):
    """The task alone may be out of reach of the acceleration limit while task and null space together are within it."""
    task, null = 0.04 * task, 0.04 * null
    result = limited(task, null, (-DQ_MAX, DQ_MAX), task + null, STEP)
    np.testing.assert_allclose(result.dq, task + null, atol=1e-9)
    assert result.task == 1.0


def test_at_a_position_limit_only_the_way_back_is_open():
    lower, upper = velocity_bounds(Q_MAX, -Q_MAX, Q_MAX, DQ_MAX, DDQ_MAX)
    assert np.all(upper == 0.0)
    np.testing.assert_allclose(lower, -DQ_MAX)


@pytest.mark.parametrize("late", [0, 1, 3])
def test_full_speed_towards_a_limit_comes_down_within_the_acceleration_limit(late):
    """Also for an arm that does what it is told so many periods later."""
    q, dq, told = np.zeros(7), DQ_MAX, [DQ_MAX] * (late + 1)
    for _ in range(600):
        bounds = velocity_bounds(q, -Q_MAX, Q_MAX, DQ_MAX, DDQ_MAX)
        new = limited(np.zeros(7), 2.0 * DQ_MAX, bounds, dq, STEP).dq
        assert np.all(np.abs(new - dq) <= STEP + 1e-9)
        dq = new
        told.append(dq)
        q = q + 0.005 * told[-1 - late]
    assert np.all(q <= Q_MAX)
    assert np.all(np.abs(dq) < 0.01)


def test_a_scaled_task_keeps_its_direction():
    task = 3.0 * DQ_MAX * np.array([1, -1, 0.5, 0.2, 1, -1, 0.1])
    result = limited(task, np.zeros(7), (-DQ_MAX, DQ_MAX), np.zeros(7), 100.0)
    np.testing.assert_allclose(np.cross(result.dq[:3], task[:3]), 0.0, atol=1e-9)
    assert 0.0 < result.task < 1.0
