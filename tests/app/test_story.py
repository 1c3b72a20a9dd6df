"""The paper's experiment, whole: relax, abort and resume where the paper does, with what the camera sees alone."""

import numpy as np
import pytest

from app.headless import Job, execute
from app.metrics import story
from app.record.signals import read_parquet
from hrc.cell.cell import Cell
from hrc.cell.pace import FreeRun
from hrc.cell.run import Inbox, run
from hrc.events import Push, Release
from hrc.geometry import apply
from hrc.messages import Mode, Snapshot

ABORTS = (13.0, 26.0, 48.0, 73.5)


@pytest.fixture(scope="module")
def paper(tmp_path_factory):
    out = tmp_path_factory.mktemp("paper") / "out"
    figures = execute(Job("paper", out, seed=0, record=False, quiet=True))
    return figures, read_parquet(out / "signals.parquet"), out


def test_the_states_follow_as_in_the_paper(paper):
    """Fig. 5, bottom: a relaxation from about 2.6 s, four aborts, one of them after a relaxation, idle after each."""
    figures = paper[0]
    assert figures["story"] == ["idle", "relax", "idle", "abort", "idle", "abort", "idle", "relax", "abort", "idle", "abort",
                                "idle"]
    first = next(span for span in figures["states"] if span[2] == Mode.RELAX)
    assert 2.6 <= first[0] <= 3.2
    assert first[1] - first[0] > 3.0
    aborts = [span for span in figures["states"] if span[2] == Mode.ABORT]
    assert [abs(span[0] - t) <= 1.0 for span, t in zip(aborts, ABORTS, strict=True)] == [True] * 4
    assert aborts[3][1] - aborts[3][0] > 9.0, "stalled until the block is removed"


def test_what_passes_in_a_moment_is_no_part_of_the_story():
    spans = [[0.0, 1.0, "idle"], [1.0, 1.04, "contact not seen"], [1.04, 2.0, "idle"], [2.0, 2.3, "relax"], [2.3, 4.0, "abort"],
             [4.0, 5.0, "idle"], [5.0, 5.3, "relax"], [5.3, 6.0, "idle"]]
    assert story(spans) == [[0.0, 2.0, "idle"], [2.3, 4.0, "abort"], [4.0, 5.0, "idle"], [5.0, 5.3, "relax"],
                            [5.3, 6.0, "idle"]]


def test_nobody_is_pushed_back_or_hard(paper):
    """In RELAX, F . v_c is never negative once the arm had 0.1 s to brake, be it that the push begins or that it comes to
    another link; a push never meets more than 70 N."""
    figures, columns, _ = paper
    t, link = columns["t"], np.where(columns["state"] == Mode.RELAX, columns["contact_link_est"], -1)
    begun = np.maximum.accumulate(np.where(link != np.r_[-1, link[:-1]], t, -np.inf))
    power = columns["contact_power"][(link >= 0) & (t - begun > 0.1)]
    assert power.size > 1000
    assert power.min() > -0.1
    assert figures["force_true_max_N"] <= 70.0
    assert figures["ddq_measured_max"] <= 100.0


def test_the_task_goes_on_while_relaxing(paper):
    figures = paper[0]
    assert figures["ee_error"]["relax"]["ticks"] > 1000
    assert figures["ee_error"]["relax"]["max_m"] <= 0.003
    assert figures["ee_error"]["relax"]["rms_m"] <= 0.0005
    assert figures["everything_finite"]


def test_contacts_are_found_where_they_are(paper):
    where = paper[0]["localisation"]
    assert where["ticks"] > 200
    assert where["right_link"] >= 0.9
    assert where["median_point_error_m"] <= 0.040


def test_forces_are_what_they_are(paper):
    force = paper[0]["force"]["any"]["links_4_to_7"]
    assert force["ticks"] > 200
    assert force["median_relative_error"] <= 0.15 or force["median_error_N"] <= 3.0


def test_no_command_leaves_the_limits(paper):
    columns, limits = paper[1], Cell()._robot.limits
    assert (np.abs(columns["dq_command"]) <= limits.dq_max + 1e-9).all()
    assert (columns["q"] < limits.q_max).all()
    assert (columns["q"] > limits.q_min).all()
    step = np.abs(np.diff(columns["dq_command"], axis=0)).max()
    assert step <= 25.0 * 0.005 + 1e-9


def test_there_is_a_figure(paper):
    assert (paper[2] / "figure5.png").stat().st_size > 50_000


def test_a_tangential_push_of_20_n_moves_the_elbow_and_not_the_hand():
    """It gives way by centimetres, never into the push, and the end effector keeps to its path within millimetres."""
    cell, inbox, seen = Cell(), Inbox(), []
    point = (0.0, -0.087, -0.07)

    class Watch:
        def on_step(self, s: Snapshot) -> None:
            if s.fresh_control:
                c = s.contact
                power = float(c.F_world @ (c.J_c @ s.command.dq)) if c is not None else 0.0
                seen.append((s.time, s.command.mode, float(np.linalg.norm(s.command.x - s.command.x_d)), power,
                             apply(s.T_world_link[3], point)[1]))

    run(cell, FreeRun(), inbox, [Watch()], until=1500)
    inbox.put(Push(3, point, (0.0, 20.0, 0.0)))
    run(cell, FreeRun(), inbox, [Watch()], until=3500)
    inbox.put(Release())
    run(cell, FreeRun(), inbox, [Watch()], until=5500)
    t, mode, error, power, y = (np.array(column) for column in zip(*seen, strict=True))
    relaxing = mode == Mode.RELAX
    assert relaxing.sum() > 300
    assert set(mode) == {Mode.IDLE, Mode.RELAX}
    assert y[(t > 3.0) & (t < 3.5)].min() - y[t <= 1.5][-1] >= 0.03
    assert error[t > 1.0].max() <= 0.003
    # Half a millimetre a second, where the acceleration limit does not let the null space follow a corner of the path.
    assert power[relaxing].min() >= -0.01
