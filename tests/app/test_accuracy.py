"""What accuracy is measured on is what it claims to be, and the tables say what was found."""

import dataclasses
import json

import numpy as np
import pytest

from app.bench.accuracy import PERFECT, bench_accuracy, locate, plot_accuracy, print_accuracy
from app.bench.filter_quality import bench_filter, print_filter
from app.bench.touches import OBSTACLES, VIEWS, gap, samples, touches
from hrc.config import Config
from hrc.geometry import apply, transform
from hrc.scene import load_scene
from hrc.vision.camera import Camera
from hrc.vision.localize import Localizer


@pytest.fixture(scope="module")
def contacts():
    return touches(Camera(), 2, 5)


def test_every_obstacle_touches_its_link_and_sinks_into_none(contacts):
    assert {(c.obstacle.name, c.view) for c in contacts} == {(b.name, v) for b in OBSTACLES for v in VIEWS}
    for c in contacts:
        apart = [gap(c.obstacle, c.T_world_body, apply(T, p)).min()
                 for T, (p, _) in zip(c.T_world_link, samples(), strict=True)]
        assert abs(apart[c.link]) < 0.0035  # the nearest of the sampled points
        assert min(apart) > -0.0011
        assert abs(gap(c.obstacle, c.T_world_body, c.point[None])[0]) < 0.01  # the middle of a curved contact


def test_the_gap_is_the_distance_to_the_surface():
    pose = transform(np.eye(3), [0.0, 0.0, 1.0])
    sphere, capsule, box = OBSTACLES
    for body, point, expected in ((sphere, (0, 0.2, 1), 0.15), (capsule, (0.1, 0, 1.05), 0.06), (capsule, (0, 0, 1.2), 0.075),
                                  (box, (0.08, 0.09, 1), 0.05), (box, (0.02, 0, 1), -0.03)):
        assert gap(body, pose, np.array([point], float))[0] == pytest.approx(expected)


def test_the_same_seed_gives_the_same_points(contacts):
    eye = Localizer(Camera(), load_scene().environment, Config().vision)
    first, second = (locate(eye, contacts, PERFECT, 5) for _ in range(2))
    assert [[(n.pixel, n.distance, n.sure) for n in near] for near in first] == [
        [(n.pixel, n.distance, n.sure) for n in near] for near in second]
    assert [c.point.tolist() for c in touches(Camera(), 2, 5)] == [c.point.tolist() for c in contacts]


def test_the_default_is_nearer_than_the_papers_rule(tmp_path, capsys):
    rows = bench_accuracy(3, 6)
    everything = {r.mode: r for r in rows if (r.noise, r.obstacle, r.view) == (True, "all", "all")}
    median = {mode: row.median_mm or np.nan for mode, row in everything.items()}
    assert median["interval"] < 0.7 * median["paper"]
    assert median["fused"] < median["interval"]
    assert everything["interval"].wrong < 0.2 * everything["paper"].wrong
    assert everything["interval"].contacts == 3 * len(OBSTACLES) * len(VIEWS)
    assert json.loads(json.dumps([dataclasses.asdict(r) for r in rows]))
    print_accuracy(rows)
    assert len(capsys.readouterr().out.splitlines()) == len(rows) + 1
    plot_accuracy(rows, tmp_path / "accuracy.png")
    assert (tmp_path / "accuracy.png").stat().st_size > 10_000


def test_the_filter_removes_the_robot_also_at_full_speed(capsys):
    rows = bench_filter(1, 7)
    default = {(r.fast, r.skew_ms): r for r in rows if r.margin_mm is None and r.extrinsic_deg == 0.25}
    assert min(default[key].recall for key in ((False, 0.0), (True, 0.0), (True, 10.0))) >= 0.995
    assert default[True, 66.0].recall < default[True, 10.0].recall
    assert default[False, 0.0].loss < 0.3
    print_filter(rows)
    assert len(capsys.readouterr().out.splitlines()) == len(rows) + 1
