"""Open loop: the robot repeats recorded commands, whatever the cell that looks on would do itself."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from hrc.cell.cell import Cell
from hrc.events import Event, Reset, SetParameter
from hrc.messages import Snapshot

Array = NDArray[np.float64]


class Driven:
    """Steps a cell like `Cell`, but its robot moves by `commands`; what the cell commands is in the snapshots alone.

    With the config, seed and events of the run that gave the commands, robot, obstacles and depth images are those of that
    run, bit for bit, and with another config of perception, estimation or reaction they still are.
    """

    def __init__(self, cell: Cell, commands: Array, fixed: Collection[str] = ()) -> None:
        """cell: at its start. commands [rad/s] (n, 7): one for each control tick, in order; after them the last one holds.

        fixed: keys of parameters that the events of the run do not change.
        """
        self.cell = cell
        self._commands, self._next, self._fixed = commands, 0, frozenset(fixed)
        self._dq = cell.command.dq

    @property
    def tick(self) -> int:
        """Ticks since the start, or the last Reset."""
        return self.cell.tick

    def apply(self, event: Event) -> None:
        """Take an event before the next step. Raises HrcError for one that cannot be."""
        if isinstance(event, SetParameter) and event.key in self._fixed:
            return
        self.cell.apply(event)
        if isinstance(event, Reset):
            self._dq = self.cell.command.dq

    def refuse(self, event: Event, reason: str) -> None:
        """Note an event that was not taken."""
        self.cell.refuse(event, reason)

    def step(self) -> Snapshot:
        """One tick."""
        snapshot = self.cell.step(self._dq)
        if snapshot.fresh_control and self._next < len(self._commands):
            self._dq = self._commands[self._next]
            self._next += 1
        return snapshot
