"""Pictures of a campaign: curves over what was swept, and metrics on the robot."""

import itertools
from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any

import numpy as np

from app.campaign import surface
from app.campaign.metrics import METRICS
from app.campaign.plan import Campaign
from app.campaign.surface import Field
from hrc.geometry import Array

Row = Mapping[str, Any]


def curves(campaign: Campaign, table: Sequence[Row]) -> bytes | None:
    """A panel for each metric, as PNG: its mean over the swept parameter with the most values, a line for each value of the
    others; bars are 95 % intervals. None without a sweep."""
    if not campaign.sweep:
        return None
    figure = _figure((11.0, 2.7 * -(-len(campaign.metrics) // 3)))
    panels = figure.subplots(-(-len(campaign.metrics) // 3), 3, squeeze=False).flatten()
    along = max(campaign.sweep, key=lambda key: len(campaign.sweep[key]))
    others = [key for key in campaign.sweep if key != along]
    x = _positions(campaign.sweep[along])
    groups = list(itertools.product(*(campaign.sweep[key] for key in others)))
    for axes, metric in zip(panels, campaign.metrics, strict=False):
        lines: dict[tuple[Any, ...], list[Row]] = {}
        for row in table:
            if row["metric"] == metric and row["mean"] is not None:
                lines.setdefault(tuple(row[key] for key in others), []).append(row)
        for i, values in enumerate(groups):
            rows = lines.get(values, [])  # none where it has no value: the others keep their colours
            label = ", ".join(f"{key} = {_shown(value)}" for key, value in zip(others, values, strict=True))
            beside = 0.012 * (i - (len(groups) - 1) / 2) * (max(x.values()) - min(x.values()))  # bars do not hide one another
            _line(axes, [x[row[along]] + beside for row in rows], rows, label)
        if all(row["mean"] >= 0.0 for rows in lines.values() for row in rows):
            axes.set_ylim(bottom=0.0)
        if not all(map(_number, campaign.sweep[along])):
            axes.set_xticks(list(x.values()), [_shown(value) for value in x])
        axes.set_title(f"{metric}\n{METRICS[metric].meaning}", fontsize=7)
        axes.set_xlabel(along, fontsize=8)
        axes.tick_params(labelsize=7)
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in panels[len(campaign.metrics):]:
        axes.set_visible(False)
    if others:
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return _png(figure)


def _positions(values: Sequence[Any]) -> dict[Any, float]:
    """Where each swept value stands on the axis: numbers where they are, others one after another."""
    return {value: float(value) if all(map(_number, values)) else float(i) for i, value in enumerate(values)}


def _line(axes: Any, x: Sequence[float], rows: Sequence[Row], label: str) -> None:
    mean = np.array([row["mean"] for row in rows])
    ends = np.array([[row["mean"] if row[end] is None else row[end] for row in rows] for end in ("low", "high")])
    axes.errorbar(x, mean, yerr=np.abs(ends - mean), marker="o", markersize=3, linewidth=1.2, capsize=2, label=label)


def heat(fields: Sequence[Field], T_world_link: Array) -> bytes:
    """The robot with each field on it, from every side of `surface.VIEWS`, as PNG."""
    from matplotlib.colors import Normalize

    figure = _figure((3.1 * len(fields) * len(surface.VIEWS), 4.6))
    panels = figure.subplots(1, len(fields) * len(surface.VIEWS), squeeze=False)[0]
    for i, field in enumerate(fields):
        own = panels[i * len(surface.VIEWS):(i + 1) * len(surface.VIEWS)]
        for axes, (name, eye) in zip(own, surface.VIEWS.items(), strict=True):
            axes.imshow(surface.picture(field, eye, T_world_link))
            axes.set_axis_off()
            axes.set_title(f"{field.metric}, {name}", fontsize=9)
        unit = METRICS[field.metric].unit.replace("bool", "share")
        bar = figure.colorbar(_mappable(Normalize(*field.scale)), ax=list(own), orientation="horizontal", shrink=0.6, pad=0.02)
        bar.set_label(f"{METRICS[field.metric].meaning} [{unit}]" if unit else METRICS[field.metric].meaning, fontsize=8)
        bar.ax.tick_params(labelsize=8)
    return _png(figure)


def _mappable(norm: Any) -> Any:
    from matplotlib.cm import ScalarMappable

    return ScalarMappable(norm, surface.colormap())


def _figure(size: tuple[float, float]) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure  # no pyplot: it would look for a display

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _png(figure: Any) -> bytes:
    out = BytesIO()
    figure.savefig(out, dpi=110)
    return out.getvalue()


def _shown(value: Any) -> str:
    return f"{value:g}" if _number(value) else str(value)


def _number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
