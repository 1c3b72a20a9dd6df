"""What every config dataclass shares: ranges, text for help and tooltips, change by key.

A config class is a frozen dataclass that derives from `Parameters`; its fields are made by
`param`, and the docstring below a field is its help text on the command line and its tooltip in
the page.
"""

import dataclasses
import functools
import inspect
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self, TypeVar

from hrc.errors import ConfigError, unknown

Tree = TypeVar("Tree", bound="Parameters")
DOCUMENTED = re.compile(r'^    (\w+): [^\n]*\n(?:     [^\n]*\n|    \)[^\n]*\n)*    """(.*?)"""', re.MULTILINE | re.DOTALL)
"""A field, on one line or more, and the docstring below it."""


def param(default: Any, *, low: float = -math.inf, high: float = math.inf, unit: str = "", live: bool = True,
          options: tuple[str, ...] = ()) -> Any:
    """A dataclass field with its closed range, unit and options.

    live: whether the value may change while the cell runs; the others need a new cell.
    """
    meta = {"low": low, "high": high, "unit": unit, "live": live, "options": options}
    return dataclasses.field(default=default, metadata=meta)


@dataclasses.dataclass(frozen=True)
class Parameters:
    """Parent of all configs: checks every value against its field's range once, at construction.

    Raises ConfigError for a value that is not finite, out of range, none of its options, or of the wrong type.
    """

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, Parameters):
                object.__setattr__(self, field.name, _checked(field, value))

    def replace(self, **changes: Any) -> Self:
        """A copy with some fields changed, checked again."""
        return dataclasses.replace(self, **changes)

    @classmethod
    def docs(cls) -> dict[str, str]:
        """The docstring below each field, by field name."""
        return _docs(cls)


def _checked(field: dataclasses.Field[Any], value: Any) -> Any:
    meta, name = field.metadata, field.name
    if options := meta.get("options"):
        if value not in options:
            raise ConfigError(unknown(name, value, options))
        return value
    if isinstance(field.default, bool):
        if not isinstance(value, bool):
            raise ConfigError(f"{name} must be true or false, not {value!r}")
        return value
    if isinstance(field.default, (int, float)):
        return _number(name, value, meta, whole=isinstance(field.default, int))
    if isinstance(field.default, tuple) and all(isinstance(x, (int, float)) for x in field.default):
        if not isinstance(value, (tuple, list)) or len(value) != len(field.default):
            raise ConfigError(f"{name} must be {len(field.default)} numbers, not {value!r}")
        return tuple(_number(name, x, meta, whole=False) for x in value)
    if not isinstance(value, type(field.default)):
        raise ConfigError(f"{name} must be a {type(field.default).__name__}, not {value!r}")
    return value


def _number(name: str, value: Any, meta: Any, *, whole: bool) -> int | float:
    kind = "a whole number" if whole else "a number"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigError(f"{name} must be {kind}, not {value!r}")
    low, high, unit = meta.get("low", -math.inf), meta.get("high", math.inf), meta.get("unit", "")
    if not math.isfinite(value) or not low <= value <= high or (whole and value != int(value)):
        raise ConfigError(f"{name} must be {kind} from {low:g} to {high:g}{' ' + unit if unit else ''}, not {value!r}")
    return int(value) if whole else float(value)


@functools.cache
def _docs(cls: type[Parameters]) -> dict[str, str]:
    """Attribute docstrings of `cls` and its parents (PEP 257 names them; the runtime drops them, so read the source)."""
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if issubclass(base, Parameters) and base is not Parameters:
            found |= _written(inspect.getfile(base)).get(base.__qualname__, {})
    return found


@functools.cache
def _written(file: str) -> dict[str, dict[str, str]]:
    """The attribute docstrings in a file, by class and field.

    Not by `ast`: up to CPython 3.12 it fails where another thread parses at the same time, as printing a traceback does.
    """
    text = Path(file).read_text(encoding="utf-8")
    classes = re.findall(r"^class (\w+).*?\n(.*?)(?=^\S|\Z)", text, re.MULTILINE | re.DOTALL)
    return {name: {field: " ".join(doc.split()) for field, doc in DOCUMENTED.findall(body)} for name, body in classes}


def keys(tree: Parameters, prefix: str = "") -> dict[str, Any]:
    """Every parameter of a tree of configs as `group.name` -> value, in order."""
    out: dict[str, Any] = {}
    for field in dataclasses.fields(tree):
        value = getattr(tree, field.name)
        if isinstance(value, Parameters):
            out |= keys(value, f"{prefix}{field.name}.")
        else:
            out[prefix + field.name] = value
    return out


def field_of(tree: Parameters, key: str) -> dataclasses.Field[Any]:
    """The field behind `group.name`. Raises ConfigError with the near names if there is none."""
    if key not in keys(tree):
        raise ConfigError(unknown("parameter", key, keys(tree)))
    *groups, name = key.split(".")
    for group in groups:
        tree = getattr(tree, group)
    return next(field for field in dataclasses.fields(tree) if field.name == name)


def replaced(tree: Tree, key: str, value: Any) -> Tree:
    """A copy of the tree with one parameter changed. Raises ConfigError for an unknown key or a bad value."""
    if key not in keys(tree):
        raise ConfigError(unknown("parameter", key, keys(tree)))
    return _replaced(tree, key, value)


def assembled(tree: Tree, values: Mapping[str, Any]) -> Tree:
    """A tree like this one with all of its values from `values`, `group.name` -> value: what `keys` gave, read back.

    Raises ConfigError for an unknown key, a missing one, or a bad value.
    """
    known = keys(tree)
    for key in values:
        if key not in known:
            raise ConfigError(unknown("parameter", key, known))
    if missing := [key for key in known if key not in values]:
        raise ConfigError(f"without a value: {', '.join(missing)}")
    return _assembled(tree, values, "")


def _assembled(tree: Tree, values: Mapping[str, Any], prefix: str) -> Tree:
    # All fields of a group at once: on the way from one valid group to another, one by one, some would not be valid.
    changes = {}
    for field in dataclasses.fields(tree):
        value, key = getattr(tree, field.name), prefix + field.name
        changes[field.name] = _assembled(value, values, f"{key}.") if isinstance(value, Parameters) else values[key]
    return dataclasses.replace(tree, **changes)


def _replaced(tree: Tree, key: str, value: Any) -> Tree:
    head, _, rest = key.partition(".")
    return dataclasses.replace(tree, **{head: _replaced(getattr(tree, head), rest, value) if rest else value})
