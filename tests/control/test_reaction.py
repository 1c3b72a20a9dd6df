"""The state machine on a robot that moves exactly as commanded: what follows what, and what never happens."""

import itertools

import numpy as np
import pytest

from hrc.control.posture import Posture
from hrc.control.reaction import OPEN, Reaction, ReactionConfig, Surroundings
from hrc.control.reference import PathFollower, TaskConfig, make_path
from hrc.errors import ConfigError
from hrc.geometry import apply, rotation_vector
from hrc.messages import Command, Contact, Mode
from hrc.model import Dynamics, joint_limits, load_spec, pinocchio_model

DT = 0.005
COMPILED = load_spec().compile()
DYNAMICS = Dynamics(pinocchio_model(COMPILED, armature=False))
LIMITS = joint_limits(COMPILED)
ELBOW = (3, np.array([0.0, -0.08, -0.07]))
WRIST = (6, np.array([0.0, -0.07, 0.0]))


class Arm:
    """Kinematics only: q follows the command, contacts are given."""

    def __init__(self, config: ReactionConfig | None = None, *, upright: bool = False) -> None:
        task = TaskConfig()
        path = PathFollower(make_path(task), task.speed)
        q_d = DYNAMICS.solve_position(np.array(task.centre), np.deg2rad(task.posture_deg))
        self.q = DYNAMICS.solve_position(path.x_d, q_d)
        self.R_d = self.tool
        self.reaction = Reaction(config or ReactionConfig(), path, Posture(q_d),
                                 (LIMITS.q_min, LIMITS.q_max, LIMITS.dq_max), DT, self.tool if upright else None)
        self.dq = np.zeros(7)
        self.jump = 0.0

    def step(self, force=None, at=ELBOW, residual=None, detected: bool | None = None,
             surroundings: Surroundings = OPEN) -> Command:
        terms = DYNAMICS.terms(self.q, self.dq)
        contact = None
        if force is not None:
            link, p_link = at
            p = apply(terms.T_world_link[link], p_link)
            J_c = terms.J_contact(link, p)
            contact = Contact(link, p, p_link, J_c, np.asarray(force, float), 0.1, np.zeros(3))
        felt = contact is not None if detected is None else detected
        command = self.reaction.update(
            self.q, terms, np.zeros(7) if residual is None else residual, felt, contact, surroundings)
        self.jump = max(self.jump, float(np.abs(command.dq - self.dq).max()))
        self.dq = command.dq
        self.q = self.q + DT * command.dq
        return command

    def run(self, seconds: float, **kw) -> list[Command]:
        return [self.step(**kw) for _ in range(round(seconds / DT))]

    @property
    def tool(self) -> np.ndarray:
        return DYNAMICS.kinematics(self.q)[0][7, :3, :3]

    def turned(self) -> float:
        """How far the tool has turned from where it began [rad]."""
        return float(np.linalg.norm(rotation_vector(self.R_d @ self.tool.T)))

    def point(self, at) -> np.ndarray:
        return apply(DYNAMICS.kinematics(self.q)[0][at[0]], at[1])


def errors(commands) -> np.ndarray:
    return np.array([np.linalg.norm(c.x_d - c.x) for c in commands])


def test_without_contact_it_keeps_to_the_path():
    commands = Arm().run(6.0)
    assert {c.mode for c in commands} == {Mode.IDLE}
    assert errors(commands)[200:].max() < 5e-4


def test_a_push_on_the_elbow_relaxes_it_and_the_task_goes_on():
    arm = Arm()
    arm.run(1.0)
    before = arm.point(ELBOW)
    commands = arm.run(2.0, force=[0.0, 15.0, 0.0])
    assert {c.mode for c in commands} == {Mode.RELAX}
    assert (arm.point(ELBOW) - before)[1] > 0.03
    assert errors(commands).max() < 1e-3
    after = arm.run(3.0)
    assert after[-1].mode is Mode.IDLE
    assert errors(after).max() < 1e-3


def test_while_relaxing_the_elbow_never_moves_into_the_push():
    arm = Arm()
    arm.run(1.0)
    force = np.array([0.0, 15.0, 0.0])
    for k in range(400):
        before = arm.point(ELBOW)
        arm.step(force=force)
        if k > 10:  # the acceleration limit needs a moment to turn the elbow round
            assert force @ (arm.point(ELBOW) - before) / DT > -0.1  # [W]; zero but for the curvature within a step


def test_a_hard_push_aborts_and_ends_where_it_began():
    arm = Arm()
    arm.run(1.0)
    assert arm.step(force=[0.0, 40.0, 0.0], at=WRIST).mode is Mode.ABORT
    x_cd = arm.point(WRIST)  # a step later, hence the millimetre below
    pushed = arm.run(1.5, force=[0.0, 10.0, 0.0], at=WRIST)
    assert {c.mode for c in pushed} == {Mode.ABORT}, "latched, although the force is below F_abort again"
    assert np.linalg.norm(pushed[-1].admittance_error) == pytest.approx(10.0 / 350.0, rel=0.1)
    at_rest = arm.point(WRIST)
    released = arm.run(3.0)
    modes = [c.mode for c in released]
    done = modes.index(Mode.IDLE)
    assert all(m is Mode.IDLE for m in modes[done:])
    assert np.linalg.norm(released[done - 1].admittance_error) < 0.0055
    assert np.linalg.norm(pushed[-1].admittance_error - (x_cd - at_rest)) < 0.002
    assert errors(arm.run(1.0)).max() < 1e-3


def test_the_path_waits_while_the_task_is_abandoned():
    arm = Arm()
    arm.run(1.0)
    arm.step(force=[0.0, 40.0, 0.0], at=WRIST)
    s = arm.reaction.path.s
    arm.run(1.0, force=[0.0, 40.0, 0.0], at=WRIST)
    assert arm.reaction.path.s == s


def test_the_latch_moves_with_the_contact_to_another_link():
    arm = Arm()
    arm.run(0.5)
    arm.step(force=[0.0, 40.0, 0.0], at=WRIST)
    at_beginning = arm.point(ELBOW)
    arm.run(0.5, force=[0.0, 20.0, 0.0], at=ELBOW)
    moved = arm.reaction._latch
    assert moved is not None
    assert moved.link == ELBOW[0]
    assert np.linalg.norm(moved.x_cd - at_beginning) < 0.01


def test_no_transition_exceeds_the_acceleration_limit():
    rng = np.random.default_rng(5)
    arm = Arm()
    for _ in range(60):
        force = None if rng.random() < 0.4 else rng.uniform(-45, 45, 3)
        at = ELBOW if rng.random() < 0.5 else WRIST
        arm.run(float(rng.uniform(0.02, 0.3)), force=force, at=at)
    assert arm.jump <= 25.0 * DT + 1e-9


def test_a_contact_nobody_sees_freezes_the_path_and_yields_in_the_joints():
    arm = Arm()
    arm.run(1.0)
    r = np.array([0.0, 4.0, 0.0, -2.0, 0.0, 0.0, 0.0])
    arm.run(0.3, residual=r, detected=True)
    s = arm.reaction.path.s
    command = arm.run(0.5, residual=r, detected=True)[-1]
    assert command.mode is Mode.UNSEEN
    np.testing.assert_allclose(command.dq, ReactionConfig().k_reflex * r, atol=1e-9)
    assert arm.reaction.path.s == s
    assert arm.run(3.0)[-1].mode is Mode.IDLE


def test_an_abandoned_task_does_not_press_into_a_contact_that_is_not_seen():
    """The spring of Eq. (6) gives way to the reflex, and the task is not resumed while something is felt."""
    arm = Arm()
    arm.run(1.0)
    arm.run(1.0, force=[0.0, 40.0, 0.0], at=WRIST)
    r = DYNAMICS.terms(arm.q, arm.dq).J_contact(6, arm.point(WRIST)).T @ np.array([0.0, 30.0, 0.0])
    before = arm.point(WRIST)
    commands = arm.run(1.0, residual=r, detected=True)
    assert {c.mode for c in commands} == {Mode.ABORT}
    np.testing.assert_allclose(commands[-1].dq, ReactionConfig().k_reflex * r, atol=1e-9)
    assert (arm.point(WRIST) - before)[1] > -0.005
    assert arm.run(6.0)[-1].mode is Mode.IDLE


def test_after_an_unseen_contact_it_comes_back_slowly_and_answers_the_next_at_once():
    arm = Arm()
    arm.run(1.0)
    r = np.array([0.0, 8.0, 0.0, -4.0, 0.0, 0.0, 0.0])
    arm.run(1.0, residual=r, detected=True)
    speeds = []
    for _ in range(200):
        x = DYNAMICS.kinematics(arm.q)[1]
        command = arm.step()
        if command.mode is Mode.IDLE:
            speeds.append(np.linalg.norm(DYNAMICS.kinematics(arm.q)[1] - x) / DT)
    assert max(speeds[30:]) < 0.06
    arm.step(residual=r, detected=True)
    assert arm.step(residual=r, detected=True).mode is Mode.UNSEEN


def test_a_longer_blend_set_while_running_does_not_restart_an_old_one():
    arm = Arm()
    arm.run(1.0)
    arm.reaction.config = ReactionConfig(n_s=400)
    assert errors(arm.run(2.0)).max() < 1e-3


def test_a_command_that_is_no_number_stops_the_arm():
    arm = Arm()
    arm.run(1.0)
    arm.step(residual=np.full(7, np.nan), detected=True)
    for _ in range(40):
        command = arm.step(residual=np.full(7, np.nan), detected=True)
    assert np.isfinite(command.dq).all()
    assert command.mode is Mode.STOP
    assert "not finite" in command.reason
    np.testing.assert_allclose(arm.run(0.5)[-1].dq, 0.0)


def test_thresholds_must_rise():
    with pytest.raises(ConfigError, match="must rise"):
        ReactionConfig(f_abort=4.0)


def test_stop_sticks_until_resumed():
    arm = Arm()
    arm.run(1.0)
    arm.reaction.stop("enough")
    stopped = arm.run(1.0)
    assert stopped[-1].mode is Mode.STOP
    assert stopped[-1].reason == "enough"
    np.testing.assert_array_equal(stopped[-1].dq, 0.0)
    assert {c.mode for c in arm.run(0.5, force=[0.0, 60.0, 0.0])} == {Mode.STOP}
    arm.reaction.resume()
    resumed = arm.run(2.0)
    assert resumed[-1].mode is Mode.IDLE
    assert errors(resumed).max() < 0.01
    assert arm.jump <= 25.0 * DT + 1e-9


def test_the_printed_law_has_no_memory():
    arm = Arm(ReactionConfig(law="printed"))
    modes = [arm.step(force=[0.0, f, 0.0], at=WRIST).mode for f in (3.0, 10.0, 40.0, 10.0, 3.0)]
    assert modes == [Mode.IDLE, Mode.RELAX, Mode.ABORT, Mode.RELAX, Mode.IDLE]


def test_the_end_effector_is_kept_off_the_table_while_the_task_is_abandoned():
    lowest = {}
    for floor in (-1.0, 0.3):
        arm = Arm(ReactionConfig(floor=floor))
        arm.run(1.0)
        lowest[floor] = min(c.x[2] for c in arm.run(6.0, force=[-40.0, 0.0, -40.0]))
    assert lowest[0.3] > lowest[-1.0] + 0.05


def test_an_abort_lasts_while_an_obstacle_is_seen_close_by():
    arm = Arm()
    arm.run(1.0)
    assert arm.run(1.0, force=[0.0, 40.0, 0.0])[-1].mode is Mode.ABORT
    assert arm.run(5.0, surroundings=Surroundings(clearance=0.02))[-1].mode is Mode.ABORT
    after = arm.run(3.0, surroundings=Surroundings(clearance=0.04))
    assert after[-1].mode is Mode.IDLE
    assert errors(after)[-1] < 1e-3


def test_without_a_camera_the_path_waits_and_goes_on_smoothly():
    arm = Arm()
    arm.run(2.0)
    waiting = arm.run(2.0, surroundings=Surroundings(blindness="unplugged"))
    assert waiting[-1].mode is Mode.BLIND
    assert waiting[-1].reason == "unplugged"
    assert waiting[-1].path_speed == 0.0
    np.testing.assert_allclose(waiting[-1].x_d, waiting[200].x_d)
    assert np.abs(waiting[-1].dq).max() < 0.01
    after = arm.run(3.0)
    assert after[-1].mode is Mode.IDLE
    assert errors(waiting + after).max() < 1e-3
    assert arm.jump < ReactionConfig().ddq_max * DT + 1e-9


def test_without_a_camera_a_contact_still_starts_the_reflex():
    arm, blind = Arm(), Surroundings(blindness="unplugged")
    arm.run(1.0)
    arm.run(0.5, surroundings=blind)
    residual = np.array([0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    commands = arm.run(0.5, residual=residual, detected=True, surroundings=blind)
    assert commands[-1].mode is Mode.UNSEEN
    assert commands[-1].dq[1] > 0.05
    assert arm.run(2.0, surroundings=blind)[-1].mode is Mode.BLIND


def test_a_task_of_six_keeps_the_tool_upright_and_still_gives_way():
    arm = Arm(upright=True)
    commands = arm.run(6.0)
    assert errors(commands)[200:].max() < 1e-3
    assert arm.turned() < 2e-3
    commands = arm.run(2.0, force=[0.0, 15.0, 0.0])
    assert {c.mode for c in commands} == {Mode.RELAX}
    assert errors(commands).max() < 2e-3
    assert arm.turned() < 5e-3


def test_the_path_slows_down_before_an_obstacle_only_if_asked_to():
    near, half = Surroundings(clearance=0.04), Surroundings(clearance=0.175)
    assert Arm().run(2.0, surroundings=near)[-1].path_speed == 1.0
    arm = Arm(ReactionConfig(separation=True))
    assert arm.run(2.0)[-1].path_speed == 1.0
    assert arm.run(2.0, surroundings=half)[-1].path_speed == pytest.approx(0.5)
    stood = arm.run(2.0, surroundings=near)
    assert stood[-1].path_speed == 0.0
    assert errors(stood).max() < 1e-3
    assert arm.run(2.0)[-1].path_speed == 1.0


def test_every_change_of_mode_says_why():
    arm = Arm()
    arm.run(1.0)
    seen = [*arm.run(0.5, force=[0.0, 12.0, 0.0]), *arm.run(1.0), *arm.run(0.5, force=[0.0, 40.0, 0.0]), *arm.run(4.0)]
    changes = [(b.mode, b.reason) for a, b in itertools.pairwise(seen) if a.mode is not b.mode]
    assert [mode for mode, _ in changes] == [Mode.IDLE, Mode.ABORT, Mode.IDLE]
    assert seen[0].reason == "12.0 N is more than f_relax, 5 N"
    assert [reason for _, reason in changes] == [
        "at most f_release, 3 N, for 0.2 s", "40.0 N is more than f_abort, 25 N",
        "the contact is gone and made up for to 5 mm"]


@pytest.mark.parametrize("waits", [True, False])
def test_the_path_waits_before_a_push_that_the_null_space_cannot_take(waits):
    arm = Arm(ReactionConfig(path_waits=waits))
    arm.run(1.0)
    against = -15.0 * (arm.reaction.path.ahead(DT) / np.linalg.norm(arm.reaction.path.ahead(DT)))
    power, speeds = [], []
    for _ in range(60):
        terms = DYNAMICS.terms(arm.q, arm.dq)
        command = arm.step(force=against, at=WRIST)
        power.append(against @ terms.J_contact(6, apply(terms.T_world_link[6], WRIST[1])) @ command.dq)
        speeds.append(command.path_speed)
    assert command.mode is Mode.RELAX
    if waits:
        assert min(power[20:]) > -0.05
        assert speeds[-1] < 0.5
    else:
        assert min(power[20:]) < -0.5
    assert errors(arm.run(3.0))[-100:].max() < 1e-3
    assert arm.reaction.path.s > 0.3, "and goes on afterwards"


def test_the_path_waits_at_once_for_a_contact_without_a_place():
    arm = Arm()
    arm.run(1.0)
    before = arm.reaction.path.s
    seen = arm.run(0.1, detected=True)
    assert {c.mode for c in seen} == {Mode.IDLE}
    assert seen[-1].path_speed == 0.0
    assert arm.reaction.path.s - before < 0.2 * 0.04
    assert arm.run(2.0)[-1].path_speed == 1.0
