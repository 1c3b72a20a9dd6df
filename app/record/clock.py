"""The clock of a session, which goes on where a Reset sets the cell's own back to 0, as in its recording."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.record.folder import Session
from hrc.events import Reset


class Clock:
    """rows: tick of each control tick, shape (n,). before, events: (tick, event), until the recording began and since."""

    def __init__(self, session: Session) -> None:
        ticks = session.columns["tick"]
        again = np.flatnonzero(np.diff(ticks) <= 0) + 1
        resets = [i for i, entry in enumerate(session.events) if isinstance(entry.event, Reset)]
        first = resets[-len(again) - 1] + 1 if session.skipped and len(resets) > len(again) else 0
        offset, offsets = 0, [0]
        self.before, self.events = list[tuple[int, Any]](), list[tuple[int, Any]]()
        for entry in session.events[first:]:
            recorded = offset + entry.tick >= ticks[0] - 1
            (self.events if recorded else self.before).append((offset + entry.tick, entry.event))
            if isinstance(entry.event, Reset) and len(offsets) <= len(again):
                offset += entry.tick
                offsets.append(offset)
        self.rows: NDArray[np.int64] = ticks + np.array(offsets)[np.searchsorted(again, np.arange(len(ticks)), side="right")]
