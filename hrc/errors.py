"""The errors of the library: every message says what would have been right."""

from collections.abc import Iterable
from difflib import get_close_matches


class HrcError(Exception):
    """The parent of every error that leaves `hrc`."""


class ConfigError(HrcError):
    """A parameter does not exist, or its value is out of range."""


class ScenarioError(HrcError):
    """A scenario file is missing or malformed."""


class EventError(HrcError):
    """An event names something that does not exist, or carries a value that cannot be."""


class AssetError(HrcError):
    """A file the library needs is missing or unreadable."""


class DeviceError(HrcError):
    """The compute device asked for is not available."""


class SensorError(HrcError):
    """A sensor delivered something that is no measurement (NaN, a wrong shape)."""


def unknown(kind: str, name: object, choices: Iterable[str]) -> str:
    """The message for a name that is none of `choices`: near names first, else all of them."""
    known = list(choices)
    near = get_close_matches(str(name), known, n=3, cutoff=0.5)
    if near:
        return f'unknown {kind} "{name}"; did you mean {" or ".join(near)}?'
    return f'unknown {kind} "{name}"; there are: {", ".join(known)}'
