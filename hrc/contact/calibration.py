"""From free motion to friction and thresholds: what the residual shows while nothing touches the robot is not contact.

The observer is a linear filter of the unexplained torque u, r_k = (r_(k-1) + K_I dt u_k) / (1 + K_I dt), so one log of r
tells what any other K_I and any compensation would have made of the same motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

from hrc.contact.friction import FrictionConfig, friction, turned
from hrc.errors import HrcError

Array = NDArray[np.float64]
BLOCK = 1.0
"""Maxima of |r| are taken over so long [s]: several times the residual's memory, 1 / K_I."""
FLOOR = 0.1
"""No threshold is lower [N m]."""
SPREAD = 3.0
"""Thresholds hold for a robot so many standard deviations from the mean of those that were logged."""
APART = 0.1
"""Samples of the fit are so far apart [s], where their noise is nearly independent."""
PRIOR_K, PRIOR_A, PRIOR_SLOPE, PRIOR_CONSTANT = 10.0, 2.0, 1.0, 0.3
"""Widths of what is believed of k, A [N m], and the model's torque error: with q [N m/rad], and constant [N m]. What all robots
show alike belongs to k: whoever subtracts it need not know where it comes from."""
PRIOR_ALPHA, PRIOR_V = (np.log(40.0), 1.2), 0.05
"""What is believed of log alpha (mean, width) and of v [rad/s] where the motion does not tell."""
BOUNDS = ((-20.0, 0.0, 0.0, -0.5), (20.0, 20.0, np.log(1000.0), 0.5))
"""Of k, A, log alpha, v."""
EULER = 0.5772156649015329


class CalibrationError(HrcError):
    """The logs cannot be calibrated from."""


@dataclass(frozen=True, eq=False)
class Log:
    """Free motion of one robot. dt [s]; q [rad], dq [rad/s], u: unexplained torque [N m], each (n, 7).

    Logs of robots with different model errors carry different numbers in `robot`.
    """

    dt: float
    q: Array
    dq: Array
    u: Array
    robot: int = 0

    def __post_init__(self) -> None:
        shapes = {np.shape(x) for x in (self.q, self.dq, self.u)}
        if shapes != {(len(self.u), 7)} or not all(np.isfinite(x).all() for x in (self.q, self.dq, self.u)):
            raise CalibrationError(f"a log holds finite q, dq and u of one shape (n, 7), not {sorted(shapes)}")

    def residual(self, k_i: float, compensation: FrictionConfig | None = None) -> Array:
        """The residual [N m] (n, 7) an observer with this K_I [1/s] and compensation would have shown, from r = 0."""
        u = self.u if compensation is None else self.u + friction(compensation, self.dq)
        return filtered(u, k_i, self.dt)


def filtered(u: Array, k_i: float, dt: float) -> Array:
    """The residual (n, ...) that an observer makes of an unexplained torque (n, ...), Eq. (2)."""
    gain = k_i * dt
    return np.asarray(lfilter([gain / (1.0 + gain)], [1.0, -1.0 / (1.0 + gain)], u, axis=0))


def unexplained(r: Array, k_i: float, dt: float) -> Array:
    """The torque (n, ...) of which an observer that started from zero made the residual r (n, ...)."""
    before = np.concatenate([np.zeros_like(r[:1]), r[:-1]])
    return (r * (1.0 + k_i * dt) - before) / (k_i * dt)


# -- friction ---------------------------------------------------------------------------------------------------------


def fit_friction(logs: Sequence[Log], k_i: float = 25.0) -> FrictionConfig:
    """The friction and offset of every joint, by robust least squares on the residual at this K_I [1/s].

    The model's own error, which turns with q and not with the sense of motion, is fitted beside it, linear in q for each
    robot, and left out. A parameter of which the motion tells nothing stays at what is believed of it.
    Raises CalibrationError without logs of at least ten seconds in all.
    """
    if sum(len(log.u) * log.dt for log in logs) < 10.0:
        raise CalibrationError("a calibration needs at least 10 s of free motion")
    columns, prior = _model_error(logs, k_i)
    found = np.array([_fit_joint(logs, joint, k_i, columns, prior) for joint in range(7)])
    k, a, alpha, v = (tuple(float(x) for x in column) for column in found.T)
    return FrictionConfig(k, a, alpha, v)


def _every(log: Log) -> int:
    return max(1, round(APART / log.dt))


def _model_error(logs: Sequence[Log], k_i: float) -> tuple[Array, Array]:
    """Columns (m, c) linear in q for each robot, as the observer passes them, and the width of their coefficients (c,)."""
    middle = np.mean([log.q.mean(axis=0) for log in logs], axis=0)
    robots = sorted({log.robot for log in logs})
    rows = []
    for log in logs:
        basis = filtered(np.column_stack([np.ones(len(log.q)), log.q - middle]), k_i, log.dt)[::_every(log)]
        row = np.zeros((len(basis), 8 * len(robots)))
        at = 8 * robots.index(log.robot)
        row[:, at:at + 8] = basis
        rows.append(row)
    return np.concatenate(rows), np.tile([PRIOR_CONSTANT, *[PRIOR_SLOPE] * 7], len(robots))


def _fit_joint(logs: Sequence[Log], joint: int, k_i: float, columns: Array, prior: Array) -> Array:
    """k, A, alpha, v of one joint (4,)."""
    y = -np.concatenate([filtered(log.u[:, joint], k_i, log.dt)[::_every(log)] for log in logs])
    sigma = max(1.4826 * float(np.median(np.abs(y - np.median(y)))), 1e-3)
    widths = np.array([PRIOR_K, PRIOR_A, PRIOR_ALPHA[1], PRIOR_V, *prior])
    middle = np.zeros(len(widths))
    middle[2] = PRIOR_ALPHA[0]

    def shape(theta: Array) -> tuple[Array, Array]:
        """The friction's share of y (m,), and its derivatives by k, A, log alpha and v (m, 4)."""
        a, alpha, v = theta[1], np.exp(theta[2]), theta[3]
        parts = []
        for log in logs:
            dq = log.dq[:, joint]
            s = turned(dq, alpha, v)
            slope = a * s * (1.0 - s)
            stack = np.column_stack([np.ones_like(s), s, slope * alpha * (dq + v), slope * alpha])
            parts.append(filtered(stack, k_i, log.dt)[::_every(log)])
        D = np.concatenate(parts)
        return theta[0] * D[:, 0] + a * D[:, 1], D

    # The priors enter through the same loss as the data; near them it is quadratic.
    def error(theta: Array) -> Array:
        return np.concatenate([(shape(theta)[0] + columns @ theta[4:] - y) / sigma, (theta - middle) / widths])

    def jacobian(theta: Array) -> Array:
        return np.vstack([np.hstack([shape(theta)[1], columns]) / sigma, np.diag(1.0 / widths)])

    start = middle.copy()
    start[1] = 0.1
    free = np.full(len(prior), np.inf)
    low, high = np.concatenate([BOUNDS[0], -free]), np.concatenate([BOUNDS[1], free])
    theta = least_squares(
        error, start, jacobian,  # pyright: ignore[reportArgumentType] (the stubs know only the names of built-in ones)
        bounds=(low, high), loss="soft_l1", x_scale=widths, max_nfev=60).x
    return np.array([theta[0], theta[1], np.exp(theta[2]), theta[3]])


# -- thresholds -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Alarms:
    """Gumbel's law of the block maxima of |r_k|, for each log: location and scale [N m] (logs, 7); robot of each log."""

    location: Array
    scale: Array
    robot: tuple[int, ...]

    def thresholds(self, per_hour: float) -> Array:
        """r_low [N m] (7,) that free motion exceeds at most so often an hour, all joints together.

        The worst log of the worst robot counts; with several robots, also one that is worse than those by their spread.
        Every crossing counts as an alarm: with hysteresis, which joins neighbouring ones, there are fewer.
        """
        if not per_hour > 0.0:
            raise CalibrationError(f"false alarms per hour must be above 0, not {per_hour!r}")
        share = min(per_hour / 7.0 * BLOCK / 3600.0, 0.5)  # of the blocks, for one joint
        levels = self.location - self.scale * np.log(-np.log1p(-share))
        worst = np.array([levels[np.array(self.robot) == robot].max(axis=0) for robot in sorted(set(self.robot))])
        r_low = worst.max(axis=0)
        if len(worst) > 1:
            r_low = np.maximum(r_low, worst.mean(axis=0) + SPREAD * worst.std(axis=0, ddof=1))
        return np.maximum(r_low, FLOOR)


def fit_alarms(logs: Sequence[Log], k_i: float, compensation: FrictionConfig | None = None) -> Alarms:
    """The law of the residual's maxima at this K_I [1/s] and compensation, by the method of moments.

    Raises CalibrationError for a log of fewer than ten blocks.
    """
    location, scale = [], []
    for log in logs:
        n = round(BLOCK / log.dt)
        r = np.abs(log.residual(k_i, compensation))
        blocks = len(r) // n
        if blocks < 10:
            raise CalibrationError(f"a log of {len(r) * log.dt:.1f} s is too short: at least {10 * BLOCK:g} s are needed")
        maxima = r[:blocks * n].reshape(blocks, n, 7).max(axis=1)
        beta = maxima.std(axis=0, ddof=1) * np.sqrt(6.0) / np.pi
        scale.append(beta)
        location.append(maxima.mean(axis=0) - EULER * beta)
    return Alarms(np.array(location), np.array(scale), tuple(log.robot for log in logs))
