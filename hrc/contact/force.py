"""The contact force from the residual, Eq. (3) and (5)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    """F: force on the robot [N] (3,); sigma_min [m]: how well the worst direction is seen; unobservable: it, a unit (3,)."""

    F: Array
    sigma_min: float
    unobservable: Array


def estimate_force(J_c: Array, r: Array, config: ForceConfig) -> ForceEstimate:
    """F = (J_c^T)# r, Eq. (5), with damping per singular value: exact above epsilon, bounded below.

    J_c: contact Jacobian (3, 7). r: residual [N m] (7,). The component of the true force in the null space of J_c^T is
    invisible to the joints; its direction is returned beside the estimate.
    """
    # J_c = U S V^T, so (J_c^T)# = U S^-1 V^T.
    U, S, Vt = np.linalg.svd(J_c, full_matrices=False)
    weak = np.clip(1.0 - (S / config.epsilon) ** 2, 0.0, 1.0) if config.epsilon > 0 else np.zeros(3)
    gain = S / np.maximum(S * S + weak * config.damping**2, 1e-12)
    return ForceEstimate(U @ (gain * (Vt @ r)), float(S[-1]), U[:, -1])
