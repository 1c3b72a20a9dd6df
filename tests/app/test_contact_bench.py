"""The bench of contacts measures what it says: laws of its figures, and mistakes that it must show."""

import json

import numpy as np
import pytest

from app.bench import pushes
from app.bench.contact import DIRECTIONS, LINKS, Push, bench, deal
from app.bench.contact_report import printed
from app.bench.contact_rows import row
from app.bench.hour import SLOW, Felt, Free, Work, cell_of, free_motion, pushed, summary
from app.bench.pushes import CONE, ROOM, Errors, Outcome, Watch, anywhere, calm, dynamics, go, place, push
from app.bench.touches import samples
from app.settings import configured
from hrc.cell.cell import Cell
from hrc.config import ideal
from hrc.contact.force import estimate_force
from hrc.errors import HrcError
from hrc.geometry import apply
from hrc.parameters import replaced

POSE = dynamics().kinematics(np.deg2rad([0.0, 25.0, 0.0, -85.0, 0.0, 70.0, 0.0]))[0]


@pytest.fixture(scope="module")
def still():
    """A perfect robot that holds its place, and its watch."""
    return Cell(replaced(ideal(), "task.kind", "hold")), Watch()


def pressed(still, link, direction, size=20.0):
    cell, watch = still
    T, force = calm(cell, watch), size * DIRECTIONS[direction]
    x, y, z = force.tolist()
    return push(cell, watch, link, place(link, DIRECTIONS[direction], T, np.random.default_rng(1)), (x, y, z))


def test_a_perfect_robot_feels_a_push_as_it_is(still):
    outcome = pressed(still, 6, "+x")
    assert outcome.delay is not None
    assert 0.0 < outcome.delay < 0.1
    assert outcome.given.inside.max() < 0.5
    assert np.median(outcome.said.inside) < 2.0
    assert outcome.located == outcome.right_link == 1.0
    assert outcome.point is not None
    assert outcome.point < 0.05
    assert still[1].false == []


def test_a_wrong_sign_of_the_estimate_would_show(still, monkeypatch):
    monkeypatch.setattr(pushes, "estimate_force", lambda J_c, r, config: estimate_force(J_c, -r, config))
    outcome = pressed(still, 6, "+x")
    assert np.median(outcome.given.whole) > 1.8 * 20.0


def test_what_the_joints_cannot_feel_is_told_apart(still):
    """Links up to the third feel two directions at most, and the errors of the parts are those of the whole."""
    given = pressed(still, 3, "-z").given
    np.testing.assert_allclose(given.whole**2, given.inside**2 + given.outside**2)
    assert given.outside.min() > 5.0
    assert given.inside.max() < 1.0


def test_a_push_too_weak_to_be_felt_is_missed(still):
    outcome = pressed(still, 3, "-z", size=1.0)
    assert outcome.delay == np.inf
    assert outcome.point is None
    assert row("ideal", "rest", 3, 0.0, [outcome]).missed == 1.0


@pytest.mark.parametrize(("r_low", "some"), [(0.1, True), (30.0, False)])
def test_false_contacts_are_those_with_nothing_touching(r_low, some):
    cell, watch = Cell(replaced(configured("realistic"), "observer.r_low", (r_low,) * 7)), Watch()
    for _ in go(cell, watch, 1.5):
        pass
    assert (len(watch.false) > 0) is (watch.felt > 0.0) is some
    assert watch.seconds == pytest.approx(1.5)
    assert 0.1 < watch.level.max() < 3.0
    before, time = len(watch.false), watch.seconds
    push(cell, watch, 6, (0.0, 0.0, 0.0), (0.0, 30.0, 0.0))
    assert (len(watch.false), watch.seconds) == (before, time)


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("name", DIRECTIONS)
def test_a_push_is_where_a_hand_can_press(link, name):
    found = np.array(place(link, DIRECTIONS[name], POSE, np.random.default_rng(0)))
    p, outward = samples()[link]
    at = np.flatnonzero((p == found).all(axis=1))
    assert len(at) == 1
    along = -outward @ POSE[link, :3, :3].T @ DIRECTIONS[name]
    hand = apply(POSE[link], found + ROOM * outward[at[0]])
    others = np.concatenate([apply(POSE[i], samples()[i][0]) for i in range(8) if i != link])
    assert np.linalg.norm(others - hand, axis=1).min() > 0.5 * ROOM  # of all samples, of which it asked a twentieth
    assert along[at[0]] > np.cos(np.radians(CONE)) or along[at[0]] > 0.0


def test_points_all_over_a_link_are_pressed_inward():
    rng = np.random.default_rng(0)
    found = [anywhere(5, POSE, rng) for _ in range(20)]
    middle = samples()[5][0].mean(axis=0)
    assert np.mean([(POSE[5, :3, :3].T @ inward) @ (middle - p) > 0.0 for p, inward in found]) > 0.8
    assert len({p for p, _ in found}) == 20


def test_every_push_of_the_grid_is_dealt_once():
    grid = [Push(link, name, force) for link in (4, 5) for name in DIRECTIONS for force in (10.0, 20.0)]
    series = list(deal({"ideal": ideal()}, grid, 3))
    for task in ("rest", "moving"):
        assert sorted(p for s in series if s.task == task for p in s.pushes) == sorted(grid)
    assert len({s.config.seed for s in series}) == 3


def test_a_row_is_the_statistics_of_its_outcomes():
    def outcome(delay, error):
        errors = Errors(*np.full((3, 4), error))
        return Outcome(5, (0.0, 10.0, 0.0), delay, errors, errors, 1.0, 1.0, 0.0, 0.02)

    found = row("ideal", "rest", 5, 0.0, [outcome(0.01, 1.0), outcome(0.03, 2.0), outcome(np.inf, 3.0), outcome(None, 4.0)])
    assert (found.pushes, found.felt_before, found.missed) == (4, 1, pytest.approx(1 / 3))
    assert found.delay_median == pytest.approx(0.02)
    assert found.said_inside is not None
    assert (found.said_inside.median_N, found.said_inside.median_share) == (2.5, 0.25)


def test_the_hours_cameras_change_nothing_while_there_is_nothing_to_see():
    work, residuals = Work(configured("realistic"), 7, 0.0, 0), []
    for changes in (SLOW, {}):
        with cell_of(work, "hexagon", 0.2, changes) as cell:
            residuals.append([s.residual for s in go(cell, Watch(), 2.0)])
    np.testing.assert_array_equal(*residuals)


def test_an_hour_in_small_counts_what_happened():
    restless = replaced(configured("realistic"), "observer.r_low", (8.0, 8.0, 8.0, 8.0, 8.0, 0.02, 8.0))
    free = list(free_motion(Work(restless, 201, 3.0, 0, motions=(("hexagon", 0.2, 0.7), ("circle", 0.1, 0.3)))))
    felt = list(pushed(Work(configured("realistic"), 201, 0.0, 2)))
    figures = summary(free, felt)
    assert figures["seconds"] == pytest.approx(3.0)
    assert figures["false"] == sum(len(f.false) for f in free) > 0
    assert figures["worst_ratio"] > 1.0
    assert (figures["pushed"], figures["missed"], figures["felt_before"]) == (2, 0, 0)
    assert 0.0 < figures["delay_p95"] < 0.1
    assert {f.kind for f in felt} == {"hexagon", "hold"}


def test_a_missed_push_is_infinitely_late():
    free = [Free(200, "hold", 0.2, 60.0, (), (0.5,) * 7)]
    felt = [Felt(200, 4, "hold", *each) for each in ((0.01, False), (0.02, False), (None, False), (None, True))]
    figures = summary(free, felt)
    assert (figures["pushed"], figures["missed"], figures["felt_before"]) == (4, 1, 1)
    assert (figures["delay_median"], figures["delay_p95"]) == (0.02, None)


def test_the_quick_run_writes_what_it_prints(tmp_path, capsys):
    bench(json=tmp_path / "force.json", quick=True)
    figures = json.loads((tmp_path / "force.json").read_text())
    assert capsys.readouterr().out == "\n".join(printed(figures)) + "\n"
    outer = {r["preset"]: r for r in figures["rows"] if not r["link"] and not r["force"]}
    assert outer["ideal"]["given_inside"]["median_share"] < 0.1
    assert outer["realistic"]["missed"] == 0.0
    assert (tmp_path / "force.png").stat().st_size > 10_000


def test_what_cannot_be_is_refused_before_anything_moves(tmp_path):
    for hours in (-1.0, float("nan"), 1e6):
        with pytest.raises(HrcError, match="hours"):
            bench(hours=hours)
    with pytest.raises(HrcError, match=r"none\.toml"):
        bench(settings=tmp_path / "none.toml")
    with pytest.raises(HrcError, match=r"force\.json"):
        bench(json=tmp_path / "none" / "force.json")
