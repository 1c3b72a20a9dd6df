"""An output folder that appears as a whole or not at all."""

import errno
import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hrc.errors import HrcError

MARK = "config.json"
"""The file by which an earlier run's folder is known: nothing else is ever overwritten."""


NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
"""What a disk may say that is no bug of ours."""


class OutputError(HrcError):
    """The output folder cannot be made."""


def check(out: Path, *, overwrite: bool = False) -> None:
    """Raise OutputError if a run must not write to `out`."""
    if not out.name or out.is_symlink() or (out.exists() and not out.is_dir()):
        raise OutputError(f"{out} cannot be the output folder; name one that does not exist")
    writable(out)
    if not out.exists():
        return
    if not overwrite:
        raise OutputError(f"the output folder {out} exists; choose another, or replace it with --overwrite")
    if any(out.iterdir()) and not (out / MARK).is_file():
        raise OutputError(f"{out} is not the folder of an earlier run (no {MARK} in it), so it is not overwritten")


def writable(out: Path) -> None:
    """Raise OutputError now, not after hours, if nothing can be made at `out`."""
    parent = next(path for path in out.absolute().parents if os.path.exists(path))
    if not parent.is_dir():
        raise OutputError(f"cannot write {out}: {parent} is no folder")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"cannot write {out}: {parent} is not writable")


def apart(out: Path, source: Path) -> None:
    """Raise OutputError if to write `out` would touch the folder that it is made of."""
    source = source.resolve()
    for path in (out.resolve(), partial(out.resolve())):
        if path == source or path in source.parents or source in path.parents:
            raise OutputError(f"{out} is not apart from {source}, of which it is to be made; name another output folder")


@contextmanager
def claimed(path: Path) -> Iterator[None]:
    """Have a folder or a file to oneself; the system gives it back when the process ends, however that happens.

    Raises OutputError if somebody else has it.
    """
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise OutputError(f"{path} is still being written") from None
    finally:
        os.close(descriptor)


def partial(out: Path) -> Path:
    """Where `out` is until it is finished, and where it stays if the process is killed."""
    return out.with_name(f".{out.name}.partial")


@contextmanager
def folder(out: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """A hidden sibling to write into, renamed to `out` at the end.

    If an HrcError or Ctrl-C leaves the block, or the disk is full, it is removed. After any other exception, a bug, it stays as
    evidence.
    """
    check(out, overwrite=overwrite)
    made = partial(out)
    try:
        if made.exists():
            with claimed(made):
                shutil.rmtree(made)
        made.mkdir(parents=True)
    except OSError as error:
        raise OutputError(f"cannot make the output folder {out}: {error.strerror}") from None
    with claimed(made):
        try:
            yield made
            if out.exists():
                shutil.rmtree(out)
            made.rename(out)
        except (HrcError, KeyboardInterrupt):
            shutil.rmtree(made, ignore_errors=True)
            raise
        except Exception as error:
            if isinstance(error, OSError) and error.errno in NO_ROOM:
                shutil.rmtree(made, ignore_errors=True)
                raise OutputError(f"cannot write {out}: {error.strerror}") from None
            error.add_note(f"What was written until then is in {made}")
            raise
