"""The arm's own Jacobians: they are the derivatives of its kinematics, and what their projectors let through does not move
the point."""

from collections.abc import Callable

import numpy as np
import pytest

from hrc.control import laws
from hrc.geometry import apply
from hrc.model import Dynamics, load_spec, pinocchio_model

DYNAMICS = Dynamics(pinocchio_model(load_spec().compile(), armature=False))
P_LINK = np.array([0.04, -0.05, 0.06])
POSTURES = np.random.default_rng(3).uniform(-2.0, 2.0, (20, 7))
H = 1e-6


def derivative(x: Callable[[np.ndarray], np.ndarray], q: np.ndarray) -> np.ndarray:
    """dx/dq (3, 7) by central differences."""
    return np.column_stack([(x(q + H * e) - x(q - H * e)) / (2.0 * H) for e in np.eye(7)])


def tool(q: np.ndarray) -> np.ndarray:
    return DYNAMICS.kinematics(q)[1]


def on_link(link: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda q: apply(DYNAMICS.kinematics(q)[0][link], P_LINK)


def test_the_jacobian_is_the_derivative_of_the_end_effectors_place():
    for q in POSTURES:
        np.testing.assert_allclose(DYNAMICS.terms(q, np.zeros(7)).J, derivative(tool, q), atol=1e-8)


@pytest.mark.parametrize("link", range(1, 8))
def test_the_contact_jacobian_is_the_derivative_of_the_points_place(link):
    for q in POSTURES:
        x_c = on_link(link)
        J_c = DYNAMICS.terms(q, np.zeros(7)).J_contact(link, x_c(q))
        np.testing.assert_allclose(J_c, derivative(x_c, q), atol=1e-8)


def assert_leaves_alone(J: np.ndarray, x: Callable[[np.ndarray], np.ndarray], q: np.ndarray, dq: np.ndarray) -> None:
    """J P = 0, P is a projector of the right rank, and motion through it leaves x where it is."""
    P = laws.inverse(J).projector
    np.testing.assert_allclose(J @ P, 0.0, atol=2.0 * laws.RANK)
    np.testing.assert_allclose(P @ P, P, atol=1e-12)
    assert round(np.trace(P)) == 7 - np.linalg.matrix_rank(J, tol=laws.RANK)
    moved = (x(q + H * P @ dq) - x(q - H * P @ dq)) / (2.0 * H)
    assert np.linalg.norm(moved) <= 2.0 * laws.RANK * np.linalg.norm(dq) + 1e-8


def test_the_null_space_does_not_move_the_end_effector():
    for q in POSTURES:
        assert_leaves_alone(DYNAMICS.terms(q, np.zeros(7)).J, tool, q, np.cos(q))


@pytest.mark.parametrize("link", range(1, 8))
def test_the_contacts_null_space_does_not_move_the_contact(link):
    """On links 1 to 3 as well, where the joints do not move the point in every direction."""
    for q in POSTURES:
        x_c = on_link(link)
        J_c = DYNAMICS.terms(q, np.zeros(7)).J_contact(link, x_c(q))
        assert_leaves_alone(J_c, x_c, q, np.cos(q))
        assert np.linalg.matrix_rank(J_c, tol=laws.RANK) == (1, 2, 2, 3, 3, 3, 3)[link - 1]
