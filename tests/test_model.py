"""Pinocchio and MuJoCo agree, and both agree with what is published of the arm."""

import mujoco
import numpy as np
import pytest

from hrc.geometry import apply, skew
from hrc.jacobian import contact_jacobian
from hrc.model import DQ_MAX, Dynamics, joint_limits, load_spec, perturbed, pinocchio_model


@pytest.fixture(scope="module")
def compiled() -> mujoco.MjModel:
    return load_spec().compile()


@pytest.fixture(scope="module")
def dynamics(compiled) -> Dynamics:
    return Dynamics(pinocchio_model(compiled, armature=True))


def states(n: int = 20):
    rng = np.random.default_rng(7)
    return [(rng.uniform(-2, 2, 7), rng.uniform(-2, 2, 7), rng.uniform(-5, 5, 7)) for _ in range(n)]


def at(compiled, q, dq) -> mujoco.MjData:
    data = mujoco.MjData(compiled)
    data.qpos[:], data.qvel[:] = q, dq
    mujoco.mj_forward(compiled, data)
    return data


def test_inertia_and_bias_agree_with_mujoco(compiled, dynamics):
    for q, dq, _ in states():
        data, M = at(compiled, q, dq), np.zeros((7, 7))
        mujoco.mj_fullM(compiled, data, M)
        np.testing.assert_allclose(dynamics.mass_matrix(q), M, atol=1e-12)
        np.testing.assert_allclose(dynamics.inverse_dynamics(q, dq, np.zeros(7)), data.qfrc_bias, atol=1e-11)


def test_kinematics_agree_with_mujoco(compiled, dynamics):
    for q, dq, _ in states():
        data, terms = at(compiled, q, dq), dynamics.terms(q, dq)
        np.testing.assert_allclose(terms.x, data.site("flange").xpos, atol=1e-12)
        J = np.zeros((3, 7))
        mujoco.mj_jacSite(compiled, data, J, None, compiled.site("flange").id)
        np.testing.assert_allclose(terms.J, J, atol=1e-12)
        for link in range(1, 8):
            np.testing.assert_allclose(terms.T_world_link[link, :3, 3], data.body(f"link_{link}").xpos, atol=1e-12)


def test_the_parts_of_the_equation_of_motion_add_up(dynamics):
    """Eq. (1): M ddq + C dq + g is the inverse dynamics."""
    for q, dq, ddq in states():
        whole = dynamics.mass_matrix(q) @ ddq + dynamics.coriolis_matrix(q, dq) @ dq + dynamics.gravity(q)
        np.testing.assert_allclose(whole, dynamics.inverse_dynamics(q, dq, ddq), atol=1e-10)
        np.testing.assert_allclose(dynamics.momentum(q, dq), dynamics.mass_matrix(q) @ dq, atol=1e-11)


def test_the_inertia_changes_by_c_plus_its_transpose(dynamics):
    """dM/dt = C + C^T, which is what makes Eq. (2) need no acceleration."""
    h = 1e-6
    for q, dq, _ in states(5):
        dM = (dynamics.mass_matrix(q + h * dq) - dynamics.mass_matrix(q - h * dq)) / (2 * h)
        C = dynamics.coriolis_matrix(q, dq)
        np.testing.assert_allclose(dM, C + C.T, atol=1e-6)
        np.testing.assert_allclose(dynamics.terms(q, dq).Ct_dq, C.T @ dq, atol=1e-12)


@pytest.mark.parametrize("link", range(1, 8))
def test_the_contact_jacobian_is_the_points_velocity(dynamics, link):
    """Eq. (10) against finite differences of the forward kinematics."""
    h, p_link = 1e-7, np.array([0.04, -0.05, 0.06])
    for q, dq, _ in states(5):
        terms = dynamics.terms(q, dq)
        p = apply(terms.T_world_link[link], p_link)
        ahead = apply(dynamics.kinematics(q + h * dq)[0][link], p_link)
        behind = apply(dynamics.kinematics(q - h * dq)[0][link], p_link)
        np.testing.assert_allclose(terms.J_contact(link, p) @ dq, (ahead - behind) / (2 * h), atol=1e-6)
        assert np.all(terms.J_link(link)[:, link:] == 0.0)
        np.testing.assert_allclose(terms.J_links()[link - 1], terms.J_link(link), atol=1e-12)


def test_the_contact_jacobian_is_eq_10():
    rng = np.random.default_rng(0)
    J_i, x_c, x_i = rng.standard_normal((6, 7)), rng.standard_normal(3), rng.standard_normal(3)
    G = np.hstack([np.eye(3), -skew(x_c - x_i)])
    np.testing.assert_allclose(contact_jacobian(J_i, x_c, x_i), G @ J_i)


def test_published_figures_of_the_arm(compiled, dynamics):
    """Height of the flange, total mass, and gravity with the arm stretched out."""
    assert dynamics.kinematics(np.zeros(7))[1] == pytest.approx([0.0, 0.0, 1.1785], abs=1e-9)
    assert compiled.body_mass.sum() == pytest.approx(16.0, abs=1e-3)
    q = np.zeros(7)
    q[1] = np.pi / 2
    assert abs(dynamics.gravity(q)[1]) == pytest.approx(47.0, abs=1.0)


def test_gravity_follows_the_identified_model(dynamics):
    """The leading terms of the gravity identified on the real arm (Gaz, Flacco, De Luca 2014), good to 0.54 N m."""
    rng = np.random.default_rng(1)
    for q in rng.uniform(-2, 2, (200, 7)):
        s2, c2, s3, c3, s4, c4 = np.sin(q[1]), np.cos(q[1]), np.sin(q[2]), np.cos(q[2]), np.sin(q[3]), np.cos(q[3])
        g = dynamics.gravity(q)
        assert g[1] == pytest.approx(-9.80665 * (3.4568 * s2 + 1.3340 * (s2 * c4 - c2 * c3 * s4)), abs=0.9)
        assert g[2] == pytest.approx(-13.08 * s2 * s3 * s4, abs=0.9)
        assert g[3] == pytest.approx(13.08 * (s2 * c3 * c4 - c2 * s4), abs=0.9)


def test_limits_are_those_of_the_data_sheet(compiled):
    limits = joint_limits(compiled)
    np.testing.assert_allclose(np.rad2deg(limits.q_max), [170, 120, 170, 120, 170, 120, 170])
    np.testing.assert_allclose(limits.q_min, -limits.q_max)
    np.testing.assert_allclose(limits.tau_max, [176, 176, 100, 100, 100, 38, 38])
    np.testing.assert_allclose(np.rad2deg(DQ_MAX), [110, 110, 128, 128, 204, 184, 184])


def test_the_observers_model_has_no_motor_inertia(compiled):
    q = np.linspace(-1, 1, 7)
    link_side = Dynamics(pinocchio_model(compiled, armature=False)).mass_matrix(q)
    motor_side = Dynamics(pinocchio_model(compiled, armature=True)).mass_matrix(q)
    np.testing.assert_allclose(motor_side - link_side, np.diag(compiled.dof_armature), atol=1e-12)


def test_a_perturbed_model_is_off_by_no_more_than_asked(compiled):
    model = pinocchio_model(compiled, armature=False)
    other = perturbed(model, 0.05, np.random.default_rng(0))
    for i in range(1, 8):
        assert other.inertias[i].mass / model.inertias[i].mass == pytest.approx(1.0, abs=0.05)
        assert other.inertias[i].mass != model.inertias[i].mass


def test_the_position_solver_reaches_its_target(dynamics):
    q = dynamics.solve_position(np.array([-0.55, 0.1, 0.45]), np.deg2rad([0, 25, 0, -85, 0, 70, 0]))
    assert dynamics.kinematics(q)[1] == pytest.approx([-0.55, 0.1, 0.45], abs=1e-6)
