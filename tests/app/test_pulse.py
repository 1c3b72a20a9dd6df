"""Who does not answer is let go of in time, whatever the system's clock does meanwhile."""

import time

import numpy as np
import pytest
from vclient import VClient, until

ELBOW = "/robot/link_3"


def test_a_frozen_browser_is_noticed_while_the_clock_runs_backwards(raw: VClient, monkeypatch: pytest.MonkeyPatch) -> None:
    point = raw.position(ELBOW) + np.array([0.06, 0.0, 0.0])
    raw.drag(ELBOW, "start", point, point)
    raw.drag(ELBOW, "update", point, point + np.array([0.0, 0.2, 0.0]))
    until(lambda: float(raw.banner()["truth"]) > 8.0)
    real, begin = time.time(), time.monotonic()
    monkeypatch.setattr(time, "time", lambda: real - 10.0 * (time.monotonic() - begin))
    until(lambda: time.monotonic() - begin > 3.0)
    assert float(raw.banner()["truth"]) > 8.0, "whoever answers, holds"
    raw.alive = False
    until(lambda: float(raw.banner()["truth"]) == 0.0)
