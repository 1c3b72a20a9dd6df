"""Pushes on the whole cell, one after another: what it feels, when, where and how strong, beside what was done to it."""

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from app.bench.touches import samples
from hrc.cell.cell import Cell
from hrc.contact.force import estimate_force
from hrc.events import Push, Release, Vector
from hrc.geometry import Array, apply
from hrc.messages import Contact, Mode, Snapshot
from hrc.model import Dynamics, load_spec, pinocchio_model

OBSERVABLE = 0.1
"""Directions of the force count as observable from this singular value of the true contact Jacobian on [m]."""
HELD, SETTLED = 0.5, 0.3
"""A push lasts so long; its force is judged from so long after its beginning on: 7.5 times the residual's memory [s]."""
CALM, PATIENCE = 0.2, 3.0
"""A push begins when nothing was felt and the task went on for so long; it is not waited for longer than this [s]."""
DECAYED = 0.25
"""What is detected anew, so long after the last true contact [s], is false."""
CONE = 30.0
"""A push is within this angle of the surface's normal [deg], where the surface offers it: a hand would slip."""
ROOM = 0.03
"""A hand fits where the surface, this far out [m], is about this far from every other part of the robot."""
TRIED = 100
"""So many points of the surface are looked at for such a place."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Of the estimated force at several moments of a push [N], each (n,): the whole vector, and its parts in the observable
    directions and in the others."""

    whole: Array
    inside: Array
    outside: Array


@dataclass(frozen=True, eq=False)
class Outcome:
    """One push: on a link, with a force on the robot [N] (3,), and what came of it.

    delay: until it was detected [s], inf if it was not while it lasted; None if something was felt before it began. given:
    errors of Eq. (5) at the true point; said: those of the cell's own contact, where it had one. located: share of the judged
    moments in which it had one; right_link, seen: of those. point: median distance from the true point [m].
    """

    link: int
    force: Vector
    delay: float | None
    given: Errors
    said: Errors
    located: float
    right_link: float | None
    seen: float | None
    point: float | None


@dataclass
class Watch:
    """Counts contacts that are none, while a cell runs.

    seconds: without a contact, nor just after one. false: when a contact was detected nevertheless [s]. felt: for how long, in
    all [s]. level (7,): the most that each residual came to in that time [N m].
    """

    seconds: float = 0.0
    felt: float = 0.0
    false: list[float] = field(default_factory=list)
    level: Array = field(default_factory=lambda: np.zeros(7))
    _last: float = 0.0
    _touched: float = -np.inf
    _detected: bool = False

    def on_step(self, snapshot: Snapshot) -> None:
        """One step has been taken."""
        if not snapshot.fresh_control:
            return
        if snapshot.truth.link >= 0:
            self._touched = snapshot.time
        elif snapshot.time - self._touched > DECAYED:
            self.seconds += snapshot.time - self._last
            self.felt += snapshot.detected * (snapshot.time - self._last)
            self.level = np.maximum(self.level, np.abs(snapshot.residual))
            if snapshot.detected and not self._detected:
                self.false.append(snapshot.time)
        self._detected, self._last = snapshot.detected, snapshot.time


def push(cell: Cell, watch: Watch, link: int, point: Vector, force: Vector) -> Outcome:
    """Press on a point of a link [m], in its frame, with a force [N] in the world, and let go."""
    start = cell.tick
    cell.apply(Push(link, point, force))
    delay = None if cell.detected else np.inf
    judged: list[Snapshot] = []
    for snapshot in go(cell, watch, HELD):
        since = (snapshot.tick - start) / cell.config.rates.base_hz
        if delay == np.inf and snapshot.detected:
            delay = since
        if since > SETTLED and snapshot.truth.link == link and np.allclose(snapshot.truth.F_world, force):
            judged.append(snapshot)
    cell.apply(Release())
    return _outcome(cell, link, force, delay, judged[::4])


def go(cell: Cell, watch: Watch, seconds: float) -> Iterator[Snapshot]:
    """The control cycles of the next seconds."""
    for _ in range(round(seconds * cell.config.rates.base_hz)):
        snapshot = cell.step()
        watch.on_step(snapshot)
        if snapshot.fresh_control:
            yield snapshot


def calm(cell: Cell, watch: Watch) -> Array:
    """Wait until the task goes on undisturbed; returns the links' poses T_world_link (8, 4, 4) then."""
    quiet, T_world_link = 0.0, np.empty(0)
    for snapshot in go(cell, watch, PATIENCE):
        undisturbed = snapshot.command.mode is Mode.IDLE and not snapshot.detected and snapshot.command.path_speed > 0.95
        quiet, T_world_link = quiet + 1.0 / cell.config.rates.control_hz if undisturbed else 0.0, snapshot.T_world_link
        if quiet >= CALM:
            break
    return T_world_link


def place(link: int, direction: Array, T_world_link: Array, rng: np.random.Generator) -> Vector:
    """A point of a link's surface [m], in its frame, where a hand can press in this direction of the world (3,).

    Drawn by area from those within CONE of the normal that no other link covers; if there is none, the point whose normal
    comes nearest.
    """
    p, outward = samples()[link]
    along = -outward @ T_world_link[link, :3, :3].T @ direction
    order = np.argsort(-along, kind="stable")
    good = order[:int((along > np.cos(np.radians(CONE))).sum())]
    for tried in (rng.permutation(good)[:TRIED], order[:TRIED], order[::len(order) // (2 * TRIED)]):
        found = tried[free(link, p[tried] + ROOM * outward[tried], T_world_link)]
        if len(found):
            x, y, z = p[found[0]].tolist()
            return x, y, z
    raise AssertionError(f"link {link} is covered all over")


def anywhere(link: int, T_world_link: Array, rng: np.random.Generator) -> tuple[Vector, Array]:
    """A point of a link's surface [m], in its frame, drawn by area where no other link covers it, and the direction inward
    (3,), in the world."""
    p, outward = samples()[link]
    chosen = rng.choice(len(p), TRIED)
    i = chosen[free(link, p[chosen] + ROOM * outward[chosen], T_world_link)][0]
    x, y, z = p[i].tolist()
    return (x, y, z), -T_world_link[link, :3, :3] @ outward[i]


def free(link: int, p_link: Array, T_world_link: Array) -> NDArray[np.bool_]:
    """Which points (n, 3) [m], in the link's frame, are at least ROOM from every other link."""
    p = apply(T_world_link[link], p_link)
    free = np.ones(len(p), bool)
    for other in range(8):
        if other != link:
            surface = apply(T_world_link[other], samples()[other][0][::20])
            free &= ((p[:, None] - surface) ** 2).sum(axis=2).min(axis=1) > ROOM**2
    return free


def _outcome(cell: Cell, link: int, force: Vector, delay: float | None, judged: list[Snapshot]) -> Outcome:
    given, said, contacts = [], [], []
    for s in judged:
        J_c = dynamics().terms(s.state.q, s.state.dq).J_contact(link, s.truth.p_world)
        given.append(parts(J_c, estimate_force(J_c, s.residual, cell.config.force).F - s.truth.F_world))
        if s.contact is not None:
            said.append(parts(J_c, s.contact.F_world - s.truth.F_world))
            contacts.append((s.contact, s.truth.p_world))
    return Outcome(link, force, delay, _errors(given), _errors(said), len(said) / max(len(judged), 1),
                   _mean([c.link == link for c, _ in contacts]), _mean([c.seen for c, _ in contacts]),
                   float(np.median([_off(c, p) for c, p in contacts])) if contacts else None)


def parts(J_c: Array, error: Array) -> tuple[float, float, float]:
    """Length of an error of the force (3,) [N], and of its parts in the observable directions and in the others."""
    U, S, _ = np.linalg.svd(J_c, full_matrices=False)
    along, inside = (U.T @ error) ** 2, S > OBSERVABLE
    whole, seen, hidden = (math.sqrt(squares.sum()) for squares in (along, along[inside], along[~inside]))
    return whole, seen, hidden


def _errors(parts: list[tuple[float, float, float]]) -> Errors:
    whole, inside, outside = np.array(parts).reshape(-1, 3).T
    return Errors(whole, inside, outside)


def _off(contact: Contact, p_world: Array) -> float:
    return float(np.linalg.norm(contact.p_world - p_world))


def _mean(values: list[bool]) -> float | None:
    return float(np.mean(values)) if values else None


@functools.cache
def dynamics() -> Dynamics:
    """The exact model, for the true contact Jacobian."""
    return Dynamics(pinocchio_model(load_spec().compile(), armature=False))
