"""Gates: figures that must lie within bounds, else exit code 1 with a table."""

import re
from pathlib import Path

import pytest

from app import gates, metrics
from app.__main__ import main
from app.record.signals import SignalTable

FIGURES = {"a": {"b": 1.5, "by_link": {5: 2}, "none": None}, "story": ["idle", "relax"], "fine": True, "name": "x"}
DOCS = Path(__file__).parents[2] / "docs"


def judged(tmp_path, text):
    (tmp_path / "mine.toml").write_text(text)
    return gates.judge(gates.load(tmp_path / "mine.toml"), FIGURES)


@pytest.mark.parametrize(("text", "holds"), [
    ('"a.b" = {max = 1.5}', True), ('"a.b" = {max = 1.49}', False), ("a.b = {min = 1.5, max = 2}", True),
    ("[a]\nb = {min = 1.6}", False), ("a.b = 1.5", True), ("[a.b]\nequals = 1.6", False), ("a.by_link.5 = {min = 2}", True),
    ('story = ["idle", "relax"]', True), ('story = ["idle"]', False), ("fine = true", True), ("fine = {min = 0}", False),
    ("a.none = {max = 1e9}", False), ('name = "x"', True), ("name = {max = 1}", False)])
def test_a_gate_holds_or_not(tmp_path, text, holds):
    (verdict,) = judged(tmp_path, text)
    assert verdict.holds is holds
    assert (gates.table([verdict]) == "") is holds


@pytest.mark.parametrize(("text", "told"), [
    ("a.c = {max = 1}", "a.b"), ("storry = []", "did you mean story"), ("a.b = {mx = 1}", "a.b"),
    ("a.b = {max = 1, mn = 1}", "min"), ("a.b = {max = true}", "number"),
    ("a.b = {}", "no bound"), ("a.b = {min = 2, max = 1}", "above"), ("a.b = {equals = 1, max = 1}", "alone"),
    ("", "no gate"), ("a b", "mine.toml"), ("a = {max = 1}", "unknown figure")])
def test_what_is_no_gate_is_refused_with_what_would_be_right(tmp_path, text, told):
    with pytest.raises(gates.GateError, match=told):
        judged(tmp_path, text)


def test_the_gates_of_the_paper_name_figures_that_there_are():
    extra = {"recording_problem": ""}
    verdicts = gates.judge(gates.load("paper"), {**metrics.compute(SignalTable().columns()), **extra})
    assert not any(v.holds for v in verdicts if v.gate.figure not in ("recording_problem", "everything_finite")), \
        "a run of nothing passes none"
    with pytest.raises(gates.GateError, match="paper"):
        gates.load("papr")
    with pytest.raises(gates.GateError, match="read"):
        gates.load("papr.toml")


def test_a_run_that_falls_short_exits_with_1_and_a_table_and_keeps_its_folder(tmp_path, capsys):
    (tmp_path / "mine.toml").write_text('story = ["idle"]\n"ee_error.idle.max_m" = {max = 0.0}\n')
    args = ["run", "free", "--out", str(tmp_path / "out"), "--duration", "0.2", "--no-record", "--quiet",
            "--check", str(tmp_path / "mine.toml")]
    with pytest.raises(SystemExit) as exit_:
        main(args)
    assert exit_.value.code == 1
    told = capsys.readouterr().out
    assert "1 of 2 gates do not hold" in told
    assert re.search(r"ee_error.idle.max_m +\S+ +must be: max 0.0", told)
    assert (tmp_path / "out" / "metrics.json").is_file()
    (tmp_path / "mine.toml").write_text('story = ["idle"]\n')
    main([*args, "--overwrite"])
    assert "all 1 gates hold" in capsys.readouterr().out


def test_the_example_in_the_docs_is_the_script_that_the_project_runs():
    script = (DOCS.parent / ".ci" / "gates").read_text()
    blocks = re.findall(r"```bash\n(.*?)```", (DOCS / "ci.md").read_text(), flags=re.DOTALL)
    wanted = [line.split("#")[0].split()[1:] for line in blocks[0].strip().splitlines()]
    run = [line.replace(" --overwrite", "").split()[1:] for line in script.splitlines() if line.startswith("elbowroom ")]
    assert wanted == run
    assert ".ci/gates" in (DOCS.parent / ".ci" / "run").read_text()
