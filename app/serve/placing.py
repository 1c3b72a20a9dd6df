"""Depth cameras in the hands of a visitor: of each, one gizmo where it stands, and one at what it looks at.

A drag says so twenty times a second; the cell hears of it at the pace of `update`, for it has to see its empty room anew from
each place. A camera stays where it was left: no visitor has to be there for that.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser

from app.serve.driver import Driver
from hrc.cell.eyes import CameraSetup
from hrc.errors import EventError, HrcError
from hrc.events import Event, MoveCamera, Vector

LIMITS = ((-3.0, 3.0), (-3.0, 3.0), (0.05, 3.0))
"""Where a camera, or what it looks at, may be dragged: x, y, z [m]."""
EYE, TARGET = 0, 1
HANDS_OFF = 0.5
"""So long after a visitor's last move, a gizmo is not set to what the cell has [s]."""
STILL = 0.001
"""A gizmo this near to its place is there [m]."""
Place = tuple[Vector, Vector]
"""Where a camera stands, and what it looks at [m]."""


class CameraControls:
    """The gizmos. `add_box` makes the checkbox that shows them, inside the container it belongs to."""

    def __init__(self, server: viser.ViserServer, session: Driver, refuse: Callable[[str], None]) -> None:
        self._server, self._session, self._refuse = server, session, refuse
        self._shown = False
        self._gizmos: dict[str, tuple[viser.TransformControlsHandle, viser.TransformControlsHandle]] = {}
        self._home: dict[str, Place] = {}
        self._has: dict[str, Place] = {}
        self._wished: dict[str, Place] = {}
        self._asked: dict[str, Event] = {}
        self._moved: dict[str, float] = {}

    def add_box(self) -> None:
        """The checkbox."""
        box = self._server.gui.add_checkbox(
            "Move the depth sensor", self._shown, hint="Drag its arrows, and those at what it looks at; Reset puts it back")

        async def on_update(event: viser.GuiEvent[Any]) -> None:
            self._shown = event.target.value
            for gizmo in self._all():
                gizmo.visible = self._shown

        box.on_update(on_update)

    def begin(self, rig: Sequence[CameraSetup]) -> None:
        """Another rig, each camera where it is configured to stand."""
        for gizmo in self._all():
            gizmo.remove()
        self._home = {setup.name: (setup.camera.eye, setup.camera.target) for setup in rig}
        self.forget()
        self._gizmos = {  # numbered: a name may hold a slash, which would nest the node
            setup.name: (self._gizmo(f"/gizmos/cameras/{i}/eye", setup.name, EYE),
                         self._gizmo(f"/gizmos/cameras/{i}/target", setup.name, TARGET))
            for i, setup in enumerate(rig)}

    def forget(self) -> None:
        """After a reset they stand where they did, and nothing is asked for any more."""
        self._has = dict(self._home)
        self._wished.clear()
        self._asked.clear()
        self._moved.clear()

    def heard(self, event: Event, *, refused: bool) -> None:
        """The cell has taken an event, or refused it."""
        if not isinstance(event, MoveCamera):
            return
        if not refused and event.name in self._has:
            self._has[event.name] = event.eye, event.target
        if event == self._asked.get(event.name):
            del self._asked[event.name]

    def update(self) -> None:
        """Hand on where cameras were dragged; set the other gizmos to where they are."""
        for name, gizmos in self._gizmos.items():
            if (wish := self._wished.pop(name, None)) is not None:
                self._put(name, wish)
            elif name not in self._asked and time.monotonic() - self._moved.get(name, -np.inf) > HANDS_OFF:
                for gizmo, position in zip(gizmos, self._has[name], strict=True):
                    if np.abs(np.asarray(gizmo.position) - position).max() > STILL:
                        gizmo.position = position

    def _all(self) -> list[viser.TransformControlsHandle]:
        return [gizmo for pair in self._gizmos.values() for gizmo in pair]

    def _gizmo(self, node: str, name: str, which: int) -> viser.TransformControlsHandle:
        scene = self._server.scene
        gizmo = scene.add_transform_controls(
            node, scale=(0.35, 0.2)[which], disable_rotations=True, translation_limits=LIMITS, visible=self._shown,
            position=self._home[name][which], depth_test=False)  # what it looks at is in the arm, as a rule
        scene.add_label(f"{node}/name", (name, f"{name} looks here")[which], font_screen_scale=0.8)

        async def on_drag(event: viser.TransformControlsEvent) -> None:
            low, high = np.transpose(LIMITS)
            x, y, z = (float(c) for c in np.clip(event.target.position, low, high))
            eye, target = self._wished.get(name) or self._aim(name)
            self._moved[name] = time.monotonic()
            self._wished[name] = ((x, y, z), target) if which == EYE else (eye, (x, y, z))

        gizmo.on_update(on_drag)
        return gizmo

    def _aim(self, name: str) -> Place:
        """Where the camera is, or is asked to be."""
        asked = self._asked.get(name)
        return (asked.eye, asked.target) if isinstance(asked, MoveCamera) else self._has[name]

    def _put(self, name: str, place: Place) -> None:
        try:
            event = MoveCamera(name, *place)
        except EventError:  # its own words have the figures, and would fill the log while the drag goes on
            self._refuse(f"{name} cannot stand there: too near to what it looks at, or straight above or below it")
            return
        try:
            self._asked[name] = event
            self._session.put(event)
        except HrcError as error:
            del self._asked[name]
            self._refuse(str(error))
