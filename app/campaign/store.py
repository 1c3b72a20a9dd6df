"""The records of a campaign in its folder: one line each, appended as they come; what is there need not be run again."""

import fcntl
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import Any

from app.campaign.plan import Campaign, CampaignError
from app.campaign.versions import differences, versions
from app.output import OutputError

MARK, RECORDS, PARTIAL = "campaign.json", "records.jsonl", ".campaign.json"
Record = dict[str, Any]


class Store:
    """Open while a campaign runs; see `opened`."""

    def __init__(self, folder: Path, file: FileIO) -> None:
        """file: of the records, open to read and append, unbuffered: what is written is written."""
        self.folder, self._file = folder, file
        self.records: dict[int, Record] = {}
        self._read()

    def add(self, record: Record) -> None:
        """Append a record. Raises OutputError if there is no room; what was there before is whole."""
        line = json.dumps(record, allow_nan=False).encode() + b"\n"
        try:
            while line:
                line = line[self._file.write(line):]
        except OSError as error:
            raise OutputError(f"cannot write {self.folder / RECORDS}: {error.strerror}; the {len(self.records)} records so far "
                              "are kept, and the same command goes on from there") from None
        self.records[record["index"]] = record

    def _read(self) -> None:
        """Take what is there; a line that was not written to its end, by a process that was killed, is cut off."""
        self._file.seek(0)
        data = self._file.readall()
        whole = data.rfind(b"\n") + 1
        self._file.truncate(whole)
        for number, line in enumerate(data[:whole].splitlines(), 1):
            try:
                record = json.loads(line)
                self.records[record["index"]] = record
            except (ValueError, KeyError, TypeError):
                raise CampaignError(f"{self.folder / RECORDS}, line {number}, is no record; remove the line, or begin anew "
                                    "with --overwrite") from None


@contextmanager
def opened(folder: Path, campaign: Campaign, *, overwrite: bool = False) -> Iterator[Store]:
    """The store of a campaign in this folder, made if it does not exist.

    Raises CampaignError for a folder with the records of another campaign or of other versions, or one that somebody writes to;
    OutputError for one that is something else or cannot be written. overwrite: begin anew there.
    """
    identity = {"campaign": campaign.identity(), "versions": versions()}
    _check(folder)
    with _claimed(folder) as file:  # from here on nobody else changes what is there
        if (folder / MARK).exists() and not overwrite:
            _compare(folder, identity)
        else:
            _begin(folder, file, {"name": campaign.name, **identity})
        yield Store(folder, file)


@contextmanager
def _claimed(folder: Path) -> Iterator[FileIO]:
    """The file of the records, which is this process's alone."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / RECORDS).open("a+b", buffering=0)
    except OSError as error:
        raise OutputError(f"cannot write the folder {folder}: {error.strerror}") from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise CampaignError(f"another process is writing to {folder}") from None
        yield file


def _begin(folder: Path, file: FileIO, mark: dict[str, Any]) -> None:
    """Empty the file of the records, remove all else, and say what they will be of. Wherever it ends, it can begin again: the
    mark of the campaign before stays until there is another."""
    partial = folder / PARTIAL
    try:
        for path in folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            elif path.name not in (RECORDS, MARK):
                path.unlink()
        file.truncate(0)
        partial.write_text(json.dumps(mark, indent=1) + "\n", encoding="utf-8")
        os.replace(partial, folder / MARK)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OutputError(f"cannot write the folder {folder}: {error.strerror}") from None


def _check(folder: Path) -> None:
    """Raises OutputError for what may not be written to."""
    if not folder.name or folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise OutputError(f"{folder} cannot be the folder of a campaign; name one that does not exist")
    there = {path.name: path for path in folder.iterdir()} if folder.exists() else {}
    if there.keys() <= {RECORDS, PARTIAL} and not (RECORDS in there and there[RECORDS].stat().st_size):
        return  # no more than that leaves one who was killed at the start
    if not (folder / MARK).is_file():
        raise OutputError(f"{folder} is not the folder of a campaign (no {MARK} in it), so nothing is written to it")


def _compare(folder: Path, identity: dict[str, Any]) -> None:
    """Raises CampaignError if the records are of another campaign, or of other versions."""
    try:
        found = json.loads((folder / MARK).read_text(encoding="utf-8"))
        other, made_by = found["campaign"], found["versions"]
    except (OSError, ValueError, KeyError, TypeError):
        raise CampaignError(f"{folder / MARK} cannot be read; begin anew with --overwrite") from None
    what = [part for part in identity["campaign"] if identity["campaign"][part] != other.get(part)]
    if what:
        raise CampaignError(f"{folder} holds the records of another campaign ({', '.join(what)} differ); choose another "
                            "folder, or begin anew with --overwrite")
    if changed := differences(identity["versions"], made_by):
        raise CampaignError(f"the records in {folder} were made by {changed}; choose another folder, or begin anew with "
                            "--overwrite")
