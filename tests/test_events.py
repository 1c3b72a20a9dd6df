"""Every event survives JSON, and none can carry what cannot be."""

import json
import math

import pytest

from hrc.errors import EventError
from hrc.events import (
    MoveCamera,
    MoveObstacle,
    Press,
    Pull,
    Push,
    Release,
    RemoveObstacle,
    Reset,
    Resume,
    SetParameter,
    Stop,
    from_dict,
    to_dict,
)

SOME = [
    Pull(3, (0.0, 0.06, -0.1), (0.1, 0.2, 0.3)),
    Push(4, (0.0, 0.0, 0.05), (0.0, 20.0, 0.0)),
    Release(),
    MoveObstacle("ball", (0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 0.0)),
    RemoveObstacle("ball"),
    Press("hand", 3, (0.0, 0.0, -0.07), (0.0, 2.0, 0.0), 0.1, 0.1, 1.0, 130.0),
    SetParameter("control.f_abort", 30.0),
    MoveCamera("camera", (0.3, -1.2, 2.0), (-0.3, 0.0, 0.4)),
    Stop(),
    Resume(),
    Reset(),
]


@pytest.mark.parametrize("event", SOME, ids=lambda e: type(e).__name__)
def test_an_event_survives_json(event):
    assert from_dict(json.loads(json.dumps(to_dict(event)))) == event


def test_a_pressing_direction_has_unit_length():
    press = from_dict(to_dict(SOME[5]))
    assert isinstance(press, Press)
    assert math.hypot(*press.direction) == pytest.approx(1.0)


@pytest.mark.parametrize(("values", "says"), [
    ({"type": "Pul"}, "did you mean Pul"),
    ({"type": "Pull", "link": 3}, "lacks point, target"),
    ({"type": "Pull", "link": 8, "point": [0, 0, 0], "target": [0, 0, 0]}, "links: 1 to 7"),
    ({"type": "Pull", "link": 3, "point": [0, 0, math.nan], "target": [0, 0, 0]}, "finite"),
    ({"type": "Pull", "link": 3, "point": [0, 0, 0], "target": [0, 0, 1e9]}, "up to 5"),
    ({"type": "Pull", "link": 3, "point": [0, 0], "target": [0, 0, 0]}, "3 finite numbers"),
    ({"type": "Push", "link": 3, "point": [0, 0, 0], "force": [0, 0, 1e6]}, "up to 150"),
    ({"type": "MoveObstacle", "name": "ball", "position": "here"}, "3 numbers"),
    ({"type": "MoveObstacle", "name": "ball", "position": [0, 0, 0], "wxyz": [0, 0, 0, 0]}, "unit quaternion"),
    ({"type": "MoveCamera", "name": "camera", "eye": [0, 0, 1]}, "lacks target"),
    ({"type": "MoveCamera", "name": 3, "eye": [0, 0, 1], "target": [1, 0, 1]}, "name must be text"),
    ({"type": "MoveCamera", "name": "camera", "eye": [0, 0, math.inf], "target": [1, 0, 1]}, "finite"),
    ({"type": "MoveCamera", "name": "camera", "eye": [0, 0, 1], "target": [6, 0, 1]}, "up to 5"),
    ({"type": "MoveCamera", "name": "camera", "eye": [0, 0, 1], "target": [0.05, 0, 1.05]}, "0.1 m or more from eye"),
    ({"type": "MoveCamera", "name": "camera", "eye": [0, 0, 2], "target": [0, 0.0005, 0]}, "straight up or down"),
    ({"type": "Stop", "resaon": "x"}, "did you mean reason"),
])
def test_a_bad_event_says_what_would_have_been_right(values, says):
    with pytest.raises(EventError, match=says):
        from_dict(values)
