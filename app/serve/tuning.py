"""Every live parameter as a widget, with buttons to put all back, to save them to a file and to load one."""

from html import escape
from itertools import groupby
from typing import Any

import viser

from app.serve.driver import Driver
from app.serve.guard import Guard
from app.serve.inputs import Inputs
from app.serve.journal import Journal
from app.settings import Found, ordered, sift, written
from hrc.config import Config
from hrc.errors import ConfigError, HrcError
from hrc.events import SetParameter
from hrc.parameters import field_of, keys

FILE = "elbowroom.toml"
MOST_TROUBLE = 12
"""Lines about a file that a visitor is shown."""


class Tuning:
    """config: the parameters as they are now. start: as this cell began, after scenario and command line."""

    def __init__(self, server: viser.ViserServer, session: Driver, config: Config, journal: Journal, guard: Guard) -> None:
        self._server, self._session, self._journal, self._guard = server, session, journal, guard
        self.config = self.start = config

    def add(self, inputs: Inputs) -> None:
        """The widgets, in the present container: a folder for each group."""
        gui = self._server.gui
        reset = gui.add_button("Reset to default", icon=viser.Icon.ARROW_BACK_UP,
                               hint="All parameters as the scenario starts with them")
        save = gui.add_button("Save settings", icon=viser.Icon.DOWNLOAD,
                              hint="A file with what differs from the defaults; --settings takes it too")
        load = gui.add_upload_button("Load settings", icon=viser.Icon.UPLOAD, mime_type=".toml",
                                     hint="A file as Save settings, or calibrate, writes it")
        live = [key for key in keys(self.config) if field_of(self.config, key).metadata["live"]]
        for group, members in groupby(live, key=lambda key: key.partition(".")[0]):
            with gui.add_folder(group, expand_by_default=False):
                for key in members:
                    inputs.add(key)

        async def on_reset(_: Any) -> None:
            self.reset()

        def on_save(event: viser.GuiEvent[Any]) -> None:  # in a thread: it writes to the socket
            if event.client is not None:
                event.client.send_file_download(FILE, written(self.config).encode(), save_immediately=True)

        async def on_load(event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
            if event.client is not None:
                self._load(event.client, event.target.value.name, event.target.value.content)

        reset.on_click(on_reset)
        save.on_click(on_save)
        load.on_upload(on_load)

    def reset(self) -> None:
        """Put every live parameter back to what this cell began with."""
        now, then = keys(self.config), keys(self.start)
        self._apply(ordered(self.config, {key: then[key] for key in now if now[key] != then[key]})[0])

    def _load(self, client: viser.ClientHandle, name: str, content: bytes) -> None:
        try:
            found = sift(content.decode(), self.config)
        except (ConfigError, UnicodeDecodeError) as error:
            self._journal.refuse(f"{name} is no settings file: {error}")
            client.add_notification("No settings file", f"{name}: {error}", color="red", auto_close_seconds=10.0)
            return
        if found.trouble:
            self._ask(client, name, found)
        else:
            self._take(client, name, found.changes)

    def _ask(self, client: viser.ClientHandle, name: str, found: Found) -> None:
        """What cannot be taken is named to whoever loads the file; the rest waits for a yes."""
        lines = [escape(line) for line in found.trouble[:MOST_TROUBLE]]
        if len(found.trouble) > MOST_TROUBLE:
            lines.append(f"and {len(found.trouble) - MOST_TROUBLE} more")
        modal, rest = client.gui.add_modal(name), len(found.changes)
        with modal:
            client.gui.add_html(
                f'<div class="eb-trouble-list">Of this file cannot be taken:<ul><li>{"<li>".join(lines)}</ul></div>')
            apply = client.gui.add_button(f"Apply the other {rest}" if rest != 1 else "Apply the other one", visible=rest > 0)
            leave = client.gui.add_button("Leave all as it is", color="gray")

        def close() -> None:
            self._guard.bind(apply, leave)
            modal.close()

        async def on_apply(_: Any) -> None:
            close()
            if self._guard.seat.admits(client.client_id):
                self._take(client, name, found.changes)
            else:
                client.add_notification(name, "Not taken: somebody else drives", color="red", auto_close_seconds=10.0)

        async def on_leave(_: Any) -> None:
            close()

        # The question covers the page: it can be closed also by who has lost the seat meanwhile.
        self._guard.free(apply, leave)
        apply.on_click(on_apply)
        leave.on_click(on_leave)

    def _take(self, client: viser.ClientHandle, name: str, changes: tuple[tuple[str, Any], ...]) -> None:
        if not self._apply(changes):
            client.add_notification(name, "Not taken: the cell is not running", color="red", auto_close_seconds=10.0)
            return
        told = f"{len(changes)} parameter{'s' if len(changes) != 1 else ''} changed"
        self._journal.tell(f"{name}: {told}")
        client.add_notification(name, told, color="green", auto_close_seconds=5.0)

    def _apply(self, changes: tuple[tuple[str, Any], ...]) -> bool:
        """Hand the changes to the cell, and say whether it is there to take them."""
        try:
            for key, value in changes:
                self._session.put(SetParameter(key, value))
        except HrcError as error:
            self._journal.refuse(str(error))
            return False
        return True
