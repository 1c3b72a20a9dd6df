"""Recordings on the page: start and stop, how long and large, and a list from which they are opened, downloaded or deleted."""

import asyncio
import contextlib
import threading
import time
from html import escape
from typing import Any

import viser

from app.headless import versions
from app.record.archive import Archive
from app.review import LOOPBACK, Server, recordings, viewer
from app.serve import download
from app.serve.driver import Driver, Phase
from app.serve.journal import Journal
from app.serve.remote import RemoteArchive
from hrc.errors import HrcError
from hrc.messages import Snapshot

NONE: str = "-"
"""Choice in the list while there is no recording."""
START, STOP = "Record", "End the recording"
LOAD_AFTER = 8.0
"""For how long the arm must have been left alone before the recorder is loaded [s]: a click need not wait for it then, and who
pushes the arm loses nothing to it."""


class RecordingControls:
    """The widgets; `add` makes them inside the container they belong to. local: the page is for this machine alone."""

    def __init__(self, server: viser.ViserServer, session: Driver, archive: Archive | RemoteArchive, journal: Journal, *,
                 local: bool) -> None:
        self._server, self._session, self.archive, self._journal = server, session, archive, journal
        self._local = local
        self._reviewed: Server | None = None
        self._note, self._problem, self._busy = "", "", False
        self._doomed = ""  # the recording that one more press of Delete removes
        self._loading: threading.Thread | None = None
        self._alone_since: float | None = None
        archive.over = self._over

    def add(self) -> None:
        """Button, state, and list."""
        gui = self._server.gui
        self._depth = gui.add_dropdown("Images", ("sampled", "full", "none"), initial_value="sampled",
                                       hint="Depth images to keep: 5 a second, all, or none")
        self._start = gui.add_button(START, icon=viser.Icon.PLAYER_RECORD,
                                     hint="Keeps everything the page shows, and what it takes to run it again")
        self._stop = gui.add_button(STOP, color="gray", icon=viser.Icon.PLAYER_STOP, visible=False)
        self._state = gui.add_html("")
        self._list: viser.GuiDropdownHandle[str] = gui.add_dropdown("Recording", (NONE,))
        self._acts = (
            gui.add_button("Review", icon=viser.Icon.EYE, hint="Opens the recording in Rerun's viewer"),
            gui.add_button("Download", icon=viser.Icon.DOWNLOAD, hint="As a zip file"),
            gui.add_button("Delete", color="gray", icon=viser.Icon.TRASH, hint="Removes it from the disk"))
        for button, act in ((self._start, self._begin), (self._stop, self._end),
                            *zip(self._acts, (self._review, self._download, self._delete), strict=True)):
            button.on_click(self._tried(act))
        self._show_list()

    def update(self, snapshot: Snapshot | None) -> None:
        """What is being recorded, as it is now. snapshot: how the cell is."""
        if self._loading is None:
            self._load_when_alone(snapshot)
        now = self.archive.now
        self._start.visible, self._stop.visible = now is None, now is not None
        self._start.disabled = self._stop.disabled = self._busy
        if now is not None:
            dropped = f", {now.images_dropped} images dropped" if now.images_dropped else ""
            self._note = (f'<b>REC</b> {escape(now.folder.name)}: {_length(now.seconds)}, '
                          f"{now.bytes / 1e6:.1f} MB{dropped}")
        problem = f'<div style="color: #e5484d">{escape(self._problem)}</div>' if self._problem else ""
        self._state.content = (f'<div id="eb-recording" class="eb-small" data-recording="{str(now is not None).lower()}">'
                               f"{self._note}{problem}</div>")

    def close(self) -> None:
        """Finish what is being recorded; the viewer goes, too."""
        if self._loading is not None:
            self._loading.join()
        self.archive.close()
        if self._reviewed is not None:
            self._reviewed.shutdown()
            self._reviewed.server_close()

    def _load_when_alone(self, snapshot: Snapshot | None) -> None:
        """While the arm is pushed, all of a slow core's time is the cell's."""
        runs = self._session.status.phase is Phase.RUNNING
        if snapshot is None or not runs or snapshot.detected or snapshot.pull is not None:
            self._alone_since = None
        elif self._alone_since is None:
            self._alone_since = time.monotonic()
        elif time.monotonic() - self._alone_since > LOAD_AFTER:
            self._loading = threading.Thread(target=self._warm, name="load the recorder", daemon=True)
            self._loading.start()

    def _warm(self) -> None:
        with contextlib.suppress(HrcError):  # a cell that has gone meanwhile says so elsewhere
            self.archive.warm()

    def _tried(self, act: Any) -> Any:
        async def on_click(event: viser.GuiEvent[Any]) -> None:
            if self._busy:
                return
            self._busy, self._problem = True, ""
            if act != self._delete:
                self._doomed = ""
            try:
                await asyncio.to_thread(act, event)  # it may take a second
            except (HrcError, OSError, ModuleNotFoundError) as error:
                self._problem = str(error)
                self._journal.refuse(str(error))
            finally:
                self._busy = False
                self._show_list()

        return on_click

    def _begin(self, _: Any) -> None:
        config, depth = self._session.config, self._depth.value
        if config is None or self._session.status.phase is not Phase.RUNNING:
            raise HrcError(f"there is nothing to record: the cell is not running ({self._session.status.text})")
        name = self.archive.start(self._session.scenario, config, versions(), depth)
        self._journal.tell(f"recording {name}")

    def _end(self, _: Any) -> None:
        now = self.archive.now
        problem = self.archive.stop()
        if problem:
            raise HrcError(problem)
        if now is not None:
            self._note = f"{escape(now.folder.name)}: {_length(now.seconds)}, {self.archive.size(now.folder.name) / 1e6:.1f} MB"
            self._journal.tell(f"recorded {now.folder.name}")
            self._show_list(now.folder.name)

    def _over(self, told: str) -> None:
        self._problem = told
        self._journal.refuse(told)
        self._show_list()

    def _review(self, _: Any) -> None:
        folder = self.archive.folder(self._list.value)
        if not self._local:
            raise HrcError(f"the viewer opens only on the server's own machine, by elbowroom review {folder}; or download it")
        self._mend(folder.name)
        paths = recordings([folder])
        server = Server(paths, self._reviewed.files if self._reviewed is not None else viewer())
        threading.Thread(target=server.serve_forever, name="review", daemon=True).start()
        before, self._reviewed = self._reviewed, server
        if before is not None:
            before.shutdown()
            before.server_close()
        assert server.server_address[0] == LOOPBACK
        self._note = f'<a href="{server.url}" target="_blank" rel="noopener">Open {escape(folder.name)} in the viewer</a>'

    def _download(self, event: viser.GuiEvent[Any]) -> None:
        name = self._list.value
        self._mend(name)
        packed, size = self.archive.packed(name)
        if event.client is not None:
            download.send(self._server, event.client, f"{name}.zip", packed, size)

    def _mend(self, name: str) -> None:
        for line in self.archive.mend(name):
            self._journal.tell(line)

    def _delete(self, _: Any) -> None:
        name = self._list.value
        if name != self._doomed:
            self._doomed, self._note = name, f"Press Delete once more, and {escape(name)} is gone."
            return
        self.archive.delete(name)
        self._doomed, self._note = "", ""
        self._journal.tell(f"deleted {name}")

    def _show_list(self, chosen: str = "") -> None:
        """chosen: the recording that what follows is about; by default it stays the one that it was."""
        names = self.archive.names()
        self._list.options = tuple(names) or (NONE,)
        if chosen in names:
            self._list.value = chosen
        elif self._list.value not in self._list.options:
            self._list.value = self._list.options[0]
        for button in self._acts:
            button.disabled = not names


def _length(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
