"""The contact Jacobian, Eq. (10), and the model's terms it is made from. Pure numpy: shared by estimation and control."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.geometry import skew, skews

Array = NDArray[np.float64]
_MOVED_BY = np.tri(7)
"""Whether joint k + 1 moves link i + 1, (7, 7)."""


def contact_jacobian(J_i: Array, x_c: Array, x_i: Array) -> Array:
    """J_c = (I  -S(x_c - x_i)) J_i, shape (3, 7): velocity of the point x_c of link i, Eq. (10).

    J_i: geometric Jacobian of link i (6, 7), linear part first, at the frame's origin x_i [m] (3,); x_c [m] (3,); all
    in the world.
    """
    return J_i[:3] - skew(x_c - x_i) @ J_i[3:]


@dataclass(frozen=True, eq=False, slots=True)
class Terms:
    """The robot model at (q, dq).

    p: generalized momentum M dq [kg m2/s] (7,). Ct_dq: C^T dq [N m] (7,). g: gravity [N m] (7,).
    T_world_link: poses of base and links (8, 4, 4). x: end effector [m] (3,). J: its Jacobian (3, 7).
    J_spatial: Jacobian of the last link's spatial velocity, taken at the world's origin (6, 7), linear part first.
    """

    p: Array
    Ct_dq: Array
    g: Array
    T_world_link: Array
    x: Array
    J: Array
    J_spatial: Array

    @property
    def J_tool(self) -> Array:
        """Jacobian of the end effector's velocity, linear part first, in the world's axes, shape (6, 7)."""
        return np.vstack([self.J, self.J_spatial[3:]])

    def J_link(self, link: int) -> Array:
        """J_i, the geometric Jacobian of link i (6, 7) in the world's axes; its last n - i columns are zero, Eq. (10)."""
        J = self.J_spatial.copy()
        J[:, link:] = 0.0
        J[:3] -= skew(self.T_world_link[link, :3, 3]) @ J[3:]
        return J

    def J_links(self) -> Array:
        """J_i of the links 1 to 7 at once, shape (7, 6, 7)."""
        J, away = np.empty((7, 6, 7)), self.T_world_link[1:, :3, 3]
        J[:, 3:] = self.J_spatial[3:] * _MOVED_BY[:, None]
        J[:, :3] = self.J_spatial[:3] * _MOVED_BY[:, None]
        J[:, :3] -= skews(away) @ J[:, 3:]
        return J

    def J_contact(self, link: int, p_world: Array) -> Array:
        """J_c of the point p_world [m] (3,) fixed to a link, shape (3, 7), Eq. (10)."""
        return contact_jacobian(self.J_link(link), p_world, self.T_world_link[link, :3, 3])
