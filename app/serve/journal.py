"""The log of the page: events, changes of mode and refusals, newest first, in words."""

import math
import threading
from collections import deque
from collections.abc import Callable
from html import escape

from app.serve.mailbox import Note
from hrc import events
from hrc.messages import LINKS, Mode

LENGTH = 60


class Journal:
    """Lines of the log. A drag sends twenty events a second; events that follow one of their own kind make one line.

    now: the cell's time [s], for what never reached the cell.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._lock = threading.Lock()  # the publisher writes and reads, and so do callbacks of the sockets
        self._lines: deque[tuple[float, str, str]] = deque(maxlen=LENGTH)
        self._last: tuple[object, ...] = ()

    def add(self, note: Note) -> None:
        """A line for what happened in the cell."""
        if isinstance(note.subject, Mode):
            why = f": {note.reason}" if note.reason else ""
            self._append(note.time, "mode", note.subject.value.upper() + why, (note.subject, note.time))
        elif isinstance(note.subject, str):
            self._append(note.time, "refused", note.subject, (note.subject, note.time))
        elif note.refused:
            name = type(note.subject).__name__
            self._append(note.time, "refused", f"{name} refused: {note.refused}", ("refused", *_kind(note.subject)))
        else:
            self._append(note.time, "event", describe(note.subject), _kind(note.subject))

    def tell(self, what: str) -> None:
        """A line for something that concerns the page and not the cell."""
        self._append(self._now(), "event", what, (what,))

    def refuse(self, why: str) -> None:
        """A line for something that was not let through."""
        self._append(self._now(), "refused", why, (why,))

    def _append(self, time: float, style: str, text: str, kind: tuple[object, ...]) -> None:
        with self._lock:
            if kind == self._last:
                self._lines.pop()
            self._last = kind
            self._lines.append((time, style, text))

    def html(self) -> str:
        """The log as HTML; everything from outside is escaped."""
        with self._lock:
            shown = tuple(reversed(self._lines))
        lines = (f'<div class="{style}"><time>{time:.2f} s</time><span>{escape(text)}</span></div>'
                 for time, style, text in shown)
        return f'<div class="eb-log">{"".join(lines)}</div>'


def describe(event: events.Event) -> str:
    """An event in a few words."""
    match event:
        case events.Pull(link=link):
            return f"pulling {LINKS[link]}"
        case events.Push(link=link, force=force):
            return f"pushing {LINKS[link]} with ({force[0]:.0f}, {force[1]:.0f}, {force[2]:.0f}) N"
        case events.Release():
            return "let go"
        case events.MoveObstacle(name=name, position=(x, y, z), wxyz=wxyz):
            return f"{name} to ({x:.2f}, {y:.2f}, {z:.2f}) m" + ("" if wxyz is None else f", turned {_degrees(wxyz):.0f} deg")
        case events.RemoveObstacle(name=name):
            return f"{name} taken out"
        case events.Press(name=name, link=link):
            return f"{name} presses {LINKS[link]}"
        case events.SetParameter(key=key, value=value):
            return f"{key} = {value:g}" if isinstance(value, float) else f"{key} = {value}"
        case events.SetTask(kind=kind):
            return f"task: {kind}"
        case events.MoveTarget(position=(x, y, z)):
            return f"target to ({x:.2f}, {y:.2f}, {z:.2f}) m"
        case events.MoveCamera(name=name, eye=(x, y, z), target=(u, v, w)):
            return f"camera {name} to ({x:.2f}, {y:.2f}, {z:.2f}) m, looks at ({u:.2f}, {v:.2f}, {w:.2f}) m"
        case events.SetPosture(q=q):
            return f"posture: {', '.join(f'{math.degrees(angle):.0f}' for angle in q)} deg"
        case events.Stop(reason=reason):
            return f"stop: {reason}"
        case _:
            return type(event).__name__.lower()


def _degrees(wxyz: tuple[float, float, float, float]) -> float:
    """The angle from upright, 0 to 180."""
    return math.degrees(2.0 * math.atan2(math.hypot(*wxyz[1:]), abs(wxyz[0])))


def _kind(event: events.Event) -> tuple[object, ...]:
    """What makes two events one line: the same act on the same thing."""
    return (type(event), getattr(event, "name", None), getattr(event, "link", None), getattr(event, "key", None))
