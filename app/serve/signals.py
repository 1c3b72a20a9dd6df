"""The right dock: the contact force over time with its thresholds, below it the images of the cameras; beside them numbers."""

from collections.abc import Sequence

import numpy as np
import viser
from viser import uplot

from app.serve.images import CameraImages
from app.serve.mailbox import PLOT_PERIOD, PLOT_POINTS, ForcePoint
from app.serve.numbers import NumbersView

ESTIMATE, TRUTH, RELAX, ABORT = "#ff3b30", "#34c759", "#e08e0b", "#b06ce0"
WIDTH = 350
WINDOW = PLOT_POINTS * PLOT_PERIOD
"""Time that the plot shows [s]."""


class SignalView:
    """A panel with the force plot and the camera images, and on a second tab the numbers."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._known: tuple[float, int, float, float] | None = None
        panel = server.gui.add_panel()
        with panel.add_tab("Signals", viser.Icon.CHART_LINE):
            self._plot = server.gui.add_uplot(
                columns((), 0.0, 0.0),
                (uplot.Series(label="t - now [s]"), _line("estimate", ESTIMATE, 2.0), _line("true", TRUTH, 1.5),
                 _line("F_relax", RELAX, 1.0, (6, 4)), _line("F_abort", ABORT, 1.0, (6, 4))),
                title=f"Contact force |F| [N], the last {WINDOW:g} s", height=150, legend=uplot.Legend(show=False),
                scales={"x": uplot.Scale(time=False, range=(-WINDOW, 0.0))})
            lines = (("estimate", ESTIMATE), ("true", TRUTH), ("F_relax", RELAX), ("F_abort", ABORT))
            server.gui.add_html(_key(lines))
            self.images = CameraImages(server)
        with panel.add_tab("Numbers", viser.Icon.LIST_NUMBERS):
            self.numbers = NumbersView(server)
        panel.dock_right()
        panel.set_width(WIDTH)

    def update_plot(self, points: Sequence[ForcePoint], f_relax: float, f_abort: float) -> None:
        """The last half minute, with the thresholds as they are now [N]; nothing is sent while nothing changes."""
        known = (points[-1].time if points else 0.0, len(points), f_relax, f_abort)
        if known != self._known:
            self._known, self._plot.data = known, columns(points, f_relax, f_abort)


def columns(points: Sequence[ForcePoint], f_relax: float, f_abort: float) -> tuple[np.ndarray, ...]:
    """Time from now [s], |F| estimated and true and the thresholds [N], each (n,).

    The axis stands: one that follows the data is lost by viser's client where two updates come at once.
    """
    now = points[-1].time if points else 0.0
    rows = [(p.time - now, p.estimate, p.truth, f_relax, f_abort) for p in points] or [(0.0, 0.0, 0.0, f_relax, f_abort)]
    return tuple(np.ascontiguousarray(column) for column in np.array(rows).T)


def _line(label: str, stroke: str, width: float, dash: tuple[int, ...] = ()) -> uplot.Series:
    return uplot.Series(label=label, stroke=stroke, width=width, points={"show": False}, dash=dash)


def _key(entries: Sequence[tuple[str, str]]) -> str:
    spans = (f'<span><i style="background:{colour}"></i>{name}</span>' for name, colour in entries)
    return f'<div class="eb-key">{"".join(spans)}</div>'
