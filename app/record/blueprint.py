"""The layout in which the viewer opens a session; it is embedded in the recording."""

from collections.abc import Sequence

import rerun.blueprint as rrb

from app.record import entities


def review(cameras: Sequence[str]) -> rrb.Blueprint:
    """3D scene, state and events on the left; images (a tab for each camera) and plots on the right."""
    scene = rrb.Spatial3DView(
        name="Scene", origin=entities.WORLD, background=[24, 27, 33],
        eye_controls=rrb.EyeControls3D(position=(1.5, -0.9, 1.2), look_target=(-0.2, 0.0, 0.5), eye_up=(0, 0, 1)))
    events = rrb.TextLogView(name="Events", origin=entities.EVENTS)
    parameters = rrb.TextDocumentView(name="Parameters", origin=entities.PARAMETERS)
    left = rrb.Vertical(scene, rrb.StateTimelineView(name="State", origin="/state"), rrb.Tabs(events, parameters),
                        row_shares=[6, 1.2, 1.8])
    pairs = [rrb.Horizontal(_image("Depth", name, entities.depth(name)), _image("Links seen", name, entities.link_ids(name)),
                            name=name) for name in cameras]
    images = pairs[0] if len(pairs) == 1 else rrb.Tabs(*pairs)
    more = rrb.Tabs(
        _plot("End effector [m]", "ee", "ee_desired"), _plot("Joint positions [rad]", "q"),
        _plot("Joint velocities [rad/s]", "dq", "dq_command"), _plot("Torques [N m]", "tau"),
        _plot("Distance [m]", *(f"clearance_{link}" for link in range(1, 8))),
        _plot("Link: estimate, truth", "contact_link_est", "contact_link_true"),
        _plot("Admittance error [m]", "admittance_error"), _plot("Power [W]", "contact_power"),
        _plot("sigma_min [m]", "sigma_min"))
    right = rrb.Vertical(images, _plot("Contact force [N]: estimate, truth", "force_est", "force_true"),
                         _plot("Residual [N m]", "residual"), more, row_shares=[2, 1.6, 1.6, 1.6])
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[1.25, 1]),
        rrb.TimePanel(state="collapsed", timeline="sim_time"), rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"))


def _image(name: str, camera: str, entity: str) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(name=name, origin=entities.camera(camera), contents=[entity])


def _plot(name: str, *signals: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name=name, origin=entities.SIGNALS,
                              contents=[f"{entities.SIGNALS}/{signal}" for signal in signals],
                              plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop))
