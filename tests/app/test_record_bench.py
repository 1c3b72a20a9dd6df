"""What `bench record` counts."""

import json

import pytest

pytest.importorskip("rerun")

from app.__main__ import main
from app.bench.record import BUDGET, table


@pytest.mark.live
def test_it_measures_with_and_without_images_and_judges_by_the_budget(tmp_path, capsys):
    main(["bench", "record", "--quick", "--json", str(tmp_path / "record.json")])
    told = capsys.readouterr().out
    found = json.loads((tmp_path / "record.json").read_text())
    rows = {row["depth"]: row for row in found["rows"]}
    assert list(rows) == list(BUDGET) == ["none", "sampled", "full"]
    for row in rows.values():
        assert 0.0 < row["p50_us"] <= row["p99_us"] <= row["max_us"]
        assert row["core"] > 0.0
    assert rows["none"]["images"] == 0 < rows["sampled"]["images"] < rows["full"]["images"] + rows["full"]["dropped"]
    assert rows["none"]["bytes_per_s"] < rows["full"]["bytes_per_s"]
    assert "within the budget" in told or "over the budget" in told
    found["rows"] = [{**row, "core": 0.01, "p99_us": 1.0} for row in found["rows"]]
    assert table(found)[-1] == "within the budget"
    found["rows"][0]["core"] = 0.06
    assert table(found)[-1] == "over the budget: none: core 0.06, budget 0.05"
