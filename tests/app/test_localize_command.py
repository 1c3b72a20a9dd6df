"""`elbowroom localize`: the lines of docs/depth_images.md, run as they stand, and what a user may get wrong."""

import csv
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.__main__ import main
from app.depth_folder import read
from app.record.png import millimetres
from hrc.geometry import transform
from hrc.messages import LINKS, Body
from hrc.model import Dynamics, load_spec, pinocchio_model
from hrc.scene import load_scene
from hrc.sim.depth_camera import DepthCamera

DOC = (Path(__file__).resolve().parents[2] / "docs" / "depth_images.md").read_text()
LOOP, MAKER = re.findall(r"```python\n(.*?)```", DOC, re.DOTALL)
COMMAND = next(line for line in DOC.splitlines() if line.startswith("elbowroom localize")).split()[1:]
POINT = [float(x) for x in re.search(r"at \((-?[\d.]+), (-?[\d.]+), (-?[\d.]+)\), on link 4", DOC).groups()]


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """The folder the document's script makes; leave it as it is."""
    folder = tmp_path_factory.mktemp("example")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(compile(MAKER, "docs/depth_images.md", "exec"), {})
    return folder / "recording"


@pytest.fixture
def recording(example, tmp_path, monkeypatch):
    """A copy to spoil, in the current folder."""
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copytree(example, tmp_path / "recording")).relative_to(tmp_path)


def rows(path):
    with open(path, newline="") as table:
        return list(csv.DictReader(table))


def point(row):
    return np.array([float(row[axis]) for axis in "xyz"])


def change(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_the_documents_command_finds_the_contact(recording, capsys):
    main(COMMAND)
    assert recording.exists()
    found, said = rows("contacts.csv"), capsys.readouterr()
    assert said.err == ""
    assert [row["file"] for row in found] == ["000.png", "001.png", "002.png", "003.png"]
    assert [float(row["time"]) for row in found] == [0.0, 0.033, 0.067, 0.1]
    first, last = found[0], found[-1]
    assert (first["touch"], first["link"], first["x"]) == ("0", "", "")  # 20 cm off
    assert (last["touch"], last["link"], last["sure"]) == ("1", "link_4", "1")
    assert np.linalg.norm(point(last) - POINT) < 0.03
    assert float(last["distance"]) < 0.01
    assert [line.split()[0] for line in said.out.splitlines()] == [row["file"] for row in found]
    assert "nothing within reach" in said.out.splitlines()[0]
    assert "link_4" in said.out.splitlines()[-1]


def test_the_documents_loop_finds_the_contact(recording, capsys):
    folder = read(recording)
    exec(compile(LOOP, "docs/depth_images.md", "exec"), {
        "empty_cell": lambda: [(shot.image(), shot.q) for shot in folder.empty],
        "stream": lambda: [(shot.image(), shot.q) for shot in folder.shots]})
    link, *found = capsys.readouterr().out.splitlines()[-1].replace("[", "").replace("]", "").split()
    assert LINKS[int(link)] == "link_4"
    assert np.linalg.norm(np.array(found[:3], float) - POINT) < 0.03


def test_without_the_lens_the_example_would_not_find_it(recording):
    """The robot is off the axis there, so that the example does test the lens."""
    change(recording / "camera.toml", "distortion", "# ")
    main(COMMAND)
    found = rows("contacts.csv")
    assert all(np.linalg.norm(point(row) - POINT) > 0.03 for row in found if row["file"] == "003.png" and row["link"])
    assert any(row["link"] for row in found if row["file"] == "000.png")  # the robot itself is not where it is removed


def test_arrays_in_metres_are_as_good_as_images(recording):
    main(["localize", "recording", "--out", "png.csv"])
    for path in sorted((recording / "depth").iterdir()):
        np.save(path.with_suffix(".npy"), np.asarray(Image.open(path)) / 1000)
        path.unlink()
    change(recording / "camera.toml", "unit = 0.001", "")
    table = recording / "joints.csv"
    table.write_text(table.read_text().replace(".png", ".npy"))
    main(["localize", "recording", "--out", "npy.csv"])
    for a, b in zip(rows("png.csv"), rows("npy.csv"), strict=True):
        assert a["link"] == b["link"]
        if a["link"]:
            np.testing.assert_allclose(point(a), point(b), atol=1e-4)


def test_without_images_of_the_empty_cell_the_boxes_count_and_it_says_so(recording, capsys):
    shutil.rmtree(recording / "empty")
    (recording / "empty.csv").unlink()
    main(["localize", "recording", "--out", "contacts.csv"])
    assert "simulated cell" in capsys.readouterr().err
    assert rows("contacts.csv")[-1]["link"] == "link_4"
    (recording / "scene.toml").write_text("# nothing stands here\n")
    main(["localize", "recording", "--out", "contacts.csv", "--overwrite"])
    assert capsys.readouterr().err == ""


def test_an_empty_cell_without_the_robot_needs_no_joint_positions(recording, capsys):
    (recording / "empty.csv").unlink()
    for path in (recording / "empty").iterdir():
        depth = np.asarray(Image.open(path)).copy()
        depth[depth < 2300] = 0  # the robot gone, and whatever else is as near
        Image.fromarray(depth).save(path)
    main(["localize", "recording"])
    assert capsys.readouterr().err == ""


def test_settings_reach_the_eye(recording, capsys):
    main(["localize", str(recording), "--set", "vision.first_link=5", "--set", "vision.reach=0.02"])
    assert "link_4" not in capsys.readouterr().out


# -- what a user may get wrong -----------------------------------------------------------------------------------------

def refusal(capsys, *args):
    with pytest.raises(SystemExit) as exit_:
        main(["localize", *map(str, args)])
    assert exit_.value.code == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("elbowroom: ")]
    return lines[-1]


def png8(folder):
    Image.fromarray(np.full((424, 512), 100, np.uint8)).save(folder / "depth" / "001.png")


def colour(folder):
    Image.fromarray(np.full((424, 512, 3), 100, np.uint8)).save(folder / "depth" / "001.png")


def small(folder):
    Image.fromarray(np.full((240, 320), 1000, np.uint16)).save(folder / "depth" / "001.png")


def broken(folder):
    path = folder / "depth" / "001.png"
    path.write_bytes(path.read_bytes()[:2000])


def nothing(folder):
    (folder / "depth" / "001.png").write_bytes(b"")


def not_finite(folder):
    change(folder / "joints.csv", "001.png,0.033,0.000000", "001.png,0.033,nan")


@pytest.mark.parametrize(("spoil", "told"), [
    (png8, "8-bit"), (colour, "RGB"), (small, "424, 512"), (broken, "cannot be read"), (nothing, "cannot be read"),
    (not_finite, "not finite")])
@pytest.mark.parametrize("lens", [True, False])
def test_a_bad_frame_is_named_and_left_out_and_the_others_count(recording, capsys, spoil, told, lens):
    spoil(recording)
    if not lens:
        change(recording / "camera.toml", "distortion", "# ")
    main(["localize", "recording", "--out", "contacts.csv"])
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("elbowroom: ")
    assert "001.png" in line
    assert told in line
    assert list(dict.fromkeys(row["file"] for row in rows("contacts.csv"))) == ["000.png", "002.png", "003.png"]


def no_images(folder):
    shutil.rmtree(folder / "depth")


def no_table(folder):
    (folder / "joints.csv").unlink()


def no_camera(folder):
    (folder / "camera.toml").unlink()


def image_without_row(folder):
    shutil.copy(folder / "depth" / "000.png", folder / "depth" / "004.png")


def row_without_image(folder):
    (folder / "depth" / "002.png").unlink()


def row_twice(folder):
    change(folder / "joints.csv", "002.png", "001.png")


def degrees(folder):
    change(folder / "joints.csv", "001.png,0.033,0.000000", "001.png,0.033,45.0")


def short_row(folder):
    change(folder / "joints.csv", "001.png,0.033,", "001.png,")


def words(folder):
    change(folder / "joints.csv", "0.033", "soon")


def other_header(folder):
    change(folder / "joints.csv", "q1", "joint_1")


def empty_table(folder):
    (folder / "joints.csv").write_text("")


def zero_focal_length(folder):
    change(folder / "camera.toml", "fx = 365.456", "fx = 0.0")


def nothing_usable(folder):
    for path in (folder / "depth").iterdir():
        path.write_bytes(b"")


def no_empty_images(folder):
    for path in (folder / "empty").iterdir():
        path.unlink()


@pytest.mark.parametrize(("spoil", "told"), [
    (shutil.rmtree, "camera.toml"), (no_images, "no depth images"), (no_table, "joints.csv"), (no_camera, "camera.toml"),
    (image_without_row, "none for 004.png"), (row_without_image, "no 002.png"), (row_twice, "twice"),
    (degrees, "line 3: q1 is 45"), (short_row, "line 3"), (words, "line 3"), (other_header, "lacks the column q1"),
    (empty_table, "lacks the column file"), (zero_focal_length, "fx must be"), (nothing_usable, "none of the 4 images"),
    (no_empty_images, "empty")])
def test_what_makes_the_folder_doubtful_ends_the_command(recording, capsys, spoil, told):
    spoil(recording)
    assert told in refusal(capsys, recording)


def test_bad_arguments_are_refused_before_anything_is_written(recording, capsys):
    Path("mine.csv").write_text("years of work")
    assert "--overwrite" in refusal(capsys, recording, "--out", "mine.csv")
    assert Path("mine.csv").read_text() == "years of work"
    assert "cannot write" in refusal(capsys, recording, "--out", "no/such/folder.csv")
    assert "vision.*" in refusal(capsys, recording, "--set", "control.f_abort=30")
    assert "vision.margin" in refusal(capsys, recording, "--set", "vision.margn=0.1")
    assert "cuda:7" in refusal(capsys, recording, "--device", "cuda:7")


def test_separate_touches_are_separate_rows(recording, capsys):
    """A ball at the wrist and a hand at the forearm, with the arm turned to the side, before a camera without a lens."""
    change(recording / "joints.csv", "003.png,0.100,0.000000", "003.png,0.100,-1.57")
    change(recording / "camera.toml", "distortion", "# ")
    shutil.rmtree(recording / "empty")
    (recording / "empty.csv").unlink()
    T = Dynamics(pinocchio_model(load_spec().compile(), armature=False)).kinematics(read(recording).shots[3].q)[0]
    camera = DepthCamera(read(recording).camera.camera, load_scene().environment, load_scene().bodies, latency=0)
    ball, hand = T[6][:3, 3] + [0.155, 0.0, 0.0], (T[6] + T[4])[:3, 3] / 2 + [0.1, 0.0, 0.0]
    camera.expose(0, T, [Body("ball", "sphere", (0.08,), transform(np.eye(3), ball)),
                         Body("hand", "sphere", (0.04,), transform(np.eye(3), hand))])
    frame = camera.latest(0)
    assert frame is not None
    Image.fromarray(millimetres(frame.depth)).save(recording / "depth" / "003.png")
    main(["localize", "recording", "--out", "contacts.csv"])
    found = [row for row in rows("contacts.csv") if row["file"] == "003.png"]
    assert len(found) >= 2
    assert [row["touch"] for row in found] == [str(i + 1) for i in range(len(found))]
    for centre, radius in ((ball, 0.08), (hand, 0.04)):
        assert min(abs(np.linalg.norm(point(row) - centre) - radius) for row in found) < 0.03
    assert "touch 2" in capsys.readouterr().out
