"""The right dock: the contact force over time with its thresholds, and what the depth camera sees."""

from collections.abc import Sequence

import numpy as np
import viser
from viser import uplot

from app.serve.mailbox import ForcePoint
from app.serve.sight import OBSTACLE, ROBOT, Sight
from hrc.messages import Snapshot

ESTIMATE, TRUTH, RELAX, ABORT = "#ff3b30", "#34c759", "#e08e0b", "#b06ce0"
WIDTH = 350
BLANK = np.full((212, 256, 3), 24, np.uint8)


class SignalView:
    """A panel with the force plot and the depth picture."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        panel = server.gui.add_panel()
        with panel.add_tab("Signals", viser.Icon.CHART_LINE):
            self._plot = server.gui.add_uplot(
                _columns((), 0.0, 0.0),
                (uplot.Series(label="t [s]"), _line("estimate", ESTIMATE, 2.0), _line("true", TRUTH, 1.5),
                 _line("F_relax", RELAX, 1.0, (6, 4)), _line("F_abort", ABORT, 1.0, (6, 4))),
                title="Contact force |F| [N] over time [s]", height=200, legend=uplot.Legend(show=False),
                scales={"x": uplot.Scale(time=False, auto=True)})
            lines = (("estimate", ESTIMATE), ("true", TRUTH), ("F_relax", RELAX), ("F_abort", ABORT))
            server.gui.add_html(_key(lines))
            self._picture = server.gui.add_image(BLANK, label="Depth camera", format="jpeg", jpeg_quality=70)
            server.gui.add_html(_key((("robot, filtered out", _css(ROBOT)), ("obstacle", _css(OBSTACLE)))))
        panel.dock_right()
        panel.set_width(WIDTH)
        self._pictured = -1

    def update_plot(self, points: Sequence[ForcePoint], f_relax: float, f_abort: float) -> None:
        """The last half minute, with the thresholds as they are now [N]."""
        self._plot.data = _columns(points, f_relax, f_abort)

    def update_picture(self, snapshot: Snapshot, sight: Sight) -> None:
        """The newest frame, if it is not on the screen yet."""
        if snapshot.frame is not None and snapshot.frame.tick != self._pictured:
            self._pictured = snapshot.frame.tick
            self._picture.image = sight.picture(snapshot.frame, snapshot.foreground, snapshot.robot_image)


def _columns(points: Sequence[ForcePoint], f_relax: float, f_abort: float) -> tuple[np.ndarray, ...]:
    rows = [(p.time, p.estimate, p.truth, f_relax, f_abort) for p in points] or [(0.0, 0.0, 0.0, f_relax, f_abort)]
    return tuple(np.ascontiguousarray(column) for column in np.array(rows).T)


def _line(label: str, stroke: str, width: float, dash: tuple[int, ...] = ()) -> uplot.Series:
    return uplot.Series(label=label, stroke=stroke, width=width, points={"show": False}, dash=dash)


def _css(colour: tuple[int, int, int]) -> str:
    return "#" + bytes(colour).hex()


def _key(entries: Sequence[tuple[str, str]]) -> str:
    spans = (f'<span><i style="background:{colour}"></i>{name}</span>' for name, colour in entries)
    return f'<div class="eb-key">{"".join(spans)}</div>'
