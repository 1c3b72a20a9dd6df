"""How often the page is drawn: as often as it may be for a fifth of a core, which the cell's process needs more."""

import time
from collections.abc import Callable

LEAST, MOST = 15, 30
"""Pictures a second: as few as still look like motion, and no more than a simulated camera delivers."""
SHARE = 0.18
"""What the page's process aims at, of a core: what it is allowed is 0.2, and it varies by a few hundredths."""
WINDOW = 1.0
"""Over which it is measured [s]."""
SLOWER, FASTER = 0.7, 1.25
"""By how much the rate changes at most from one window to the next: a second in which a visitor loads is no more than that."""


class Tempo:
    """hz: pictures a second, a whole number from LEAST to MOST; it follows what the process spends, whatever it is spent on.
    beats: pictures so far.

    A process that is beneath its share draws at MOST: one visitor on a quick machine, or nobody. On a slow one, or with many
    visitors, each picture costs more, and there are fewer of them: everybody sees the same, a little less often.
    """

    def __init__(self, spent: Callable[[], float] = time.process_time, now: Callable[[], float] = time.monotonic) -> None:
        """spent: CPU time of the process so far [s]."""
        self.hz, self.beats = MOST, 0
        self._spent, self._now = spent, now
        self.begin()

    def begin(self) -> None:
        """What was spent so far was not spent on pictures."""
        self._before, self._since = self._spent(), self._now()

    def beat(self) -> None:
        """It is time for a picture."""
        self.beats += 1
        now = self._now()
        if now - self._since < WINDOW:
            return
        spent = self._spent()
        share = (spent - self._before) / (now - self._since)
        self._before, self._since = spent, now
        wanted = self.hz * min(max(SHARE / max(share, 1e-3), SLOWER), FASTER)
        if abs(wanted - self.hz) >= 1.0:
            self.hz = round(min(max(wanted, LEAST), MOST))
