"""Scenario files are read whole or refused with line and reason."""

import pytest

from hrc.cell import scenario
from hrc.config import Config
from hrc.errors import ScenarioError
from hrc.events import Press


def test_those_of_the_project_load():
    assert {"paper", "free", "push"} <= set(scenario.names())
    for name in scenario.names():
        loaded = scenario.load(name)
        assert loaded.duration > 0
        assert all(t <= loaded.duration for t, _ in loaded.events)


def test_the_papers_experiment_presses_five_times():
    presses = [(t + e.approach, e.link) for t, e in scenario.load("paper").events if isinstance(e, Press)]
    assert presses == [(2.6, 3), (13.0, 6), (26.0, 3), (47.3, 5), (73.6, 3)]


def test_settings_change_the_config(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('duration = 2\n[set]\n"control.f_abort" = 40.0\n')
    assert scenario.load(file).configured(Config()).control.f_abort == 40.0


@pytest.mark.parametrize(("text", "says"), [
    ("duration = 2\nbogus = 1\n", "line 2: unknown entry"),
    ("duration = -2\n", "line 1: duration must be"),
    ("duration = \n", "line 1"),
    ("duration = 2\n\n[[event]]\nt = 1\ntype = 'Pusj'\n", "line 3: .*did you mean Push"),
    ("duration = 2\n[[event]]\ntype = 'Stop'\n", "needs its time t"),
    ("duration = 2\n[set]\n'control.f_abrt' = 3\n", "did you mean control.f_abort"),
    ("event = 3\nduration = 1\n", r"\[\[event\]\]"),
])
def test_a_malformed_file_says_where_and_why(tmp_path, text, says):
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(ScenarioError, match=says):
        scenario.load(file)


def test_an_unknown_name_lists_the_near_ones():
    with pytest.raises(ScenarioError, match="did you mean paper"):
        scenario.load("papr")
