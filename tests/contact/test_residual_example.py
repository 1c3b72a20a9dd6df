"""The script in docs/residual_example.md does what its page says, on the log of an arm that is not this project's."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "residual_example.md").read_text(), flags=re.DOTALL)
JOINTS, DT, PUSHED = 6, 0.002, 1.0
FINER = 10
"""The motion is so many times finer than its log."""
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
F = np.array([0.0, 15.0, -10.0])


def urdf() -> str:
    """Six joints in a row, each with half a kilogram less than the one before."""
    links = "".join(
        f'<link name="l{i}"><inertial><origin xyz="0.02 0 0.1"/><mass value="{4.0 - 0.5 * i}"/>'
        f'<inertia ixx="0.03" iyy="0.03" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for i in range(JOINTS + 1))
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/><origin xyz="0 0 0.22"/>'
        f'<axis xyz="{AXES[i]}"/><limit lower="-3" upper="3" effort="200" velocity="3"/></joint>' for i in range(JOINTS))
    return f'<robot name="arm">{links}{joints}</robot>'


def moved(model: pin.Model) -> tuple[np.ndarray, np.ndarray]:
    """A log (n, 1 + 3 * 6) of three seconds of motion with a push at the last joint's frame, and J^T F at its end (6,)."""
    data, q, dq, rows = model.createData(), np.full(JOINTS, 0.3), np.zeros(JOINTS), []
    r, h = np.zeros(JOINTS), DT / FINER
    for k in range(round(3.0 / h)):
        t = k * h
        q_d = 0.3 + 0.5 * np.sin(3.0 * t) * np.exp(-max(0.0, t - 0.8) * 8.0)
        tau = pin.computeGeneralizedGravity(model, data, q) + 60.0 * (q_d - q) - 12.0 * dq
        if t >= PUSHED:
            J = pin.computeJointJacobian(model, data, q, JOINTS)
            r = J[:3].T @ data.oMi[JOINTS].rotation.T @ F
        if k % FINER == 0:
            rows.append([t, *q, *dq, *tau])
        ddq = pin.aba(model, data, q, dq, tau + r)
        q, dq = q + h * (dq + 0.5 * h * ddq), dq + h * ddq
    return np.array(rows), r


@pytest.fixture(scope="module")
def printed(tmp_path_factory) -> tuple[np.ndarray, np.ndarray]:
    """What the script prints (n, 7), and the torque of the push at the end of the log (6,)."""
    folder = tmp_path_factory.mktemp("log")
    (folder / "arm.urdf").write_text(urdf())
    log, contact = moved(pin.buildModelFromXML(urdf()))
    names = ["t", *(f"{name}_{i + 1}" for name in ("q", "dq", "tau") for i in range(JOINTS))]
    np.savetxt(folder / "log.csv", log, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    assert len(SCRIPT) == 1
    (folder / "residual.py").write_text(SCRIPT[0])
    done = subprocess.run([sys.executable, "residual.py", "arm.urdf", "log.csv"], cwd=folder, capture_output=True, text=True,
                          check=False, env={"PYTHONPATH": str(ROOT), "PATH": ""})
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "t," + ",".join(f"r_{i + 1}" for i in range(JOINTS))
    return np.array([[float(x) for x in line.split(",")] for line in lines[1:]]), contact


def test_free_motion_leaves_no_residual(printed):
    rows, _ = printed
    free = rows[rows[:, 0] < PUSHED - DT]
    assert len(free) > 400
    assert np.abs(free[:, 1:]).max() < 0.02


def test_a_steady_push_is_the_residual(printed):
    rows, contact = printed
    assert np.linalg.norm(contact) > 5.0
    assert np.linalg.norm(rows[-1, 1:] - contact) < 0.02 * np.linalg.norm(contact)
