"""From what a user types to a config: a preset, a scenario's settings, a settings file and `key=value` pairs in that order."""

import json
import math
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hrc import toml_file
from hrc.cell.scenario import Scenario
from hrc.config import PRESETS, Config
from hrc.errors import ConfigError, unknown
from hrc.parameters import field_of, keys, replaced

_WORD = re.compile(r"[A-Za-z_][\w.-]*")


def parse(setting: str) -> tuple[str, Any]:
    """Key and value of `key=value`; the value is TOML, and a bare word is a string. Raises ConfigError."""
    key, equals, text = (part.strip() for part in setting.partition("="))
    if not key or not equals or not text:
        raise ConfigError(f'malformed setting "{setting}"; write key=value, as in control.f_abort=30')
    try:
        table = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        table = {}
    if list(table) == ["value"]:
        return key, table["value"]
    if _WORD.fullmatch(text):
        return key, text
    raise ConfigError(f'malformed value in "{setting}"; a value is a number, true, false, "text" or [a, b, c]')


def read(file: Path) -> list[tuple[str, Any]]:
    """Keys and values of a settings file: TOML, `control.f_abort = 30` or a table [control].

    Raises ConfigError, with the file, for one that cannot be read, an unknown key or a bad value.
    """
    settings = list(flat(toml_file.read(file, "settings", ConfigError)).items())
    try:
        changed(Config(), settings)
    except ConfigError as error:
        raise ConfigError(f"{file.name}: {error}") from None
    return settings


def written(config: Config) -> str:
    """A settings file with whatever differs from the defaults, for `read` and `--settings`."""
    plain = keys(Config())
    lines = [f"{key} = {_toml(value)}" for key, value in keys(config).items() if value != plain[key]]
    return "\n".join(["# Parameters that differ from the defaults of Elbowroom.", *lines, ""])


@dataclass(frozen=True)
class Found:
    """What a settings file means for a cell that runs. changes: those that it can take now, in an order in which each is
    valid when its turn comes. trouble: a line for each entry that it cannot."""

    changes: tuple[tuple[str, Any], ...]
    trouble: tuple[str, ...]


def sift(text: str, config: Config) -> Found:
    """Tell the entries of a settings file apart. Raises ConfigError if it is no TOML."""
    try:
        table = flat(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(str(error)) from None
    present, trouble, wanted = keys(config), [], {}
    for key, value in table.items():
        if key not in present:
            trouble.append(unknown("parameter", key, present))
        elif _same(value, present[key]):
            continue
        elif not field_of(config, key).metadata["live"]:
            trouble.append(f"{key} = {_shown(value)} needs a new start, with --settings")
        else:
            wanted[key] = value
    changes, refused = ordered(config, wanted)
    return Found(changes, (*trouble, *refused))


def ordered(config: Config, wanted: Mapping[str, Any]) -> tuple[tuple[tuple[str, Any], ...], tuple[str, ...]]:
    """Changes one by one, each valid after those before it (a threshold may have to wait for another), and why others are
    not."""
    done: list[tuple[str, Any]] = []
    left, refused = dict(wanted), dict[str, str]()
    while True:
        before = len(left)
        for key, value in list(left.items()):
            try:
                config = replaced(config, key, value)
            except ConfigError as error:
                # A refused value names only the field; a refused key is in the message already.
                refused[key] = f"{key}: {error}" if key in keys(config) else str(error)
            else:
                done.append((key, left.pop(key)))
        if len(left) == before:
            return tuple(done), tuple(refused[key] for key in left)


def _same(value: Any, present: Any) -> bool:
    return value == (list(present) if isinstance(present, tuple) else present)


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value) if isinstance(value, str) else repr(value)  # a TOML string takes all escapes of a JSON one


def flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """A table by dotted keys: `control.f_abort = 30`, quoted or not, and a table [control] are the same."""
    out: dict[str, Any] = {}
    for key, value in table.items():
        out |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return out


def changed(config: Config, settings: Iterable[tuple[str, Any]]) -> Config:
    """The config with these values, whatever their order; of two for a key the later. Raises ConfigError that names all
    that cannot be."""
    done, refused = ordered(config, dict(settings))
    if refused:
        raise ConfigError("; ".join(refused))
    for key, value in done:
        config = replaced(config, key, value)
    return config


def configured(preset: str = "default", scenario: Scenario | None = None, settings: Sequence[str] = (),
               seed: int | None = None, file: Path | None = None) -> Config:
    """The config of a run. Raises ConfigError for an unknown preset, key or a bad value."""
    if preset not in PRESETS:
        raise ConfigError(unknown("preset", preset, PRESETS))
    config = PRESETS[preset]()
    if scenario is not None:
        config = scenario.configured(config)
    config = changed(config, [*(read(file) if file else ()), *map(parse, settings)])
    return config if seed is None else replaced(config, "seed", seed)


def table(config: Config) -> str:
    """Every parameter of a config as aligned lines: key, value, range and unit, meaning."""
    lines = []
    for key, value in keys(config).items():
        field = field_of(config, key)
        lines.append((key, _shown(value), _range(field.metadata), _meaning(config, key)))
    widths = [max(len(line[i]) for line in lines) for i in range(3)]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(line, [*widths, 0], strict=True)).rstrip()
                     for line in lines)


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_shown(x) for x in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _range(meta: Mapping[str, Any]) -> str:
    if meta["options"]:
        return " | ".join(meta["options"])
    low, high = meta["low"], meta["high"]
    bounds = f"{low:.10g} to {high:.10g}" if math.isfinite(low) or math.isfinite(high) else ""
    return f"{bounds} {meta['unit']}".strip()


def _meaning(config: Config, key: str) -> str:
    owner: Any = config
    *groups, name = key.split(".")
    for group in groups:
        owner = getattr(owner, group)
    return owner.docs().get(name, "")
