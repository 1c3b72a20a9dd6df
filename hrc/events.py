"""Everything that may disturb a run. The browser, a scenario file and a recording send the same events.

An interactive session is config + seed + events, so every event can be written to JSON and read back unchanged.
Values are checked on construction: EventError says what would have been right.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from hrc.errors import EventError, unknown

Vector = tuple[float, float, float]
REACH = 5.0
"""No position in an event lies farther than this from the robot's base [m]."""
NEAREST_TARGET, UPRIGHT = 0.1, 1e-3
"""What a camera looks at is at least so far from it, and so far to its side: straight up or down no image is level [m]."""


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise EventError(f"{name} must be text, not {value!r}")
    return value


def _vector(name: str, value: Any, limit: float = REACH, length: int = 3) -> tuple[float, ...]:
    try:
        if isinstance(value, str):
            raise TypeError
        vector = tuple(float(x) for x in value)
    except (TypeError, ValueError):
        raise EventError(f"{name} must be {length} numbers, not {value!r}") from None
    if len(vector) != length or not all(math.isfinite(x) and abs(x) <= limit for x in vector):
        raise EventError(f"{name} must be {length} finite numbers up to {limit:g}, not {value!r}")
    return vector


def _scalar(name: str, value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise EventError(f"{name} must be a number from {low:g} to {high:g}, not {value!r}")
    return float(value)


def _link(value: Any) -> int:
    if isinstance(value, bool) or value not in range(1, 8):
        raise EventError(f"unknown link {value!r}; links: 1 to 7")
    return int(value)


class Event:
    """Parent of all events. Slots: a drag makes twenty events a second, and all are kept for a replay."""

    __slots__ = ()

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)


@dataclass(frozen=True, slots=True)
class Pull(Event):
    """Hold a point of a link by a capped spring, as with the mouse; a later Pull moves the spring's other end.

    point: the grabbed point in the link's frame [m]. target: where the spring pulls it, in the world [m].
    """

    link: int
    point: Vector
    target: Vector

    def __post_init__(self) -> None:
        self._set("link", _link(self.link))
        self._set("point", _vector("point", self.point, 0.5))
        self._set("target", _vector("target", self.target))


@dataclass(frozen=True, slots=True)
class Push(Event):
    """Press on a point of a link with a force fixed in the world [N], until Release.

    point: in the link's frame [m]. force: on the robot, in the world [N].
    """

    link: int
    point: Vector
    force: Vector

    def __post_init__(self) -> None:
        self._set("link", _link(self.link))
        self._set("point", _vector("point", self.point, 0.5))
        self._set("force", _vector("force", self.force, 150.0))


@dataclass(frozen=True, slots=True)
class Release(Event):
    """Let go of whatever Pull or Push holds."""


@dataclass(frozen=True, slots=True)
class MoveObstacle(Event):
    """Bring an obstacle into the scene, or move and turn it: its drive, limited in force and torque, goes for this pose.

    position [m], in the world. wxyz: orientation, None keeps the present one, or the one that it is turning to.
    """

    name: str
    position: Vector
    wxyz: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        self._set("name", _text("name", self.name))
        self._set("position", _vector("position", self.position))
        if self.wxyz is not None:
            wxyz = _vector("wxyz", self.wxyz, 2.0, 4)
            if not 0.5 < math.hypot(*wxyz) < 2.0:
                raise EventError(f"wxyz must be a unit quaternion, not {self.wxyz!r}")
            self._set("wxyz", wxyz)


@dataclass(frozen=True, slots=True)
class RemoveObstacle(Event):
    """Take an obstacle out of the scene."""

    name: str

    def __post_init__(self) -> None:
        self._set("name", _text("name", self.name))


@dataclass(frozen=True, slots=True)
class Press(Event):
    """Choreography: an obstacle approaches a point of a moving link, presses into it, holds, and withdraws.

    point: on the link's axis, in its frame [m]. direction: of the pressing, in the world. approach [s]: spent following
    the point until first touch. speed, withdraw_speed [m/s]; depth: of the drive's target past first touch [m];
    hold [s]; stiffness [N/m] and cap [N] of the drive. aside: where it comes from and leaves to, relative to first touch
    [m], in the world; None is straight back.
    """

    name: str
    link: int
    point: Vector
    direction: Vector
    speed: float
    depth: float
    hold: float
    stiffness: float
    cap: float = 150.0
    withdraw_speed: float = 0.4
    approach: float = 0.6
    aside: Vector | None = None

    def __post_init__(self) -> None:
        self._set("name", _text("name", self.name))
        self._set("link", _link(self.link))
        self._set("point", _vector("point", self.point, 0.5))
        direction = _vector("direction", self.direction, 10.0)
        if math.hypot(*direction) < 1e-6:
            raise EventError("direction must not be zero")
        self._set("direction", tuple(x / math.hypot(*direction) for x in direction))
        if self.aside is not None:
            self._set("aside", _vector("aside", self.aside))
        for name, low, high in (("speed", 0.001, 1.0), ("depth", 0.0, 1.0), ("hold", 0.0, 600.0),
                                ("stiffness", 1.0, 5000.0), ("cap", 1.0, 500.0), ("withdraw_speed", 0.01, 1.0),
                                ("approach", 0.1, 10.0)):
            self._set(name, _scalar(name, getattr(self, name), low, high))


@dataclass(frozen=True, slots=True)
class SetParameter(Event):
    """Change one live parameter, `group.name`, while the cell runs."""

    key: str
    value: Any

    def __post_init__(self) -> None:
        self._set("key", _text("key", self.key))


@dataclass(frozen=True, slots=True)
class SetTask(Event):
    """Exchange the end effector's task while the cell runs: a kind of `task.kind`. The arm goes there without a jump.

    "follow" begins where the arm comes to a stand.
    """

    kind: str

    def __post_init__(self) -> None:
        self._set("kind", _text("kind", self.kind))


@dataclass(frozen=True, slots=True)
class MoveTarget(Event):
    """Where the end effector is to go [m], in the world, in the task "follow"."""

    position: Vector

    def __post_init__(self) -> None:
        self._set("position", _vector("position", self.position))


@dataclass(frozen=True, slots=True)
class SetPosture(Event):
    """The desired posture q_d [rad] (7,), which the arm keeps as far as its task leaves it free; it is neared slowly."""

    q: tuple[float, ...]

    def __post_init__(self) -> None:
        self._set("q", _vector("q", self.q, 2.0 * math.pi, 7))


@dataclass(frozen=True, slots=True)
class MoveCamera(Event):
    """Move a depth camera: at once it stands at `eye` and looks at `target` [m], in the world, level; Reset puts it back."""

    name: str
    eye: Vector
    target: Vector

    def __post_init__(self) -> None:
        self._set("name", _text("name", self.name))
        self._set("eye", _vector("eye", self.eye))
        self._set("target", _vector("target", self.target))
        x, y, z = (t - e for e, t in zip(self.eye, self.target, strict=True))
        if math.hypot(x, y, z) < NEAREST_TARGET:
            raise EventError(f"target must be {NEAREST_TARGET:g} m or more from eye, not {math.hypot(x, y, z):.3g} m")
        if math.hypot(x, y) < UPRIGHT:
            raise EventError(f"the camera must not look straight up or down: eye {self.eye}, target {self.target}")


@dataclass(frozen=True, slots=True)
class Stop(Event):
    """Stand still and stay so until Resume. Not a safety function."""

    reason: str = "stopped by the user"

    def __post_init__(self) -> None:
        self._set("reason", _text("reason", self.reason))


@dataclass(frozen=True, slots=True)
class Resume(Event):
    """End a Stop; the arm rejoins its path smoothly."""


@dataclass(frozen=True, slots=True)
class Reset(Event):
    """Put the whole cell back to its start: same config, same seed."""


TYPES: dict[str, type[Event]] = {cls.__name__: cls for cls in Event.__subclasses__()}


def to_dict(event: Event) -> dict[str, Any]:
    """A JSON-ready dict with the event's type."""
    return {"type": type(event).__name__, **dataclasses.asdict(event)}  # pyright: ignore[reportArgumentType]


def from_dict(values: dict[str, Any]) -> Event:
    """The event again. Raises EventError for an unknown type, a missing or unknown field, or a bad value."""
    values = dict(values)
    name = values.pop("type", None)
    cls = TYPES.get(str(name))
    if cls is None:
        raise EventError(unknown("event type", name, TYPES))
    fields = {f.name: f for f in dataclasses.fields(cls)}  # pyright: ignore[reportArgumentType]
    for key in values:
        if key not in fields:
            raise EventError(unknown(f"field of {name}", key, fields))
    missing = [k for k, f in fields.items() if f.default is dataclasses.MISSING and k not in values]
    if missing:
        raise EventError(f"{name} lacks {', '.join(missing)}")
    return cls(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})
