"""Which of the points that vision offers can have caused the residual.

A force on link i moves only joints 1 to i, and only as J_c^T F: vision alone may name a link that is merely in line with
the obstacle, the residual tells whether a push there could have felt like this.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
WEAK = 0.05
"""Directions of J_c^T below this fraction of the strongest explain nothing: noise alone would fit them."""


def misfit(J_c: Array, r: Array, r_low: Array) -> float:
    """The part of the residual that no force at this point explains, min |r - J_c^T F| / |r|, from 0 to 1.

    J_c: contact Jacobian of the point (3, 7). r: residual [N m] (7,). r_low: thresholds [N m] (7,), the scale of each joint.
    """
    felt = r / r_low
    U, S, _ = np.linalg.svd(J_c.T / r_low[:, None], full_matrices=False)
    explained = U[:, S > WEAK * S[0]].T @ felt
    total = float(felt @ felt)
    return float(np.sqrt(max(0.0, total - float(explained @ explained)) / max(total, 1e-12)))
