"""The residual is a first-order filter of the contact torque, whatever the step."""

import numpy as np
import pytest

from hrc.contact.residual import Detector, MomentumObserver, ObserverConfig


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
