"""From what a user types to a config: a preset, a scenario's settings, a settings file and `key=value` pairs in that order."""

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

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
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"the settings file {file} cannot be read: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{file.name}: {error}") from None
    settings = list(_flat(table).items())
    try:
        _changed(Config(), settings)
    except ConfigError as error:
        raise ConfigError(f"{file.name}: {error}") from None
    return settings


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in table.items():
        out |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return out


def _changed(config: Config, settings: Sequence[tuple[str, Any]]) -> Config:
    for key, value in settings:
        try:
            config = replaced(config, key, value)
        except ConfigError as error:
            # A refused value names only the field; a refused key is in the message already.
            raise ConfigError(f"{key}: {error}" if key in keys(config) else str(error)) from None
    return config


def configured(preset: str = "default", scenario: Scenario | None = None, settings: Sequence[str] = (),
               seed: int | None = None, file: Path | None = None) -> Config:
    """The config of a run. Raises ConfigError for an unknown preset, key or a bad value."""
    if preset not in PRESETS:
        raise ConfigError(unknown("preset", preset, PRESETS))
    config = PRESETS[preset]()
    if scenario is not None:
        config = scenario.configured(config)
    config = _changed(config, [*(read(file) if file else ()), *map(parse, settings)])
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
