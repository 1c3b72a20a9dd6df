"""Rates neither drift nor bunch; a delayed value is the newest whose time has come."""

from itertools import pairwise

import pytest

from hrc.cell.clock import Delayed, Rate, RatesConfig
from hrc.errors import ConfigError


@pytest.mark.parametrize("hz", [1, 30, 170, 200, 333, 1000])
def test_a_rate_is_exact_over_a_second_and_even_within(hz):
    rate = Rate(hz, 1000)
    due = [tick for tick in range(10_000) if rate.due(tick)]
    assert len(due) == 10 * hz
    gaps = {b - a for a, b in pairwise(due)}
    assert max(gaps) - min(gaps) <= 1


def test_a_value_is_readable_after_its_delay_and_the_newest_wins():
    delayed: Delayed[str] = Delayed(3)
    delayed.put(0, "a")
    delayed.put(1, "b")
    assert [delayed.get(t) for t in (2, 3, 4, 9)] == [None, "a", "b", "b"]


def test_a_control_rate_that_does_not_divide_the_base_is_refused():
    with pytest.raises(ConfigError, match="must divide"):
        RatesConfig(control_hz=300)
