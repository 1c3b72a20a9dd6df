"""The MCAP file of a session, read back by the format's own reader: times, counts and values are those of the session."""

import base64
import json
import re
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rerun")
pytest.importorskip("mcap")

import pyarrow.parquet as pq
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation
from test_record import column, decoded

from app.__main__ import main
from app.headless import Job, execute
from app.record.archive import Archive
from app.record.folder import read
from app.record.foxglove import SCHEMAS
from app.record.mcap_file import export
from app.record.signals import read_parquet
from hrc.cell import pace, scenario
from hrc.cell.cell import Cell
from hrc.cell.run import Inbox, run
from hrc.events import Push, Reset
from hrc.messages import LINKS
from hrc.model import Dynamics, load_spec, pinocchio_model

NS = 1_000_000


def topics_of(path):
    """(log time [ns], schema, message) of each topic, in order of time."""
    found = defaultdict(list)
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            found[channel.topic].append((message.log_time, schema.name, json.loads(message.data)))
    return found


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("export")
    execute(Job("push", folder / "run", duration=2.5, depth="sampled", quiet=True))
    main(["export", str(folder / "run"), "--out", str(folder / "run.mcap")])
    return folder / "run", folder / "run.mcap", topics_of(folder / "run.mcap")


def test_topics_and_schemas_are_the_ones_that_foxglove_knows(exported):
    _, path, topics = exported
    section = (Path(__file__).parents[2] / "docs" / "recording.md").read_text().split("## In Foxglove")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `(/\S*)` \| `(\S+)` \|", section, re.MULTILINE)
    assert {name.replace("{camera}", "camera"): schema for name, schema in rows} == {
        name: messages[0][1] for name, messages in topics.items()}
    assert {name: messages[0][1].removeprefix("foxglove.") for name, messages in topics.items()} == {
        "/tf": "FrameTransforms", "/scene": "SceneUpdate", "/obstacles": "SceneUpdate", "/contact": "SceneUpdate",
        "/log": "Log", "/signals": "elbowroom.Signals", "/cameras/camera/depth": "RawImage",
        "/cameras/camera/calibration": "CameraCalibration"}
    with path.open("rb") as file:
        reader = make_reader(file)
        schemas = {schema.name: json.loads(schema.data) for schema in reader.get_summary().schemas.values()}
        assert next(iter(reader.iter_metadata())).metadata["scenario"] == "push"
    assert set(schemas) == set(SCHEMAS)
    for messages in topics.values():
        assert [time for time, *_ in messages] == sorted(time for time, *_ in messages)
        for _, name, message in messages:
            assert set(message) == set(schemas[name]["properties"])


def test_signals_are_those_of_the_table_to_the_bit(exported):
    folder, _, topics = exported
    columns, messages = read_parquet(folder / "signals.parquet"), topics["/signals"]
    assert [time for time, *_ in messages] == (columns["tick"] * NS).tolist()
    for name, values in columns.items():
        found = np.array([message[name] for *_, message in messages], object if values.dtype.kind == "U" else None)
        if values.dtype.kind == "f":
            expected = np.where(np.isfinite(values), values, np.nan)
            np.testing.assert_array_equal(found.astype(float), expected)
        else:
            np.testing.assert_array_equal(found, values)


def test_the_robot_stands_where_its_joints_say(exported):
    folder, _, topics = exported
    columns, robot = read_parquet(folder / "signals.parquet"), Dynamics(pinocchio_model(load_spec().compile(), armature=False))
    still, *moving = topics["/tf"]
    assert [t["child_frame_id"] for t in still[2]["transforms"]] == ["camera"]
    assert [time for time, *_ in moving] == (columns["tick"][::4] * NS).tolist()
    for (_, _, message), q in zip(moving[::25], columns["q"][::100], strict=True):
        for transform, name, T in zip(message["transforms"], LINKS, robot.kinematics(q)[0], strict=True):
            assert (transform["parent_frame_id"], transform["child_frame_id"]) == ("world", name)
            np.testing.assert_allclose([transform["translation"][axis] for axis in "xyz"], T[:3, 3], atol=1e-12)
            turn = Rotation.from_quat([transform["rotation"][axis] for axis in "xyzw"])
            np.testing.assert_allclose(turn.as_matrix(), T[:3, :3], atol=1e-9)


def test_arrows_end_at_the_contact_and_go_with_it(exported):
    folder, _, topics = exported
    columns, there, arrows = read_parquet(folder / "signals.parquet"), set(), 0
    shown = {}
    for time, _, message in topics["/contact"]:
        for deletion in message["deletions"]:
            there.remove(deletion["id"])
        for entity in message["entities"]:
            there.add(entity["id"])
            row = np.flatnonzero(columns["tick"] * NS == time)[0]
            (arrow,), name = entity["arrows"], entity["id"]
            pose = arrow["pose"]
            along = Rotation.from_quat([pose["orientation"][a] for a in "xyzw"]).apply([1.0, 0.0, 0.0])
            tip = [pose["position"][a] for a in "xyz"] + along * (arrow["shaft_length"] + arrow["head_length"])
            np.testing.assert_allclose(tip, columns[f"contact_point_{name}"][row], atol=1e-9)
            np.testing.assert_allclose(100 * (arrow["shaft_length"] + arrow["head_length"]) * along,
                                       columns[f"force_{name}"][row], atol=1e-6)
            arrows += 1
        shown[time] = set(there)
    assert arrows > 20, "there was a contact"
    for row in range(0, len(columns["tick"]), 4):
        expected = {name for name in ("est", "true") if np.isfinite(columns[f"contact_point_{name}"][row]).all()}
        assert shown.get(int(columns["tick"][row]) * NS, set()) == expected


def test_images_are_the_recorded_ones_and_obstacles_stand_as_the_cameras_saw_them(exported):
    folder, _, topics = exported
    ticks, blobs = column(folder / "session.rrd", "/world/cameras/camera/depth", "EncodedDepthImage:blob")
    images = topics["/cameras/camera/depth"]
    for topic in ("depth", "calibration"):
        assert [time for time, *_ in topics[f"/cameras/camera/{topic}"]] == [tick * NS for tick in ticks]
    for (_, _, image), blob in zip(images, blobs, strict=True):
        data = np.frombuffer(base64.b64decode(image["data"]), "<u2").reshape(image["height"], image["width"])
        np.testing.assert_array_equal(data, decoded(bytes(blob[0])))
    exposures = pq.read_table(folder / "exposures.parquet").to_pydict()
    frames = {(step + 1) * NS: i for i, step in enumerate(exposures["step"])}
    assert {time for time, *_ in images} <= set(frames), "both clocks are one"
    hand = [(frames[time], entity) for time, _, update in topics["/obstacles"] for entity in update["entities"]
            if entity["id"] == "hand"]
    assert len(hand) > 5
    for i, entity in hand:
        (sphere,) = entity["spheres"]
        expected = np.reshape(exposures["hand"][i], (4, 4))[:3, 3]
        np.testing.assert_allclose([sphere["pose"]["position"][a] for a in "xyz"], expected, atol=1e-12)


def test_the_log_has_every_transition_and_event(exported):
    folder, _, topics = exported
    mode = read_parquet(folder / "signals.parquet")["state"]
    changes = [m for i, m in enumerate(mode) if i == 0 or m != mode[i - 1]]
    told = [message["message"] for *_, message in topics["/log"]]
    assert [text.removeprefix("-> ") for text in told if text.startswith("-> ")] == changes
    assert len(told) == len(changes) + len(read(folder).events)


def test_after_a_reset_the_clock_goes_on(tmp_path):
    archive, cell, inbox = Archive(tmp_path), Cell(), Inbox(scenario.load("free"))
    run(cell, pace.FreeRun(7), inbox, [archive], until=203)
    name = archive.start("free", cell.config, {}, "none")
    run(cell, pace.FreeRun(7), inbox, [archive], until=452)
    inbox.put(Reset())
    run(cell, pace.FreeRun(7), inbox, [archive], until=10**6, stopped=lambda: archive.now.seconds >= 0.4)
    inbox.put(Push(4, (0.0, 0.0, 0.0), (0.0, 20.0, 0.0)))
    run(cell, pace.FreeRun(7), inbox, [archive], until=10**6, stopped=lambda: archive.now.seconds >= 0.5)
    archive.stop()
    export(read(archive.folder(name)), tmp_path / "reset.mcap")
    topics = topics_of(tmp_path / "reset.mcap")
    times = np.array([time for time, *_ in topics["/signals"]]) // NS
    ticks, _ = column(archive.folder(name) / "session.rrd", "/signals/q", "Scalars:scalars")
    assert times.tolist() == ticks
    said = [(time // NS, message["message"].split()[0]) for time, _, message in topics["/log"]]
    began = archive.root / name / "events.jsonl"
    reset, push = (json.loads(line)["tick"] for line in began.read_text().splitlines())
    assert said[1:] == [(reset, "Reset"), (reset + push, "Push")]


def test_a_file_that_exists_is_left_alone(exported, capsys):
    folder, path, _ = exported
    before = path.stat().st_mtime_ns
    with pytest.raises(SystemExit) as exit_:
        main(["export", str(folder), "--out", str(path)])
    assert exit_.value.code == 2
    assert "exists" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["export", str(folder), "--out", str(path.parent / "none" / "x.mcap")])
    assert "cannot write" in capsys.readouterr().err
    assert path.stat().st_mtime_ns == before
