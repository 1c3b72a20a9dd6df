"""The cell in a process of its own, as the page's process sees it: what is wanted goes there, what is new comes back."""

import contextlib
import itertools
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import replace
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.record.shelf import ArchiveError, Progress, Shelf
from app.serve import spare
from app.serve.driver import STOPPED, Phase, Status
from app.serve.mailbox import Mailbox
from app.serve.process import SIGN, Order
from app.serve.wire import Answer, Call, CutError, Over, Pulse, Said, State, Wire, with_images
from hrc.config import Config
from hrc.errors import HrcError
from hrc.events import Event, Stop

if TYPE_CHECKING:
    from app.record.recorder import Depth

FAREWELL, BRIEF = 60.0, 5.0
"""For how long the process may take to end [s], with a recording to finish and without; then it is killed."""
PATIENCE = 300.0
"""For how long an answer may take [s]: the end of a long recording does."""
NOTHING = State(Status(Phase.STARTING, "starting"), paused=False, speed=1.0, factor=0.0, capped=False, silence=0.0, stages={})


class RemoteCell:
    """A `Driver` of a cell in another process, which is started with the first scenario, and anew where it has gone.

    mailbox: what the page shows. say: told what is going on. archive: the cell's recordings.
    """

    def __init__(self, mailbox: Mailbox, order: Order, *, say: Callable[[str], None] = print) -> None:
        self.config: Config | None = None
        self.scenario = ""
        self.archive = RemoteArchive(order.recordings, self.call)
        self._mailbox, self._order, self._say = mailbox, order, say
        self._lock = threading.RLock()  # calls go out in the order of their numbers
        self._numbers = itertools.count(1)
        self._asked: dict[int, _Question] = {}
        self._state, self._at = NOTHING, time.monotonic()
        self._since = 0  # a pulse tells nothing of the state until this call has been heard
        self._outbox: queue.SimpleQueue[Call | None] | None = None
        self._process: BaseProcess | None = None
        self._closing = False
        self._looked = 0
        self._next = 0.0

    # -- what the page wants ----------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Start the process, if there is none, so that it loads while the page is built."""
        with self._lock:
            if self._process is not None or self._closing:
                return
            process, link = spare.taken()
            wire = Wire(link)
            with contextlib.suppress(CutError):  # whoever reads finds out, too, and says so
                wire.send(self._order)
            self._process, self._outbox = process, queue.SimpleQueue()
            for act, *means in ((self._read, wire, process), (self._write, wire, self._outbox)):
                threading.Thread(target=act, args=means, name="cell's wire", daemon=True).start()
            if self.speed != 1.0:
                self._tell("speed", self.speed)

    def start(self, name: str) -> None:
        """Begin with a scenario."""
        self.open(name)

    def open(self, name: str) -> None:
        """Leave the running cell and start another with this scenario."""
        with self._lock:
            self.prepare()
            self.scenario = name
            self._become(status=Status(Phase.STARTING, f'starting "{name}"'), paused=False)
            self._tell("open", name)

    def close(self) -> None:
        """Stop stepping, finish the recording, end the process."""
        with self._lock:
            self._closing, process = True, self._process
            self._tell("leave")
        if process is not None:
            process.join(BRIEF if self.archive.now is None else FAREWELL)
            if process.is_alive():
                process.kill()
                process.join()
        self._become(status=Status(Phase.CLOSED, "the server is closing"))

    def put(self, event: Event) -> None:
        """An event for the next step. Raises HrcError while no cell runs, save for a Stop while one is built."""
        with self._lock:
            starting = self.status.phase is Phase.STARTING and isinstance(event, Stop)
            if not starting and (self.config is None or self.status.phase is not Phase.RUNNING):
                raise self.status.refusal
            if starting:
                self._tell("put", event)
                self._become(status=STOPPED)
            else:
                self._send(Call(next(self._numbers), "put", (event,)))

    def reset(self) -> None:
        """Back to the start of the scenario; a cell that failed is made anew."""
        with self._lock:
            if self.status.phase is Phase.FAILED:
                self.open(self.scenario)
            elif self.config is None or self.status.phase is not Phase.RUNNING:
                raise self.status.refusal
            else:
                self._send(Call(next(self._numbers), "reset"))

    def step(self, ticks: int) -> None:
        """Pause, and take so many steps."""
        with self._lock:
            self._tell("step", ticks)
            self._become(paused=True)

    @property
    def paused(self) -> bool:
        """Whether simulated time stands still."""
        return self._state.paused

    @paused.setter
    def paused(self, paused: bool) -> None:
        with self._lock:
            self._tell("pause", paused)
            self._become(paused=paused)

    @property
    def speed(self) -> float:
        """Simulated seconds per second that are asked for."""
        return self._state.speed

    @speed.setter
    def speed(self, speed: float) -> None:
        with self._lock:
            self._tell("speed", speed)
            self._become(speed=speed)

    def watch(self, hz: int) -> None:
        """How often somebody looks [Hz], and so how often the cell tells what is new. 0: nobody, so that no images are sent.

        To be told again and again, or the cell takes the page for gone.
        """
        if hz != self._looked or time.monotonic() >= self._next:
            with self._lock:
                self._looked, self._next = hz, time.monotonic() + SIGN
                self._send(Call(next(self._numbers), "watched", (hz,)))

    def call(self, what: str, *arguments: Any) -> Any:
        """Have something done there, and wait for what comes of it. Raises what it raises, or HrcError if nobody answers."""
        question = _Question()
        with self._lock:
            if self._outbox is None:
                raise HrcError(f"the cell is gone ({self.status.text})")
            number = next(self._numbers)
            self._asked[number] = question
            self._send(Call(number, what, arguments, answer=True))
        try:
            return question.answered(PATIENCE)
        finally:
            self._asked.pop(number, None)

    def ask(self, what: str) -> Any:
        """The answer of the cell's witness (`Order.witness`)."""
        return self.call("ask", what)

    # -- how it is --------------------------------------------------------------------------------------------------

    @property
    def status(self) -> Status:
        """The phase, and a line about it."""
        return self._state.status

    @property
    def factor(self) -> float:
        """Simulated seconds per second that are reached."""
        return self._state.factor

    @property
    def capped(self) -> bool:
        """Whether the machine is too slow: steps are dropped, and enough of them to see."""
        return self._state.capped

    @property
    def silence(self) -> float:
        """For how long the cell has given no sign of life, its process included [s]."""
        return self._state.silence + time.monotonic() - self._at

    @property
    def healthy(self) -> bool:
        """Whether the cell has given a sign of life lately, paused or not, and has not failed."""
        return self.status.well(self.silence)

    def stages(self) -> Mapping[str, tuple[float, float]]:
        """Of each stage of the cell the time of one run [s], and its part of a core."""
        return self._state.stages

    @property
    def pid(self) -> int | None:
        """Of the cell's process."""
        return self._process.pid if self._process is not None else None

    # -- there and back ---------------------------------------------------------------------------------------------

    def _become(self, **changes: Any) -> None:
        """What is asked for holds at once; what the cell says of it counts again when it has heard of it."""
        with self._lock:
            self._state = replace(self._state, **changes)

    def _tell(self, what: str, *arguments: Any) -> None:
        """A call that changes the state."""
        self._since = next(self._numbers)
        self._send(Call(self._since, what, arguments))

    def _send(self, call: Call) -> None:
        """Post it: a process that takes nothing keeps nobody waiting here."""
        if self._outbox is not None:
            self._outbox.put(call)

    @staticmethod
    def _write(wire: Wire, outbox: "queue.SimpleQueue[Call | None]") -> None:
        with contextlib.suppress(CutError):  # whoever reads finds out, too, and says so
            while (call := outbox.get()) is not None:
                wire.send(call)

    def _read(self, wire: Wire, process: BaseProcess) -> None:
        with contextlib.suppress(CutError):
            while True:
                try:
                    self._take(wire.receive())
                except (CutError, MemoryError):
                    raise
                except Exception:  # one message that nobody can make use of must not end the page
                    traceback.print_exc(file=sys.stderr)
        self._lost(process)

    def _take(self, message: object) -> None:
        if isinstance(message, Pulse):
            self._feel(message)
        elif isinstance(message, Said):
            self._say(message.line)
        elif isinstance(message, Over):
            self.archive.now = None
            self.archive.over(message.told)
        elif isinstance(message, Answer):
            question = self._asked.get(message.number)
            if question is not None:
                question.settle(message)

    def _feel(self, pulse: Pulse) -> None:
        with self._lock:
            if pulse.config is not None:
                self.config = pulse.config
            self._at = time.monotonic()
            if pulse.heard >= self._since:
                self._state = pulse.state
        before = self._mailbox.latest
        latest = pulse.snapshot
        if pulse.same:
            latest = before
        elif latest is not None:
            latest = with_images(latest, before, own=pulse.images)
        self.archive.now = pulse.recording
        self._mailbox.deliver(pulse.notes, pulse.forces, latest, begun=pulse.begun)

    def _lost(self, process: BaseProcess) -> None:
        """The process has ended; as a rule because it was told to."""
        process.join(FAREWELL)
        why = f"its process has ended, exit code {process.exitcode}"
        with self._lock:
            asked, self._asked = list(self._asked.values()), {}
            if self._outbox is not None:
                self._outbox.put(None)
            if not self._closing:
                self._outbox = self._process = self.archive.now = None
                self._mailbox.fail((), f"the cell failed ({why})")
                self._become(status=Status(Phase.FAILED, f"{why}. Reset or choose a scenario."))
                self._say(f"the cell failed ({why}); the page lives on")
        for question in asked:
            question.settle(Answer(0, error=HrcError(f"the cell is gone ({why})")))


class _Question:
    """One that somebody waits for the answer of."""

    def __init__(self) -> None:
        self._settled = threading.Event()
        self._answer: Answer | None = None

    def settle(self, answer: Answer) -> None:
        self._answer = answer
        self._settled.set()

    def answered(self, patience: float) -> Any:
        self._settled.wait(patience)
        if self._answer is None:
            raise HrcError(f"the cell's process has not answered for {patience:g} s")
        if self._answer.error is not None:
            raise self._answer.error
        return self._answer.result


class RemoteArchive(Shelf):
    """The recordings, of which the other process makes one at a time."""

    def __init__(self, root: Path, call: Callable[..., Any]) -> None:
        super().__init__(root)
        self._call, self._now = call, None
        self.over: Callable[[str], None] = lambda _: None
        """Told, on another thread, when a recording has ended by itself, and why."""

    @property
    def now(self) -> Progress | None:
        """The recording that is being made, which is not among the others yet."""
        return self._now

    @now.setter
    def now(self, now: Progress | None) -> None:
        self._now = now

    def start(self, scenario: str, config: Config, about: Mapping[str, Any], depth: "Depth") -> str:
        """Record from the next step on; the name. Raises ArchiveError or RecordingError if that cannot be."""
        name = self._call("record", scenario, config, dict(about), depth)
        self._now = Progress(self.root / name)
        return name

    def stop(self) -> str:
        """Finish the recording; the problem, if there was one. Raises ArchiveError if there is none."""
        if self._now is None:
            raise ArchiveError("nothing is being recorded")
        problem = self._call("end")
        self._now = None
        return problem

    def warm(self) -> None:
        """Load what the first recording needs, so that whoever asks for it need not wait."""
        self._call("warm")

    def close(self) -> None:
        """Nothing: the process finishes what is being recorded when it ends."""
