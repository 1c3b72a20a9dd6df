import pytest

from hrc.errors import AssetError
from hrc.scene import load_scene, scenes


@pytest.mark.parametrize("name", scenes())
def test_the_scenes_that_come_with_the_project_load(name):
    scene = load_scene(name)
    assert {box.name for box in scene.environment} >= {"table", "floor"}
    assert {body.name for body in scene.bodies} >= {"hand", "ball", "block", "slab", "forearm", "figure"}


def test_a_scene_adds_to_the_one_it_extends(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('extends = "cell"\n[[camera]]\nname = "left"\nhz = 15\neye = [0.0, 2.0, 1.0]\n')
    scene = load_scene(file)
    assert scene.bodies == load_scene().bodies
    assert scene.cameras[0].changes == {"hz": 15, "eye": (0.0, 2.0, 1.0)}


@pytest.mark.parametrize(("text", "complaint"), [
    ('extends = "cel"', 'unknown scene "cel"; did you mean cell'),
    ("[[bodies]]", 'unknown entry "bodies"; did you mean body'),
    ("[[camera]]\nhz = 30", "a camera needs a name"),
    ('[[camera]]\nname = "a"\n[[camera]]\nname = "a"', "two cameras have the same name"),
    ('[[body]]\nname = "a"\nshape = "sphere"\nsize = [1.0, 2.0]', "sphere or figure with one size"),
    ("[[body", "malformed"),
])
def test_a_bad_scene_file_is_one_clear_error(tmp_path, text, complaint):
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(AssetError, match=complaint):
        load_scene(file)


def test_a_scene_that_extends_itself_is_an_error(tmp_path):
    file = tmp_path / "loop.toml"
    file.write_text(f'extends = "{file}"')
    with pytest.raises(AssetError, match="malformed"):
        load_scene(file)


def test_an_unknown_scene_names_those_there_are():
    with pytest.raises(AssetError, match="there are: cell, two_cameras, two_hands"):
        load_scene("zoo")
