"""viser opens its archive of some thousand icons anew for each icon of a widget, which is most of the time that a page takes
to build. Here it is opened once. `zipfile` is a private name of viser's in as far as it is replaced.
"""

import contextlib
import zipfile
from collections.abc import Iterator
from types import SimpleNamespace

from viser import _icons


@contextlib.contextmanager
def opened_once() -> Iterator[None]:
    """Within it viser reads its icons from an archive that stays open."""
    stock = _icons.zipfile  # pyright: ignore[reportPrivateImportUsage]
    with zipfile.ZipFile(_icons.ICONS_DIR / "tabler-icons.zip") as archive:
        _icons.zipfile = SimpleNamespace(ZipFile=lambda _: contextlib.nullcontext(archive))  # pyright: ignore[reportPrivateImportUsage]
        try:
            yield
        finally:
            _icons.zipfile = stock  # pyright: ignore[reportPrivateImportUsage]
