"""The thread that tells the browsers: reads the mailbox, writes the scene and the panels, each at its own rate.

It never touches the cell. It skips frames when it is late, and does nothing for a scene that nobody looks at.
"""

import sys
import threading
import time
import traceback
from dataclasses import dataclass

import viser

from app.serve.cameras import CameraView
from app.serve.demo import Demo
from app.serve.distances import DistanceView
from app.serve.driver import Driver
from app.serve.forces import ForceView
from app.serve.journal import Journal
from app.serve.mailbox import Mailbox
from app.serve.obstacles import ObstacleControls
from app.serve.panel import Panel
from app.serve.placing import CameraControls
from app.serve.scene import SceneView
from app.serve.seat_box import SeatBox
from app.serve.selection import Selection
from app.serve.signals import SignalView
from app.serve.steering import Steering
from app.serve.tempo import Tempo
from app.serve.tuning import Tuning
from hrc.cell.eyes import rig
from hrc.config import Config
from hrc.errors import ConfigError
from hrc.events import Event, Reset, SetParameter
from hrc.messages import Snapshot
from hrc.parameters import replaced
from hrc.scene import load_scene

CLOUD_EVERY, IMAGE_EVERY, PANEL_EVERY, NUMBERS_EVERY, TRAIL_EVERY, SEAT_EVERY = 2, 3, 3, 6, 6, 30
"""In beats, of which there are thirty a second if the machine is quick enough: cloud 15 Hz then, camera images, banner and plot
10 Hz, numbers and tool path 5 Hz, the seat 1 Hz."""
GAP = 0.02
"""Between two beats, however late they are [s]: viser sends only then, and looks 60 times a second."""


@dataclass
class Screen:
    """The parts of the page that follow the cell."""

    view: SceneView
    forces: ForceView
    cameras: CameraView
    distances: DistanceView
    obstacles: ObstacleControls
    placing: CameraControls
    steering: Steering
    panel: Panel
    signals: SignalView
    tuning: Tuning
    demo: Demo
    selection: Selection
    journal: Journal
    seat: SeatBox


class Publisher:
    """Publishes until it is closed, at a tempo. config: what the screen shows until the first cell runs."""

    def __init__(self, server: viser.ViserServer, session: Driver, mailbox: Mailbox, screen: Screen,
                 config: Config, tempo: Tempo) -> None:
        self._server, self._session, self._mailbox, self._screen = server, session, mailbox, screen
        self._begun: Config | None = None
        self._tempo = tempo
        self._begin(config)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="publisher", daemon=True)

    def start(self) -> None:
        """Begin to publish."""
        self._thread.start()

    def close(self) -> None:
        """Stop publishing."""
        self._closing.set()
        self._thread.join(timeout=5.0)

    def _loop(self) -> None:
        beat, due = 0, time.monotonic()
        self._tempo.begin()
        while not self._closing.wait(max(GAP, due - time.monotonic())):
            due = max(due + 1.0 / self._tempo.hz, time.monotonic())
            beat += 1
            self._tempo.beat()
            try:
                with self._server.atomic():  # one frame for each browser, and one wake-up of the sockets' thread
                    self._publish(beat)
            except Exception:  # one frame that cannot be drawn must not end the page
                traceback.print_exc(file=sys.stderr)
                self._closing.wait(1.0)

    def _publish(self, beat: int) -> None:
        if self._session.config is not None and self._session.config is not self._begun:
            self._begin(self._session.config)
        self._read_notes()
        snapshot = self._mailbox.latest  # after the notes: what they tell of has happened in it
        watched = bool(self._server.get_clients())
        self._session.watch(self._tempo.hz if watched else 0)
        if beat % PANEL_EVERY == 0:
            self._screen.panel.update(snapshot)
            self._screen.panel.update_log(snapshot)
        if beat % SEAT_EVERY == 0:
            self._screen.seat.update()
        if snapshot is not None:
            self._screen.demo.update(snapshot)
        if snapshot is not None and watched:
            self._draw(beat, snapshot)

    def _draw(self, beat: int, snapshot: Snapshot) -> None:
        self._screen.view.update_poses(snapshot)
        self._screen.view.follow(snapshot)
        self._screen.forces.update(snapshot)
        self._screen.distances.update(snapshot)
        if beat % CLOUD_EVERY == 0:
            self._screen.cameras.update(snapshot)
        if beat % PANEL_EVERY == 1:
            self._screen.obstacles.update(snapshot)
            self._screen.placing.update()
            self._screen.steering.update(snapshot)
            control = self._config.control
            self._screen.signals.update_plot(self._mailbox.forces(), control.f_relax, control.f_abort)
        if beat % NUMBERS_EVERY == 2:
            self._screen.signals.numbers.update(snapshot, self._config, self._session.stages(), self._screen.selection.link)
        if beat % IMAGE_EVERY == 1:
            self._screen.signals.images.update(snapshot)
        if beat % TRAIL_EVERY == 3:
            self._screen.view.update_trail()

    def _read_notes(self) -> None:
        """The log, and what follows from an event: sliders show what the cell has, not what was asked for."""
        for note in self._mailbox.take_notes():
            self._screen.journal.add(note)
            if isinstance(note.subject, Event):
                self._screen.steering.heard(note.subject)
                self._screen.placing.heard(note.subject, refused=bool(note.refused))
            if isinstance(note.subject, Reset) and self._begun is not None:
                self._adopt(self._begun)
                self._screen.obstacles.forget()
                self._screen.placing.forget()
                self._screen.steering.begin(self._begun)
                self._screen.demo.begin()
                self._screen.view.forget_trail()
            elif isinstance(note.subject, SetParameter):
                self._set(note.subject, refused=bool(note.refused))

    def _set(self, event: SetParameter, *, refused: bool) -> None:
        """Follow a change; one that was refused puts the slider back."""
        try:
            self._adopt(self._config if refused else replaced(self._config, event.key, event.value))
        except ConfigError as error:
            self._screen.journal.refuse(str(error))

    def _begin(self, config: Config) -> None:
        """Another cell: its scene, its cameras, its parameters, and nothing left of the one before."""
        self._begun = config
        scene = load_scene(config.scene)
        cameras = rig(config, scene)
        self._screen.view.begin(scene)
        self._screen.cameras.begin(cameras)
        self._screen.placing.begin(cameras)
        self._screen.signals.images.begin(cameras)
        self._screen.obstacles.forget()
        self._screen.steering.begin(config)
        self._screen.tuning.start = config
        self._screen.demo.begin()
        self._adopt(config)

    def _adopt(self, config: Config) -> None:
        self._config = config
        self._screen.forces.stiffness, self._screen.forces.cap = config.push.stiffness, config.push.cap
        self._screen.panel.show_parameters(config)
