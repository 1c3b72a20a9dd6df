"""Where the data files are: inside the package when installed, beside it in a checkout."""

from pathlib import Path

from hrc.errors import AssetError

_HRC = Path(__file__).resolve().parent


def assets() -> Path:
    """The folder of robot, scenes and scenarios. Raises AssetError if there is none."""
    return _first(_HRC / "assets", _HRC.parent / "assets")


def static() -> Path:
    """The folder of what the browser page loads. Raises AssetError if there is none."""
    return _first(_HRC.parent / "app" / "static")


def _first(*folders: Path) -> Path:
    for folder in folders:
        if folder.is_dir():
            return folder
    places = " or ".join(str(folder) for folder in folders)
    raise AssetError(f"no data folder at {places}; install the package again, or run from a complete checkout")
