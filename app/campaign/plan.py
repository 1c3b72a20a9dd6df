"""Campaign files: what is swept, what is drawn at random, what happens; TOML, for people to copy and change."""

import hashlib
import itertools
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app.campaign.episode import Episode
from app.campaign.metrics import METRICS
from app.campaign.trial import Trial
from app.settings import flat, ordered
from hrc import toml_file
from hrc.cell import scenario
from hrc.config import PRESETS
from hrc.errors import ConfigError, HrcError, unknown
from hrc.parameters import field_of, keys, replaced

FOLDER = "campaigns"
ENTRIES = ("title", "description", "preset", "scenario", "episodes", "seed", "worst", "metrics", "set", "sweep", "random")
MOST = 10_000_000
"""No campaign has more episodes."""
MOST_TRIED = 5_000
"""Of more combinations of ends of what is drawn, at all points, each end is tried alone."""


class CampaignError(HrcError):
    """A campaign cannot be: its file is missing or malformed, or asks for what there is not."""


@dataclass(frozen=True)
class Draw:
    """A parameter drawn anew in each episode: uniformly between two numbers, or one of several values."""

    low: float = 0.0
    high: float = 0.0
    of: tuple[Any, ...] = ()

    def value(self, rng: np.random.Generator, *, whole: bool) -> Any:
        """The next value."""
        if self.of:
            return self.of[int(rng.integers(len(self.of)))]
        if whole:
            return int(rng.integers(int(self.low), int(self.high) + 1))
        return float(rng.uniform(self.low, self.high))

    @property
    def ends(self) -> tuple[Any, ...]:
        """Values that must be possible."""
        return self.of or (self.low, self.high)


@dataclass(frozen=True)
class Campaign:
    """episodes: at each point of the sweep. sweep: values by parameter; every combination is a point. worst: the metric that
    `--record` ranks by."""

    name: str
    title: str
    description: str
    episodes: int
    seed: int
    base: Trial
    sweep: Mapping[str, tuple[Any, ...]]
    random: Mapping[str, Draw]
    worst: str
    metrics: tuple[str, ...]
    script: scenario.Scenario | None = None

    @property
    def points(self) -> tuple[dict[str, Any], ...]:
        """The grid."""
        return tuple(dict(zip(self.sweep, values, strict=True)) for values in itertools.product(*self.sweep.values()))

    @property
    def total(self) -> int:
        """Episodes in all."""
        return self.episodes * math.prod(map(len, self.sweep.values()))

    def chosen(self, wanted: Callable[[int], bool]) -> Iterator[Episode]:
        """The episodes whose index is wanted.

        Number k is the same at every point of the sweep but for what is swept, so that differences are paired. The index goes
        through the points first: it stays what it is when there are to be more episodes.
        """
        points = [(point, _changed(self.base, point)) for point in self.points]
        for k in range(self.episodes):
            seed = (self.seed, k)
            rng = np.random.default_rng(seed)
            own, drawn = int(rng.integers(2**31)), {}
            for key, draw in self.random.items():
                drawn[key] = draw.value(rng, whole=isinstance(field_of(self.base, key).default, int))
            for index, (point, trial) in enumerate(points, k * len(points)):
                if wanted(index):
                    trial = replaced(_changed(trial, drawn), "seed", own)
                    yield Episode(index, seed, trial, {"episode": k, **point, **drawn}, self.script)

    def identity(self) -> dict[str, Any]:
        """Everything that a record depends on besides versions, ready for JSON. How many episodes there are does not matter to
        any of them; the order of what is swept and drawn does: it numbers the points, and deals out the random numbers.
        """
        script = None if self.script is None else {
            "duration": self.script.duration, "events": [[t, repr(event)] for t, event in self.script.events]}
        return json.loads(json.dumps({
            "seed": self.seed, "parameters": {key: v for key, v in keys(self.base).items() if key != "seed"},
            "sweep": list(self.sweep.items()), "scenario": script, "files": self._files(),
            "random": [[key, list(d.of) or {"low": d.low, "high": d.high}] for key, d in self.random.items()]}))

    def _files(self) -> dict[str, str]:
        """Digests of one's own files that the cell reads; those of the project belong to its version."""
        drawn = self.random["task.waypoints"].of if "task.waypoints" in self.random else ()
        names = (self.base.scene, self.base.task.waypoints, *self.sweep.get("task.waypoints", ()), *drawn)
        paths = [Path(name) for name in names if name]
        return {str(path): hashlib.sha256(path.read_bytes()).hexdigest()[:12] for path in paths if path.is_file()}


def names() -> list[str]:
    """The campaigns that come with the project."""
    return toml_file.names(FOLDER)


def load(name_or_path: str | Path, episodes: int | None = None) -> Campaign:
    """A campaign by its name, or by the path of its file; `campaigns/NAME.toml` is one by name where there is no such file.

    episodes: instead of those of the file. Raises HrcError for whatever could not be run.
    """
    path = Path(name_or_path)
    if path.suffix == ".toml" and path.parent == Path(FOLDER) and path.stem in names() and not path.exists():
        name_or_path = path.stem
    path = toml_file.find(name_or_path, FOLDER, "campaign", CampaignError)
    table = toml_file.read(path, "campaign", CampaignError)
    try:
        return _campaign(path.stem, table, episodes)
    except HrcError as error:
        raise CampaignError(f"{path.name}: {error}") from None


def _campaign(name: str, table: Mapping[str, Any], episodes: int | None) -> Campaign:
    for key in table:
        if key not in ENTRIES:
            raise CampaignError(unknown("entry", key, ENTRIES))
    settings, sweep, random = (_table(table, key) for key in ("set", "sweep", "random"))
    base, script = _base(table, settings)
    for key in (*sweep, *random):
        field_of(base, key)
    metrics, worst = table.get("metrics", list(METRICS)), _text(table, "worst", "force_error_N")
    if not isinstance(metrics, list) or not metrics:
        raise CampaignError(f"metrics must be a list of names, with at least one, not {metrics!r}")
    for metric in (*metrics, worst):
        if metric not in METRICS:
            raise CampaignError(unknown("metric", metric, METRICS))
    campaign = Campaign(
        name, str(table.get("title", name)), " ".join(str(table.get("description", "")).split()),
        _whole("episodes", table.get("episodes", 100) if episodes is None else episodes, 1, MOST),
        _whole("seed", table.get("seed", 0), 0, 2**31 - 1), base,
        {key: _values(key, values) for key, values in sweep.items()},
        {key: _draw(key, value) for key, value in random.items()}, worst, tuple(metrics), script)
    _check(campaign)
    return campaign


def _base(table: Mapping[str, Any], settings: Mapping[str, Any]) -> tuple[Trial, scenario.Scenario | None]:
    preset = _text(table, "preset", "default")
    if preset not in PRESETS:
        raise CampaignError(unknown("preset", preset, PRESETS))
    base, script = Trial.of(PRESETS[preset]()), None
    if "scenario" in table:
        script = scenario.load(_text(table, "scenario", ""))
        base = Trial.of(script.configured(base.config))
    return _changed(base, settings), script


def _check(campaign: Campaign) -> None:
    """Try every point, with every end of what is drawn: what cannot be is said before anything runs."""
    if campaign.total > MOST:
        raise CampaignError(f"{campaign.total} episodes; at most {MOST} can be")
    swept = [*campaign.sweep, *campaign.random]
    if both := [key for key in campaign.sweep if key in campaign.random]:
        raise CampaignError(f"{both[0]} is both swept and drawn: each episode can have one value only")
    if campaign.script is not None and (own := [key for key in swept if key.startswith("situation.")]):
        raise CampaignError(f"{own[0]} has no effect where a scenario says what happens")
    for key in ("seed", "scene"):
        if key in swept:
            raise CampaignError(f"{key} cannot be swept or drawn" + (": every episode has its own" if key == "seed" else ""))
    together = [dict(zip(campaign.random, values, strict=True))
                for values in itertools.product(*(draw.ends for draw in campaign.random.values()))]
    if len(together) * len(campaign.points) > MOST_TRIED:
        together = [{key: value} for key, draw in campaign.random.items() for value in draw.ends]
    for point in campaign.points:
        trial = _changed(campaign.base, point)
        for drawn in together:
            _changed(trial, drawn)


def _changed(trial: Trial, changes: Mapping[str, Any]) -> Trial:
    """With these parameters, in an order in which each is valid. Raises ConfigError if there is none."""
    for key in changes:
        field_of(trial, key)
    done, refused = ordered(trial, changes)
    if refused:
        raise ConfigError("; ".join(refused))
    for key, value in done:
        trial = replaced(trial, key, value)
    return trial


def _table(table: Mapping[str, Any], key: str) -> dict[str, Any]:
    found = table.get(key, {})
    if not isinstance(found, dict):
        raise CampaignError(f'"{key}" must be a table, [{key}]')
    return _drawn(flat(found)) if key == "random" else flat(found)


def _drawn(table: Mapping[str, Any]) -> dict[str, Any]:
    """Keys without the last part, which is low, high or of."""
    out: dict[str, dict[str, Any]] = {}
    for key, value in table.items():
        name, _, end = key.rpartition(".")
        if end not in ("low", "high", "of"):
            raise CampaignError(f"{key} is drawn from {{low = a, high = b}} or {{of = [a, b, c]}}, not from {value!r}")
        out.setdefault(name, {})[end] = value
    return out


def _values(key: str, values: Any) -> tuple[Any, ...]:
    if not isinstance(values, list):
        raise CampaignError(f"{key} is swept over a list of values, not {values!r}")
    if not values:
        raise CampaignError(f"the sweep over {key} has no values, so there is nothing to run")
    if any(value in values[:i] for i, value in enumerate(values)):
        raise CampaignError(f"the sweep over {key} has a value twice: {values}")
    return tuple(tuple(value) if isinstance(value, list) else value for value in values)


def _draw(key: str, value: Any) -> Draw:
    if isinstance(value, dict) and list(value) == ["of"] and isinstance(value["of"], list) and value["of"]:
        return Draw(of=tuple(tuple(v) if isinstance(v, list) else v for v in value["of"]))
    if isinstance(value, dict) and set(value) == {"low", "high"} and all(
            isinstance(v, (int, float)) and not isinstance(v, bool) for v in value.values()) and value["low"] <= value["high"]:
        return Draw(value["low"], value["high"])
    raise CampaignError(f"{key} is drawn from {{low = a, high = b}} or {{of = [a, b, c]}}, not from {value!r}")


def _text(table: Mapping[str, Any], name: str, default: str) -> str:
    if not isinstance(value := table.get(name, default), str):
        raise CampaignError(f"{name} must be a name, not {value!r}")
    return value


def _whole(name: str, value: Any, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise CampaignError(f"{name} must be a whole number from {low} to {high}, not {value!r}")
    return value
