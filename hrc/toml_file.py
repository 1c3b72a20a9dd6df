"""TOML files, by the name under which they come with the project or by path; what is wrong with one is an error of its kind."""

import tomllib
from pathlib import Path
from typing import Any

from hrc.errors import HrcError, unknown
from hrc.paths import assets


def names(folder: str) -> list[str]:
    """What comes with the project in a folder of its assets."""
    return sorted(path.stem for path in (assets() / folder).glob("*.toml"))


def find(name_or_path: str | Path, folder: str, what: str, error: type[HrcError]) -> Path:
    """The path of a file. Raises `error`, with names like it, for one that is neither a name of the folder nor a path."""
    path = Path(name_or_path)
    if path.suffix == ".toml":
        return path
    if str(name_or_path) not in names(folder):
        raise error(unknown(what, str(name_or_path), names(folder)) + " (a path must end in .toml)")
    return assets() / folder / f"{name_or_path}.toml"


def text(path: Path, what: str, error: type[HrcError]) -> str:
    """What stands in the file. Raises `error` if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as reason:
        raise error(f"the {what} file {path} cannot be read: {reason}") from None


def table(text: str, what: str, name: str, error: type[HrcError]) -> dict[str, Any]:
    """Text as a table. Raises `error`, with file and line, for one that is no TOML."""
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as reason:
        raise error(f"the {what} file {name} is malformed: {reason}") from None


def read(path: Path, what: str, error: type[HrcError]) -> dict[str, Any]:
    """The file as a table. Raises `error` if it cannot be read, or is no TOML."""
    return table(text(path, what, error), what, path.name, error)
