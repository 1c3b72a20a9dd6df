"""The guided demo: the arm moves, a hand comes, it relaxes, aborts and resumes. A caption follows what happens, not a clock."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape

import viser

from app.serve.driver import Driver
from hrc.errors import HrcError
from hrc.events import Event, Press, RemoveObstacle, SetTask
from hrc.messages import Mode, Snapshot

SCENARIO = "free"
PATIENCE = 30.0
"""Simulated time after which a step that did not come to its end breaks the demo off [s]."""
GENTLE = Press("hand", link=3, point=(0.0, 0.0, -0.07), direction=(0.0, 1.0, 0.0), speed=0.12, depth=0.105, hold=3.5,
               stiffness=130.0, approach=2.0, aside=(0.0, -0.3, 0.0))
HARD = Press("hand", link=6, point=(0.0, 0.0, 0.0), direction=(0.0, -1.0, 0.0), speed=0.2, depth=0.15, hold=3.0,
             stiffness=600.0, approach=2.0)


@dataclass(frozen=True)
class Step:
    """A caption, what happens at its begin, what ends it, and how long it stays at least [s], simulated."""

    caption: str
    ends: Callable[[Snapshot], bool]
    events: tuple[Event, ...] = ()
    least: float = 3.0


STEPS = (
    Step("The arm draws a hexagon in the air. Nobody is near.", lambda s: s.command.mode is Mode.IDLE,
         (SetTask("hexagon"),), least=5.0),
    Step("A hand comes. The depth camera sees it: lines show how near it is.", lambda s: s.command.mode is Mode.RELAX,
         (GENTLE,), least=0.0),
    Step("RELAX: it presses on the elbow, and the joints feel with how many newtons. The elbow gives way; the tool stays on "
         "its path.", lambda s: s.command.mode is Mode.IDLE),
    Step("The hand has gone, and comes again: harder.", lambda s: s.command.mode is Mode.ABORT, (HARD,), least=0.0),
    Step("ABORT: the push is stronger than F_abort. The arm leaves its task and follows the hand.",
         lambda s: s.command.mode is Mode.IDLE),
    Step("RESUME: nobody pushes any more, and the arm joins its path where it had left it.",
         lambda s: s.command.mode is Mode.IDLE and s.command.path_speed > 0.99, least=4.0),
    Step("Now you: drag a link of the arm with the mouse.", lambda _: True, (RemoveObstacle("hand"),), least=5.0),
)


class Demo:
    """The button and the captions. `begin` and `update` are the publisher's to call; what a visitor asks for waits for them."""

    def __init__(self, server: viser.ViserServer, session: Driver, refuse: Callable[[str], None]) -> None:
        self._server, self._session, self._refuse = server, session, refuse
        self._asked = self._enough = False
        self._at: int | None = None
        self._since = 0.0

    def add(self) -> None:
        """The button and the place of the captions, in the present container."""
        self._button = self._server.gui.add_button(
            "Guided demo", icon=viser.Icon.PRESENTATION, hint="The arm moves, a hand comes, it relaxes, aborts and resumes (G)")
        self._caption = self._server.gui.add_html("", visible=False)

        async def on_click(_: object) -> None:
            self.toggle()

        self._button.on_click(on_click)

    def toggle(self) -> None:
        """Start the demo with a fresh cell, or end it."""
        if self._asked or self._at is not None:
            self._asked, self._enough = False, True
            return
        self._asked = True
        self._session.paused = False
        try:
            if self._session.scenario == SCENARIO:
                self._session.reset()
            else:
                self._session.open(SCENARIO)
        except HrcError as error:
            self._asked = False
            self._refuse(str(error))

    def begin(self) -> None:
        """The cell is at its start: of the demo, if somebody asked for it; another start ends one that runs."""
        asked = self._asked and self._session.scenario == SCENARIO
        self._end()
        if asked:
            self._enter(0, 0.0)

    def update(self, snapshot: Snapshot) -> None:
        """Go on to the next step when the present one has come to its end."""
        if self._at is None:
            return
        step, stayed = STEPS[self._at], snapshot.time - self._since
        if self._enough or snapshot.command.mode is Mode.STOP or stayed > PATIENCE:
            self._end()
        elif stayed >= step.least and step.ends(snapshot):
            if self._at + 1 < len(STEPS):
                self._enter(self._at + 1, snapshot.time)
            else:
                self._end()

    def _enter(self, at: int, time: float) -> None:
        self._at, self._since = at, time
        self._button.label = "End the demo"
        self._caption.content = (f'<div class="eb-caption" role="status" data-step="{at + 1}"><b>{at + 1} of {len(STEPS)}</b> '
                                 f"{escape(STEPS[at].caption)}</div>")
        self._caption.visible = True
        try:
            for event in STEPS[at].events:
                self._session.put(event)
        except HrcError as error:
            self._end()
            self._refuse(str(error))

    def _end(self) -> None:
        self._asked, self._enough, self._at = False, False, None
        self._button.label = "Guided demo"
        self._caption.visible = False
