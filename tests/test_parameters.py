"""Configs refuse what cannot be and say what would have been right."""

import math
from dataclasses import dataclass, field

import pytest

from hrc.errors import ConfigError
from hrc.parameters import Parameters, field_of, keys, param, replaced


@dataclass(frozen=True)
class Inner(Parameters):
    gain: float = param(5.0, low=0.0, high=10.0, unit="1/s")
    """How strong
    it is."""
    count: int = param(3, low=1, high=9, live=False)
    triple: tuple[float, ...] = param((1.0, 2.0, 3.0), low=0.0, high=4.0)
    kind: str = param("round", options=("round", "square"))
    on: bool = param(True)


@dataclass(frozen=True)
class Outer(Parameters):
    inner: Inner = field(default_factory=Inner)
    size: float = param(1.0, low=0.0)


def test_keys_list_the_tree_in_order():
    assert list(keys(Outer())) == ["inner.gain", "inner.count", "inner.triple", "inner.kind", "inner.on", "size"]


def test_a_change_by_key_leaves_the_rest():
    before = Outer()
    after = replaced(before, "inner.gain", 7)
    assert after.inner.gain == 7.0
    assert {k: v for k, v in keys(after).items() if k != "inner.gain"} == \
        {k: v for k, v in keys(before).items() if k != "inner.gain"}


@pytest.mark.parametrize(("key", "value", "says"), [
    ("inner.gain", 11.0, "from 0 to 10 1/s"),
    ("inner.gain", math.nan, "not nan"),
    ("inner.gain", "5", "must be a number"),
    ("inner.gain", True, "must be a number"),
    ("inner.count", 2.5, "a whole number"),
    ("inner.triple", (1.0, 2.0), "must be 3 numbers"),
    ("inner.triple", (1.0, 2.0, math.inf), "from 0 to 4"),
    ("inner.kind", "squre", "did you mean square"),
    ("inner.on", 1, "true or false"),
    ("inner.gian", 1.0, "did you mean inner.gain"),
    ("nothing.like.it", 1.0, "unknown parameter"),
    ("inner", 1.0, "unknown parameter"),
])
def test_a_bad_change_says_what_would_have_been_right(key, value, says):
    with pytest.raises(ConfigError, match=says):
        replaced(Outer(), key, value)


def test_the_docstring_of_a_field_is_its_help():
    assert Inner.docs()["gain"] == "How strong it is."
    assert field_of(Outer(), "inner.count").metadata["live"] is False
