"""The robot description against the datasheet's figures and the laws every rigid body obeys."""

import mujoco
import numpy as np
import pytest

from hrc.paths import assets

LINKS = [f"link_{i}" for i in range(1, 8)]


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_path(str(assets() / "lwr" / "lwr.xml"))


@pytest.fixture
def data(model):
    return mujoco.MjData(model)


def test_it_is_the_arm_alone(model):
    assert [model.body(i).name for i in range(model.nbody)] == ["world", "base", *LINKS]
    assert [model.joint(i).name for i in range(model.njnt)] == [f"joint_{i}" for i in range(1, 8)]
    assert [model.actuator(i).name for i in range(model.nu)] == [f"motor_{i}" for i in range(1, 8)]
    assert model.nq == model.nv == 7
    assert list(model.actuator_trnid[:, 0]) == list(range(7))


def test_total_mass_is_that_of_the_datasheet(model):
    assert model.body_mass.sum() == pytest.approx(16.0, abs=1e-9)


def test_axes_and_lengths(model, data):
    mujoco.mj_kinematics(model, data)
    assert data.site("flange").xpos == pytest.approx([0, 0, 1.1785], abs=1e-9)
    assert data.xaxis == pytest.approx(np.array(
        [[0, 0, 1], [0, -1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, 1]]), abs=1e-12)
    heights = [data.body(name).xpos[2] for name in LINKS]
    assert heights == pytest.approx([0.3105, 0.3105, 0.7105, 0.7105, 1.1005, 1.1005, 1.1005], abs=1e-9)


def test_limits(model):
    degrees = np.array([170, 120, 170, 120, 170, 120, 170])
    assert model.jnt_limited.all()
    assert np.degrees(model.jnt_range) == pytest.approx(np.column_stack([-degrees, degrees]))
    torque = np.array([176, 176, 100, 100, 100, 38, 38])
    assert model.actuator_forcelimited.all()
    assert model.actuator_forcerange == pytest.approx(np.column_stack([-torque, torque]))


def test_gravity_of_the_outstretched_arm(model, data):
    data.qpos[1] = np.pi / 2
    mujoco.mj_forward(model, data)
    assert abs(data.qfrc_bias[1]) == pytest.approx(47.0, abs=1.0)
    assert abs(data.qfrc_bias[3]) == pytest.approx(13.3, abs=0.5)


def test_nothing_acts_behind_the_torque_sensors(model):
    assert not model.dof_damping.any()
    assert not model.dof_frictionloss.any()
    assert model.dof_armature == pytest.approx(np.array([3.19, 3.05, 1.98, 2.05, 0.787, 0.391, 0.394]) / 4)


def test_inertias_are_those_of_real_bodies(model):
    for principal in model.body_inertia[1:]:
        assert (principal > 0).all()
        assert 2 * principal.max() < principal.sum()            # the triangle inequality


def test_centres_of_mass_lie_within_their_shells(model):
    for i, name in enumerate(["base", *LINKS], start=1):
        own = (model.geom_bodyid == i) & (model.geom_group == 3)
        box = model.geom_aabb[own]
        low = (model.geom_pos[own] - np.linalg.norm(box[:, 3:], axis=1)[:, None]).min(0)
        high = (model.geom_pos[own] + np.linalg.norm(box[:, 3:], axis=1)[:, None]).max(0)
        assert (low < model.body_ipos[i]).all(), name
        assert (model.body_ipos[i] < high).all(), name


def test_the_robot_does_not_touch_itself_but_other_things(model):
    seen, touched = model.geom_group == 2, model.geom_group == 3
    assert seen.sum() == 8
    assert not (model.geom_contype[seen] | model.geom_conaffinity[seen]).any()
    assert not (model.geom_contype[touched][:, None] & model.geom_conaffinity[touched][None]).any()
    spec = mujoco.MjSpec.from_file(str(assets() / "lwr" / "lwr.xml"))
    ball = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05, 0, 0], pos=[0, -0.11, 0.7105])
    ball.contype, ball.conaffinity = 2, 1
    met = spec.compile()
    state = mujoco.MjData(met)
    mujoco.mj_forward(met, state)
    assert state.ncon > 0
    touching = {met.body(met.geom_bodyid[i]).name for i in state.contact.geom.ravel()}
    assert touching <= {"world", "link_3", "link_4"}


def test_options(model):
    assert model.opt.timestep == pytest.approx(1e-3)
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert model.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE
