"""A task that cannot be done is refused before anything moves."""

import dataclasses

import numpy as np
import pytest

from hrc.cell.task import plan
from hrc.control.reference import TaskConfig
from hrc.errors import ConfigError
from hrc.model import Dynamics, joint_limits, load_spec, pinocchio_model
from hrc.scene import load_scene

COMPILED = load_spec().compile()
DYNAMICS = Dynamics(pinocchio_model(COMPILED, armature=False))


def planned(**changes):
    return plan(TaskConfig(**changes), DYNAMICS, joint_limits(COMPILED), load_scene())


@pytest.mark.parametrize("kind", ["hexagon", "circle", "hold"])
@pytest.mark.parametrize("upright", [False, True])
def test_the_arm_begins_on_its_path(kind, upright):
    task = planned(kind=kind, upright=upright)
    np.testing.assert_allclose(DYNAMICS.kinematics(task.q_start)[1], task.path.at(0.0), atol=1e-6)
    np.testing.assert_allclose(DYNAMICS.kinematics(task.q_d)[1], TaskConfig().centre, atol=1e-6)
    assert (task.R_d is not None) == upright


def test_waypoints_are_run_from_the_first(tmp_path):
    file = tmp_path / "points.txt"
    file.write_text("-0.5 -0.2 0.4\n-0.6 0.1 0.5\n-0.45 0.2 0.35\n")
    task = planned(kind="waypoints", waypoints=str(file))
    assert np.linalg.norm(DYNAMICS.kinematics(task.q_start)[1] - [-0.5, -0.2, 0.4]) < 0.01


@pytest.mark.parametrize(("changes", "complaint"), [
    ({"centre": (1.2, 1.2, 1.2)}, r"cannot reach \[1.2"),
    ({"centre": (-0.75, 0.0, 0.75), "radius": 0.3}, "cannot reach"),
    ({"centre": (-0.55, 0.0, 0.10)}, "leads through the table"),
    ({"speed": 0.5, "centre": (-0.3, 0.0, 0.35), "radius": 0.3, "upright": True}, "too fast for the joints|cannot reach|lim"),
])
def test_an_impossible_path_is_one_clear_error(changes, complaint):
    with pytest.raises(ConfigError, match=complaint):
        planned(**changes)


def test_a_path_too_fast_for_the_joints_says_what_could_be_done():
    limits = joint_limits(COMPILED)
    slow = dataclasses.replace(limits, dq_max=0.1 * limits.dq_max)
    with pytest.raises(ConfigError, match=r"too fast for the joints.* at most 0\.\d\d m/s can be done there"):
        plan(TaskConfig(speed=0.5), DYNAMICS, slow, load_scene())
