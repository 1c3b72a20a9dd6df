"""The worst episodes of a campaign, kept as sessions: where that fails, nothing else is lost."""

from pathlib import Path

import pytest
from test_campaign import SHORT, row, summary_of

from app.__main__ import main
from app.campaign import store, worst
from app.campaign.plan import load


def test_what_cannot_be_kept_does_not_cost_the_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (short := tmp_path / "short.toml").write_text(SHORT)
    campaign, out = load(short, 1), tmp_path / "out"
    with store.opened(out, campaign) as opened:
        for index in range(campaign.total):
            opened.add(row(index, force_error_N=1.0, missed=0.0))
    (out / worst.FOLDER).write_text("in the way")
    with pytest.raises(SystemExit) as exit_:
        main(["campaign", str(short), "--out", str(out), "--episodes", "1", "--record", "1"])
    told = capsys.readouterr()
    assert exit_.value.code == 2
    assert "could not all be kept" in told.err
    assert "2 of 2 records" in told.out
    assert "Short" in (out / "report.html").read_text()
    assert summary_of(out)["metric"]
