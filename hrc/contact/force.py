"""The contact force from the residual, Eq. (3) and (5), and how well it is known."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrc.geometry import skew
from hrc.parameters import Parameters, param

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ForceConfig(Parameters):
    """Damping of the pseudoinverse in Eq. (5)."""

    epsilon: float = param(0.1, low=0.0, high=1.0, unit="m")
    """Singular values of J_c below this are damped: the force along them is barely seen by the joints."""
    damping: float = param(0.05, low=0.0, high=1.0, unit="m")
    """Largest damping, reached at singular value zero."""


class ForceEstimate(NamedTuple):
    """F: force on the robot [N] (3,); sigma_min [m]: how well the worst direction is seen; unobservable: it, a unit (3,).

    inverse: what makes F of the residual, F = inverse r [1/m] (3, 7).
    """

    F: Array
    sigma_min: float
    unobservable: Array
    inverse: Array


def estimate_force(J_c: Array, r: Array, config: ForceConfig) -> ForceEstimate:
    """F = (J_c^T)# r, Eq. (5), with damping per singular value: exact above epsilon, bounded below.

    J_c: contact Jacobian (3, 7), or several one upon the other (3 k, 7), which gives their forces one after the other (3 k,).
    r: residual [N m] (7,). The component of the true force in the null space of J_c^T is invisible to the joints; its
    direction is returned beside the estimate.
    """
    # J_c = U S V^T, so (J_c^T)# = U S^-1 V^T.
    U, S, Vt = np.linalg.svd(J_c, full_matrices=False)
    weak = np.maximum(1.0 - (S / config.epsilon) ** 2, 0.0) if config.epsilon > 0 else np.zeros(len(S))
    gain = S / np.maximum(S * S + weak * config.damping**2, 1e-12)
    inverse = (U * gain) @ Vt
    return ForceEstimate(inverse @ r, float(S[-1]), U[:, -1], inverse)


class Doubt(StrEnum):
    """Why the joints alone do not tell several forces."""

    NONE = ""
    UNFELT = "a force at one of the points has a direction that no joint feels"
    OPPOSED = "opposite forces along the line between the points cancel in every joint"
    ALIKE = "different forces at the points feel alike in the joints"


class ForcesEstimate(NamedTuple):
    """F: force on the robot at each point [N] (k, 3); sigma_min [m], inverse [1/m] (3 k, 7): as in ForceEstimate, of all.

    doubt: why F is not what acts, even of an exact residual; empty where it is.
    """

    F: Array
    sigma_min: float
    inverse: Array
    doubt: Doubt


def estimate_forces(Js: Sequence[Array], r: Array, config: ForceConfig) -> ForcesEstimate:
    """All forces from the stacked Jacobian, r = (J_c1; J_c2; ...)^T (F_1; F_2; ...), exact where its rank is full.

    Js: contact Jacobians (3, 7), at least one. r: residual [N m] (7,). Seven joints tell at most two forces.
    """
    stack = np.vstack(Js)
    F, sigma_min, unfelt, inverse = estimate_force(stack, r, config)
    return ForcesEstimate(F.reshape(-1, 3), sigma_min, inverse, _doubt(Js, stack, sigma_min, unfelt, config))


def _doubt(Js: Sequence[Array], stack: Array, sigma_min: float, unfelt: Array, config: ForceConfig) -> Doubt:
    if len(stack) <= stack.shape[1] and sigma_min > max(config.epsilon, 1e-9):
        return Doubt.NONE
    if any(np.linalg.svd(J, compute_uv=False)[-1] <= max(config.epsilon, 1e-9) for J in Js):
        return Doubt.UNFELT
    pair = unfelt.reshape(-1, 3)
    return Doubt.OPPOSED if np.linalg.norm(pair.sum(axis=0)) < 1e-6 else Doubt.ALIKE


def estimate_pushes(J_c: Array, r: Array, R: Array, prior: Array) -> tuple[Array, Array]:
    """The likeliest forces (3 k,) and what makes them of the residual (3 k, 7), where the joints alone leave them open.

    J_c: stacked Jacobians (3 k, 7). R: covariance of the residual's noise [N^2 m^2] (7, 7); prior: that of the forces
    [N^2] (3 k, 3 k). With a wide prior it is the weighted pseudoinverse of Eq. (5).
    """
    inverse = np.linalg.solve(J_c.T @ prior @ J_c + R, J_c.T @ prior).T
    return inverse @ r, np.asarray(inverse, np.float64)


def force_covariance(inverse: Array, J_c: Array, R: Array, prior: Array) -> Array:
    """Covariance [N^2] (3 k, 3 k) of the error of F = inverse r, r = J_c^T F + noise of covariance R [N^2 m^2] (7, 7).

    What is not felt of the force, (I - inverse J_c^T) F, is not known to be nothing: it counts with the covariance that the
    force is believed to have, `prior` [N^2] (3 k, 3 k). So a direction that no joint feels is no surer than before.
    The residual follows a force with the time constant 1 / K_I: the covariance is that of a force which changes slowly.
    """
    lost = np.eye(len(J_c)) - inverse @ J_c.T
    return inverse @ R @ inverse.T + lost @ prior @ lost.T


def place_covariance(J_w: Array, F: Array, spread: Array) -> Array:
    """Covariance [N^2 m^2] (7, 7) of the residual's part that a displaced contact point leaves unexplained, to first order.

    J_w: Jacobian of the link's angular velocity (3, 7). F: the force there [N] (3,). spread: covariance of the point [m^2]
    (3, 3). Moved by d, the force shows in the residual as J_c^T F + J_w^T (d x F), Eq. (3) and (10).
    """
    moment = J_w.T @ skew(F)
    return np.asarray(moment @ spread @ moment.T, np.float64)
