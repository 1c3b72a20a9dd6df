"""Whatever people do to it: nothing becomes infinite, no limit breaks, and the task always goes on afterwards.

ELBOWROOM_RANDOM_SECONDS and ELBOWROOM_RANDOM_SEEDS make it longer than it is by default.
"""

import os

import numpy as np
import pytest

from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.errors import HrcError
from hrc.events import MoveObstacle, Press, Pull, Push, Release, RemoveObstacle, SetParameter
from hrc.messages import Mode, Snapshot
from hrc.model import joint_limits, load_spec

SECONDS = float(os.environ.get("ELBOWROOM_RANDOM_SECONDS", "12"))
SEEDS = int(os.environ.get("ELBOWROOM_RANDOM_SEEDS", "2"))
EVERY = 0.7
"""Something happens so often, on average [s]."""
LIMITS = joint_limits(load_spec().compile())
PARAMETERS = {"control.f_abort": (15.0, 60.0), "control.k_f": (0.0, 0.1), "control.k_a": (0.001, 0.02),
              "control.n_s": (1, 60), "task.speed": (0.0, 0.3), "vision.margin": (0.01, 0.05), "sensor.noise": (0.0, 4.0),
              "observer.k_i": (5.0, 40.0)}


def vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def near_the_arm(cell_state: Snapshot, rng: np.random.Generator, spread: float) -> tuple[float, float, float]:
    x, y, z = cell_state.T_world_link[int(rng.integers(3, 8)), :3, 3] + rng.uniform(-spread, spread, 3)
    return float(x), float(y), max(float(z), 0.1)


def something(snapshot: Snapshot, rng: np.random.Generator):
    """An event that a person at the page might cause."""
    link, point = int(rng.integers(1, 8)), vector(rng.uniform(-0.1, 0.1, 3))
    name = str(rng.choice(["hand", "ball", "block", "slab"]))
    kind = int(rng.integers(0, 7))
    if kind == 0:
        return Push(link, point, vector(rng.uniform(-40.0, 40.0, 3)))
    if kind == 1:
        return Pull(link, point, near_the_arm(snapshot, rng, 0.4))
    if kind == 2:
        return Release()
    if kind == 3:
        return MoveObstacle(name, near_the_arm(snapshot, rng, 0.5))
    if kind == 4:
        return RemoveObstacle(name)
    if kind == 5:
        direction = vector(rng.normal(size=3))
        return Press(name, int(rng.integers(3, 7)), (0.0, 0.0, -0.08), direction, 0.15, 0.12, 1.0, 200.0, approach=0.4)
    key = str(rng.choice([*PARAMETERS, "sensor.unplugged", "control.separation"]))
    if key not in PARAMETERS:
        return SetParameter(key, bool(rng.random() < 0.3))
    low, high = PARAMETERS[key]
    value = rng.uniform(low, high)
    return SetParameter(key, round(value) if isinstance(low, int) else float(value))


def check(s: Snapshot, before: Snapshot | None, step: float) -> None:
    for value in (s.state.q, s.state.dq, s.state.tau, s.residual, s.command.dq, s.command.x):
        assert np.isfinite(value).all()
    assert (s.state.q > LIMITS.q_min - 0.02).all()
    assert (s.state.q < LIMITS.q_max + 0.02).all()
    assert (np.abs(s.command.dq) <= LIMITS.dq_max + 1e-9).all()
    near = np.minimum(s.state.q - LIMITS.q_min, LIMITS.q_max - s.state.q) < 0.3
    if before is not None and not near.any():  # at a position limit the brake is harder
        assert (np.abs(s.command.dq - before.command.dq) <= step + 1e-9).all()


@pytest.mark.timeout(300.0 + 5.0 * SECONDS)
@pytest.mark.parametrize("seed", range(SEEDS))
def test_nothing_breaks_and_the_task_goes_on(seed):
    rng = np.random.default_rng(seed)
    cell = Cell(Config(seed=seed))
    step = cell.config.control.ddq_max / cell.config.rates.control_hz
    before, modes, refused = None, set(), 0
    while cell.tick < 1000 * SECONDS:
        s = cell.step()
        if not s.fresh_control:
            continue
        check(s, before, step)
        before = s
        modes.add(s.command.mode)
        if rng.random() < 0.005 / EVERY:
            try:
                cell.apply(something(s, rng))
            except HrcError:
                refused += 1
    assert len(modes) >= 3
    for event in (Release(), *(RemoveObstacle(name) for name in ("hand", "ball", "block", "slab")),
                  SetParameter("sensor.unplugged", False), SetParameter("control.separation", False),
                  SetParameter("task.speed", 0.2), *(SetParameter(k, v) for k, v in (
                      ("control.k_a", 0.005), ("observer.k_i", 25.0), ("vision.margin", 0.025), ("sensor.noise", 1.0)))):
        try:
            cell.apply(event)
        except HrcError:
            refused += 1  # what is not there cannot be removed
    for _ in range(12_000):
        s = cell.step()
        if s.command.mode is Mode.IDLE and s.command.path_speed > 0.99:
            break
    assert s.command.mode is Mode.IDLE, s.command.reason
    assert s.command.path_speed > 0.99
