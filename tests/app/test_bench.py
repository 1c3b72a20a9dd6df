"""The bench of speed: what it writes, and that its contenders solve the same problem. No time is asserted anywhere."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.bench import baselines, report, window
from app.bench.frames import Condition, Take, record
from app.bench.perception import Cycle, error
from app.bench.timing import Contender, by_turns
from app.output import OutputError
from hrc import meshes
from hrc.config import Config
from hrc.vision import reference
from hrc.vision.render import Renderer, environment_depth

ROOT = Path(__file__).resolve().parents[2]
CONFIG = Config().vision


def bench(*args: str, **environment: str) -> "subprocess.CompletedProcess[str]":
    """A process of its own: it pins itself to a core, and MuJoCo must draw without a screen in it."""
    return subprocess.run([sys.executable, "-m", "app", "bench", *args], cwd=ROOT, capture_output=True, text=True, check=False,
                          env={**os.environ, **environment})


def test_quick_run_writes_every_figure(tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    done = bench("--quick", "--json", str(path))
    assert done.returncode == 0, done.stderr
    figures = json.loads(path.read_text())
    assert figures["exact"]["max_abs_error_m"] < 1e-6
    assert 0 < figures["cycle"]["median_ms"] <= figures["cycle"]["p90_ms"]
    assert 0 < figures["cycle"]["default_median_ms"] <= figures["cycle"]["default_p90_ms"]
    assert {"mujoco_ckdtree", "mujoco_ckdtree_no_ids", "open3d_ckdtree", "brute_force"} <= figures["baselines"].keys()
    for entry in figures["baselines"].values():
        if entry["ratio"] is None:
            assert entry["missing"]
        else:
            assert entry["ratio"] == pytest.approx(entry["median_ms"] / figures["cycle"]["median_ms"])
        assert entry["name"] in done.stdout
    assert {"cpu", "cores", "pinned_core", "python", "packages", "frames", "rounds", "triangles", "seed"} \
        <= figures["conditions"].keys()
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_had_is_named(tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    done = bench("--quick", "--json", str(path), MUJOCO_GL="disable")
    assert done.returncode == 0, done.stderr
    missing = json.loads(path.read_text())["baselines"]["mujoco_ckdtree"]
    assert missing["ratio"] is None
    assert missing["missing"]
    assert missing["missing"] in done.stdout


def test_unwritable_path_is_refused_before_anything_is_measured(tmp_path: Path) -> None:
    done = bench("--json", str(tmp_path / "none" / "bench.json"))
    assert done.returncode == 2
    assert "cannot write" in done.stderr
    assert done.stdout == ""
    with pytest.raises(OutputError, match="folder"):
        report.check(tmp_path)


def test_json_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    report.write(path, {"cycle": 1})
    with pytest.raises(ValueError, match="JSON"):
        report.write(path, {"cycle": math.nan})
    assert json.loads(path.read_text()) == {"cycle": 1}
    assert list(tmp_path.iterdir()) == [path]


@pytest.fixture(scope="module")
def take() -> Take:
    return record(Condition(), 3)[0]


@pytest.mark.parametrize("name", [name for name in baselines.BASELINES if name != "brute_force"])
def test_a_baseline_finds_the_least_distance(take: Take, name: str) -> None:
    tree = baselines.assemble(name, take, CONFIG)
    if isinstance(tree, str):
        pytest.skip(tree)
    assert isinstance(tree, baselines.Tree)
    cover, surface = (Renderer(take.camera, meshes.robot("perception")) for _ in range(2))
    cover.expand(CONFIG.margin)
    environment = environment_depth(take.camera, take.environment, CONFIG.environment_margin)
    for k, T in enumerate(take.T_world_link):
        tree(k)
        expanded = cover.render(T)
        robot, first = (expanded, 0) if name.endswith("no_ids") else (surface.render(T), CONFIG.first_link)
        around = np.full(take.camera.shape, False)
        links = slice(CONFIG.first_link, None)
        T_camera_link, boxes = (take.camera.T_camera_world @ T)[links], window.corners(CONFIG.margin)[links]
        around[window.rectangle(take.camera, T_camera_link, boxes, CONFIG.reach)] = True
        real = np.where(around, take.frames[k].depth, np.inf)
        kept = reference.filtered(real, expanded.depth, environment)
        candidates = np.where(around & (robot.link >= first) & (robot.link < reference.NO_LINK), robot.depth, np.inf)
        # With obstacles that are not deep at all there is no occlusion rule, and a k-d tree finds the same.
        least = reference.distance_map(take.camera, candidates, kept, CONFIG.reach, 0.0).min()
        assert np.isfinite(least)
        assert tree.least == pytest.approx(least, abs=5e-5)
    tree.close()


@pytest.mark.parametrize("mode", ["paper", "interval"])
def test_our_distances_are_those_of_brute_force(take: Take, mode: str) -> None:
    assert error(Cycle([take], CONFIG.replace(mode=mode), "perception")) < 1e-6


def test_an_inexact_distance_shows(take: Take) -> None:
    cycle = Cycle([take], CONFIG, "perception")
    cycle.eyes[0].configure(CONFIG.replace(thickness=0.01))
    assert error(cycle) > 1e-3


def test_frames_are_distinct_and_in_reach(take: Take) -> None:
    for before, after in zip(take.frames, take.frames[1:], strict=False):
        assert (before.depth != after.depth).any()
    cycle = Cycle([take], CONFIG, "perception")
    for k in range(len(take.frames)):
        cycle(k)
        assert cycle.found[0]


@pytest.mark.parametrize("coverage", [0.01, 0.1, 0.4])
def test_a_board_covers_its_share_of_the_image(coverage: float) -> None:
    board = record(Condition(obstacle="board", coverage=coverage), 2)[0]
    bare = record(Condition(obstacle="board", coverage=1e-5), 2)[0]
    changed = np.mean(board.frames[0].depth < bare.frames[0].depth - 0.05)
    assert changed == pytest.approx(coverage, rel=0.35)


def test_turns_are_taken_round_by_round() -> None:
    order: list[tuple[str, int]] = []

    class Noted(Contender):
        def __init__(self, name: str) -> None:
            self.steps = {"first": lambda k: order.append((name, k)), "second": lambda _: None}

    times = by_turns({"a": Noted("a"), "b": Noted("b")}, frames=2, rounds=2)
    assert order == [(name, k) for _ in range(3) for name in "ab" for k in range(2)]
    measured: dict[str, Any] = {name: t.seconds.shape for name, t in times.items()}
    assert measured == {"a": (4, 2), "b": (4, 2)}
    assert times["a"].median_ms("first") <= times["a"].p90_ms()
