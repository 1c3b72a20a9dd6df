"""A recording whose writer was killed may end in the middle of a message; then no reader opens any of it. This cuts that off.

The format: 12 bytes that begin with RRF2, then messages, each with a header of two little-endian u64, kind and length of the
payload. The message of kind 0 holds the footer and ends the stream; a trailer of 32 bytes says where it is.
"""

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from hrc.errors import HrcError

_MAGIC, _HEADER, _MESSAGE = b"RRF2", 12, struct.Struct("<QQ")
_END, _KINDS = 0, 4
_TRAILER, _TRAILER_MAGIC = 32, b"RRF2FOOT"


class RepairError(HrcError):
    """A file is no recording, or cannot be written."""


@dataclass(frozen=True)
class Found:
    """What a recording holds. messages: whole ones with data. end: where the last of them ends; size: of the file [bytes].

    finished: whether the writer has ended it; then it is whole.
    """

    messages: int
    end: int
    size: int
    finished: bool

    @property
    def torn(self) -> int:
        """Bytes after the last whole message."""
        return 0 if self.finished else self.size - self.end


def look(path: Path) -> Found:
    """Walk through the messages of a recording. Raises RepairError if it is none."""
    try:
        with path.open("rb") as file:
            return _walk(path, file, os.fstat(file.fileno()).st_size)
    except OSError as error:
        raise RepairError(f"{path} cannot be read: {error.strerror}") from None


def _walk(path: Path, file: BinaryIO, size: int) -> Found:
    if (head := file.read(_HEADER))[: len(_MAGIC)] != _MAGIC[: len(head)]:
        raise RepairError(f"{path} is no recording: a .rrd file of this version begins with {_MAGIC.decode()}")
    messages, end = 0, min(_HEADER, size)
    while end + _MESSAGE.size <= size:
        file.seek(end)
        kind, length = _MESSAGE.unpack(file.read(_MESSAGE.size))
        after = end + _MESSAGE.size + length
        if kind >= _KINDS or after > size:
            break
        if kind == _END:  # without its trailer it is of no use
            file.seek(after)
            finished = size - after >= _TRAILER and _TRAILER_MAGIC in file.read(_TRAILER)
            return Found(messages, end, size, finished)
        messages, end = messages + 1, after
    return Found(messages, end, size, finished=False)


def repair(path: Path) -> Found:
    """Cut what follows the last whole message; what was found before. A whole recording stays as it is.

    Raises RepairError for what is no recording, has not a single whole message, or cannot be written.
    """
    found = look(path)
    if not found.messages:
        raise RepairError(f"{path} has no whole message in it; there is nothing to save")
    if found.torn:
        try:
            os.truncate(path, found.end)
        except OSError as error:
            raise RepairError(f"{path} cannot be written: {error.strerror}") from None
    return found
