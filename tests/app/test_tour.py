"""The tour: what it takes pictures of, and that the documentation shows it."""

import re
from pathlib import Path

import pytest

from app.tour import ALSO, SCREENS, tour
from hrc.errors import HrcError

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_documentation_shows_every_screen_in_small_files() -> None:
    shown = set(re.findall(r"\(page/(\w+)\.webp\)", (DOCS / "page.md").read_text(encoding="utf-8")))
    assert shown == {*SCREENS, *(name for name, _, _ in ALSO)} - {"help"}
    for name in shown:
        assert 5_000 < (DOCS / "page" / f"{name}.webp").stat().st_size < 150_000, name


def test_the_film_of_the_readme_is_small() -> None:
    assert "docs/page/film.webp" in (DOCS.parent / "README.md").read_text(encoding="utf-8")
    assert 100_000 < (DOCS / "page" / "film.webp").stat().st_size < 3_000_000


def test_without_a_chromium_the_tour_says_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(HrcError, match="Chromium"):
        tour(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
