"""What each visitor is told about the operator's seat, with the buttons to take, release and hand it over."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import viser

from app.serve.guard import Guard
from app.serve.keys import Role
from app.serve.pulse import answers

ANSWER = 10.0
"""How long an operator may think about somebody's wish to drive before silence counts as consent [s]."""
PING = 2.0
"""How long its browser may take to give a sign of life [s]; one that does not is not waited for."""


@dataclass
class _Box:
    """One visitor's widgets."""

    client: viser.ClientHandle
    text: viser.GuiHtmlHandle
    take: viser.GuiButtonHandle
    release: viser.GuiButtonHandle
    agree: viser.GuiButtonHandle
    keep: viser.GuiButtonHandle


class SeatBox:
    """Made for each visitor when it comes. folder: where on the screen. say: a line for the log.

    answer: how long an operator may think about somebody's wish to drive [s].
    """

    def __init__(self, guard: Guard, server: viser.ViserServer, folder: viser.GuiFolderHandle, say: Callable[[str], None],
                 answer: float = ANSWER) -> None:
        self._guard, self._seat, self._server, self._folder = guard, guard.seat, server, folder
        self._say, self.answer = say, answer
        self._boxes: dict[int, _Box] = {}
        self._waiting: asyncio.Task[None] | None = None
        self._driving: int | None = None
        self._seat.on_change(self._show)
        server.on_client_connect(self._on_join)
        server.on_client_disconnect(self._on_leave)

    async def _on_join(self, client: viser.ClientHandle) -> None:
        gui = client.gui
        with self._folder:
            text = gui.add_html("")
            take = gui.add_button("Take control", icon=viser.Icon.HAND_GRAB, visible=False,
                                  hint="Asks whoever drives; at once if nobody does")
            release = gui.add_button("Release control", icon=viser.Icon.HAND_OFF, visible=False,
                                     hint="Lets the next drive, and lets go whatever you hold")
            agree = gui.add_button("Hand over", color="green", icon=viser.Icon.CHECK, visible=False)
            keep = gui.add_button("Keep control", color="gray", icon=viser.Icon.X, visible=False)
        self._guard.free(take, release, agree, keep)
        visitor = client.client_id

        async def on_take(_: Any) -> None:
            if self._seat.take(visitor):
                self._waiting = asyncio.create_task(self._await_answer(visitor))

        async def on_release(_: Any) -> None:
            self._seat.release(visitor)

        async def on_agree(_: Any) -> None:
            self._seat.answer(visitor, consent=True)

        async def on_keep(_: Any) -> None:
            self._seat.answer(visitor, consent=False)

        for button, act in ((take, on_take), (release, on_release), (agree, on_agree), (keep, on_keep)):
            button.on_click(act)
        self._boxes[visitor] = _Box(client, text, take, release, agree, keep)
        self._show()

    def update(self) -> None:
        """Tell everybody how long the line to him takes; from any thread, and done where the seat changes."""
        self._server.get_event_loop().call_soon_threadsafe(self._tell_all)

    def _tell_all(self) -> None:
        for visitor, box in list(self._boxes.items()):
            self._tell(visitor, box)

    def _tell(self, visitor: int, box: _Box) -> None:
        text = self._text(visitor, may=self._guard.role(visitor) is Role.OPERATOR)
        if box.text.content != text:
            box.text.content = text

    async def _on_leave(self, client: viser.ClientHandle) -> None:
        box = self._boxes.pop(client.client_id, None)
        if box is not None:
            self._guard.bind(box.take, box.release, box.agree, box.keep)

    async def _await_answer(self, asker: int) -> None:
        """Silence is consent: of an operator that does not answer, and at once of a browser that does not."""
        operator = self._boxes.get(self._seat.operator) if self._seat.operator is not None else None
        if operator is None or await asyncio.to_thread(answers, self._server, operator.client, PING):
            await asyncio.sleep(self.answer)
        self._seat.yield_to(asker)

    def _show(self) -> None:
        operator, asking = self._seat.operator, self._seat.asking
        if asking is None and self._waiting is not None:  # the question has been answered
            self._waiting.cancel()
            self._waiting = None
        if operator != self._driving:
            self._driving = operator
            self._say("nobody drives" if operator is None else f"{_name(operator)} drives")
        for visitor, box in list(self._boxes.items()):
            may, mine = self._guard.role(visitor) is Role.OPERATOR, visitor == operator
            asked = mine and asking is not None
            self._tell(visitor, box)
            box.take.visible = may and not mine
            box.take.disabled = asking is not None
            box.release.visible = mine
            box.agree.visible = box.keep.visible = asked

    def _text(self, visitor: int, *, may: bool) -> str:
        operator, asking = self._seat.operator, self._seat.asking
        if visitor == operator:
            role = "operator"
            told = "<b>You drive.</b>"
            if asking is not None:
                told += f" {_name(asking)} asks to drive: without an answer it may in {self.answer:.0f} s."
        else:
            role = "visitor" if may else "viewer"
            driver = f"{_name(operator)} drives." if operator is not None else "Nobody drives."
            told = f"<b>You watch.</b> {driver}"
            if not may:
                told += " Your link is for watching; STOP works all the same."
            elif visitor == asking:
                told += " You have asked to drive."
            elif operator is None:
                told += " Whoever acts first does."
        trip = self._guard.round_trip(visitor)
        took = f"{1000.0 * trip:.0f}" if trip is not None else ""
        line = f' <span class="eb-trip">Round trip {took} ms.</span>' if took else ""
        return (f'<div id="eb-seat" class="eb-small" data-role="{role}" data-visitor="{visitor}" '
                f'data-operator="{"" if operator is None else operator}" '
                f'data-asking="{"" if asking is None else asking}" data-trip="{took}">{told}{line}</div>')


def _name(visitor: int) -> str:
    return f"Visitor {visitor + 1}"
