"""A session in which the depth camera was moved: its recording, its export and its replays know where it stood."""

import numpy as np
import pytest

pytest.importorskip("rerun")
pytest.importorskip("mcap")

from test_export import NS, topics_of
from test_record import column, recorder_of

from app import open_loop
from app.headless import Job, execute
from app.record.folder import read
from app.record.mcap_file import export
from app.replay import exact
from hrc.cell import pace
from hrc.cell.cell import Cell
from hrc.cell.run import Record, run
from hrc.config import Config
from hrc.events import MoveCamera, Reset
from hrc.geometry import look_at

HOME = Config().camera
ASIDE = MoveCamera("camera", (-0.4, 1.9, 0.9), (-0.3, 0.0, 0.4))
ABOVE = MoveCamera("camera", (0.3, -1.2, 2.0), (-0.3, 0.0, 0.4))
MOVED = """
title = "The camera is carried about"
duration = 1.5
[[event]]
t = 0.0
type = "MoveObstacle"
name = "ball"
position = [-0.35, 0.35, 0.5]
[[event]]
t = 0.5
type = "MoveCamera"
name = "camera"
eye = [-0.4, 1.9, 0.9]
target = [-0.3, 0.0, 0.4]
[[event]]
t = 1.2
type = "MoveCamera"
name = "camera"
eye = [1.0, 1.0, 1.0]
target = [-0.3, 0.0, 0.4]
[[event]]
t = 1.2
type = "MoveCamera"
name = "camera"
eye = [0.3, -1.2, 2.0]
target = [-0.3, 0.0, 0.4]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    home = tmp_path_factory.mktemp("moved")
    (home / "moved.toml").write_text(MOVED)
    execute(Job(str(home / "moved.toml"), home / "run", depth="full", quiet=True))
    return home / "run"


def stood(path):
    """From which tick on the recording has the camera where [m]."""
    ticks, eyes = column(path, "/world/cameras/camera", "Transform3D:translation")
    return list(zip(ticks, (tuple(np.round(np.ravel(eye), 6)) for eye in eyes), strict=True))


def test_the_recording_has_its_pose_from_the_first_frame_that_it_took_there(folder):
    frames, _ = column(folder / "session.rrd", "/world/cameras/camera/depth", "EncodedDepthImage:blob")
    first, second = (min(tick for tick in frames if tick > moved) for moved in (500, 1200))
    assert stood(folder / "session.rrd") == [(0, HOME.eye), (first, ASIDE.eye), (second, ABOVE.eye)]


def test_the_export_has_every_pose_and_none_between(folder, tmp_path):
    export(read(folder), tmp_path / "run.mcap")
    told = topics_of(tmp_path / "run.mcap")["/tf"]
    poses = [(time, t["translation"]) for time, _, message in told for t in message["transforms"]
             if t["child_frame_id"] == "camera"]
    assert [time for time, _ in poses][1:] == [500 * NS - 1, 500 * NS, 1200 * NS - 1, 1200 * NS, 1200 * NS]
    eyes = HOME.eye, HOME.eye, ASIDE.eye, ASIDE.eye, (1.0, 1.0, 1.0), ABOVE.eye
    for (_, found), (x, y, z) in zip(poses, eyes, strict=True):
        assert found == pytest.approx({"x": x, "y": y, "z": z})


def test_it_runs_again_to_the_bit_and_is_looked_at_anew(folder):
    assert exact(folder)[1]
    assert np.isfinite(read(folder).columns["clearance_5"][-50:]).all(), "it sees the ball"
    for depth in ("rendered", "recorded"):
        assert open_loop.execute(open_loop.Job(folder, depth=depth)).changed is None
        assert open_loop.execute(open_loop.Job(folder, ("vision.thickness=0.01",), depth=depth)).changed.signals


def test_a_reset_and_another_file_have_it_where_it_stands(tmp_path):
    cell, path = Cell(), tmp_path / "session.rrd"
    events = Record([(100, ASIDE), (700, Reset()), (600, ABOVE)])
    steps = iter(range(10**9))
    with recorder_of(cell, path, depth="none", rotate=1.0, wait=True) as recorder:
        run(cell, pace.FreeRun(1), events, [recorder], until=10**9, stopped=lambda: next(steps) >= 2600)
    assert len(recorder.paths) == 3
    first, second, third = (stood(file) for file in recorder.paths)
    assert [eye for _, eye in first] == [HOME.eye, ASIDE.eye, HOME.eye]
    assert [eye for _, eye in second] == [HOME.eye, ABOVE.eye]
    assert [eye for _, eye in third] == [ABOVE.eye]
    assert first[2][0] == 701
    assert 1300 < second[1][0] < 1350
    _, turns = column(recorder.paths[2], "/world/cameras/camera", "Transform3D:mat3x3")
    np.testing.assert_allclose(np.reshape(turns[0], (3, 3)).T, look_at(ABOVE.eye, ABOVE.target)[:3, :3], atol=1e-6)
