"""The layout in which the viewer opens a session; it is embedded in the recording."""

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import rerun.blueprint as rrb

from app.record import entities

SUFFIX = ".rbl"
"""Of a file that holds a layout alone."""


def review(cameras: Sequence[str], *, replayed: bool = False) -> rrb.Blueprint:
    """3D scene, state and events on the left; images (a tab for each camera) and plots on the right.

    replayed: draw the curves of a replay, too.
    """
    plot = partial(_plot, origins=(entities.SIGNALS, entities.REPLAY) if replayed else (entities.SIGNALS,))
    scene = rrb.Spatial3DView(
        name="Scene", origin=entities.WORLD, background=[24, 27, 33],
        eye_controls=rrb.EyeControls3D(position=(1.1, -1.05, 1.05), look_target=(-0.15, 0.0, 0.5), eye_up=(0, 0, 1)))
    events = rrb.TextLogView(name="Events", origin=entities.EVENTS)
    parameters = rrb.TextDocumentView(name="Parameters", origin=entities.PARAMETERS)
    lanes = 1 + len(cameras) + replayed
    left = rrb.Vertical(scene, rrb.StateTimelineView(name="State", origin="/state"), rrb.Tabs(events, parameters),
                        row_shares=[5.6, 0.9 + 0.5 * min(lanes, 5), 1.9])
    pairs = [rrb.Horizontal(_image("Depth", name, entities.depth(name)), _image("Links seen", name, entities.link_ids(name)),
                            name=name) for name in cameras]
    images = pairs[0] if len(pairs) == 1 else rrb.Tabs(*pairs)
    forces = rrb.Tabs(_curves("|F| [N] and thresholds", entities.FORCE_PLOT, *[entities.REPLAYED_FORCE_PLOT] * replayed),
                      plot("Force [N]: estimate, truth", "force_est", "force_true"))
    residuals = rrb.Tabs(_curves("|r| / r_low", entities.RESIDUAL_PLOT), plot("Residual [N m]", "residual"))
    more = rrb.Tabs(
        plot("End effector [m]", "ee", "ee_desired"), plot("Admittance error [m]", "admittance_error"),
        _curves("Period of a control cycle [ms]", entities.PERIOD_PLOT), plot("Joint positions [rad]", "q"),
        plot("Joint velocities [rad/s]", "dq", "dq_command"), plot("Torques [N m]", "tau"),
        plot("Distance [m]", *(f"clearance_{link}" for link in range(1, 8))),
        plot("Link: estimate, truth", "contact_link_est", "contact_link_true"),
        plot("Power [W]", "contact_power"), plot("sigma_min [m]", "sigma_min"))
    right = rrb.Vertical(images, forces, residuals, more, row_shares=[2, 1.6, 1.6, 1.6])
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[1.25, 1]),
        rrb.TimePanel(state="collapsed", timeline="sim_time"), rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"))


def saved(layout: rrb.Blueprint, application: str) -> bytes:
    """The layout as a file."""
    with tempfile.TemporaryDirectory(prefix="elbowroom-layout-") as folder:
        path = Path(folder) / f"layout{SUFFIX}"
        layout.save(application, str(path))
        return path.read_bytes()


def _image(name: str, camera: str, entity: str) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(name=name, origin=entities.camera(camera), contents=[entity])


def _plot(name: str, *signals: str, origins: Sequence[str]) -> rrb.TimeSeriesView:
    return _curves(name, *(f"{origin}/{signal}" for origin in origins for signal in signals))


def _curves(name: str, *contents: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name=name, origin="/", contents=contents,
                              plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop))
