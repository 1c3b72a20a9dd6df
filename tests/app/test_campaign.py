"""Campaigns: what is played, what came of it, and that neither interruptions nor who plays it make a difference."""

import errno
import json
import os
import resource
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_campaign import SHORT, row

from app.__main__ import main
from app.bench.pushes import dynamics
from app.bench.touches import poses, samples
from app.campaign import places, plan, store, worst
from app.campaign.command import STAMP, SUMMARY
from app.campaign.contacts import TAP, share, surface_along
from app.campaign.episode import Episode, play
from app.campaign.metrics import METRICS
from app.campaign.plan import CampaignError, load
from app.campaign.trial import PROFILES, Trial
from app.output import OutputError
from hrc import meshes
from hrc.errors import HrcError
from hrc.geometry import apply
from hrc.parameters import keys, replaced
from hrc.paths import assets
from hrc.scene import BodySpec
from hrc.vision.camera import CameraConfig


def trial(**changes: object) -> Trial:
    base = Trial()
    for key, value in {"task.kind": "hold", **{f"situation.{k}": v for k, v in changes.items()}}.items():
        base = replaced(base, key, value)
    return base


# -- the plan -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", plan.names())
def test_every_campaign_that_comes_along_can_be_run(name: str) -> None:
    campaign = load(name, episodes=1)
    assert len(list(campaign.chosen(lambda _: True))) == campaign.total == len(campaign.points)
    assert campaign.worst in METRICS


def test_seeds_are_paired_across_the_sweep_and_indices_stay_when_there_are_more(short: Path) -> None:
    few, more = (list(load(short, n).chosen(lambda _: True)) for n in (2, 5))
    assert more[: len(few)] == few
    by_point = [[e for e in more if e.values["plant.friction_left"] == f] for f in (0.0, 0.3)]
    for a, b in zip(*by_point, strict=True):
        assert (a.seed, a.trial.seed, a.values["plant.payload"]) == (b.seed, b.trial.seed, b.values["plant.payload"])
        assert a.trial.plant.friction_left != b.trial.plant.friction_left
    assert len({e.trial.seed for e in more}) == 5
    assert [e.index for e in more] == list(range(10))


@pytest.mark.parametrize(("change", "told"), [
    (("plant.friction_left = [", "plant.friction_lef = ["), "plant.friction_left"),
    (("[0.0, 0.3]", "[]"), "no values"),
    (("[0.0, 0.3]", "[0.1, 0.1]"), "twice"),
    (("[0.0, 0.3]", "0.3"), "list of values"),
    (("[0.0, 0.3]", "[0.0, 30.0]"), "0 to 2"),
    (("{ low = 0.0, high = 0.2 }", "{ low = 0.0, high = 20.0 }"), "0 to 7"),
    (("{ low = 0.0, high = 0.2 }", "{ low = 0.3, high = 0.2 }"), "low = a, high = b"),
    (("{ low = 0.0, high = 0.2 }", "0.2"), "low = a, high = b"),
    (("episodes = 2", "episodes = 0"), "1 to"),
    (("episodes = 2", "episods = 2"), "episodes"),
    (("episodes = 2", 'worst = "force_eror_N"'), "force_error_N"),
    (("episodes = 2", 'scenario = "pusch"'), "push"),
    (("settle = 0.2", "setle = 0.2"), "situation.settle"),
    (('title = "Short"', "title = "), "malformed"),
    (('metrics = ["missed", "force_error_N"]', "metrics = []"), "list of names, with at least one"),
    (('metrics = ["missed", "force_error_N"]', "metrics = 3"), "list of names, with at least one"),
    (("episodes = 2", 'worst = ["missed"]'), "worst must be a name"),
    (("episodes = 2", 'preset = ["default"]'), "preset must be a name"),
    (("episodes = 2", "scenario = 1"), "scenario must be a name"),
    (("plant.payload = ", "plant.friction_left = "), "both swept and drawn"),
])
def test_a_file_that_cannot_be_run_is_refused_with_what_would_be_right(short: Path, change, told: str) -> None:
    assert change[0] in SHORT
    short.write_text(SHORT.replace(*change))
    with pytest.raises(HrcError, match=r"short\.toml") as refusal:
        load(short)
    assert told in str(refusal.value)


def test_names_paths_and_what_is_neither(tmp_path: Path) -> None:
    assert load("campaigns/force_accuracy.toml") == load("force_accuracy")
    with pytest.raises(CampaignError, match="force_accuracy"):
        load("force_acuracy")
    with pytest.raises(CampaignError, match="cannot be read"):
        load(tmp_path / "missing.toml")


# -- situations ---------------------------------------------------------------------------------------------------------


def test_places_are_drawn_by_area_and_only_where_asked() -> None:
    T, rng = poses(np.array([0.0, 0.6, 0.0, -1.3, 0.0, 0.6, 0.0])), np.random.default_rng(0)
    drawn = [places.draw(range(3, 8), T, rng) for _ in range(400)]
    share_of = np.bincount([p.link for p in drawn], minlength=8)[3:] / len(drawn)
    area = np.array(places.areas())[3:] / sum(places.areas()[3:])
    assert np.abs(share_of - area).max() < 0.1
    for place in drawn[:20]:
        points, normals = samples()[place.link]
        i = int(np.argmin(((points - place.p_link) ** 2).sum(axis=1)))
        np.testing.assert_array_equal(place.normal, normals[i])


def test_the_visible_part_faces_the_camera() -> None:
    T, rng, camera = poses(np.array([0.0, 0.6, 0.0, -1.3, 0.0, 0.6, 0.0])), np.random.default_rng(1), CameraConfig()
    facing = []
    for _ in range(60):
        link, p, normal = places.draw(range(3, 8), T, rng, (camera,))
        sight = np.array(camera.eye) - apply(T[link], p)
        facing.append(float(T[link, :3, :3] @ normal @ sight / np.linalg.norm(sight)))
    assert np.mean(np.array(facing) > -0.1) > 0.95
    away = [float(T[p.link, :3, :3] @ p.normal @ (np.array(camera.eye) - apply(T[p.link], p.p_link)))
            for p in (places.draw(range(3, 8), T, rng) for _ in range(60))]
    assert np.mean(np.array(away) < 0.0) > 0.2, "the whole surface has another side"


def test_directions_fill_the_friction_cone_and_do_not_leave_it() -> None:
    rng, inward = np.random.default_rng(2), np.array([0.6, 0.0, -0.8])
    cosines = np.array([places.within_cone(inward, 0.5, rng) @ inward for _ in range(2000)])
    edge = 1.0 / np.sqrt(1.25)
    assert edge <= cosines.min() < edge + 0.001
    assert cosines.mean() == pytest.approx((1.0 + edge) / 2.0, abs=0.005), "uniform by solid angle"
    np.testing.assert_allclose(places.within_cone(inward, 0.0, rng), inward)


def test_random_postures_keep_their_limits_and_their_distance_to_the_table() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        q, tip = places.posture(0.7, rng)
        T, x, _ = dynamics().kinematics(q)
        np.testing.assert_allclose(x, tip)
        assert np.rad2deg(np.abs(q)).max() <= 0.7 * 170.0
        assert min(apply(T[i], samples()[i][0])[:, 2].min() for i in range(2, 8)) > 0.04


@pytest.mark.parametrize(("shape", "size"), [("sphere", (0.05,)), ("capsule", (0.04, 0.085)), ("box", (0.15, 0.06, 0.15))])
def test_the_surface_of_a_body_along_a_direction_is_where_its_mesh_is(shape: str, size: tuple[float, ...]) -> None:
    body, rng, mesh = BodySpec("it", shape, size), np.random.default_rng(5), meshes.shape(shape, size)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces)  # convex: inside of every face
    for direction in rng.normal(size=(20, 3)):
        direction /= np.linalg.norm(direction)
        assert surface_along(body, direction) <= body.extent(direction) + 1e-12
        inside, outside = (f * surface_along(body, direction) * direction for f in (0.97, 1.01))
        height = [np.einsum("nc,nc->n", p - solid.triangles[:, 0], solid.face_normals).max() for p in (inside, outside)]
        assert height[0] < 0.0 < height[1]


@pytest.mark.parametrize("profile", PROFILES)
def test_profiles_begin_and_end_with_nothing_and_never_pull(profile: str) -> None:
    t = np.linspace(-0.1, 1.2, 1301)
    values = np.array([share(profile, x, 1.0) for x in t])
    assert values.min() >= 0.0
    assert values.max() <= 1.0 + 1e-12
    assert not values[(t < 0.0) | (t >= 1.0)].any()
    assert values.max() > 0.9
    if profile == "tap":
        assert not values[t > TAP].any()
    if profile == "wiggle":
        assert np.ptp(values[(t > 0.2) & (t < 0.9)]) > 0.4


# -- episodes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("changes", [
    {"profile": "any"}, {"by": "obstacle", "shape": "sphere"}, {"contacts": 2}, {"posture": "random", "surface": "visible"}],
    ids=str)
def test_an_episode_touches_the_robot_and_judges_what_is_felt(changes: dict[str, object]) -> None:
    record = play(Episode(7, (0, 7), trial(**changes), {"episode": 7}))
    assert record["error"] is None
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert set(METRICS) <= set(record)
    assert record["force_peak_N"] > 9.0
    assert record["located"] is not None, "it lasts long enough to be judged"
    assert 3 <= record["link"] <= 7
    surface = samples()[record["link"]][0]
    assert np.linalg.norm(surface - record["p_link_m"], axis=1).min() < 0.02, "on the link's surface"


def test_an_episode_that_raises_is_a_record_with_its_error() -> None:
    record = play(Episode(3, (0, 3), trial(by="obstacle", shape="capsule", contacts=2), {"episode": 3}))
    assert record["index"] == 3
    assert "the scene has 1" in record["error"]
    assert "HrcError" in record["error"]


@pytest.mark.parametrize(("args", "told"), [
    (["force_acuracy"], "force_accuracy"), (["force_accuracy", "--episodes", "0"], "1 to"),
    (["force_accuracy", "--address", "tcp://a:1", "--tls-ca", "ca.pem"], "tls://a:1"),
    (["force_accuracy", "--workers", "0"], "at least one"), (["force_accuracy", "--record", "-1"], "--record")])
def test_bad_input_is_one_line_and_leaves_nothing(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], args: list[str], told: str) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["campaign", *args, "--out", str(tmp_path / "out")])
    assert exit_.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert told in line
    assert list(tmp_path.iterdir()) == []


def summary_of(out: Path) -> dict[str, list[object]]:
    import pyarrow.parquet as pq

    return pq.read_table(out / SUMMARY).to_pydict()


# -- records ------------------------------------------------------------------------------------------------------------


def test_a_torn_last_line_is_cut_and_what_is_whole_stays(short: Path, tmp_path: Path) -> None:
    campaign, out = load(short), tmp_path / "out"
    with store.opened(out, campaign) as opened:
        for i in range(3):
            opened.add(row(i, missed=False))
    whole = (out / store.RECORDS).read_bytes()
    (out / store.RECORDS).write_bytes(whole + b'{"index": 3, "mis')
    with store.opened(out, campaign) as opened:
        assert sorted(opened.records) == [0, 1, 2]
        opened.add(row(3, missed=True))
    assert (out / store.RECORDS).read_bytes().startswith(whole)
    with store.opened(out, campaign) as opened:
        assert sorted(opened.records) == [0, 1, 2, 3]
        with pytest.raises(CampaignError, match="another process"), store.opened(out, campaign):
            pass


def test_records_of_another_campaign_are_refused_and_a_strangers_folder_in_any_case(short: Path, tmp_path: Path) -> None:
    campaign, out = load(short), tmp_path / "out"
    with store.opened(out, campaign) as opened:
        opened.add(row(0))
    with store.opened(out, load(short, 50)) as opened:
        assert list(opened.records) == [0], "more episodes are the same campaign"
    short.write_text(SHORT.replace("[0.0, 0.3]", "[0.0, 0.4]"))
    with pytest.raises(CampaignError, match=r"another campaign \(sweep differ"), store.opened(out, load(short)):
        pass
    mark = json.loads((out / store.MARK).read_text())
    mark["versions"]["mujoco"] = "3.0.0"
    (out / store.MARK).write_text(json.dumps(mark))
    with pytest.raises(CampaignError, match=r"mujoco 3\.0\.0 \(here"), store.opened(out, campaign):
        pass
    with store.opened(out, load(short), overwrite=True) as opened:
        assert not opened.records
    thesis = tmp_path / "thesis"
    thesis.mkdir()
    (thesis / "chapter.txt").write_text("three years")
    with pytest.raises(OutputError, match="not the folder of a campaign"), store.opened(thesis, campaign, overwrite=True):
        pass
    assert (thesis / "chapter.txt").exists()


def test_to_begin_anew_leaves_a_campaign_that_runs_alone_and_nothing_of_one_that_does_not(short: Path, tmp_path: Path) -> None:
    campaign, out = load(short), tmp_path / "out"
    with store.opened(out, campaign) as running:
        running.add(row(0))
        with pytest.raises(CampaignError, match="another process"), store.opened(out, campaign, overwrite=True):
            pass
        running.add(row(1))
    (out / "worst").mkdir()
    (out / "worst" / "old").write_text("old")
    with store.opened(out, campaign) as again:
        assert sorted(again.records) == [0, 1]
    with store.opened(out, campaign, overwrite=True) as anew:
        assert not anew.records
    assert sorted(path.name for path in out.iterdir()) == [store.MARK, store.RECORDS]
    (out / store.MARK).unlink()  # all that a process leaves that is killed at the start
    (out / store.PARTIAL).write_text("")
    with store.opened(out, campaign) as again:
        again.add(row(0))
    assert sorted(path.name for path in out.iterdir()) == [store.MARK, store.RECORDS]


def test_to_begin_anew_can_be_tried_again_wherever_it_broke_off(
        short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign, out = load(short), tmp_path / "out"
    with store.opened(out, campaign) as opened:
        opened.add(row(0))
    (out / "worst").mkdir()

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    for broken, at in ((shutil, "rmtree"), (os, "replace")):
        with monkeypatch.context() as patch:
            patch.setattr(broken, at, full)
            with pytest.raises(OutputError, match="No space left"), store.opened(out, campaign, overwrite=True):
                pass
        assert not (out / store.PARTIAL).exists()
    with store.opened(out, campaign, overwrite=True) as anew:
        assert not anew.records


def test_another_order_of_what_is_swept_is_another_campaign(short: Path, tmp_path: Path) -> None:
    more = "sensor.noise = [1.0, 2.0]"
    short.write_text(SHORT.replace("plant.friction_left = [0.0, 0.3]", f"plant.friction_left = [0.0, 0.3]\n{more}"))
    with store.opened(tmp_path / "out", load(short)) as opened:
        opened.add(row(0))
    short.write_text(SHORT.replace("plant.friction_left = [0.0, 0.3]", f"{more}\nplant.friction_left = [0.0, 0.3]"))
    with pytest.raises(CampaignError, match="sweep differ"), store.opened(tmp_path / "out", load(short)):
        pass


def test_own_files_belong_to_the_campaign(short: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text((assets() / "scenes" / "cell.toml").read_text())
    short.write_text(SHORT.replace("[set]", f'[set]\nscene = "{scene}"'))
    before = load(short).identity()
    scene.write_text(scene.read_text() + "\n# moved\n")
    assert load(short).identity()["files"] != before["files"]


def test_tables_and_report_follow_what_is_asked_of_the_same_records(
        short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    main(["campaign", str(short), "--out", str(out), "--workers", "1"])
    first = (out / "report.html").stat().st_mtime_ns
    main(["campaign", str(short), "--out", str(out)])
    assert (out / "report.html").stat().st_mtime_ns == first, "nothing new, nothing written"
    (out / STAMP).write_text("")  # as a kill may leave it
    main(["campaign", str(short), "--out", str(out)])
    assert (out / "report.html").stat().st_mtime_ns > first
    short.write_text(SHORT.replace('title = "Short"', 'title = "Shorter"').replace('"missed", ', ""))
    main(["campaign", str(short), "--out", str(out), "--episodes", "1"])
    assert "2 of 2 records" in capsys.readouterr().out
    assert "Shorter" in (out / "report.html").read_text()
    assert set(summary_of(out)["metric"]) == {"force_error_N"}
    assert set(summary_of(out)["n"]) <= {0, 1}


def test_a_record_without_room_is_one_clear_line_and_costs_no_other(short: Path, tmp_path: Path) -> None:
    campaign, out = load(short), tmp_path / "out"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with store.opened(out, campaign) as opened:
        opened.add(row(0))
        resource.setrlimit(resource.RLIMIT_FSIZE, ((out / store.RECORDS).stat().st_size + 20, hard))
        try:
            with pytest.raises(OutputError, match=r"File too large; the 1 records so far are kept"):
                opened.add(row(1))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    with store.opened(out, campaign) as opened:
        assert list(opened.records) == [0]
        opened.add(row(1))


def test_the_worst_are_those_with_the_largest_error(short: Path) -> None:
    campaign = replace(load(short), worst="force_error_N")
    records = [row(0, force_error_N=1.0), row(1, force_error_N=None), row(2, force_error_N=9.0), row(3, force_error_N=5.0)]
    assert worst.ranked(campaign, records, 2) == [2, 3]
    assert worst.ranked(replace(campaign, worst="right_link"), [row(0, right_link=1.0), row(1, right_link=0.2)], 5) == [1, 0]


def test_the_guide_lists_every_campaign_parameter_and_metric(tmp_path: Path) -> None:
    guide = (Path(__file__).parents[2] / "docs" / "campaigns.md").read_text(encoding="utf-8")
    for name in (*plan.names(), *METRICS, *(key for key in keys(Trial()) if key.startswith("situation."))):
        assert f"| `{name}` |" in guide, name
    example = tmp_path / "example.toml"
    example.write_text(guide.split("```toml\n")[1].split("```")[0])
    assert load(example).total == 600
