"""The report of a campaign: one HTML page that needs no other file, with curves, tables, and the robot to turn around."""

import base64
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from app.campaign import plots, summary, surface
from app.campaign.metrics import METRICS
from app.campaign.plan import Campaign
from app.campaign.surface import Field
from app.campaign.versions import versions
from app.output import OutputError
from app.session_report import STYLE
from hrc import meshes
from hrc.geometry import Array, apply
from hrc.paths import static

REPORT = "report.html"
MAPS = ("point_error_m", "force_error_N", "force_blind_N", "missed")
"""The metrics that are shown on the robot, as far as there are any."""
OWN_STYLE = """
#robot { width: 100%; height: 520px; display: block; background: #eef1f4; border-radius: 8px; cursor: grab; touch-action: none }
.maps button { font: inherit; margin: .4rem .4rem .4rem 0; padding: .2rem .7rem; border: 1px solid #9aa7b3; border-radius: 6px;
 background: #fff } .maps button[aria-pressed=true] { background: #1c2530; color: #fff }
.scale { display: inline-block; width: 12rem; height: .8rem; vertical-align: middle; margin: 0 .5rem }
"""


def write(campaign: Campaign, records: Sequence[Mapping[str, Any]], folder: Path, worst: Sequence[Path] = ()) -> None:
    """Write report.html into the folder. worst: sessions to name. Raises OutputError if it cannot be written."""
    text = page(campaign, records, [str(path.relative_to(folder)) for path in worst])
    partial = folder / f".{REPORT}.partial"
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, folder / REPORT)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OutputError(f"cannot write {folder / REPORT}: {error.strerror}") from None


def page(campaign: Campaign, records: Sequence[Mapping[str, Any]], worst: Sequence[str] = ()) -> str:
    """The page as text."""
    table = summary.rows(campaign, records)
    fields = [field for metric in MAPS if (field := surface.over(records, metric)) is not None]
    curves = plots.curves(campaign, table)
    body = [
        f"<h1>{escape(campaign.title)}</h1><p>{escape(campaign.description)}</p>",
        f'<p class="note">{len(records)} of {campaign.total} episodes; points of the sweep: {len(campaign.points)}; seed '
        f"{campaign.seed}; {escape(', '.join(f'{k} {v}' for k, v in versions().items()))}</p>",
        *_errors(records),
        *([f"<h2>Over what was swept</h2>{_image(curves, 'curves')}<p class='note'>Bars are 95 % intervals of the mean.</p>"]
          if curves else []),
        *(_maps(campaign, fields) if fields else []),
        "<h2>Figures</h2>", _table(campaign, table),
        *_worst(campaign, worst),
        "<h2>Metrics</h2><table>", *(_meaning(name) for name in campaign.metrics), "</table>"]
    policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
    return ('<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
            f'<meta http-equiv="Content-Security-Policy" content="{policy}"><title>{escape(campaign.title)}</title>'
            f"<style>{STYLE}{OWN_STYLE}</style></head><body>{''.join(body)}</body></html>\n")


def _maps(campaign: Campaign, fields: Sequence[Field]) -> Iterator[str]:
    T = surface.poses(campaign.base)
    yield "<h2>On the robot</h2>"
    yield (f'<p class="note">Mean over the contacts around each place, a bell of {100 * surface.WIDTH:g} cm; grey where the '
           f"nearest contact is farther than {100 * surface.FAR:g} cm. All points of the sweep together, in the posture of the "
           "task. Drag to turn, scroll to come nearer.</p>")
    yield '<div class="maps"><canvas id="robot"></canvas></div>'
    script = (static() / "surface.js").read_text(encoding="utf-8")
    yield f'<script type="application/json" id="robot-data">{json.dumps(_mesh(fields, T))}</script><script>{script}</script>'
    for i in range(0, len(fields), 2):
        yield _image(plots.heat(fields[i:i + 2], T), "metrics on the robot")


def _mesh(fields: Sequence[Field], T_world_link: Array) -> dict[str, Any]:
    """The robot as one mesh with a colour at each vertex for each field, for surface.js."""
    parts, first, faces = meshes.robot(surface.DETAIL), 0, []
    for part in parts:
        faces.append(part.faces + first)
        first += len(part.vertices)
    vertices = np.concatenate([apply(T, part.vertices) for T, part in zip(T_world_link, parts, strict=True)])
    normals = np.concatenate([part.normals @ T[:3, :3].T for T, part in zip(T_world_link, parts, strict=True)])
    rgb = [np.concatenate([surface.colours(v, field.scale) for v in field.values]) for field in fields]
    return {
        "vertices": _packed(vertices, "<f4"), "normals": _packed(127.0 * normals, "i1"),
        "faces": _packed(np.concatenate(faces), "<u2"), "middle": surface.LOOK_AT,
        "ramp": surface.ramp(),
        "fields": [{"name": f.metric, "unit": METRICS[f.metric].unit.replace("bool", "share"), "scale": f.scale,
                    "colours": _packed(255.0 * c, "u1")} for f, c in zip(fields, rgb, strict=True)]}


def _packed(values: Array, kind: str) -> str:
    rounded = np.round(values) if kind != "<f4" else values
    return base64.b64encode(rounded.astype(kind).tobytes()).decode()


def _image(png: bytes, alt: str) -> str:
    return f'<figure><img alt="{alt}" src="data:image/png;base64,{base64.b64encode(png).decode()}"></figure>'


def _table(campaign: Campaign, table: Sequence[Mapping[str, Any]]) -> str:
    names = (*campaign.sweep, "metric", "n", "mean", "95 % interval", "p95", "unit",
             *(["difference to the first point, of pairs"] if campaign.sweep else []))
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    lines = []
    for row in table:
        cells = [*(row[key] for key in campaign.sweep), row["metric"], row["n"], _number(row["mean"]), _interval(row),
                 _number(row["p95"]), row["unit"].replace("bool", "share")]
        if row["difference_n"]:
            cells.append(f"{_number(row['difference_mean'])} ({_interval(row, 'difference_')})")
        lines.append("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in cells) + "</tr>")
    return f"<table><tr>{head}</tr>{''.join(lines)}</table>"


def _meaning(metric: str) -> str:
    unit, text = METRICS[metric].unit.replace("bool", "yes / no"), escape(METRICS[metric].meaning)
    return f"<tr><td>{metric}</td><td>{unit}</td><td>{text}</td></tr>"


def _interval(row: Mapping[str, Any], of: str = "") -> str:
    return "-" if row[f"{of}low"] is None else f"{row[f'{of}low']:.4g} to {row[f'{of}high']:.4g}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _errors(records: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    failed = [record for record in records if record["error"] is not None]
    if failed:
        first = "".join(f"<li>episode {r['index']}: {escape(r['error'])}</li>" for r in failed[:20])
        yield f'<p class="differs">{len(failed)} episodes failed and count in no figure:</p><ul>{first}</ul>'


def _worst(campaign: Campaign, worst: Sequence[str]) -> Iterator[str]:
    if worst:
        yield f"<h2>The worst by {campaign.worst}</h2><p>Sessions, for <code>elbowroom replay --exact</code> and "
        yield f"<code>elbowroom review</code>:</p><ul>{''.join(f'<li>{escape(path)}</li>' for path in worst)}</ul>"
