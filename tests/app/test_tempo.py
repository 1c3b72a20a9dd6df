"""The page is drawn as often as its part of a core allows."""

import pytest

from app.serve import tempo as module
from app.serve.tempo import LEAST, MOST, SHARE, Tempo


@pytest.fixture(autouse=True)
def own_share(monkeypatch: pytest.MonkeyPatch) -> None:
    """That of a page, not that of the page of the other tests."""
    monkeypatch.setattr(module, "SHARE", SHARE)


class Machine:
    """A clock, and what a page has spent on it: `fixed` of a core, and `each` [s] for a picture."""

    def __init__(self, fixed: float, each: float) -> None:
        self.fixed, self.each = fixed, each
        self.time = self.spent = 0.0

    def run(self, tempo: Tempo, seconds: float) -> float:
        """Draw for so long; the part of a core that it took in the last second."""
        end, last = self.time + seconds, (0.0, 0.0)
        while self.time < end:
            gap = 1.0 / tempo.hz
            if self.time < end - 1.0:
                last = self.time, self.spent
            self.time += gap
            self.spent += self.fixed * gap + self.each
            tempo.beat()
        return (self.spent - last[1]) / (self.time - last[0])


@pytest.mark.parametrize(("fixed", "each", "hz"), [
    (0.0, 0.002, MOST),  # a quick machine
    (0.0, 0.008, 22),
    (0.06, 0.006, 20),
    (0.05, 0.02, LEAST),  # even this is too much, but fewer would not be motion any more
])
def test_it_finds_the_rate_that_it_may_have(fixed: float, each: float, hz: int) -> None:
    machine = Machine(fixed, each)
    tempo = Tempo(lambda: machine.spent, lambda: machine.time)
    assert tempo.hz == MOST
    share = machine.run(tempo, 20.0)
    assert abs(tempo.hz - hz) <= 1
    assert share < SHARE + 0.02 or hz == LEAST


def test_it_rises_again_when_visitors_have_gone() -> None:
    machine = Machine(0.1, 0.02)
    tempo = Tempo(lambda: machine.spent, lambda: machine.time)
    machine.run(tempo, 5.0)
    assert tempo.hz == LEAST
    machine.fixed, machine.each = 0.0, 0.0
    machine.run(tempo, 2.5)
    assert LEAST < tempo.hz < MOST  # step by step
    machine.run(tempo, 4.0)
    assert tempo.hz == MOST
