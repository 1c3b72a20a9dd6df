"""Scenario files: a title, a duration, parameters, and events at their times; TOML, for people to copy and change."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hrc import toml_file
from hrc.config import Config
from hrc.errors import ConfigError, EventError, ScenarioError, unknown
from hrc.events import Event, Reset, from_dict
from hrc.parameters import replaced

LONGEST = 1e6
"""No scenario lasts longer [s]."""


@dataclass(frozen=True)
class Scenario:
    """What happens in a run. duration [s]; settings: parameters by key; events: (time [s], event), in order."""

    name: str
    title: str
    description: str
    duration: float
    settings: dict[str, Any]
    events: tuple[tuple[float, Event], ...]

    def configured(self, config: Config) -> Config:
        """The config with this scenario's settings. Raises ScenarioError for one that cannot be."""
        for key, value in self.settings.items():
            try:
                config = replaced(config, key, value)
            except ConfigError as error:
                raise ScenarioError(f"scenario {self.name}: {error}") from None
        return config


def names() -> list[str]:
    """The scenarios that come with the project."""
    return toml_file.names("scenarios")


def load(name_or_path: str | Path) -> Scenario:
    """A scenario by its name, or by the path of its file. Raises ScenarioError with the line and the reason."""
    path = toml_file.find(name_or_path, "scenarios", "scenario", ScenarioError)
    text = toml_file.text(path, "scenario", ScenarioError)
    return _scenario(path.stem, path.name, text, toml_file.table(text, "scenario", path.name, ScenarioError))


def _scenario(name: str, file: str, text: str, table: dict[str, Any]) -> Scenario:
    known = ("title", "description", "duration", "set", "event")
    for key in table:
        if key not in known:
            raise ScenarioError(f"{file}, line {_line(text, key)}: {unknown('entry', key, known)}")
    duration = table.get("duration")
    if isinstance(duration, bool) or not isinstance(duration, (int, float)) or not 0 < duration < LONGEST:
        given = "missing" if duration is None else repr(duration)
        raise ScenarioError(f"{file}, line {_line(text, 'duration')}: duration must be seconds above 0, not {given}")
    settings, listed = table.get("set", {}), table.get("event", [])
    if not isinstance(settings, dict) or not isinstance(listed, list) or not all(isinstance(e, dict) for e in listed):
        raise ScenarioError(f'{file}: "set" must be a table of parameters, and events are written as [[event]]')
    scenario = Scenario(name, str(table.get("title", name)), str(table.get("description", "")), float(duration),
                        _flat(settings), _events(file, text, listed, float(duration)))
    scenario.configured(Config())
    return scenario


def _flat(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """`control.f_abort = 30`, quoted or not, and a table [set.control] are the same."""
    out: dict[str, Any] = {}
    for key, value in table.items():
        out |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return out


def _events(file: str, text: str, listed: list[dict[str, Any]], duration: float) -> tuple[tuple[float, Event], ...]:
    lines = [i for i, line in enumerate(text.splitlines(), 1) if re.match(r"\s*\[\[\s*event\s*\]\]", line)]
    events: list[tuple[float, Event]] = []
    for index, entry in enumerate(listed):
        where = f"{file}, line {lines[index]}" if index < len(lines) else f"{file}, event {index + 1}"
        values = dict(entry)
        time = values.pop("t", None)
        if isinstance(time, bool) or not isinstance(time, (int, float)) or not 0 <= time <= duration:
            raise ScenarioError(f"{where}: an event needs its time t in seconds, from 0 to the duration, {duration:g}; "
                                f"it has {'none' if time is None else repr(time)}")
        try:
            event = from_dict(values)
        except EventError as error:
            raise ScenarioError(f"{where}: {error}") from None
        if isinstance(event, Reset):
            raise ScenarioError(f"{where}: a scenario cannot reset itself: it would never end")
        events.append((float(time), event))
    return tuple(sorted(events, key=lambda e: e[0]))


def _line(text: str, key: str) -> int:
    """The line where a top-level key stands, 1 if it is missing."""
    pattern = re.compile(rf"\s*\[*\s*{re.escape(key)}\b")
    return next((i for i, line in enumerate(text.splitlines(), 1) if pattern.match(line)), 1)
