"""The recording: what is in it, that it is lossless, and that it never costs the loop an event."""

import io
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

rr = pytest.importorskip("rerun")

from matplotlib.image import imread  # noqa: E402
from rerun.chunk import RrdReader  # noqa: E402

from app import metrics  # noqa: E402
from app.gates import flat  # noqa: E402
from app.record import png  # noqa: E402
from app.record.recorder import Recorder, RecordingError  # noqa: E402
from app.record.signals import SIGNALS, SignalTable  # noqa: E402
from app.record.writer import PLOTTED  # noqa: E402
from hrc.cell import pace, scenario  # noqa: E402
from hrc.cell.cell import Cell  # noqa: E402
from hrc.cell.eyes import rig  # noqa: E402
from hrc.cell.run import Inbox, run  # noqa: E402
from hrc.config import Config  # noqa: E402
from hrc.events import MoveObstacle, RemoveObstacle  # noqa: E402
from hrc.messages import LINKS, Mode  # noqa: E402
from hrc.parameters import keys  # noqa: E402
from hrc.vision.camera import Camera  # noqa: E402

DOCS = Path(__file__).parents[2] / "docs" / "recording.md"


def recorder_of(cell, path, **options):
    config = cell.config
    cameras = {setup.name: Camera(setup.camera) for setup in rig(config, cell.scene)}
    return Recorder(path, base_hz=config.rates.base_hz, scene=cell.scene, cameras=cameras, parameters=keys(config),
                    about={"scenario": "push", "seed": config.seed}, **options)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Two and a half seconds of the scenario `push`, every snapshot kept beside the recording."""
    path = tmp_path_factory.mktemp("session") / "session.rrd"
    script, cell, table, snapshots = scenario.load("push"), Cell(), SignalTable(), []

    class Keep:
        def on_step(self, snapshot):
            snapshots.append(snapshot)

    inbox = Inbox(script)
    inbox.put(MoveObstacle("ball", (-1.0, 0.6, 0.5)))
    inbox.put(RemoveObstacle("nobody"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RERUN_STRICT", "1")
        with recorder_of(cell, path, depth="full", wait=True) as recorder:
            run(cell, pace.FreeRun(), inbox, [table, recorder, Keep()], until=2500)
    return path, table.columns(), snapshots, recorder


def decoded(blob):
    """A 16-bit PNG by another hand: matplotlib gives it as 0..1 in float32, which holds 16 bits exactly."""
    return np.round(imread(io.BytesIO(blob), format="png").astype(float) * 65535).astype(np.uint16)


def chunks(path, entity):
    """(columns by name, timeless or not) of each chunk of an entity."""
    for chunk in RrdReader(str(path)).stream().filter(content=[entity]):
        if chunk.entity_path == entity:
            yield chunk.to_record_batch(), chunk.is_static


def column(path, entity, name):
    """Ticks and flat values of one component, in order of time."""
    ticks, values = [], []
    for batch, is_static in chunks(path, entity):
        if not is_static and name in batch.schema.names:
            ticks += batch.column("step").to_pylist()
            values += batch.column(name).to_pylist()
    order = np.argsort(ticks, kind="stable")
    return [ticks[i] for i in order], [values[i] for i in order]


def test_the_entities_are_exactly_the_documented_ones(session):
    path, *_ = session
    text = DOCS.read_text().split("## session.rrd")[1].split("## signals.parquet")[0]
    documented = re.findall(r"^\| `(/[^`]*)` \|", text, re.MULTILINE)
    patterns = [re.compile(re.sub(r"\\\{\w+\\\}", r"[^/]+", re.escape(entity))) for entity in documented]
    found = {chunk.entity_path for chunk in RrdReader(str(path)).store().stream()}
    assert [entity for entity in found if not any(p.fullmatch(entity) for p in patterns)] == []
    assert [p.pattern for p in patterns if not any(p.fullmatch(entity) for entity in found)] == []
    signals = {s.name for s in SIGNALS} - {"tick", "t", "state", "touch_links", "touch_points", "touch_sure"}
    assert {entity for entity in found if entity.startswith("/signals/")} == {f"/signals/{name}" for name in signals}
    assert {entity for entity in found if entity.startswith("/world/robot/")} == {f"/world/robot/{x}" for x in LINKS}


def test_the_columns_are_documented():
    text = DOCS.read_text().split("## signals.parquet")[1]
    assert re.findall(r"^\| `(\w+)` \| (\d+) \| (.+) \| (.+) \|$", text, re.MULTILINE) \
        == [(s.name, str(s.width), s.unit, s.frame or "-") for s in SIGNALS]


def test_every_figure_is_documented(session):
    text = DOCS.read_text().split("## metrics.json")[1].split("\n## ")[0]
    modes, documented = {mode.value for mode in Mode}, set(re.findall(r"`(\w+)`", text))
    names = {part for name, _ in flat(metrics.compute(session[1])) for part in name.split(".") if not part.isdigit()}
    assert names - modes - documented == set()


@pytest.mark.parametrize("signal", PLOTTED, ids=lambda s: s.name)
def test_signals_are_lossless_and_on_the_clock(session, signal):
    path, columns, *_ = session
    ticks, values = column(path, f"/signals/{signal.name}", "Scalars:scalars")
    assert ticks == columns["tick"].tolist()
    expected = columns[signal.name].astype(float).reshape(len(ticks), signal.width)
    expected[np.isinf(expected)] = np.nan  # a gap in the curve
    np.testing.assert_array_equal(np.array(values), expected)


def test_both_timelines_tell_the_same_time(session):
    path, *_ = session
    for batch, is_static in chunks(path, "/signals/q"):
        if not is_static:
            ns = np.asarray(batch.column("sim_time").cast("int64"))
            np.testing.assert_array_equal(ns, np.asarray(batch.column("step")) * 1_000_000)


def test_poses_are_those_of_the_snapshots(session):
    path, _, snapshots, _ = session
    by_tick = {s.tick: s for s in snapshots}
    ticks, places = column(path, "/world/robot/link_5", "Transform3D:translation")
    _, turns = column(path, "/world/robot/link_5", "Transform3D:quaternion")
    assert len(ticks) == pytest.approx(50 * 2.5, abs=2)
    for tick, place, turn in zip(ticks, places, turns, strict=True):
        T = by_tick[tick].T_world_link[5]
        np.testing.assert_allclose(place[0], T[:3, 3], atol=1e-6)
        np.testing.assert_allclose(Rotation.from_quat(turn[0]).as_matrix(), T[:3, :3], atol=1e-6)


def test_lines_and_touches_are_those_of_the_snapshots(session):
    path, _, snapshots, _ = session
    by_tick = {s.tick: s for s in snapshots}
    ticks, strips = column(path, "/world/distances", "LineStrips3D:strips")
    kept = column(path, "/world/robot/link_5", "Transform3D:translation")[0]
    assert ticks == kept
    for tick, lines in zip(ticks, strips, strict=True):
        expected = [(c.p_robot, c.p_obstacle) for c in by_tick[tick].clearances]
        np.testing.assert_allclose(np.reshape(lines, (-1, 2, 3)), np.reshape(expected, (-1, 2, 3)), atol=1e-6)
    ticks, places = column(path, "/world/contact/touches", "Points3D:positions")
    assert ticks == kept
    for tick, points in zip(ticks, places, strict=True):
        expected = [touch.p_world for touch in by_tick[tick].touches]
        np.testing.assert_allclose(np.reshape(points, (-1, 3)), np.reshape(expected, (-1, 3)), atol=1e-6)
    assert any(map(len, strips)), "the ball was near"
    assert any(map(len, places)), "the hand touched"


def test_clearances_and_touches_are_in_the_table(session):
    _, columns, snapshots, _ = session
    rows = [s for s in snapshots if s.fresh_control]
    for link in range(1, 8):
        expected = [next((c.distance for c in s.clearances if c.link == link), np.inf) for s in rows]
        np.testing.assert_array_equal(columns[f"clearance_{link}"], expected)
    least = min((c.distance for s in rows for c in s.clearances if c.link > 0), default=None)
    assert metrics.compute(columns)["clearance_min_m"] == least
    assert columns["touches"].tolist() == [len(s.touches) for s in rows]
    for i, s in enumerate(rows):
        n = len(s.touches)
        assert columns["touch_links"][i, :n].tolist() == [touch.link for touch in s.touches]
        assert columns["touch_sure"][i, :n].tolist() == [touch.sure for touch in s.touches]
        np.testing.assert_array_equal(columns["touch_points"][i, : 3 * n], [x for touch in s.touches for x in touch.p_world])
        assert np.isnan(columns["touch_links"][i, n:]).all()
        assert np.isnan(columns["touch_points"][i, 3 * n :]).all()
    assert not columns["silent_cameras"].any()


TWO_CAMERAS = """
extends = "cell"
[[camera]]
name = "behind"
[[camera]]
name = "left/far"
eye = [-0.3, 2.5, 1.0]
unplugged = true
"""


def test_each_camera_has_its_own_images_and_a_dead_one_is_a_state(tmp_path):
    (tmp_path / "two.toml").write_text(TWO_CAMERAS)
    cell, table, path = Cell(Config(scene=str(tmp_path / "two.toml"))), SignalTable(), tmp_path / "session.rrd"
    with recorder_of(cell, path, depth="full", wait=True) as recorder:
        run(cell, pace.FreeRun(), Inbox(), [table, recorder], until=600)
    frames, _ = column(path, "/world/cameras/behind/depth", "EncodedDepthImage:blob")
    assert len(frames) == recorder.images_kept > 10
    entities = {chunk.entity_path for chunk in RrdReader(str(path)).store().stream()}
    assert "/world/cameras/left\\/far" in entities, "its place is known"
    assert column(path, "/world/cameras/left\\/far/depth", "EncodedDepthImage:blob")[0] == []
    _, states = column(path, "/state/cameras/left\\/far", "StateChange:state")
    assert [state[0] for state in states] == ["delivers", "silent"]
    _, states = column(path, "/state/cameras/behind", "StateChange:state")
    assert [state[0] for state in states] == ["delivers"]
    silent = table.columns()["silent_cameras"]
    assert silent[0] == 0
    assert silent[-1] == 2, "the second camera"


def test_every_depth_frame_is_kept_at_its_exposure_to_the_millimetre(session):
    path, _, snapshots, recorder = session
    frames = {s.views[0].frame.tick: s.views[0].frame.depth for s in snapshots if s.fresh_frame}
    ticks, blobs = column(path, "/world/cameras/camera/depth", "EncodedDepthImage:blob")
    assert sorted(frames) == ticks
    assert recorder.images_kept == len(ticks)
    assert recorder.images_dropped == 0
    for tick, blob in zip(ticks[::10], blobs[::10], strict=True):
        image = decoded(bytes(blob[0]))
        depth = frames[tick]
        measured = np.isfinite(depth)
        assert np.all(image[~measured] == 0)
        np.testing.assert_allclose(image[measured], 1000 * depth[measured], atol=0.501)


def test_transitions_events_and_refusals_are_all_there(session):
    path, columns, snapshots, _ = session
    modes = columns["state"]
    changes = [mode for i, mode in enumerate(modes) if i == 0 or mode != modes[i - 1]]
    _, states = column(path, "/state/mode", "StateChange:state")
    assert [state[0] for state in states] == changes
    _, texts = column(path, "/events", "TextLog:text")
    told = [text[0] for text in texts]
    assert sum(" refused: " in text for text in told) == sum(len(s.refused) for s in snapshots) == 1
    assert sum(text.startswith("-> ") for text in told) == len(changes)
    assert sum(text.startswith("camera ") for text in told) == 1, "it delivers, from the first tick on"
    assert len(told) == 1 + len(changes) + sum(len(s.events) + len(s.refused) for s in snapshots)


def test_a_sampled_recording_keeps_five_images_a_second_and_none_keeps_none(session, tmp_path):
    _, _, snapshots, _ = session
    cell = Cell()
    for depth, kept in (("sampled", 5 * 2.5), ("none", 0)):
        with recorder_of(cell, tmp_path / f"{depth}.rrd", depth=depth, wait=True) as recorder:
            for snapshot in snapshots:
                recorder.on_step(snapshot)
        assert recorder.images_kept == pytest.approx(kept, abs=1)
    assert {c.entity_path for c in RrdReader(str(tmp_path / "none.rrd")).store().stream()
            if c.entity_path.startswith("/world/cameras/camera/")} <= {"/world/cameras/camera/depth"}


def test_a_recorder_that_falls_behind_drops_images_only_and_counts_them(session, tmp_path):
    _, columns, snapshots, _ = session
    frames = sum(s.fresh_frame for s in snapshots)
    with recorder_of(Cell(), tmp_path / "live.rrd", depth="full") as recorder:
        for snapshot in snapshots:  # far faster than real time
            recorder.on_step(snapshot)
    assert recorder.images_kept + recorder.images_dropped == frames
    assert recorder.images_dropped > 0
    ticks, _ = column(tmp_path / "live.rrd", "/signals/q", "Scalars:scalars")
    assert ticks == columns["tick"].tolist()


def test_what_cannot_be_recorded_is_refused_at_the_start(tmp_path):
    cell = Cell()
    with pytest.raises(RecordingError, match="cannot record"):
        recorder_of(cell, tmp_path / "no such folder" / "session.rrd")
    with pytest.raises(RecordingError, match="sampled"):
        recorder_of(cell, tmp_path / "session.rrd", depth="sample")


@settings(deadline=None, max_examples=30)
@given(arrays(np.uint16, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_a_png_gives_the_image_back(image):
    np.testing.assert_array_equal(decoded(png.encode(image)), image)


def test_depth_out_of_range_becomes_no_measurement():
    depth = np.array([[0.0, 1.2344, np.inf, 70.0, -1.0]], np.float32)
    np.testing.assert_array_equal(png.millimetres(depth), [[0, 1234, 0, 0, 0]])
