"""A hand on the robot: dragging a link with the mouse is a Pull, letting go a Release. Nobody's hand stays behind."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import viser

from app.serve.driver import Driver
from app.serve.scene import SceneView
from app.serve.vigil import Vigil
from hrc.errors import HrcError
from hrc.events import Event, Pull, Release, Vector
from hrc.geometry import apply, inverse


@dataclass
class _Grip:
    """Who holds which point of which link; the point stays fixed to the link while the mouse moves."""

    client: viser.ClientHandle
    link: int
    point: Vector


class Hands:
    """Turns drags of links into events. One hand at a time: it holds until it lets go, leaves or falls silent."""

    def __init__(self, server: viser.ViserServer, session: Driver, view: SceneView,
                 refuse: Callable[[str], None]) -> None:
        self._session, self._view, self._refuse = session, view, refuse
        self._grip: _Grip | None = None
        self._lock = threading.Lock()  # a Pull must not follow the Release that the vigil led to
        for link, node in enumerate(view.links[1:], start=1):
            for modifier in (None, "cmd/ctrl"):
                node.on_drag("left", modifier=modifier)(self._handler(link))
        server.on_client_disconnect(self._on_leave)
        self._vigil = Vigil(server, "hands", self._abandoned)

    def close(self) -> None:
        """End the watch."""
        self._vigil.close()

    def _handler(self, link: int) -> Callable[[Any], Any]:
        async def on_drag(event: viser.SceneNodeDragEvent[Any]) -> None:
            with self._lock:
                self._drag(event, link)

        return on_drag

    def _drag(self, event: viser.SceneNodeDragEvent[Any], link: int) -> None:
        grip = self._grip
        if grip is not None and grip.client.client_id != event.client_id:
            if event.phase == "start":
                self._refuse("somebody else is holding the arm")
        elif event.phase == "end":
            self._let_go(grip)
        elif event.phase == "start":
            # The browser clicked on the pose it was shown, not on the newest one.
            x, y, z = (float(c) for c in apply(inverse(self._view.shown[link]), event.start_position))
            self._hold(_Grip(event.client, link, (x, y, z)), event.end_position)
        elif grip is not None and grip.link == link:
            self._vigil.hears(grip.client)
            self._put(lambda: Pull(link, grip.point, event.end_position))

    def let_go_of(self, client_id: int) -> None:
        """Whatever this client holds: it has left, or drives no longer."""
        with self._lock:
            grip = self._grip
            if grip is not None and grip.client.client_id == client_id:
                self._let_go(grip)

    async def _on_leave(self, client: viser.ClientHandle) -> None:
        self.let_go_of(client.client_id)

    def _abandoned(self, client: viser.ClientHandle) -> None:
        with self._lock:
            grip = self._grip
            if grip is not None and grip.client is client:
                self._refuse("the browser that held the arm does not answer: let go")
                self._let_go(grip)

    def _hold(self, grip: _Grip, target: Vector) -> None:
        if self._put(lambda: Pull(grip.link, grip.point, target)):
            self._grip = grip
            self._vigil.hears(grip.client)

    def _let_go(self, grip: _Grip | None) -> None:
        if grip is not None and self._grip is grip:
            self._grip = None
            self._vigil.ends()
            self._put(Release)

    def _put(self, event: Callable[[], Event]) -> bool:
        """Make an event and hand it in; both may find that it cannot be."""
        try:
            self._session.put(event())
        except HrcError as error:
            self._refuse(str(error))
            return False
        return True
