"""The force estimate is exact where the joints see it, and bounded where they do not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrc.contact.force import ForceConfig, estimate_force, force_covariance, place_covariance
from hrc.contact.proprioception import ProprioceptionConfig
from hrc.geometry import apply
from hrc.model import Dynamics, load_spec, pinocchio_model


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


# -- covariance ------------------------------------------------------------------------------------------------------

TERMS = Dynamics(pinocchio_model(load_spec().compile(), armature=False)).terms(
    np.deg2rad([5.0, 27.0, -10.0, -83.0, 8.0, 69.0, 0.0]), np.zeros(7))
R = np.diag(np.square(ProprioceptionConfig().sigma))
MANY = 20_000
PRIOR = 30.0**2 * np.eye(3)


def felt(link: int, p_link=(0.03, -0.05, 0.04)) -> tuple[np.ndarray, np.ndarray]:
    """A point of a link in the world, and the Jacobian there."""
    p = apply(TERMS.T_world_link[link], np.array(p_link))
    return p, TERMS.J_contact(link, p)


def assert_same_covariance(errors: np.ndarray, covariance: np.ndarray) -> None:
    """Second moments of many errors (n, 3) against a covariance, to 5 % of its scale."""
    np.testing.assert_allclose(errors.T @ errors / len(errors), covariance, atol=0.05 * np.trace(covariance))


@pytest.mark.parametrize("link", range(2, 8))
def test_covariance_is_that_of_the_error_under_noise(link):
    """Whatever the link: many residuals with that noise, of forces that lie anywhere in the prior."""
    rng, J_c, config = np.random.default_rng(link), felt(link)[1], ForceConfig()
    F = 30.0 * rng.standard_normal((MANY, 3))
    r = F @ J_c + rng.multivariate_normal(np.zeros(7), R, MANY)
    inverse = estimate_force(J_c, r[0], config).inverse
    assert_same_covariance(r @ inverse.T - F, force_covariance(inverse, J_c, R, PRIOR))


@pytest.mark.parametrize("link", range(4, 8))
def test_covariance_holds_what_a_displaced_point_does(link):
    """The force acts up to centimetres from where it is believed to; J_c is that of the believed point."""
    rng, config, spread, F = np.random.default_rng(link), ForceConfig(), 0.02, np.array([8.0, -25.0, 15.0])
    p, J_c = felt(link)
    true = [TERMS.J_contact(link, p + d) for d in spread * rng.standard_normal((MANY // 4, 3))]
    r = np.array([J.T @ F for J in true]) + rng.multivariate_normal(np.zeros(7), R, len(true))
    inverse = estimate_force(J_c, r[0], config).inverse
    whole = R + place_covariance(TERMS.J_link(link)[3:], F, spread**2 * np.eye(3))
    errors = r @ inverse.T - inverse @ J_c.T @ F
    assert_same_covariance(errors, force_covariance(inverse, J_c, whole, 0.0 * PRIOR))
    assert np.trace(inverse @ whole @ inverse.T) > 1.2 * np.trace(inverse @ R @ inverse.T)


@given(st.integers(0, 10_000), st.floats(0.0, 0.3))
def test_covariance_never_claims_more_than_is_felt(seed, smallest):
    """Along the worst direction the error may be as large as what is hidden there; where nothing is felt, all of it."""
    J_c = jacobian(seed, smallest)
    estimate = estimate_force(J_c, np.zeros(7), ForceConfig())
    covariance = force_covariance(estimate.inverse, J_c, R, PRIOR)
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-9)
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    u = estimate.unobservable
    passed = u @ (estimate.inverse @ J_c.T) @ u  # how much of a force along u the estimate shows
    assert u @ covariance @ u >= (30.0 * (1.0 - passed)) ** 2 - 1e-9
    if smallest == 0.0:
        assert u @ covariance @ u == pytest.approx(900.0)
