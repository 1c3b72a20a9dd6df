"""Chromiums that watch for hours, from a process of their own: what it takes to drive them is not the page's memory."""

import threading
import time
from typing import Any

from app.browser import launched, opened

STANDS = 60.0
"""A page whose banner has not changed for so long stands still [s]. It changes several times a second where there is time."""


def watch(url: str, number: int, ready: threading.Event, over: threading.Event, seconds: float) -> list[str]:
    """So many tabs until it is over, or for so long [s] at most; what their consoles said that nobody asked for.

    ready: set when the arm is drawn in all of them. over: set when the cell rests, for whether a tab stands still is asked
    then: one that gives way to a cell that wants all of two slow cores may wait for a picture for over a minute, and is not to
    blame. Raises what `launched` and `opened` raise.
    """
    said: list[str] = []
    with launched(aside=True) as browser:
        names = [f"browser {i + 1}" for i in range(number)]
        tabs = {name: opened(browser, url, lambda tab, name=name: _listen(tab, name, said)) for name in names}
        ready.set()
        end = time.monotonic() + seconds
        while not over.is_set() and time.monotonic() < end:
            next(iter(tabs.values())).wait_for_timeout(1000.0)
        beats = {name: _beat(tab) for name, tab in tabs.items()}
        end = time.monotonic() + STANDS
        while (still := [name for name, tab in tabs.items() if _beat(tab) == beats[name]]) and time.monotonic() < end:
            next(iter(tabs.values())).wait_for_timeout(200.0)
        said += [f"{name}: it stands still" for name in still]
    return said


def _beat(tab: Any) -> str:
    return tab.evaluate("() => document.querySelector('#eb-banner')?.dataset.beat")


def _listen(tab: Any, name: str, said: list[str]) -> None:
    tab.on("console", lambda message: said.append(f"{name}: {message.text}") if message.type == "error" else None)
    tab.on("pageerror", lambda error: said.append(f"{name}: {error}"))
    tab.on("crash", lambda _: said.append(f"{name}: it crashed"))
