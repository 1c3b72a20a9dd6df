"""The command palette (Ctrl+K) and its keys."""

from collections.abc import Callable
from typing import Any

import viser

Act = Callable[[viser.ClientHandle], None]


class Commands:
    """for_all: those that concern only their own visitor's screen, whoever drives."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._gui = server.gui
        self.for_all: list[viser.CommandHandle] = []

    def add(self, label: str, act: Act, key: Any = None, *, icon: Any = None, for_all: bool = False) -> None:
        """A command, and the key that triggers it without a modifier. act: told whose command it is."""
        command = self._gui.add_command(label, hotkey=key, icon=icon)

        async def on_trigger(event: viser.CommandEvent) -> None:
            if event.client is not None:
                act(event.client)

        command.on_trigger(on_trigger)
        if for_all:
            self.for_all.append(command)
