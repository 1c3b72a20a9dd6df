"""Icons that come from the archive opened once are viser's own."""

import zipfile

import pytest
from viser import _icons

from app.serve.icons import opened_once

NAMES = ("player-record", "eye", "download", "trash")


def test_icons_are_the_same_and_the_archive_is_opened_once(monkeypatch: pytest.MonkeyPatch) -> None:
    _icons.svg_from_icon.cache_clear()
    expected = [_icons.svg_from_icon(name) for name in NAMES]
    _icons.svg_from_icon.cache_clear()
    opened, stock = [], zipfile.ZipFile
    monkeypatch.setattr(zipfile, "ZipFile", lambda path: opened.append(path) or stock(path))
    with opened_once():
        assert [_icons.svg_from_icon(name) for name in NAMES] == expected
    assert len(opened) == 1
    _icons.svg_from_icon.cache_clear()
    assert _icons.svg_from_icon(NAMES[0]) == expected[0], "and afterwards as before"
    assert len(opened) == 2
