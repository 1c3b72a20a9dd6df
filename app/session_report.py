"""`elbowroom report`: sessions as one HTML page that needs no other file: figures, metrics, parameters, and what differs."""

import base64
import contextlib
import os
import tempfile
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from app import gates, metrics
from app.output import OutputError, partial, writable
from app.record.folder import Session, SessionError, read
from app.record.recover import mended
from app.report import figure
from hrc.config import Config
from hrc.parameters import keys

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c2530; max-width: 1200px; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2.2rem; border-bottom: 1px solid #d5dbe1 }
img { width: 100% } figure { margin: 1rem 0 } figcaption { font-weight: 600 }
table { border-collapse: collapse; font-size: 13px }
td, th { padding: .2rem .8rem .2rem 0; text-align: left; vertical-align: top; overflow-wrap: anywhere }
td:not(:first-child) { font-variant-numeric: tabular-nums } tr:nth-child(even) { background: #f5f7f9 }
.differs { color: #b3261e; font-weight: 600 } .note { color: #5c6b7a }
"""


def write(folders: Sequence[Path], out: Path, *, overwrite: bool = False) -> None:
    """Write the page.

    Raises SessionError for a folder of no session, OutputError for one that is not finished or a file that exists or cannot be
    written.
    """
    if not folders:
        raise SessionError("name a folder that `run` or `replay` has written")
    if out.is_dir() or (out.exists() and not overwrite):
        raise OutputError(f"{out} exists; choose another, or replace it with --overwrite")
    for folder in folders:
        mended(folder)
    writable(out)
    sessions = [read(folder) for folder in folders]
    text = page(sessions)
    made = partial(out)
    try:
        made.parent.mkdir(parents=True, exist_ok=True)
        made.write_text(text, encoding="utf-8")
        os.replace(made, out)
    except OSError as error:
        raise OutputError(f"cannot write {out}: {error.strerror}") from None
    finally:
        with contextlib.suppress(OSError):
            made.unlink(missing_ok=True)


def page(sessions: Sequence[Session]) -> str:
    """The page of these sessions, the first of them being what the others are compared with."""
    names = [_name(session, i) for i, session in enumerate(sessions)]
    figures = [dict(gates.flat(metrics.compute(session.columns))) for session in sessions]
    parameters = [keys(session.config) for session in sessions]
    default = keys(Config())
    rows = list(dict.fromkeys(name for table in figures for name in table))
    changed = [key for key in default if any(table[key] != default[key] for table in parameters)]
    differing = [key for key in changed if any(table[key] != parameters[0][key] for table in parameters)]
    about = [{key: session.about.get(key) for key in session.about if not isinstance(session.about[key], dict)}
             for session in sessions]
    keys_about = list(dict.fromkeys(key for table in about for key in table))
    parts = [
        f"<h1>{escape(' and '.join(names) if len(names) < 3 else f'{len(names)} sessions')}</h1>",
        '<p class="note">What differs from the first session is red.</p>' if len(sessions) > 1 else "",
        "<h2>Figures</h2>", *(_figure(name, session) for name, session in zip(names, sessions, strict=True)),
        "<h2>Metrics</h2>", _table(names, rows, figures),
        "<h2>Parameters that differ between the sessions</h2>" if len(sessions) > 1 else "",
        (_table(names, differing, parameters) if differing else "<p>None.</p>") if len(sessions) > 1 else "",
        "<h2>Parameters other than the default</h2>",
        _table(["default", *names], changed, [default, *parameters]) if changed else "<p>None.</p>",
        "<h2>Run</h2>", _table(names, keys_about, about),
        "<h2>All parameters</h2><details><summary>show</summary>", _table(names, list(default), parameters), "</details>"]
    policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
    return ('<!doctype html><html lang="en"><head><meta charset="utf-8">'
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
            f"<title>{escape(names[0])}</title><style>{STYLE}</style></head><body>{''.join(parts)}</body></html>\n")


def _name(session: Session, number: int) -> str:
    about = session.about
    seed = session.config.seed
    return f"{number + 1}: {about.get('scenario', 'session')}, seed {seed}" + (" (replay)" if "open_loop_of" in about else "")


def _figure(name: str, session: Session) -> str:
    control = session.config.control
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figure.png"
        figure(path, session.columns, F_relax=control.f_relax, F_abort=control.f_abort, title=name)
        image = base64.b64encode(path.read_bytes()).decode()
    return f'<figure><img alt="{escape(name)}" src="data:image/png;base64,{image}"></figure>'


def _table(names: Sequence[str], rows: Sequence[str], columns: Sequence[Mapping[str, Any]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    lines = []
    for row in rows:
        values = [column.get(row) for column in columns]
        cells = "".join(f'<td class="differs">{_shown(v)}</td>' if v != values[0] else f"<td>{_shown(v)}</td>" for v in values)
        lines.append(f"<tr><td>{escape(row)}</td>{cells}</tr>")
    return f"<table><tr><th></th>{head}</tr>{''.join(lines)}</table>"


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (list, tuple)):
        ends = [value] if not value or not isinstance(value[0], (list, tuple)) else value
        return "<br>".join(escape(" ".join(_plain(x) for x in line)) for line in ends) or "-"
    return escape(str(value))


def _plain(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
