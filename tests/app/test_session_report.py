"""The report: one page, all of it inside, and what differs is marked."""

import re
import resource
from html.parser import HTMLParser

import pytest

from app import session_report
from app.__main__ import main
from app.headless import Job, execute
from app.output import OutputError
from app.record.folder import read
from app.session_report import page


class Page(HTMLParser):
    """Rows of cells, and everything that the page would load."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.loaded, self.differs = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.loaded += [value for name, value in attrs if name in ("src", "href")]
        self.cell = tag in ("td", "th")
        if tag == "tr":
            self.rows.append([])
        if tag == "td" and ("class", "differs") in attrs:
            self.differs.append(self.rows[-1][0])

    def handle_data(self, data):
        if self.cell:
            self.rows[-1].append(data)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sessions")
    execute(Job("push", folder / "a", duration=2.5, record=False, quiet=True))
    execute(Job("push", folder / "b", duration=2.5, record=False, quiet=True, settings=("control.f_relax=7",)))
    return folder / "a", folder / "b"


def test_a_page_holds_figures_metrics_and_what_differs_and_loads_nothing(folders, tmp_path, capsys):
    out = tmp_path / "new" / "report.html"
    main(["report", *map(str, folders), "--out", str(out)])
    assert capsys.readouterr().out.strip() == str(out)
    assert [path.name for path in out.parent.iterdir()] == ["report.html"]
    text = out.read_text()
    found = Page(text)
    assert len(found.loaded) == 2
    assert all(link.startswith("data:image/png;base64,") for link in found.loaded)
    assert not re.search(r"<script|@import|url\(", text)
    rows = {row[0]: row[1:] for row in found.rows if len(row) > 1}
    assert rows["control.f_relax"] == ["5", "7"]
    assert "everything_finite" in rows
    assert {"control.f_relax", "signals_sha256"} <= set(found.differs)
    assert "control.f_abort" not in found.differs


def test_a_name_from_outside_is_text(folders):
    session = read(folders[0])
    about = {**session.about, "scenario": "<script>alert(1)</script>", "<b>": "<i>"}
    text = page([type(session)(session.folder, session.config, about, session.events, session.columns)])
    assert "<script" not in text
    assert "<i>" not in text
    assert "&lt;script&gt;" in text


def test_a_full_disk_is_said_and_leaves_nothing(folders, tmp_path, monkeypatch):
    monkeypatch.setattr(session_report, "page", lambda _: "x" * 20_000)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with pytest.raises(OutputError, match="File too large"):
            session_report.write(folders, tmp_path / "report.html")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_session_or_is_there_already_is_refused(folders, tmp_path, capsys):
    def refusal(*args):
        with pytest.raises(SystemExit) as exit_:
            main(["report", *map(str, args)])
        assert exit_.value.code == 2
        return capsys.readouterr().err

    assert "config.json" in refusal(tmp_path, "--out", tmp_path / "report.html")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "thesis.html").write_text("years of work")
    assert "--overwrite" in refusal(folders[0], "--out", tmp_path / "thesis.html")
    assert (tmp_path / "thesis.html").read_text() == "years of work"
