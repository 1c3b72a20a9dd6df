"""The residual is a first-order filter of the contact torque, whatever the step."""

import numpy as np
import pytest

from hrc.contact.residual import Acceleration, Detector, MomentumObserver, ObserverConfig
from hrc.errors import ConfigError, SensorError


@pytest.mark.parametrize("dt", [0.001, 0.005])
@pytest.mark.parametrize("gain", [10.0, 25.0, 100.0])
def test_step_response_is_one_minus_exp(gain, dt):
    """A unit mass pushed by a constant torque: r = tau_c (1 - e^(-K t)), Eq. (2)-(3)."""
    observer = MomentumObserver(ObserverConfig(k_i=gain))
    tau_c = np.linspace(-3.0, 3.0, 7)
    observer.update(np.zeros(7), np.zeros(7), np.zeros(7), np.zeros(7), dt)
    for k in range(1, 200):
        p = tau_c * k * dt
        r = observer.update(p, np.zeros(7), np.zeros(7), np.zeros(7), dt)
        exact = tau_c * (1.0 - np.exp(-gain * k * dt))
        np.testing.assert_allclose(r, exact, atol=3.0 * gain * dt)
    np.testing.assert_allclose(r, tau_c * (1.0 - (1.0 + gain * dt) ** -199), atol=1e-9)


def test_a_modelled_torque_leaves_no_residual():
    observer, dt = MomentumObserver(ObserverConfig()), 0.005
    g, tau = np.full(7, 4.0), np.full(7, 4.0)
    for _ in range(50):
        r = observer.update(np.zeros(7), np.zeros(7), g, tau, dt)
    np.testing.assert_allclose(r, 0.0, atol=1e-12)


def test_it_is_stable_at_a_gain_that_explicit_euler_is_not():
    observer, dt = MomentumObserver(ObserverConfig(k_i=200.0)), 0.05
    observer.update(np.zeros(7), np.zeros(7), np.zeros(7), np.zeros(7), dt)
    r = np.zeros(7)
    for k in range(1, 100):
        r = observer.update(np.full(7, k * dt), np.zeros(7), np.zeros(7), np.zeros(7), dt)
    np.testing.assert_allclose(r, 1.0, atol=1e-6)


def test_a_gain_changed_while_running_does_not_jump():
    observer, dt, tau_c = MomentumObserver(ObserverConfig(k_i=25.0)), 0.005, np.full(7, 7.0)
    r = np.zeros(7)
    for k in range(400):
        if k == 200:
            observer.config = ObserverConfig(k_i=200.0)
        r = observer.update(tau_c * k * dt, np.zeros(7), np.zeros(7), np.zeros(7), dt)
        assert r.max() <= 7.0 + 1e-9
    np.testing.assert_allclose(r, tau_c, atol=1e-6)


def test_detection_has_hysteresis():
    config = ObserverConfig(off=0.5)
    detector, r_low = Detector(config), config.r_low[3]
    seen = [detector.update(np.eye(7)[3] * level * r_low) for level in (0.9, 1.1, 0.6, 0.4, 0.9)]
    assert seen == [False, True, True, False, False]


@pytest.mark.parametrize("joints", [1, 2, 6, 9])
def test_any_number_of_joints_and_a_bare_gain_will_do(joints):
    observer, configured, dt = MomentumObserver(25.0), MomentumObserver(ObserverConfig(k_i=25.0)), 0.002
    zero, tau_c = np.zeros(joints), np.arange(1.0, joints + 1.0)
    for k in range(500):
        r = observer.update(k * dt * tau_c, zero, zero, zero, dt)
        np.testing.assert_array_equal(r, configured.update(k * dt * tau_c, zero, zero, zero, dt))
    np.testing.assert_allclose(r, tau_c, rtol=1e-6)


@pytest.mark.parametrize("sizes", [(6, 7, 7, 7), (7, 6, 6, 7), (7, 7, 7, 6), (7, 1, 1, 1)])
def test_terms_of_different_joints_are_refused(sizes):
    p, Ct_dq, g, tau = (np.zeros(n) for n in sizes)
    with pytest.raises(SensorError, match="one shape"):
        MomentumObserver(25.0).update(p, Ct_dq, g, tau, 0.005)


@pytest.mark.parametrize(("joints", "dt"), [(6, 0.005), (7, 0.0), (7, -0.005), (7, float("nan"))])
def test_another_arm_and_a_clock_that_does_not_run_are_refused(joints, dt):
    observer, seven, now = MomentumObserver(25.0), np.zeros(7), np.zeros(joints)
    observer.update(seven, seven, seven, seven, 0.005)
    with pytest.raises(SensorError, match="above 0"):
        observer.update(now, now, now, now, dt)


def test_a_gain_out_of_range_is_refused():
    with pytest.raises(ConfigError, match="k_i"):
        MomentumObserver(-1.0)


def test_while_accelerating_hard_another_threshold_holds_for_the_beginning_only():
    config = ObserverConfig(hard=5.0, accelerating=2.0, off=0.5)
    one = np.eye(7)[3] * config.r_low[3]
    for acceleration, begins in ((4.9, 1.0), (5.1, 2.0)):
        detector = Detector(config)
        assert not detector.update(0.99 * begins * one, acceleration)
        assert detector.update(1.01 * begins * one, acceleration)
        assert detector.update(0.51 * one, acceleration)
        assert not detector.update(0.49 * one, acceleration)


def test_an_acceleration_is_remembered_as_long_as_the_residual_remembers_it():
    acceleration, observer, dt = Acceleration(0.005), MomentumObserver(25.0), 0.005
    zero, steps = np.zeros(7), 40
    assert acceleration.update(zero, 25.0) == 0.0
    peak = acceleration.update(np.full(7, 0.1), 25.0)
    assert peak == pytest.approx(20.0)
    observer.update(zero, zero, zero, zero, dt)
    r = r_peak = observer.update(np.ones(7), zero, zero, zero, dt)[0]
    for _ in range(steps):
        now = acceleration.update(np.full(7, 0.1), 25.0)
        r = observer.update(np.ones(7), zero, zero, zero, dt)[0]
    assert now / peak == pytest.approx(np.exp(-25.0 * dt * steps))
    assert now / peak <= r / r_peak <= 2.0 * now / peak
    assert acceleration.update(np.full(7, -0.1), 25.0) == pytest.approx(40.0)
