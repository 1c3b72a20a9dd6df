"""`elbowroom serve`: the page, its cell, and how they start and stop."""

import contextlib
import io
import signal
import sys
import time
import warnings
import webbrowser
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from app.record.archive import Archive
from app.serve.access import Access
from app.serve.address import is_loopback
from app.serve.cameras import CameraView
from app.serve.demo import Demo
from app.serve.distances import DistanceView
from app.serve.forces import ForceView
from app.serve.guard import Guard
from app.serve.hands import Hands
from app.serve.heap import Holes
from app.serve.icons import opened_once
from app.serve.journal import Journal
from app.serve.mailbox import Mailbox
from app.serve.obstacles import ObstacleControls
from app.serve.panel import Panel
from app.serve.placing import CameraControls
from app.serve.process import SWITCH, Order, Witness
from app.serve.publisher import Publisher, Screen
from app.serve.recordings import RecordingControls
from app.serve.remote import RemoteCell
from app.serve.results import ResultsView, read
from app.serve.scene import SceneView
from app.serve.seat_box import SeatBox
from app.serve.selection import Selection
from app.serve.session import Session, configured
from app.serve.signals import SignalView
from app.serve.steering import Steering
from app.serve.tempo import Tempo
from app.serve.theme import Theme
from app.serve.tuning import Tuning
from hrc.cell import scenario as scenarios
from hrc.cell.eyes import rig
from hrc.cell.run import Observer
from hrc.messages import Snapshot
from hrc.vision.kernels import check_device

OWN = Access()
RECORDINGS = Path("recordings")


class Page:
    """One server, one cell, any number of browsers."""

    @opened_once()
    def __init__(self, scenario: str = "free", access: Access = OWN, *, device: str = "cpu",
                 settings: Mapping[str, Any] | Iterable[tuple[str, Any]] = (), seed: int = 0,
                 say: Callable[[str], None] = print, observers: Sequence[Observer] | None = None,
                 witness: Callable[[], Witness] | None = None, recordings: Path = RECORDINGS,
                 results: Path | None = None) -> None:
        """Bind the port and build the page; the cell starts with `start`.

        access: where it is served, and to whom; by default to this machine. The cell runs in a process of its own, where the
        witness sees every snapshot, if one is to be made; with observers it runs in a thread of this one, and they see them.
        recordings: folder for what is recorded, made with the first. results: folder of a campaign, shown on the robot.
        Raises ScenarioError, ConfigError, AssetError or DeviceError for what cannot be run, PageError for an address that
        cannot be served, and HrcError for results that are none.
        """
        self._holes = Holes()
        check_device(device)
        fields = read(results) if results is not None else []
        self._mailbox = mailbox = Mailbox()
        self.journal = Journal(lambda: mailbox.latest.time if mailbox.latest is not None else 0.0)
        settings = dict(settings)
        config = configured(scenario, settings, seed)
        rig(config)
        if observers is None:
            order = Order(recordings, device, tuple(settings.items()), seed, witness)
            self.session = RemoteCell(mailbox, order, say=say)
            archive = self.session.archive
        else:
            archive = Archive(recordings, device)
            self.session = Session(mailbox, device=device, settings=settings, seed=seed, say=say,
                                   observers=(archive, *observers))
        self.guard = Guard(access.keys, names=access.names, tls=access.tls, healthy=lambda: self.session.healthy)
        self.server = self.guard.open(access.host, access.port, "Elbowroom")
        if isinstance(self.session, RemoteCell):
            self.session.prepare()
        self.url, self.watch_url = access.urls(self.server.get_port())
        self._scenario, self._switched = scenario, sys.getswitchinterval()
        theme = Theme(self.server)
        view, forces, cameras = SceneView(self.server), ForceView(self.server), CameraView(self.server)
        distances, signals = DistanceView(self.server), SignalView(self.server)
        self._obstacles = obstacles = ObstacleControls(self.server, self.session, view, self.journal.refuse)
        placing = CameraControls(self.server, self.session, self.journal.refuse)
        steering = Steering(self.server, self.session, self.journal.refuse)
        tuning = Tuning(self.server, self.session, config, self.journal, self.guard)
        demo = Demo(self.server, self.session, self.journal.refuse)
        self.recordings = RecordingControls(self.server, self.session, archive, self.journal, local=is_loopback(access.host))
        listed = dict.fromkeys((*scenarios.names(), scenario))
        layers = {
            "Forces": _switch(forces, "show_forces"), "Distances and touches": _switch(distances, "show_distances"),
            "Foreground points": _switch(cameras, "show_cloud"), "Depth cameras": _switch(cameras, "show_cameras"),
            "Camera images": _switch(signals.images, "show_images"), "Path of the tool": _switch(view, "show_trail")}
        panel = Panel(self.server, self.session, scenarios=tuple(listed), scenario=scenario, config=config, look=view.look,
                      layers=layers, obstacles=obstacles, placing=placing, steering=steering, tuning=tuning, demo=demo,
                      theme=theme, recordings=self.recordings, journal=self.journal,
                      results=ResultsView(self.server, view, fields) if fields else None)
        self._hands = Hands(self.server, self.session, view, self.journal.refuse)
        self.guard.free(*panel.for_all)
        self.guard.seat.on_left(self._hands.let_go_of)
        self.guard.seat.on_left(obstacles.let_go_of)
        self.seat_box = SeatBox(self.guard, self.server, panel.seat, self.journal.tell)
        screen = Screen(view, forces, cameras, distances, obstacles, placing, steering, panel, signals, tuning, demo,
                        Selection(view), self.journal, self.seat_box)
        # A cell in this process takes more of it than the page may; fewer pictures would not help it.
        self.tempo = Tempo() if observers is None else Tempo(lambda: 0.0)
        self._publisher = Publisher(self.server, self.session, mailbox, screen, config, self.tempo)

    @property
    def latest(self) -> Snapshot | None:
        """What is to be seen now; None until a cell has taken its first step."""
        return self._mailbox.latest

    def start(self) -> None:
        """Publish, and start the cell; returns at once."""
        self._switched = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH)
        self._publisher.start()
        self._holes.start()
        self.session.start(self._scenario)

    def close(self) -> None:
        """Stop the cell, then the page."""
        self._hands.close()
        self._obstacles.close()
        self.session.close()
        self._publisher.close()
        self._holes.close()
        self.recordings.close()
        sys.setswitchinterval(self._switched)
        with contextlib.redirect_stdout(io.StringIO()):  # viser announces its end on stdout
            self.server.stop()


def _switch(part: object, name: str) -> Callable[[bool], None]:
    """What a checkbox does: show a part of the screen, or not."""
    return lambda shown: setattr(part, name, shown)


def serve(scenario: str = "free", access: Access = OWN, device: str = "cpu",
          settings: Mapping[str, Any] | Iterable[tuple[str, Any]] = (), seed: int = 0, open_browser: bool = False,
          recordings: Path = RECORDINGS, results: Path | None = None) -> None:
    """Serve the page until Ctrl-C or SIGTERM.

    access: where, and to whom. settings: parameters by key, over the scenario's own. recordings: folder for them. results: of a
    campaign, to show on the robot.

    Raises HrcError for what cannot be, before anything is served.
    """
    told: list[int] = []  # an Event would lock up for good when a second signal comes in the middle of the first one's set()
    for number in (signal.SIGINT, signal.SIGTERM):  # SIGTERM would be lost on the first process of a container
        signal.signal(number, lambda number, _: told.append(number))
    # A visitor who has just gone may be told one thing more; that it does not arrive is no news to who runs the page.
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection")
    print("loading ...", flush=True)
    page = Page(scenario, access, device=device, settings=settings, seed=seed, say=lambda line: print(line, flush=True),
                recordings=recordings, results=results)
    print(f"Elbowroom is at {page.url} (Ctrl-C ends it)", flush=True)
    if page.watch_url is not None:
        print(f"to watch only:  {page.watch_url}", flush=True)
    if access.tls is None and not is_loopback(access.host):
        print("this is plain HTTP: whoever can read the network reads the token; --tls-cert and --tls-key serve HTTPS",
              flush=True)
    page.start()
    if open_browser:
        webbrowser.open(page.url)
    while not told:
        time.sleep(0.1)
    print("stopping ...", flush=True)
    page.close()
