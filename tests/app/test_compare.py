"""One scenario with several presets, side by side."""

import json

import pytest

from app.compare import Job, execute
from hrc.errors import HrcError


def test_the_printed_laws_chatter_beside_the_default(tmp_path, capsys):
    rows = execute(Job("push", tmp_path / "both", duration=5.0, quiet=True))
    assert list(rows) == ["default", "literal"]
    assert rows["literal"]["modes"] > 2 * rows["default"]["modes"]
    assert rows["literal"]["joint step"] > 100.0 > rows["default"]["joint step"]
    assert json.loads((tmp_path / "both" / "compare.json").read_text()) == rows
    assert (tmp_path / "both" / "compare.png").stat().st_size > 50_000
    assert {path.name for path in (tmp_path / "both").iterdir()} == {
        "default", "literal", "compare.json", "compare.png", "config.json"}
    assert "literal" in capsys.readouterr().out


@pytest.mark.parametrize(("changes", "told"), [
    ({"presets": ("default",)}, "two or more"), ({"presets": ("default", "default")}, "two or more"),
    ({"presets": ("default", "litral")}, "literal"), ({"scenario": "psh"}, "push"), ({"settings": ("control.lam=2",)}, "lam")])
def test_what_cannot_be_compared_is_refused_before_anything_runs(tmp_path, changes, told):
    with pytest.raises(HrcError, match=told):
        execute(Job(**{"scenario": "push", "out": tmp_path / "out", **changes}))
    assert not list(tmp_path.iterdir())
