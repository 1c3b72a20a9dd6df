"""The tables of a campaign: means, shares and their differences, and the intervals of them."""

from pathlib import Path

import numpy as np
import pytest
from small_campaign import row

from app.campaign import summary
from app.campaign.plan import load


def test_means_and_intervals_are_those_of_the_values(short: Path) -> None:
    campaign, rng = load(short, 40), np.random.default_rng(0)
    values = rng.normal(3.0, 1.0, 80)
    records = [row(i, missed=i % 8 == 0, force_error_N=float(values[i])) for i in range(80)]
    records[5] = {"index": 5, "episode": 2, "plant.friction_left": 0.3, "error": "HrcError: no"}
    table = summary.rows(campaign, records)
    assert [(r["plant.friction_left"], r["metric"]) for r in table] == [
        (0.0, "missed"), (0.0, "force_error_N"), (0.3, "missed"), (0.3, "force_error_N")]
    assert [(r["n"], r["failed"]) for r in table] == [(40, 0), (40, 0), (39, 1), (39, 1)]
    assert table[0]["mean"] == 0.25
    assert 0.12 < table[0]["low"] < 0.25 < table[0]["high"] < 0.41
    assert table[1]["mean"] == pytest.approx(values[::2].mean())
    assert table[1]["high"] - table[1]["mean"] == pytest.approx(2.0227 * values[::2].std(ddof=1) / np.sqrt(40), rel=1e-4)
    assert table[1]["p95"] == pytest.approx(np.percentile(values[::2], 95))
    assert table[1]["difference_n"] == 0
    pairs = np.delete(values[1::2] - values[::2], 2)
    assert (table[3]["difference_n"], table[3]["difference_mean"]) == (39, pytest.approx(pairs.mean()))
    assert table[3]["difference_low"] == pytest.approx(pairs.mean() - 2.0244 * pairs.std(ddof=1) / np.sqrt(39), rel=1e-4)


def test_an_interval_holds_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(4)
    held = [low <= 0.0 <= high for low, high in
            ((d["low"], d["high"]) for d in (summary.described(list(rng.normal(size=12))) for _ in range(2000)))]
    assert np.mean(held) == pytest.approx(0.95, abs=0.015)
    held = [d["low"] <= 0.1 <= d["high"] for d in
            (summary.described(list(rng.random(40) < 0.1), summary.wilson) for _ in range(2000))]
    assert np.mean(held) > 0.93
    none = summary.described([False] * 20, summary.wilson)
    assert none["low"] == 0.0
    assert none["high"] > 0.1


def test_a_difference_of_shares_is_not_sure_where_all_pairs_agree(short: Path) -> None:
    campaign = load(short, 30)
    records = [row(i, missed=i % 6 < 2, force_error_N=1.0) for i in range(60)]
    missed = next(r for r in summary.rows(campaign, records) if r["metric"] == "missed" and r["difference_n"])
    assert (missed["difference_n"], missed["difference_mean"]) == (30, 0.0)
    assert -0.2 < missed["difference_low"] < 0.0 < missed["difference_high"] < 0.2


def test_an_interval_of_a_difference_of_shares_holds_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    pairs = rng.choice([-1, 0, 1], p=[0.05, 0.8, 0.15], size=(2000, 60))
    found = [summary.described(list(values), summary.agresti_min) for values in pairs]
    assert 0.93 < np.mean([d["low"] <= 0.1 <= d["high"] for d in found]) < 0.98
