"""A known friction is found, thresholds hold on noise they have not seen, and nothing to subtract changes nothing."""

import numpy as np
import pytest

from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.contact.calibration import (
    FLOOR,
    CalibrationError,
    Log,
    filtered,
    fit_alarms,
    fit_friction,
    unexplained,
)
from hrc.contact.friction import FrictionConfig, friction
from hrc.contact.residual import MomentumObserver, ObserverConfig

DT = 0.005
TRUE = FrictionConfig(k=(-0.4, 0.1, -0.2, 0.3, 0.0, -0.3, 0.2), a=(1.2, 0.6, 0.5, 0.7, 0.4, 0.9, 0.3),
                      alpha=(60.0, 40.0, 20.0, 100.0, 30.0, 25.0, 50.0), v=(0.01, 0.0, -0.02, 0.0, 0.02, 0.03, 0.0))


def motion(seconds=120.0, seed=0, noise=0.1, true=TRUE, tilt=0.0) -> Log:
    """Joints that turn to and fro, each with its own period; tilt [N m/rad]: a model error that goes with q."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, DT)[:, None]
    w = 2.0 * np.pi / np.array([4.0, 5.0, 6.1, 7.3, 3.7, 4.6, 5.9])
    q, dq = np.sin(w * t) * 0.4, w * np.cos(w * t) * 0.4
    u = -friction(true, dq) + tilt * q[:, ::-1] + noise * rng.standard_normal(q.shape)
    return Log(DT, q, dq, u)


@pytest.mark.parametrize("tilt", [0.0, 0.5], ids=["exact model", "model error"])
def test_a_known_friction_is_found(tilt):
    found = fit_friction([motion(tilt=tilt)])
    dq = np.linspace(-0.4, 0.4, 41)[:, None] * np.ones(7)
    error = friction(found, dq) - friction(TRUE, dq)
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.05
    assert np.abs(np.array(found.k) - TRUE.k).max() < 0.06
    assert np.abs(np.array(found.a) - TRUE.a).max() < 0.06


def test_without_motion_nothing_wild_is_found():
    rng = np.random.default_rng(1)
    still = np.zeros((4000, 7))
    found = fit_friction([Log(DT, still, still, 0.3 + 0.1 * rng.standard_normal(still.shape))])
    assert np.abs(friction(found, np.zeros(7)) + 0.3).max() < 0.1
    assert np.abs(friction(found, np.full((2, 7), [[-0.3], [0.3]]))).max() < 1.0


def test_outliers_do_not_carry_the_fit_away():
    clean = motion()
    u = clean.u.copy()
    u[2000:2200] += 30.0
    found = fit_friction([Log(DT, clean.q, clean.dq, u)])
    assert np.abs(np.array(found.a) - TRUE.a).max() < 0.1


def test_one_residual_tells_that_of_another_gain():
    rng = np.random.default_rng(2)
    u = rng.standard_normal((300, 7))
    for gain in (10.0, 40.0):
        observer, p, seen = MomentumObserver(ObserverConfig(k_i=gain)), np.zeros(7), []
        observer.update(p, np.zeros(7), np.zeros(7), np.zeros(7), DT)
        for torque in u:
            p = p + DT * torque
            seen.append(observer.update(p, np.zeros(7), np.zeros(7), np.zeros(7), DT))
        np.testing.assert_allclose(filtered(u, gain, DT), seen, atol=1e-9)
        np.testing.assert_allclose(unexplained(np.array(seen), gain, DT), u, atol=1e-9)


@pytest.mark.parametrize("per_hour", [36.0, 360.0])
def test_the_rate_of_false_alarms_holds_on_noise_not_seen(per_hour):
    none = FrictionConfig()
    r_low = fit_alarms([motion(600.0, 3, 3.0, none)], 25.0).thresholds(per_hour)
    assert np.all(r_low > FLOOR)
    over = np.any(np.abs(motion(3600.0, 4, 3.0, none).residual(25.0)) > r_low, axis=1)
    onsets = np.flatnonzero(over[1:] & ~over[:-1])
    alarms = 1 + int((np.diff(onsets) > 0.2 / DT).sum()) if onsets.size else 0
    assert per_hour / 6.0 < alarms < 2.0 * per_hour


def test_rarer_alarms_and_robots_that_differ_ask_for_higher_thresholds():
    logs = [motion(60.0, seed) for seed in range(3)]
    rare, often = (fit_alarms(logs, 25.0).thresholds(rate) for rate in (0.01, 10.0))
    assert np.all(rare > often)
    apart = [Log(log.dt, log.q, log.dq, log.u * (1.0 + robot), robot) for robot, log in enumerate(logs)]
    single = np.max([fit_alarms([log], 25.0).thresholds(0.01) for log in apart], axis=0)
    assert np.all(fit_alarms(apart, 25.0).thresholds(0.01) > single)


def test_what_cannot_be_calibrated_from_is_refused():
    log = motion(5.0)
    with pytest.raises(CalibrationError, match="10 s"):
        fit_friction([log])
    with pytest.raises(CalibrationError, match="too short"):
        fit_alarms([log], 25.0)
    with pytest.raises(CalibrationError, match="finite"):
        Log(DT, log.q, log.dq, log.u * np.nan)
    with pytest.raises(CalibrationError, match="above 0"):
        fit_alarms([motion(20.0)], 25.0).thresholds(0.0)


def test_the_cell_subtracts_friction_and_zero_changes_no_bit(monkeypatch):
    def residuals(config):
        cell = Cell(config)
        return np.array([cell.step().residual for _ in range(300)])

    with_zeros = residuals(Config())
    with_friction = residuals(Config(friction=TRUE))
    monkeypatch.setattr("hrc.cell.cell.friction", lambda *_: 0.0)
    np.testing.assert_array_equal(with_zeros, residuals(Config()))
    assert np.abs(with_friction - with_zeros).max() > 0.1
