"""The bench of yielding: relaxing takes force away where it says so, and costs the end effector nothing."""

import json

from app.bench.yielding import Work, bench, printed, run


def test_relaxing_takes_force_away_and_keeps_the_end_effector():
    on, off = run(Work(3, "+y", True, 7)), run(Work(3, "+y", False, 7))
    assert on is not None
    assert off is not None
    assert on.held < off.held - 2.0
    assert on.given_way > 0.01 > off.given_way
    assert on.ee_error < 5e-4
    assert on.power is not None
    assert on.power > -0.1
    assert len(printed([on, off])) == 3


def test_the_quick_run_writes_its_rows(tmp_path, capsys):
    bench(json=tmp_path / "yield.json", quick=True)
    rows = json.loads((tmp_path / "yield.json").read_text())["rows"]
    assert [row["relaxing"] for row in rows] == [True, False]
    assert "3 +y" in capsys.readouterr().out
