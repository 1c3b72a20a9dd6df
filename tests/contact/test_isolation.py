"""The residual tells links apart that vision confuses."""

import numpy as np

from hrc.contact.isolation import misfit
from hrc.geometry import apply
from hrc.model import Dynamics, load_spec, pinocchio_model

R_LOW = np.array([1.5, 2.5, 1.0, 1.2, 0.8, 0.5, 0.5])
DYNAMICS = Dynamics(pinocchio_model(load_spec().compile(), armature=False))
Q = np.deg2rad([5.0, 27.0, -10.0, -83.0, 8.0, 69.0, 0.0])
POINTS = {3: (0.0, -0.08, -0.07), 4: (0.0, 0.06, 0.1), 5: (0.05, 0.0, -0.1), 6: (0.07, 0.0, 0.0), 7: (0.0, 0.04, 0.06)}


def jacobian(link: int) -> np.ndarray:
    terms = DYNAMICS.terms(Q, np.zeros(7))
    return terms.J_contact(link, apply(terms.T_world_link[link], POINTS[link]))


def test_the_true_point_explains_its_residual():
    rng = np.random.default_rng(0)
    for link in POINTS:
        J_c = jacobian(link)
        for F in rng.uniform(-30, 30, (20, 3)):
            assert misfit(J_c, J_c.T @ F, R_LOW) < 0.06


def test_another_link_mostly_does_not():
    """Over random forces, the true link fits better than any other nearly always."""
    rng, right, total = np.random.default_rng(1), 0, 0
    for link in POINTS:
        for F in rng.uniform(-30, 30, (40, 3)):
            r = jacobian(link).T @ F + rng.normal(0.0, 0.1, 7) * R_LOW
            best = min(POINTS, key=lambda other: misfit(jacobian(other), r, R_LOW))
            right, total = right + (best == link), total + 1
    assert right / total > 0.6


def test_joints_beyond_the_link_count_against_it():
    r = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0])
    assert misfit(jacobian(3), r, R_LOW) > 0.99
