"""The force estimate is exact where the joints see it, and bounded where they do not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrc.contact.force import ForceConfig, estimate_force


def jacobian(seed: int, smallest: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    U, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    V, _ = np.linalg.qr(rng.standard_normal((7, 3)))
    return U @ np.diag([0.8, 0.4, smallest]) @ V.T


@given(st.integers(0, 10_000), st.floats(0.1, 0.4))
def test_exact_when_well_conditioned(seed, smallest):
    J_c = jacobian(seed, smallest)
    F = np.random.default_rng(seed + 1).uniform(-50, 50, 3)
    estimate = estimate_force(J_c, J_c.T @ F, ForceConfig())
    np.testing.assert_allclose(estimate.F, F, atol=1e-9)
    assert estimate.sigma_min == pytest.approx(smallest)


@given(st.integers(0, 10_000), st.floats(0.0, 0.05))
def test_bounded_near_singularity(seed, smallest):
    """The gain along the weak direction never exceeds 1 / (2 damping): noise is not blown up."""
    J_c = jacobian(seed, smallest)
    r = np.random.default_rng(seed).standard_normal(7)
    config = ForceConfig()
    weak = np.linalg.norm(r) / (2.0 * config.damping * np.sqrt(0.75))
    assert np.linalg.norm(estimate_force(J_c, r, config).F) <= np.linalg.norm(r) / 0.4 + weak


def test_the_unobservable_direction_is_the_one_the_joints_do_not_feel():
    J_c = jacobian(3, 0.0)
    estimate = estimate_force(J_c, np.zeros(7), ForceConfig())
    np.testing.assert_allclose(J_c.T @ estimate.unobservable, 0.0, atol=1e-12)
    assert estimate.sigma_min == pytest.approx(0.0, abs=1e-12)
    visible = J_c.T @ (10.0 * estimate.unobservable)
    np.testing.assert_allclose(estimate_force(J_c, visible, ForceConfig()).F, 0.0, atol=1e-9)
