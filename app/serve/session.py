"""The thread that owns the cell. Everybody else puts events, or asks for another scenario; nobody else steps it."""

import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from app.serve.driver import STOPPED, Phase, Status
from app.serve.mailbox import Mailbox
from app.serve.stopwatch import Rendering, TimedCell
from app.settings import changed
from hrc.cell import scenario
from hrc.cell.pace import RealTime
from hrc.cell.run import Inbox, Observer, run
from hrc.cell.scenario import Scenario
from hrc.config import Config
from hrc.events import Event, MoveCamera, MoveObstacle, MoveTarget, Press, Pull, Reset, Resume, Stop
from hrc.messages import Snapshot

HOME: dict[str, tuple[float, float, float]] = {
    "ball": (-0.35, 0.55, 0.35), "block": (-0.75, -0.55, 0.30), "slab": (-0.25, -0.60, 0.35), "hand": (0.15, 0.55, 0.35),
    "forearm": (0.15, -0.55, 0.35), "figure": (-1.25, 0.35, 0.45)}
"""Where an obstacle is brought in [m]: within reach of the mouse, out of reach of the arm on its path."""


class _Shield:
    """Hands snapshots on to an observer until it fails; from then on the cell goes without it."""

    def __init__(self, observer: Observer, say: Callable[[str], None]) -> None:
        self._observer: Observer | None = observer
        self._say = say

    def on_step(self, snapshot: Snapshot) -> None:
        if self._observer is None:
            return
        try:
            self._observer.on_step(snapshot)
        except Exception as error:  # whatever it is, the arm must not suffer from who looks on
            name, self._observer = type(self._observer).__name__, None
            traceback.print_exc(file=sys.stderr)
            self._say(f"{name} failed ({type(error).__name__}: {error}) and is left out; the cell goes on")


def _supersedes(event: Event, waiting: Event) -> bool:
    """Whether an event says all that one before it said that nothing has come of yet: where the same thing is dragged."""
    match event, waiting:
        case Pull(link, point), Pull(before, there):
            return (link, point) == (before, there)
        case MoveTarget(), MoveTarget():
            return True
        case MoveObstacle(name, _, turned), MoveObstacle(before, _, was):
            return name == before and (turned is not None or was is None)
        case MoveCamera(name), MoveCamera(before):
            return name == before
        case _:
            return False


class PageInbox(Inbox):
    """Remembers what it gave out for the step that is being taken: if that step fails, no snapshot tells of it.

    alive: when that was [s, monotonic].
    """

    def __init__(self, script: Scenario, base_hz: int) -> None:
        super().__init__(script, base_hz)
        self.given: list[Event] = []
        self.alive = time.monotonic()

    def put(self, event: Event) -> None:
        """An event for the next tick; of a drag that goes on while time stands still, the newest is kept."""
        try:
            if _supersedes(event, self._put[-1]):
                self._put[-1] = event
                return
        except IndexError:  # there is none, or it has just been taken
            pass
        super().put(event)

    def take(self, tick: int) -> list[Event]:
        """Everything due before the step that follows `tick`."""
        self.alive = time.monotonic()
        due = super().take(tick)
        self.given = due.copy() if tick else self.given + due  # at tick 0 once more in the same step, after a Reset
        return due


def configured(name: str, settings: Mapping[str, Any], seed: int) -> Config:
    """The config that a scenario runs with, settings over it. Raises ScenarioError or ConfigError."""
    return changed(scenario.load(name).configured(Config().replace(seed=seed)), settings.items())


class Session:
    """A cell that runs in real time in a thread of its own, one scenario after another.

    settings: `group.name` -> value, over each scenario's own. say: told what is going on, for the terminal.
    observers: see every snapshot beside the mailbox; one that fails is left out.
    scenario: the one asked for last. config: the running cell's, at its start; None before the first.
    """

    def __init__(self, mailbox: Mailbox, *, device: str = "cpu", settings: Mapping[str, Any] | None = None,
                 seed: int = 0, say: Callable[[str], None] = print, observers: Sequence[Observer] = ()) -> None:
        self.config: Config | None = None
        self.scenario = ""
        self.status = Status(Phase.STARTING, "starting")
        self._mailbox, self._device, self._seed, self._say = mailbox, device, seed, say
        self._observers = (mailbox, *(_Shield(observer, say) for observer in observers))
        self._settings = dict(settings or {})
        self._wanted: queue.Queue[str | None] = queue.Queue()
        self._lock = threading.Lock()  # what is put, or asked for, belongs to one cell or to the next
        self._inbox: PageInbox | None = None
        self._stop: Stop | None = None
        self._wait = False  # whether the cell that is being built shall begin paused
        self._pacer = RealTime()
        self._alive = time.monotonic()
        self._welcome: tuple[Event, ...] = ()
        self._cell: TimedCell | None = None
        self._rendering = Rendering() if device == "cpu" else None  # a GPU leaves the host little to do
        self._thread = threading.Thread(target=self._loop, name="cell", daemon=True)

    def start(self, name: str) -> None:
        """Begin with a scenario."""
        self.open(name)
        self._thread.start()

    def open(self, name: str) -> None:
        """Leave the running cell and start another with this scenario."""
        with self._lock:
            self.scenario, self.status = name, Status(Phase.STARTING, f'starting "{name}"')
            self._wait = False
            self._wanted.put(name)

    def close(self) -> None:
        """Stop stepping and end the thread."""
        self._wanted.put(None)
        self._thread.join(timeout=5.0)

    def put(self, event: Event) -> None:
        """An event for the next step. Raises HrcError while no cell runs.

        A Stop for a cell that is still being built waits for it: the arm stands from its first step on.
        For a Stop, Resume or Reset a paused cell takes one control cycle, so that it takes hold at once.
        """
        with self._lock:
            if self.status.phase is Phase.STARTING and isinstance(event, Stop):
                self._stop, self.status = event, STOPPED
                return
            if self._inbox is None or self.config is None or self.status.phase is not Phase.RUNNING:
                raise self.status.refusal
            self._inbox.put(event)
        if self._pacer.paused and isinstance(event, (Stop, Resume, Reset)):
            self._pacer.step_once(self.config.rates.base_hz // self.config.rates.control_hz)

    def reset(self) -> None:
        """Back to the start of the scenario; a cell that failed is made anew."""
        if self.status.phase is Phase.FAILED:
            self.open(self.scenario)
            return
        self.put(Reset())
        for event in self._welcome:
            self.put(event)

    @property
    def paused(self) -> bool:
        """Whether simulated time stands still."""
        return self._pacer.paused

    @paused.setter
    def paused(self, paused: bool) -> None:
        with self._lock:
            self._wait = paused and self.status.phase is Phase.STARTING
            self._pacer.paused = paused

    def step(self, ticks: int) -> None:
        """Pause, and take so many steps."""
        self.paused = True
        self._pacer.step_once(ticks)

    def watch(self, hz: int) -> None:
        """Nothing: what is looked at is here anyway."""

    @property
    def speed(self) -> float:
        """Simulated seconds per second that are asked for."""
        return self._pacer.speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._pacer.speed = speed

    @property
    def factor(self) -> float:
        """Simulated seconds per second that are reached."""
        return self._pacer.factor

    @property
    def capped(self) -> bool:
        """Whether the machine is too slow: steps are dropped, and enough of them to see."""
        return self._pacer.capped and self._pacer.factor < 0.97 * self._pacer.speed

    @property
    def healthy(self) -> bool:
        """Whether the cell's thread has come round lately, paused or not, and its cell has not failed."""
        return self.status.well(self.silence)

    @property
    def silence(self) -> float:
        """For how long the cell's thread has not come round [s]; it does so with each step, or while there is none to take."""
        inbox = self._inbox
        return time.monotonic() - (self._alive if inbox is None else max(self._alive, inbox.alive))

    def stages(self) -> Mapping[str, tuple[float, float]]:
        """Of each stage of the cell the time of one run [s], and its part of a core."""
        return self._cell.stages() if self._cell is not None else {}

    def _loop(self) -> None:
        while (name := self._wanted.get()) is not None:
            try:
                self._drive(name)
            except Exception as error:  # whatever broke the cell, the page lives on and says so
                traceback.print_exc(file=sys.stderr)
                what = f"{type(error).__name__}: {error}"
                self._mailbox.fail(self._inbox.given if self._inbox is not None else (), f"the cell failed ({what})")
                with self._lock:
                    if self._wanted.empty():  # else somebody has already chosen again
                        self.status = Status(Phase.FAILED, f"{what}. Reset or choose a scenario.")
                self._say(f"the cell failed ({what}); the page lives on")
            self._inbox = None
        self.status = Status(Phase.CLOSED, "the server is closing")

    def _drive(self, name: str) -> None:
        self._alive = time.monotonic()
        if not self._wanted.empty():  # somebody has already chosen again
            return
        self._mailbox.clear()
        note = "building the cell and compiling its kernels (about 5 s the first time)"
        with self._lock:
            if self._stop is None:
                self.status = Status(Phase.STARTING, f'"{name}": {note}')
        self._say(f'starting "{name}": {note} ...')
        script, config = scenario.load(name), configured(name, self._settings, self._seed)
        cell = self._cell = TimedCell(config, self._device, self._rendering)
        brought = any(isinstance(event, (Press, MoveObstacle)) for _, event in script.events)
        self._welcome = () if brought else (MoveObstacle("ball", HOME["ball"]),)
        base_hz = config.rates.base_hz
        pacer, inbox = RealTime(base_hz, self._pacer.speed), PageInbox(script, base_hz)
        with self._lock:
            if not self._wanted.empty():
                return
            for event in (*self._welcome, *filter(None, [self._stop])):
                inbox.put(event)
            if self._wait:
                pacer.paused = True
                pacer.step_once(1)  # so that there is something to see
            self.config, self._pacer, self._inbox, self._stop = config, pacer, inbox, None
            self.status = Status(Phase.RUNNING)
        self._say(f'"{name}" is running')
        run(cell, pacer, inbox, self._observers, until=sys.maxsize, stopped=self._stopped)

    def _stopped(self) -> bool:
        """Asked each time round."""
        self._alive = time.monotonic()
        return not self._wanted.empty()
