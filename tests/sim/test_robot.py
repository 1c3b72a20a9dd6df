"""The plant: it follows, its sensors tell the truth to within their errors, and nothing in it pushes too hard."""

import numpy as np
import pytest

from hrc.contact.residual import MomentumObserver, ObserverConfig
from hrc.errors import EventError
from hrc.events import MoveObstacle, Press, Pull, Push, Release, RemoveObstacle
from hrc.geometry import apply, rotation_about, rotation_from_quaternion, rotation_vector
from hrc.model import Dynamics, pinocchio_model
from hrc.scene import load_scene
from hrc.sim.obstacles import ObstacleConfig, Turn
from hrc.sim.push import PushConfig
from hrc.sim.robot import PlantConfig, SimulatedRobot
from hrc.sim.sensor import friction

IDEAL = PlantConfig(torque_noise=0.0, friction_left=0.0)
TURNED = (0.6, 0.0, 0.64, 0.48)
Q = np.deg2rad([0.0, 27.0, 0.0, -83.0, 0.0, 69.0, 0.0])


def robot(plant: PlantConfig = IDEAL, seed: int = 0) -> SimulatedRobot:
    made = SimulatedRobot(load_scene(), plant, PushConfig(), ObstacleConfig(), base_hz=1000, control_hz=200,
                          rng=np.random.default_rng(seed))
    made.place(Q)
    return made


def near(p: np.ndarray, dx: float, dy: float, dz: float) -> tuple[float, float, float]:
    return (p[0] + dx, p[1] + dy, p[2] + dz)


def swing(t: float) -> np.ndarray:
    return 0.2 * np.sin(2.0 * t + np.arange(7))


def test_it_follows_a_velocity_command():
    plant, q, errors = robot(), Q.copy(), []
    for k in range(600):
        dq = swing(k * 0.005)
        for _ in range(5):
            state = plant.step(dq)
            q += dq * 0.001
        errors.append(np.abs(state.q - q).max())
    assert max(errors) < 0.01


def test_motion_without_contact_leaves_no_residual():
    """The sensors are on the link side: motor inertia is in the servo's model and not in the observer's."""
    plant = robot()
    dynamics = Dynamics(pinocchio_model(plant.model, armature=False))
    observer, worst = MomentumObserver(ObserverConfig()), 0.0
    assert plant.model.dof_armature[:7].min() > 0.05
    for k in range(800):
        dq, tau = swing(k * 0.005), np.zeros(7)
        for _ in range(5):
            state = plant.step(dq)
            tau += state.tau / 5
        terms = dynamics.terms(state.q, state.dq)
        r = observer.update(terms.p, terms.Ct_dq, terms.g, tau, 0.005)
        if k > 100:
            worst = max(worst, float(np.abs(r).max()))
    assert worst < 0.05


def test_the_residual_is_the_torque_of_a_known_push():
    """Eq. (3): r tends to J_c^T F_c."""
    plant = robot()
    dynamics = Dynamics(pinocchio_model(plant.model, armature=False))
    observer = MomentumObserver(ObserverConfig())
    point, force = (0.0, 0.06, -0.1), (0.0, -15.0, 5.0)
    plant.apply(Push(4, point, force))
    for _ in range(200):
        tau = np.zeros(7)
        for _ in range(5):
            state = plant.step(np.zeros(7))
            tau += state.tau / 5
        terms = dynamics.terms(state.q, state.dq)
        r = observer.update(terms.p, terms.Ct_dq, terms.g, tau, 0.005)
    p = apply(terms.T_world_link[4], point)
    np.testing.assert_allclose(r, terms.J_contact(4, p).T @ np.array(force), atol=0.05)
    truth = plant.truth()
    np.testing.assert_allclose(truth.F_world, force)
    assert truth.link == 4


def test_the_realistic_sensor_is_off_by_noise_and_what_friction_is_left():
    readings = {}
    for left, noise in ((0.0, 0.0), (0.2, 0.0), (0.0, 0.003)):
        plant = robot(PlantConfig(torque_noise=noise, friction_left=left))
        readings[left, noise] = np.array([plant.step(np.zeros(7)).tau for _ in range(400)])
    offset = (readings[0.2, 0.0] - readings[0.0, 0.0]).mean(axis=0)
    np.testing.assert_allclose(offset, 0.2 * friction(np.zeros(7)), atol=0.02)
    sigma = (readings[0.0, 0.003] - readings[0.0, 0.0]).std(axis=0)
    np.testing.assert_allclose(sigma, 0.003 * robot().limits.tau_max, rtol=0.2)


def test_a_pull_is_a_capped_spring_and_its_hand_can_be_seen():
    plant = robot()
    point = (0.0, 0.0, -0.07)
    here = plant.point(3, np.array(point))
    plant.apply(Pull(3, point, near(here, 0.0, 0.02, 0.0)))
    plant.step(np.zeros(7))
    np.testing.assert_allclose(plant.truth().F_world, [0.0, 0.02 * PushConfig().stiffness, 0.0], atol=0.3)
    hand = plant.bodies()[-1]
    assert hand.present
    assert hand.virtual
    assert np.linalg.norm(hand.T_world_body[:3, 3] - here) < 0.15
    plant.apply(Pull(3, point, near(here, 0.0, 2.0, 0.0)))
    plant.step(np.zeros(7))
    assert np.linalg.norm(plant.truth().F_world) == pytest.approx(80.0)
    plant.apply(Release())
    plant.step(np.zeros(7))
    assert not plant.bodies()[-1].present
    assert np.all(plant.truth().F_world == 0.0)


def test_an_obstacle_yanked_through_the_arm_stays_below_its_cap_and_outside():
    plant = robot()
    wrist = plant.point(6, np.zeros(3))
    plant.apply(MoveObstacle("ball", near(wrist, 0.0, 0.35, 0.0)))
    plant.apply(MoveObstacle("ball", near(wrist, 0.0, -0.5, 0.0)))
    forces = []
    for _ in range(2500):
        plant.step(np.zeros(7))
        forces.append(np.linalg.norm(plant.truth().F_world))
    assert max(forces) > 40.0
    assert np.median(forces[-500:]) < ObstacleConfig().cap * 1.1
    ball = next(b for b in plant.bodies() if b.name == "ball")
    assert ball.T_world_body[1, 3] > plant.point(6, np.zeros(3))[1]


def test_a_contact_at_80_n_sinks_in_by_less_than_5_mm():
    plant = robot()
    wrist = plant.point(6, np.zeros(3))
    plant.apply(MoveObstacle("ball", near(wrist, 0.0, -0.3, 0.0)))
    plant.apply(MoveObstacle("ball", near(wrist, 0.0, 0.5, 0.0)))
    deepest, force = 0.0, 0.0
    for _ in range(1500):
        plant.step(np.zeros(7))
        F = float(np.linalg.norm(plant.truth().F_world))
        if 60.0 < F < 85.0:
            deepest = max(deepest, *(-c.dist for c in plant._data.contact))
            force = max(force, F)
    assert force > 75.0
    assert deepest < 0.005


def test_no_obstacle_appears_inside_the_robot():
    plant = robot()
    with pytest.raises(EventError, match="no room"):
        plant.apply(MoveObstacle("ball", tuple(plant.point(5, np.array([0.0, 0.0, -0.1])))))
    assert not any(b.present for b in plant.bodies())
    with pytest.raises(EventError, match="did you mean ball"):
        plant.apply(RemoveObstacle("bal"))


def pose(plant: SimulatedRobot, name: str) -> np.ndarray:
    return next(b for b in plant.bodies() if b.name == name).T_world_body


def angle(R: np.ndarray) -> float:
    return float(np.linalg.norm(rotation_vector(R)))


@pytest.mark.parametrize("name", ["slab", "forearm", "figure"])
def test_a_free_body_turns_to_its_orientation_without_a_jump(name):
    plant = robot()
    plant.apply(MoveObstacle(name, (1.5, 1.5, 0.8), (1.0, 0.0, 0.0, 0.0)))
    plant.apply(MoveObstacle(name, (1.5, 1.5, 0.8), TURNED))
    spec = next(b for b in load_scene().bodies if b.name == name)
    fastest, before = ObstacleConfig().speed / spec.reach * 0.001, pose(plant, name)
    for _ in range(4000):
        plant.step(np.zeros(7))
        now = pose(plant, name)
        assert angle(now[:3, :3] @ before[:3, :3].T) < 1.01 * fastest + Turn.CLOSE
        before = now
    np.testing.assert_allclose(before[:3, :3], rotation_from_quaternion(TURNED), atol=1e-12)
    np.testing.assert_allclose(before[:3, 3], (1.5, 1.5, 0.8), atol=1e-6)


@pytest.mark.parametrize("wxyz", [(0.7071, 0.0, 0.0, 0.7071), (0.7071, 0.7071, 0.0, 0.0)])
def test_a_body_that_is_turned_into_the_arm_pushes_no_harder_than_one_that_is_dragged(wxyz):
    """It is 3 cm beside the arm, and its corners are farther out than that; twice, to the same bits."""
    def turned() -> tuple[list[float], float, np.ndarray, float, int]:
        plant = robot()
        place = near(plant.point(5, np.array([0.0, 0.0, -0.15])), 0.0, 0.17, 0.0)
        plant.apply(MoveObstacle("slab", place))
        plant.apply(MoveObstacle("slab", place, wxyz))
        forces, deepest, under_way = [], 0.0, 0
        for _ in range(2000):
            plant.step(np.zeros(7))
            under_way += angle(pose(plant, "slab")[:3, :3] @ rotation_from_quaternion(wxyz).T) > 0.0
            forces.append(float(np.linalg.norm(plant.truth().F_world)))
            deepest = max(deepest, *(-c.dist for c in plant._data.contact), 0.0)
        return forces, deepest, pose(plant, "slab"), float(np.linalg.norm(pose(plant, "slab")[:3, 3] - place)), under_way

    (forces, deepest, T, yielded, under_way), again = turned(), turned()
    cap, reach = ObstacleConfig().cap, np.linalg.norm((0.15, 0.06, 0.15))
    free = 0.5 * np.pi * reach / ObstacleConfig().speed * 1000
    assert under_way > 1.05 * free, "the arm holds it up"
    assert 0.3 * cap < max(forces) < 1.2 * cap
    assert np.median(forces[-500:]) < 1.1 * cap
    assert deepest < 0.015, "what is turned is felt where it is"
    assert yielded > 0.02, "it makes room for itself"
    assert angle(T[:3, :3] @ rotation_from_quaternion(wxyz).T) < 1e-9
    assert forces == again[0]
    np.testing.assert_array_equal(T, again[2])


def test_a_body_that_cannot_be_turned_farther_is_held_and_goes_on_when_there_is_room():
    R, target, c = np.eye(3), rotation_about([0.0, 0.0, 1.0], 1.0), ObstacleConfig()
    turn, most = Turn(target), c.cap * 0.2
    for _ in range(1000):
        R = turn.step(R, np.array([0.0, 0.0, -most]), 0.2, c, 0.001)
    assert angle(R) < 1e-9
    back = turn.step(R, np.array([0.0, 0.0, -1.5 * most]), 0.2, c, 0.001)
    assert rotation_vector(back)[2] < 0.0
    for _ in range(1000):
        R = turn.step(R, np.zeros(3), 0.2, c, 0.001)
    assert R is target


@pytest.mark.parametrize(("name", "start"), [("hand", 0.12), ("forearm", 0.12), ("figure", 0.45)])
def test_what_a_visitor_may_bring_pushes_back(name, start):
    plant = robot()
    forearm = plant.point(5, np.array([0.0, 0.0, -0.15]))
    plant.apply(MoveObstacle(name, near(forearm, 0.0, start, 0.0)))
    plant.apply(MoveObstacle(name, near(forearm, 0.0, -0.4, 0.0)))
    forces = []
    for _ in range(1500):
        plant.step(np.zeros(7))
        forces.append(np.linalg.norm(plant.truth().F_world))
    cap = ObstacleConfig().cap
    assert 0.5 * cap < np.median(forces[-500:]) < 1.1 * cap
    assert plant.truth().link > 0


def test_a_live_speed_reaches_an_obstacle_on_its_way():
    plant = robot()
    plant.apply(MoveObstacle("ball", (0.0, 0.8, 0.3)))
    plant.apply(MoveObstacle("ball", (0.0, -0.8, 0.3)))
    plant.obstacles.config = ObstacleConfig(speed=0.05)
    for _ in range(500):
        plant.step(np.zeros(7))
    ball = next(b for b in plant.bodies() if b.name == "ball")
    assert ball.T_world_body[1, 3] > 0.75


def test_a_pressing_obstacle_comes_presses_and_goes():
    plant = robot()
    plant.apply(Press("hand", 3, (0.0, 0.0, -0.07), (0.0, 1.0, 0.0), speed=0.12, depth=0.08, hold=0.5, stiffness=200.0))
    touched = []
    for k in range(4000):
        plant.step(np.zeros(7))
        if np.linalg.norm(plant.truth().F_world) > 1.0:
            touched.append(k)
    assert 500 <= touched[0] <= 800
    assert touched[-1] < 2500
    assert not plant.bodies()[0].present


def test_a_body_that_was_turned_presses_with_the_side_that_it_shows():
    plant, turned = robot(), (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # 90 deg about z
    plant.apply(MoveObstacle("slab", (0.0, -0.9, 0.5), turned))
    plant.apply(Press("slab", 3, (0.0, 0.0, -0.07), (0.0, 1.0, 0.0), speed=0.12, depth=0.08, hold=0.5, stiffness=200.0))
    touched = []
    for k in range(1200):
        plant.step(np.zeros(7))
        if np.linalg.norm(plant.truth().F_world) > 1.0:
            touched.append(k)
    assert 400 <= touched[0] <= 800, "a wide slab meets more of the arm than that point, and some of it before"


def test_the_blocked_arm_does_not_whip_when_freed():
    """A leash on the servo's reference: what cannot be followed is not stored."""
    plant = robot()
    plant.apply(Push(6, (0.0, 0.06, 0.0), (0.0, 60.0, 0.0)))
    fastest = 0.0
    for k in range(1500):
        if k == 1000:
            plant.apply(Release())
        state = plant.step(np.array([0.5, 0, 0, 0, 0, 0, 0.0]))
        if k > 1000:
            fastest = max(fastest, float(np.abs(state.dq).max()))
    assert fastest < 2.0


def test_a_payload_sags_the_arm_a_little_and_shows_in_the_torque():
    """Nobody knows of it: what it weighs is read as a torque that no model explains."""
    bare, loaded = robot(), robot(IDEAL.replace(payload=1.0))
    for _ in range(1000):
        a, b = bare.step(np.zeros(7)), loaded.step(np.zeros(7))
    T = Dynamics(pinocchio_model(bare.model, armature=False)).kinematics(Q)[0]
    lever = T[7][:3, 3] - T[2][:3, 3]
    assert abs(b.tau[1] - a.tau[1]) == pytest.approx(9.81 * np.hypot(lever[0], lever[1]), rel=0.25)
    assert 1e-4 < np.abs(b.q - a.q).max() < 0.01
    np.testing.assert_allclose(pinocchio_model(loaded.model, armature=False).inertias[7].mass,
                               pinocchio_model(bare.model, armature=False).inertias[7].mass)


def test_encoders_read_in_steps():
    step = 1e-3
    plant = robot(IDEAL.replace(encoder_step=step))
    for k in range(400):
        state = plant.step(swing(k // 5 * 0.005))
    np.testing.assert_allclose(state.q / step, np.round(state.q / step), atol=1e-6)
    np.testing.assert_allclose(state.dq / (step / 0.005), np.round(state.dq / (step / 0.005)), atol=1e-6)
    assert np.abs(state.dq - swing(0.395)).max() < 2 * step / 0.005


def test_late_commands_are_followed_all_the_same_and_the_same_way_every_time():
    first, second, exact = (robot(IDEAL.replace(jitter=j)) for j in (4, 4, 0))
    for k in range(100):
        dq = swing(k * 0.005)
        for _ in range(5):
            a, b, c = first.step(dq), second.step(dq), exact.step(dq)
    np.testing.assert_array_equal(a.q, b.q)
    assert 1e-7 < np.abs(a.q - c.q).max() < 2e-3
