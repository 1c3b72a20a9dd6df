"""What `bench start` times: real starts, whose stages come one after the other."""

import pytest

from app.bench.start import BARE, BARE_LINK, CELL, LINK, LOADED, MOTION, PAGE, printed, timed
from hrc.paths import assets


@pytest.mark.live
def test_a_start_reaches_its_stages_in_their_order() -> None:
    times = timed(("-m", "app", "serve", "--port"), (), LINK, {})
    assert 0.0 < times[LOADED] < times[PAGE] < times[MOTION]
    assert times[LOADED] < times[CELL] < times[MOTION]
    alone = timed(("-c", BARE), (str(assets() / "lwr" / "lwr.xml"),), BARE_LINK, {})
    assert alone.keys() == {PAGE, MOTION}
    assert alone[PAGE] < alone[MOTION]


def test_a_start_that_fails_says_so_at_once() -> None:
    with pytest.raises(RuntimeError, match="exit code 3"):
        timed(("-c", "raise SystemExit(3)"), (), LINK, {})


def test_the_table_leaves_out_what_was_not_reached() -> None:
    row = {"median_s": {PAGE: 0.5, MOTION: 0.75}, "all_s": []}
    conditions = {"cores": 2, "load": 0.1, "system": "s", "device": "cpu", "python": "3", "starts": 3, "scenario": "free"}
    *_, line = printed({"conditions": conditions, "rows": {"alone": row}})
    assert line.split() == ["alone", "0.50", "0.75"]
