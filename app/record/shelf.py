"""The recordings that there are, each in a folder of its own: listed, mended, packed, deleted."""

import contextlib
import json
import shutil
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, cast

from app import output
from app.record.folder import METRICS, SESSION, files
from app.record.recover import mend
from hrc.errors import HrcError, unknown

MOST_BYTES = 1_000_000_000
"""Size of the largest download."""


class ArchiveError(HrcError):
    """There is no such recording, or none can be made."""


@dataclass(frozen=True)
class Progress:
    """Of the recording that is being made: simulated length so far [s], size [bytes], and depth images that it had to drop."""

    folder: Path
    seconds: float = 0.0
    bytes: int = 0
    images_dropped: int = 0


class Shelf:
    """A folder of recordings. root: made with the first of them."""

    def __init__(self, root: Path) -> None:
        self.root = root

    @property
    def now(self) -> Progress | None:
        """The recording that is being made, which is not among the others yet."""
        return None

    def names(self) -> list[str]:
        """All recordings but the one that is being made, the newest first."""
        now = self.now.folder.name if self.now is not None else ""
        if not self.root.is_dir():
            return []
        folders = [path for path in self.root.iterdir() if path.name != now and not path.is_symlink() and files(path)]
        return [path.name for path in sorted(folders, key=lambda path: (path / SESSION).stat().st_mtime, reverse=True)]

    def folder(self, name: str) -> Path:
        """The folder of one of them. Raises ArchiveError for anything else: a name is no path."""
        if name not in self.names():
            raise ArchiveError(unknown("recording", name, self.names()))
        return self.root / name

    def mend(self, name: str) -> list[str]:
        """Put in order what a killed process has left of a recording; what was done, in words."""
        done: list[str] = []
        mend(self.folder(name), done.append)
        return done

    def size(self, name: str) -> int:
        """Bytes of all files of a recording."""
        return sum(path.stat().st_size for path in self.folder(name).iterdir())

    def seconds(self, name: str) -> float | None:
        """Simulated length of a recording [s]; None for one that was cut off."""
        try:
            return float(json.loads((self.folder(name) / METRICS).read_text())["simulated_s"])
        except (OSError, ValueError, KeyError):
            return None

    def delete(self, name: str) -> None:
        """Remove a recording from the disk. Raises OutputError while another process makes it."""
        with output.claimed(self.folder(name)):
            shutil.rmtree(self.root / name)

    def packed(self, name: str) -> tuple[BinaryIO, int]:
        """A recording as a zip file that goes when it is closed, at its beginning, and its size [bytes].

        Raises ArchiveError for one that is too large.
        """
        folder = self.folder(name)
        if self.size(name) > MOST_BYTES:
            raise ArchiveError(f"{name} has more than {MOST_BYTES / 1e9:g} GB; take it from {self.root.name}/ on the server")
        with contextlib.ExitStack() as unless:
            packed = cast(BinaryIO, unless.enter_context(tempfile.TemporaryFile(dir=self.root)))
            with zipfile.ZipFile(packed, "w") as zipped:
                for path in sorted(folder.iterdir()):
                    zipped.write(path, f"{name}/{path.name}")
            size = packed.tell()
            packed.seek(0)
            unless.pop_all()
        return packed, size
