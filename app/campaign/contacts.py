"""Makes the contacts of an episode: looks where the robot is when it is time, draws places and forces, and sends events."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from app.campaign import places
from app.campaign.trial import ANY, PROFILES, SHAPES, Trial
from hrc.cell.eyes import rig
from hrc.errors import HrcError
from hrc.events import Event, Press, Push, Release, Vector
from hrc.geometry import Array
from hrc.messages import Snapshot
from hrc.scene import BodySpec, Scene, load_scene

RISE, TAP = 0.1, 0.06
"""A "hold" is at its full force after so long, a "tap" lasts so long [s]."""
SWELL, SWELL_HZ = 0.25, 2.0
"""A "wiggle" swells and ebbs by this part of the force, so often a second."""
APPROACH = 0.3
"""An obstacle takes so long from where it appears to the robot [s]."""
REACH = 0.005
"""An obstacle is sent to this far below the surface [m]: what it aims at must be inside the link."""
TRIES = 20
"""An obstacle that finds no room is sent somewhere else, so often."""


def share(profile: str, t: float, held: float) -> float:
    """The force of a hand as a part of its full one, t seconds after its beginning, if it lasts `held` seconds."""
    if not 0.0 <= t < held:
        return 0.0
    if profile == "ramp":
        return t / held
    if profile == "hold":
        return min(1.0, t / RISE)
    if profile == "tap":
        return math.sin(math.pi * t / TAP) if t < TAP else 0.0
    if profile == "wiggle":
        return min(1.0, t / RISE) * (1.0 - SWELL + SWELL * math.sin(2.0 * math.pi * SWELL_HZ * t))
    return 1.0


@dataclass
class _Hand:
    """A force on a point of a link: its direction (3,), in the world, and size [N]."""

    link: int
    point: Vector
    direction: Array
    size: float
    profile: str


def surface_along(body: BodySpec, direction: Array) -> float:
    """How far the surface of a body is from its centre along a unit vector of its own frame [m]."""
    along = np.abs(direction)
    if body.shape == "box":
        return float(np.min(np.asarray(body.size) / np.maximum(along, 1e-9)))
    if body.shape == "capsule":
        (radius, half), across = body.size, math.hypot(along[0], along[1])
        if radius * along[2] <= half * across:
            return radius / across
        return float(half * along[2] + math.sqrt(radius**2 - (half * across) ** 2))
    return body.size[0]


class Contacts:
    """Where the events of an episode come from, and an observer, because it has to see the robot to touch it.

    What it draws depends on the seed and on where the robot is; each thing has a generator of its own, so that the same
    episode with another parameter differs in as little as can be.
    """

    def __init__(self, trial: Trial, seed: Sequence[int]) -> None:
        """seed: of all that is drawn. Raises HrcError if the scene lacks what the situation needs."""
        s = self._situation = trial.situation
        self._base_hz, self._period = trial.rates.base_hz, trial.rates.base_hz // trial.rates.control_hz
        self._rng = dict(zip(("place", "force", "obstacle", "body"),
                             map(np.random.default_rng, np.random.SeedSequence(seed).spawn(4)), strict=True))
        scene = load_scene(trial.scene)
        self._bodies = {body.name: body for body in self._chosen(scene)}
        self._cameras = tuple(setup.camera for setup in rig(trial.config, scene)) if s.surface == "visible" else ()
        self._start = round(s.settle * self._base_hz / self._period) * self._period
        self._wait = APPROACH if self._bodies else 0.0
        self._ends: list[float] = []
        self._hand: _Hand | None = None
        self._pressing: dict[str, int] = {}
        self._given = 0.0
        self._tick = self._tries = 0
        self._T_world_link = np.zeros((8, 4, 4))
        self._due: list[Event] = []

    def over(self) -> bool:
        """Whether everything has happened."""
        return bool(self._ends) and self._tick >= max(self._ends)

    @property
    def described(self) -> dict[str, float | str | None]:
        """What was drawn, for the record."""
        hand = self._hand
        return {"force_drawn_N": hand.size if hand else None, "profile": hand.profile if hand else None,
                "obstacle": ", ".join(self._pressing) or None}

    def on_step(self, snapshot: Snapshot) -> None:
        """See where the robot is; an obstacle that found no room goes somewhere else."""
        self._T_world_link, self._tick = snapshot.T_world_link, snapshot.tick
        for event, reason in snapshot.refused:
            self._tries += 1
            if self._tries > TRIES:
                raise HrcError(f"no room for an obstacle at {TRIES} places: {reason}")
            if isinstance(event, Press):
                del self._pressing[event.name]
                self._due.append(self._press(event.name))

    def take(self, tick: int) -> list[Event]:
        """The events before the step that follows this tick."""
        due, self._due = self._due, []
        if tick == self._start:
            due += self._begin()
        if self._hand is not None:
            due += self._held(self._hand, (tick - self._start) / self._base_hz - self._wait, tick)
        return due

    def _begin(self) -> Iterator[Event]:
        s = self._situation
        self._last(s.held)
        if s.by == "hand":
            place, rng = self._place(self._rng["place"]), self._rng["force"]
            inward = -self._T_world_link[place.link, :3, :3] @ place.normal
            direction = places.within_cone(inward, s.friction, rng)
            size = float(rng.uniform(s.force_low, s.force_high))
            drawn = PROFILES[int(rng.integers(len(PROFILES)))]
            self._hand = _Hand(place.link, _vector(place.p_link), direction, size, drawn if s.profile == ANY else s.profile)
        for name in self._bodies:
            yield self._press(name)

    def _held(self, hand: _Hand, t: float, tick: int) -> Iterator[Event]:
        """The force as it changes, every control period."""
        if tick % self._period:
            return
        now = hand.size * share(hand.profile, t, self._situation.held)
        if now != self._given:
            self._given = now
            yield Push(hand.link, hand.point, _vector(now * hand.direction)) if now > 0.0 else Release()

    def _press(self, name: str) -> Press:
        """An obstacle's way to a place on a link that nothing else touches.

        It is taken to touch when its farthest point would; if its surface on the line of pressing is nearer to its centre than
        that, it goes on by as much.
        """
        s, rng, body = self._situation, self._rng["obstacle"], self._bodies[name]
        place = self._place(rng)
        self._pressing[name] = place.link
        inward = -self._T_world_link[place.link, :3, :3] @ place.normal
        cap, stiffness = (float(rng.uniform(*between)) for between in (
            (s.force_low, s.force_high), (s.stiffness_low, s.stiffness_high)))
        direction = places.within_cone(inward, s.friction, rng)
        depth = min(1.0, cap / stiffness + REACH + body.extent(direction) - surface_along(body, direction))
        self._last(depth / s.speed + s.held)
        return Press(name, place.link, _vector(place.p_link - REACH * place.normal), _vector(direction), s.speed, depth, s.held,
                     stiffness, cap, approach=APPROACH)

    def _last(self, seconds: float) -> None:
        """A contact goes on for so long after the approach: the episode ends after the last."""
        self._ends.append(self._tick + (self._wait + seconds + self._situation.after) * self._base_hz)

    def _place(self, rng: np.random.Generator) -> places.Place:
        s = self._situation
        taken = {*self._pressing.values(), *([self._hand.link] if self._hand else [])}
        links = [link for link in range(s.first_link, s.last_link + 1) if link not in taken]
        return places.draw(links, self._T_world_link, rng, self._cameras)

    def _chosen(self, scene: Scene) -> list[BodySpec]:
        """The obstacles."""
        s = self._situation
        wanted = s.contacts - (s.by == "hand")
        fit = [body for body in scene.bodies if body.shape in (SHAPES if s.shape == ANY else (s.shape,))]
        if len(fit) < wanted:
            of_shape = "" if s.shape == ANY else f" of shape {s.shape}"
            raise HrcError(f"the situation needs {wanted} obstacles{of_shape}; the scene has {len(fit)}")
        return [fit[i] for i in self._rng["body"].permutation(len(fit))[:wanted]]


def _vector(v: Array) -> Vector:
    x, y, z = v.tolist()
    return x, y, z
