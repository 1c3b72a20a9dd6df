"""The laws of the control laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrc.control import laws

seeds = st.integers(0, 100_000)


def random_jacobian(seed: int, weakest: float = 0.2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    U, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    V, _ = np.linalg.qr(rng.standard_normal((7, 3)))
    return U @ np.diag([0.9, 0.5, weakest]) @ V.T


@given(seeds, st.floats(0.0, 0.3))
def test_the_projector_is_one_even_where_the_inverse_is_damped(seed, weakest):
    """J P = 0 and P P = P, near a singularity too, where I - J#J with a damped J# is no projector."""
    J = random_jacobian(seed, weakest)
    P = laws.inverse(J).projector
    np.testing.assert_allclose(P @ P, P, atol=1e-12)
    np.testing.assert_allclose(P, P.T, atol=1e-12)
    np.testing.assert_allclose(J @ P, 0.0, atol=2 * laws.RANK)


@given(seeds)
def test_the_task_is_exact_when_well_conditioned(seed):
    J = random_jacobian(seed)
    dx = np.random.default_rng(seed).uniform(-0.2, 0.2, 3)
    np.testing.assert_allclose(J @ laws.inverse(J).pinv @ laws.task_velocity(dx, np.zeros(3), 10.0, 0.25), dx, atol=1e-9)


@given(seeds, st.floats(0.0, 0.3))
def test_yielding_never_moves_into_the_push(seed, weakest):
    """F . v_c >= 0, and the task stays untouched."""
    J, J_c = random_jacobian(seed), random_jacobian(seed + 1, weakest)
    F = np.random.default_rng(seed).uniform(-40, 40, 3)
    P = laws.inverse(J).projector
    dq = laws.relax_velocity(J_c, P, F, 0.02, 5.0)
    assert F @ (J_c @ dq) >= -1e-9
    np.testing.assert_allclose(J @ dq, 0.0, atol=1e-9)


@given(seeds)
def test_task_and_posture_do_not_press_either(seed):
    J, J_c = random_jacobian(seed), random_jacobian(seed + 1)
    rng = np.random.default_rng(seed)
    F, P = rng.uniform(-40, 40, 3), laws.inverse(J).projector
    task, null = laws.inverse(J).pinv @ rng.uniform(-0.2, 0.2, 3), P @ rng.uniform(-0.5, 0.5, 7)
    kept = laws.not_into_the_push(task, null, J_c, P, F)
    np.testing.assert_allclose(J @ kept, 0.0, atol=1e-9)
    if F @ (J_c @ (task + null)) >= 0.0:
        np.testing.assert_array_equal(kept, null)
    elif np.linalg.norm(P @ J_c.T @ F) ** 2 > laws.ROOM[1] * np.linalg.norm(J_c.T @ F) ** 2:
        assert F @ (J_c @ (task + kept)) == pytest.approx(0.0, abs=1e-9)


def test_the_printed_form_does_on_some_postures():
    """Why the default is not the printed one: P J_c# F turns against F for some pairs of Jacobians."""
    worst = 0.0
    for seed in range(300):
        J, J_c = random_jacobian(seed), random_jacobian(seed + 1)
        F = np.random.default_rng(seed).uniform(-40, 40, 3)
        dq = laws.inverse(J).projector @ laws.relax_velocity_printed(J_c, F, 0.05)
        worst = min(worst, float(F @ (J_c @ dq)))
    assert worst < 0.0


def test_the_force_term_is_continuous_at_its_threshold():
    direction = np.array([0.6, 0.0, 0.8])
    below, above = laws.beyond(4.999999 * direction, 5.0), laws.beyond(5.000001 * direction, 5.0)
    np.testing.assert_allclose(below, 0.0)
    np.testing.assert_allclose(above, 0.0, atol=1e-5)
    np.testing.assert_allclose(laws.beyond(25.0 * direction, 5.0), 20.0 * direction)


def test_admittance_is_at_rest_where_spring_and_push_balance():
    F = np.array([0.0, 14.0, 0.0])
    assert np.allclose(laws.admittance_velocity(F, -F / 350.0, 0.005, 350.0, 0.25), 0.0)
    fast = laws.admittance_velocity(1000.0 * F, np.zeros(3), 0.005, 350.0, 0.25)
    assert np.linalg.norm(fast) == pytest.approx(0.25)


@given(seeds)
def test_forgetting_with_unit_gain_keeps_a_constant_velocity(seed):
    """Eq. (15) settles at the null velocity itself with unit gain, and at 1 / (1 - lambda) times it as printed."""
    P = laws.inverse(random_jacobian(seed)).projector
    null = P @ np.random.default_rng(seed).standard_normal(7)
    for unit_gain, gain in ((True, 1.0), (False, 5.0)):
        dq = np.zeros(7)
        for _ in range(200):
            dq = laws.with_forgetting(null, P, dq, 0.8, unit_gain=unit_gain)
        np.testing.assert_allclose(dq, gain * null, atol=1e-9)


def test_the_blend_ends_at_one():
    assert [laws.blend(h, 4) for h in (1, 2, 3, 4, 5)] == [0.25, 0.5, 0.75, 1.0, 1.0]


def test_the_path_takes_only_what_leaves_no_motion_into_the_push():
    rng = np.random.default_rng(5)
    for _ in range(200):
        J_c, F, path, rest = rng.normal(size=(3, 7)), rng.normal(size=3), rng.normal(size=7), rng.normal(size=7)
        share = laws.share_of_the_path(path, rest, J_c, np.zeros((7, 7)), F)
        power = [F @ J_c @ (rest + s * path) for s in (share, share + 1e-3)]
        assert 0.0 <= share <= 1.0
        if F @ J_c @ rest >= 0.0:
            assert power[0] >= -1e-9
            assert share == 1.0 or power[1] < 0.0
        else:
            assert share == (1.0 if F @ J_c @ path >= 0.0 else 0.0)
        assert laws.share_of_the_path(path, rest, J_c, np.eye(7), F) == 1.0, "the null space takes it all"
