"""Steering from the page: the kind of task, a gizmo for the target of the end effector, its nudges, and the desired posture.

What a visitor asks for stands until the cell has heard it, and at least for HANDS_OFF; after that, widgets show what the cell
has, whoever changed it. A target stays where it was left: no visitor has to be there for the arm to get to it.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from app.serve.driver import Driver
from hrc.config import Config
from hrc.control.reference import KINDS
from hrc.errors import HrcError
from hrc.events import Event, MoveTarget, SetPosture, SetTask
from hrc.geometry import Array, rotation_from_quaternion
from hrc.messages import Aim, Snapshot
from hrc.model import joint_limits, load_spec

FOLLOW = "follow"
LIMITS = ((-1.0, 1.0), (-1.0, 1.0), (0.02, 1.3))
"""Where the target may be dragged: x, y, z [m]."""
NUDGE = 0.01
"""One press of a key or a button moves the target so far [m]."""
LEVEL, UPRIGHT = ("Left", "Right", "Away", "Near"), ("Up", "Down")
"""Nudges as the visitor sees them on the screen; app/static/head.html gives them the arrow keys and the page keys."""
HANDS_OFF = 0.5
"""So long after a visitor's last act, a widget is not set to what the cell has [s]."""
STILL, SHORT = 0.001, 0.005
"""A gizmo this near to the target is where it belongs; a goal farther from the target than this is short of it [m]."""
HELP = ("What the end effector does. follow: drag the arrows at the tool, and the arm goes there; "
        "arrow keys, Page Up and Page Down move the target by 1 cm")


class Steering:
    """The widgets. `add_task` and `add_posture` make them inside the container they belong to."""

    def __init__(self, server: viser.ViserServer, session: Driver, refuse: Callable[[str], None]) -> None:
        self._server, self._session, self._refuse = server, session, refuse
        self._q = np.zeros(7)
        self._target = np.zeros(3)
        self._chose = self._moved = -np.inf
        self._asked: Event | None = None
        self._shown_posture: Array | None = None
        self._gizmo = server.scene.add_transform_controls(
            "/gizmos/target", scale=0.3, disable_rotations=True, translation_limits=LIMITS, visible=False)
        self._note = server.scene.add_label(
            "/gizmos/short", "as near as the arm gets from here", font_screen_scale=0.8, visible=False)

        async def on_drag(event: viser.TransformControlsEvent) -> None:
            self._move(np.asarray(event.target.position, float))

        self._gizmo.on_update(on_drag)

    def add_task(self, config: Config) -> None:
        """The choice of the task, and the nudges."""
        gui = self._server.gui
        self._kind = gui.add_dropdown("Task", _kinds(config), initial_value=config.task.kind, hint=HELP)
        self._nudges = (
            gui.add_button_group("Nudge 1 cm", LEVEL, visible=False, hint="The arrow keys do the same"),
            gui.add_button_group("Up, down", UPRIGHT, visible=False, hint="Page Up and Page Down do the same"))

        async def on_kind(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is not None:  # else it was set by `update`
                self._chose = time.monotonic()
                self._put(SetTask(event.target.value))

        async def on_nudge(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                self._move(self._target + NUDGE * direction(event.target.value, np.asarray(event.client.camera.wxyz)))

        self._kind.on_update(on_kind)
        for nudge in self._nudges:
            nudge.on_click(on_nudge)

    def add_posture(self) -> None:
        """A slider for each joint of q_d; nothing happens before the button is pressed."""
        gui, limits = self._server.gui, joint_limits(load_spec().compile())
        lows, highs = np.ceil(np.rad2deg(limits.q_min)).tolist(), np.floor(np.rad2deg(limits.q_max)).tolist()
        self._sliders = [
            gui.add_slider(f"Joint {j} [deg]", min=low, max=high, step=1.0, initial_value=0.0,
                           hint="Of the desired posture q_d")
            for j, (low, high) in enumerate(zip(lows, highs, strict=True), start=1)]
        take = gui.add_button("Make this the posture", icon=viser.Icon.CHECK,
                              hint="The arm goes towards it as far as its task leaves it free")
        copy = gui.add_button("Copy the arm's posture", icon=viser.Icon.COPY, hint="Set the sliders to where the arm is now")

        async def on_take(_: Any) -> None:
            self._put(SetPosture(tuple(float(np.deg2rad(slider.value)) for slider in self._sliders)))

        async def on_copy(_: Any) -> None:
            self._show_posture(self._q)

        take.on_click(on_take)
        copy.on_click(on_copy)

    def begin(self, config: Config) -> None:
        """Another cell, or a reset one: nothing is asked for any more."""
        self._chose = self._moved = -np.inf
        self._asked = None
        self._shown_posture = None
        self._kind.options = _kinds(config)

    def heard(self, event: Event) -> None:
        """The cell has taken an event, or refused it."""
        if event == self._asked:
            self._asked = None

    def update(self, snapshot: Snapshot) -> None:
        """Widgets as the cell is, unless a visitor is just at them."""
        aim, self._q = snapshot.aim, snapshot.state.q
        following = aim.kind == FOLLOW and aim.target is not None
        self._gizmo.visible = following
        for nudge in self._nudges:
            nudge.visible = following
        if self._shown_posture is None or (aim.q_d != self._shown_posture).any():
            self._shown_posture = aim.q_d
            self._show_posture(aim.q_d)
        self._show_note(aim)
        now = time.monotonic()
        if self._asked is not None:  # the cell is late, or stands still: what it shows is from before
            return
        if now - self._chose > HANDS_OFF:
            self._kind.value = aim.kind
        if aim.target is not None and now - self._moved > HANDS_OFF:
            self._target = aim.target
            if np.abs(np.asarray(self._gizmo.position) - aim.target).max() > STILL:
                self._gizmo.position = aim.target

    def _show_note(self, aim: Aim) -> None:
        if aim.target is None or aim.goal is None or float(np.linalg.norm(aim.goal - aim.target)) < SHORT:
            self._note.visible = False
        else:
            self._note.visible, self._note.position = True, aim.goal

    def _show_posture(self, q: Array) -> None:
        for slider, angle in zip(self._sliders, np.rad2deg(q), strict=True):
            slider.value = float(np.clip(round(float(angle)), slider.min, slider.max))

    def _move(self, position: Array) -> None:
        low, high = np.transpose(LIMITS)
        x, y, z = np.clip(position, low, high).tolist()
        event = MoveTarget((x, y, z))  # raises if they are no numbers, before anything is kept of them
        self._moved, self._target = time.monotonic(), np.array(event.position)
        self._put(event)
        if (self._target != self._gizmo.position).any():  # else this browser's own drag put it there, and goes on
            self._gizmo.position = self._target

    def _put(self, event: Event) -> None:
        self._asked = event
        try:
            self._session.put(event)
        except HrcError as error:
            self._asked = None
            self._refuse(str(error))


def direction(nudge: str, wxyz: Array) -> Array:
    """The world's axis (3,) that comes nearest to a nudge as seen by a camera of this orientation (4,)."""
    if nudge in UPRIGHT:
        return np.array([0.0, 0.0, 1.0 if nudge == "Up" else -1.0])
    R = rotation_from_quaternion(wxyz)
    # Seen from above, what is up on the screen is away, and so is, seen from the side, what is behind it.
    away = R[:2, 2] - R[:2, 1]
    axis = int(np.argmax(np.abs(away)))
    away = np.eye(3)[axis] * (np.sign(away[axis]) or 1.0)
    right = np.array([away[1], -away[0], 0.0])
    return {"Away": away, "Near": -away, "Right": right, "Left": -right}[nudge]


def _kinds(config: Config) -> tuple[str, ...]:
    return tuple(kind for kind in KINDS if kind != "waypoints" or config.task.waypoints)
