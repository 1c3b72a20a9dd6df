"""What stays when nothing is near and nothing moves is learned, slowly and not too much of it; a contact is not."""

import numpy as np
import pytest

from hrc.contact.zero import ResidualZero, ZeroConfig

DT = 0.005
R_LOW = np.array([1.5, 2.5, 1.0, 1.2, 0.8, 0.5, 0.5])
BIAS = 0.3 * R_LOW * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
REST = {"dq": np.zeros(7), "clearance": np.inf, "detected": False}


def zero(**config) -> ResidualZero:
    return ResidualZero(ZeroConfig(on=True, **config), DT)


def run(z: ResidualZero, seconds: float, r=BIAS, **state) -> np.ndarray:
    now = REST | state
    return [z.update(r, now["dq"], R_LOW, clearance=now["clearance"], detected=now["detected"])
            for _ in range(round(seconds / DT))][-1]


def learned(z: ResidualZero) -> np.ndarray:
    assert z.offset is not None
    return z.offset


def test_a_bias_at_rest_with_nothing_near_goes_with_the_time_constant():
    z = zero(after=1.0, time_constant=3.0)
    np.testing.assert_array_equal(run(z, 0.99), BIAS)
    np.testing.assert_allclose(run(z, 3.01), BIAS / np.e, rtol=0.01)
    np.testing.assert_allclose(run(z, 30.0), 0.0, atol=1e-4)


@pytest.mark.parametrize("state", [
    {"dq": np.eye(7)[3] * 0.05}, {"clearance": 0.2}, {"clearance": 0.0}, {"detected": True}],
    ids=["moving", "something near", "vision cannot tell", "contact"])
def test_nothing_is_learned_otherwise_and_nothing_forgotten(state):
    z = zero()
    np.testing.assert_array_equal(run(z, 20.0, **state), BIAS)
    run(z, 20.0)
    before = learned(z).copy()
    run(z, 20.0, r=-BIAS, **state)
    np.testing.assert_array_equal(learned(z), before)


def test_a_residual_that_changes_is_not_learned():
    z = zero(steady=0.2)
    for k in range(4000):
        run(z, DT, r=BIAS * np.sin(2.0 * np.pi * 0.5 * k * DT) * 1.5)
    np.testing.assert_allclose(learned(z), 0.0)


def test_a_moment_of_motion_starts_the_wait_anew():
    z = zero(after=1.0)
    for _ in range(20):
        run(z, 0.9)
        run(z, DT, dq=np.ones(7))
    np.testing.assert_allclose(learned(z), 0.0)


def test_the_offset_is_bounded_so_that_its_end_is_no_alarm():
    """A push just below detection that nobody sees: learned at most by half, and no contact when it ends."""
    z = zero(most=0.5)
    left = run(z, 100.0, r=0.95 * R_LOW)
    np.testing.assert_allclose(left, 0.45 * R_LOW)
    assert (np.abs(run(z, DT, r=np.zeros(7))) < R_LOW).all()


def test_noise_is_not_learned():
    rng, z = np.random.default_rng(0), zero()
    for _ in range(6000):
        run(z, DT, r=BIAS + 0.03 * R_LOW * rng.standard_normal(7))
    assert (np.abs(learned(z) - BIAS) < 0.01 * R_LOW).all()


def test_off_it_leaves_the_residual_alone():
    z = ResidualZero(ZeroConfig(on=False), DT)
    assert run(z, 20.0) is BIAS
    assert z.offset is None
