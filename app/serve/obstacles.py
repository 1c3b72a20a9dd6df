"""Obstacles in the hands of a visitor: a gizmo for each, dragging the body itself, and a box to bring it in or out.

The drawn body is where the plant has it; the gizmo is where its drive, limited in force and torque, is asked to go.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from app.serve.driver import Driver
from app.serve.scene import SceneView
from app.serve.session import HOME
from app.serve.vigil import Vigil
from hrc.errors import HrcError
from hrc.events import Event, MoveObstacle, RemoveObstacle, Vector
from hrc.geometry import quaternion_from_rotation
from hrc.messages import Body, Snapshot

LIMITS = ((-1.5, 1.0), (-1.2, 1.2), (0.0, 1.5))
"""Where a gizmo may be dragged: x, y, z [m]."""
STILL = 0.001
"""A gizmo within this of its body, each part of its quaternion too, is where it belongs [m]."""
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
"""How an obstacle is brought in, wxyz."""
GRANTED = 0.5
"""How long a wish to have an obstacle in or out may take [s]; then its box shows again what is."""
SCALE = 0.16
"""Size of a sphere's gizmo; the others' stand out of their bodies."""


class ObstacleControls:
    """Gizmos and drags. The checkboxes are made by `add_boxes`, inside the tab they belong to."""

    def __init__(self, server: viser.ViserServer, session: Driver, view: SceneView,
                 refuse: Callable[[str], None]) -> None:
        self._session, self._view, self._refuse = session, view, refuse
        self._server = server
        self._boxes: dict[str, viser.GuiCheckboxHandle] = {}
        self._asked: set[str] = set()
        self._wished: dict[str, tuple[bool, float]] = {}
        self._facing = {name: np.array(UPRIGHT) for name in HOME}
        self._grabbed: dict[int, tuple[str, np.ndarray]] = {}
        self._held: dict[int, str] = {}
        self._poses: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._draggable: dict[str, Any] = {}
        self._gizmos = {name: self._gizmo(name, home) for name, home in HOME.items()}
        self._vigil = Vigil(server, "obstacles", self._abandoned)

    def close(self) -> None:
        """End the watch over who drags."""
        self._vigil.close()

    def add_boxes(self) -> None:
        """A checkbox for each obstacle, in the present container."""
        for name, home in HOME.items():
            box = self._server.gui.add_checkbox(name.capitalize(), False, hint=f"Bring the {name} in, or take it out")
            box.on_update(self._on_box(name, home))
            self._boxes[name] = box

    def update(self, snapshot: Snapshot) -> None:
        """Gizmos and boxes follow what is there, unless a visitor asked for something else."""
        for body in snapshot.bodies:
            if body.name not in self._gizmos:
                continue
            self._make_draggable(body)
            gizmo = self._gizmos[body.name]
            gizmo.visible = body.present and not body.virtual
            wish, since = self._wished.get(body.name, (body.present, 0.0))
            # A box that showed what was would take the next click for no change.
            if body.name in self._boxes and (wish == body.present or time.monotonic() - since > GRANTED):
                self._wished.pop(body.name, None)
                self._boxes[body.name].value = body.present
            if not body.present:
                self._poses.pop(body.name, None)
                continue
            position, wxyz = body.T_world_body[:3, 3], quaternion_from_rotation(body.T_world_body[:3, :3])
            self._poses[body.name] = position, wxyz
            if body.name in self._asked:
                continue
            # Written only when it has moved: a write in the same moment as a visitor's drag would take its place.
            if np.abs(gizmo.position - position).max() > STILL:
                gizmo.position = position
            if not _same(gizmo.wxyz, wxyz):
                gizmo.wxyz = self._facing[body.name] = wxyz

    def let_go_of(self, client_id: int) -> None:
        """The obstacle that this client drags stays where it is, be its target far inside of the arm."""
        self._grabbed.pop(client_id, None)
        name = self._held.pop(client_id, None)
        if name is None:
            return
        self._vigil.ends()
        if name in self._poses and self._move(name, *self._poses[name]):
            self._asked.discard(name)  # its gizmo comes back to it

    def forget(self) -> None:
        """After a reset nothing is asked for any more."""
        self._asked.clear()

    def _gizmo(self, name: str, home: Vector) -> viser.TransformControlsHandle:
        gizmo = self._server.scene.add_transform_controls(
            f"/gizmos/{name}", scale=SCALE, disable_sliders=True, translation_limits=LIMITS, position=home, visible=False)

        async def on_update(event: viser.TransformControlsEvent) -> None:
            if not self._hears(event, name):
                return
            wxyz = event.target.wxyz / np.linalg.norm(event.target.wxyz)
            self._move(name, event.target.position, None if _same(wxyz, self._facing[name]) else wxyz)

        gizmo.on_update(on_update)
        return gizmo

    def _hears(self, event: "viser.TransformControlsEvent | viser.SceneNodeDragEvent[Any]", name: str) -> bool:
        """Whether somebody drags this obstacle, who then holds it until he lets go. Who has left gets an end by viser."""
        client, holder = event.client, event.client_id
        if client is None or holder is None:
            return False
        if holder not in self._server.get_clients():
            self.let_go_of(holder)
            return False
        if event.phase == "end":
            self._held.pop(holder, None)
            self._vigil.ends()
        else:
            self._held[holder] = name
            self._vigil.hears(client)
        return True

    def _abandoned(self, client: viser.ClientHandle) -> None:
        name = self._held.get(client.client_id)
        if name is not None:
            self._refuse(f"the browser that held the {name} does not answer: it stays where it is")
            self.let_go_of(client.client_id)

    def _make_draggable(self, body: Body) -> None:
        """The body itself can be dragged too, in the plane of the screen."""
        node = self._view.bodies[body.name]
        if self._draggable.get(body.name) is node:  # another cell draws its own
            return
        self._draggable[body.name] = node
        gizmo = self._gizmos[body.name]
        gizmo.disable_rotations = body.shape == "sphere"
        gizmo.scale = {"sphere": SCALE, "figure": 0.6 * body.size[0]}.get(body.shape, 2.0 * max(body.size))

        async def on_drag(event: viser.SceneNodeDragEvent[Any]) -> None:
            if not self._hears(event, body.name):
                return
            if event.phase == "start":
                offset = np.asarray(event.target.position) - np.asarray(event.start_position)
                self._grabbed[event.client_id] = (body.name, offset)
            name, offset = self._grabbed.get(event.client_id, ("", np.zeros(3)))
            if event.phase == "end":
                self._grabbed.pop(event.client_id, None)
            elif name == body.name:
                position = np.asarray(event.end_position) + offset
                if self._move(name, position):
                    self._gizmos[name].position = position

        node.on_drag("left")(on_drag)

    def _on_box(self, name: str, home: Vector) -> Callable[[Any], Any]:
        async def on_update(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is None:  # set by `update`, not by a visitor
                return
            self._asked.discard(name)
            self._wished[name] = event.target.value, time.monotonic()
            self._put(MoveObstacle(name, home, UPRIGHT) if event.target.value else RemoveObstacle(name))

        return on_update

    def _move(self, name: str, position: Any, wxyz: Any = None) -> bool:
        """wxyz: None if it is as before."""
        low, high = np.transpose(LIMITS)
        x, y, z = np.clip(position, low, high).tolist()
        turned = None if wxyz is None else tuple(wxyz.tolist())
        moved = self._put(MoveObstacle(name, (x, y, z), turned))  # clipped, so it can always be made
        if moved:
            self._asked.add(name)
            if wxyz is not None:
                self._facing[name] = wxyz
        return moved

    def _put(self, event: Event) -> bool:
        try:
            self._session.put(event)
        except HrcError as error:
            self._refuse(str(error))
            return False
        return True


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two quaternions are one orientation."""
    return bool(min(np.abs(a - b).max(), np.abs(a + b).max()) < STILL)
