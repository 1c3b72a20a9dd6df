"""What the attacks are aimed at: a small server with one widget of each kind, guarded or as viser comes."""

import contextlib
import http.client
from collections.abc import Callable
from typing import Any

import viser
from fuzz import message
from vclient import VClient, until

from app.serve.guard import Guard
from app.serve.keys import Keys

TOKEN, WATCH = "operate-token", "watch-token"


class Target:
    """A small server with one widget of each kind. guarded: or viser as it comes. heard: what reached a callback.

    patience: how long an effect is waited for [s].
    """

    def __init__(self, *, guarded: bool) -> None:
        self.guard = Guard(Keys(TOKEN, WATCH)) if guarded else None
        self.server = (self.guard.open("127.0.0.1", 0, "test") if self.guard is not None
                       else _stock())
        self.port = self.server.get_port()
        self.patience = 0.5 if guarded else 10.0
        self.heard: list[Any] = []
        gui = self.server.gui
        self.gain = gui.add_slider("Gain", min=0.0, max=1.0, step=0.1, initial_value=0.5)
        self.mode = gui.add_dropdown("Mode", ("a", "b"))
        self.locked = gui.add_checkbox("Locked", False, disabled=True)
        stop, hidden = gui.add_button("STOP"), gui.add_button("Hidden", visible=False)
        self.upload = gui.add_upload_button("Upload")
        self.gizmo = self.server.scene.add_transform_controls("/gizmo")
        self.box = self.server.scene.add_box("/box")
        if self.guard is not None:
            self.guard.free(stop)

        def hears(what: str) -> Callable[[Any], Any]:
            async def on_event(_: Any) -> None:
                self.heard.append(what)

            return on_event

        async def on_drag(event: viser.SceneNodeDragEvent[Any]) -> None:
            self.heard.append(tuple(event.end_position))

        stop.on_click(hears("stop"))
        hidden.on_click(hears("hidden"))
        self.box.on_drag("left")(on_drag)
        self.server.request_share_url = lambda *_, **__: self.heard.append("tunnel")  # never a real one

    def client(self, token: str = TOKEN) -> VClient:
        """Somebody who was let in."""
        client = VClient(self.port, headers={"Authorization": f"Bearer {token}"})
        until(client.ready.is_set)
        until(lambda: client.widget("STOP"))
        return client

    def lets_in(self, **options: Any) -> bool:
        """Whether a socket opens."""
        client = VClient(self.port, **options)
        until(lambda: client.ready.is_set() or client.closed.is_set())
        client.close()
        return client.ready.is_set()

    def get(self, path: str = "/", **headers: str) -> http.client.HTTPResponse:
        """An HTTP request."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=5)
        connection.request("GET", path, headers=headers)
        return connection.getresponse()

    def gained(self, act: Callable[[VClient], None], harm: Callable[[], Any]) -> bool:
        """Whether something that a visitor did had its effect, within a moment."""
        client = self.client()
        with contextlib.suppress(ConnectionError):
            act(client)
        try:
            until(harm, self.patience)
        except TimeoutError:
            return False
        finally:
            client.close()
        return True

    def stop_is_dead(self) -> bool:
        """Whether another visitor presses STOP in vain."""
        before, other = self.heard.count("stop"), self.client()
        uuid = other.widget("STOP")
        other.send(message("GuiUpdateMessage", uuid=uuid, updates={"value": True}))
        try:
            until(lambda: self.heard.count("stop") > before, 10.0)
        except TimeoutError:
            return True
        finally:
            other.close()
        return False


def _stock() -> viser.ViserServer:
    with contextlib.redirect_stdout(None):
        return viser.ViserServer(host="127.0.0.1", port=0, verbose=False)


def authorized(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}
