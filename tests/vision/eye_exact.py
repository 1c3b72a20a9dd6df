"""What the eye must find in a scene: the answer of the brute-force reference, to a micrometre."""

from dataclasses import dataclass

import numpy as np
from eye_random import Scene

from hrc import meshes
from hrc.messages import LINKS, DepthFrame, RobotImage
from hrc.vision import reference
from hrc.vision.localize import Localizer
from hrc.vision.render import Renderer, environment_depth

TOLERANCE = 1e-6
"""Largest difference [m] from the reference."""
HAIR = 1e-6
"""Which of two depths is the nearer may fall either way in float32 when they differ by less than this share."""
PAIRS = 2e6
"""What brute force takes about 50 ms for."""


class NotExactError(AssertionError):
    """The eye and the reference differ."""


@dataclass(frozen=True)
class Outcome:
    """How far the eye was off in a scene [m], and what was in it."""

    error: float
    compared: int
    within_reach: int
    coverage: float


def demand(holds: bool, what: str, s: Scene) -> None:
    """Raise NotExactError unless it holds (`assert` says less when it runs outside pytest)."""
    if not holds:
        raise NotExactError(f"{s.name}: {what}")


def surface(s: Scene) -> RobotImage:
    """What distances are measured from: the robot now, expanded in mode paper."""
    return expanded(s, now=True) if s.paper else Renderer(s.camera, meshes.robot("perception")).render(s.T_now)


def expanded(s: Scene, *, now: bool) -> RobotImage:
    """What the robot's pixels are removed with."""
    renderer = Renderer(s.camera, meshes.robot("filter"))
    renderer.expand(s.config.margin)
    return renderer.render(s.T_now if now else s.T_stamp)


def check(s: Scene, pairs: float = PAIRS) -> Outcome:
    """Compare foreground, distance map and minima with the reference. Raises NotExactError where they differ.

    pairs: robot pixels times obstacle pixels beyond which only some of the robot's pixels, chosen at random, are compared.
    """
    eye = Localizer(s.camera, s.environment, s.config)
    eye.filter(DepthFrame(3, s.real.copy()), s.T_stamp)
    nearest, distances, foreground = eye.localize(5, s.T_now), eye.distances(), eye.foreground.depth
    check_foreground(s, foreground)
    robot = surface(s)
    on = robot.link < len(LINKS)
    on &= robot.link >= s.config.first_link
    demand(not np.isfinite(distances[~on]).any(), "a distance off the links that count", s)
    compared = _some(on, int(pairs / max(1, np.isfinite(foreground).sum())))
    thickness = s.thickness if s.paper else reference.depths(s.camera, foreground, s.thickness)
    brute = reference.distance_map(s.camera, np.where(compared, robot.depth, np.inf), foreground, s.config.reach, thickness)
    # With what is out of reach at the reach, a pixel that only one of the two finds counts as well.
    reach = s.config.reach
    off = np.abs(np.minimum(distances, reach) - np.minimum(brute, reach))[compared]
    error = float(off.max(initial=0.0))
    demand(error <= TOLERANCE, f"the map is {error:.1e} m off in {np.count_nonzero(off > TOLERANCE)} of {off.size} pixels", s)
    error = max(error, check_nearest(s, nearest, robot, distances, brute if compared.sum() == on.sum() else None))
    return Outcome(error, int(compared.sum()), int(np.isfinite(brute).sum()), float(np.isfinite(foreground).mean()))


def check_foreground(s: Scene, foreground: np.ndarray) -> None:
    """The filter keeps what is in front by a hair or more, and nothing that is behind by a hair or more."""
    robot = expanded(s, now=False).depth.astype(float)
    fixed = environment_depth(s.camera, s.environment, s.config.environment_margin)
    neighbours = 0 if s.paper else s.config.neighbours
    surely, maybe = (reference.filtered(s.real, robot * (1 + by), fixed * (1 + by)) for by in (-HAIR, HAIR))
    if neighbours:
        surely = reference.supported(surely, neighbours, 0.03 - HAIR)
        maybe = reference.supported(maybe, neighbours, 0.03 + HAIR)
    kept = np.isfinite(foreground)
    demand(bool((kept <= np.isfinite(maybe)).all()), "a pixel of the foreground that should be removed", s)
    demand(bool((kept >= np.isfinite(surely)).all()), "a pixel removed that should be in the foreground", s)
    demand(bool((foreground[kept] == s.real[kept]).all()), "a pixel of the foreground changed its depth", s)


def check_nearest(s: Scene, nearest, robot: RobotImage, distances: np.ndarray, brute: np.ndarray | None) -> float:
    """Every link within reach is found, at its least distance; mode paper: that of the nearest link at its first pixel."""
    links = [i for i in range(len(LINKS)) if np.isfinite(distances[robot.link == i]).any()]
    least = {i: distances[robot.link == i].min() for i in links}
    by_distance = sorted(links, key=lambda i: (least[i], i))
    expected = by_distance[:1] if s.paper else by_distance
    demand([n.link for n in nearest] == expected, f"links {[n.link for n in nearest]} instead of {expected}", s)
    error = 0.0
    for n in nearest:
        u, v = n.pixel
        demand(n.distance == least[n.link], f"link {n.link}: not the least distance of the map", s)
        demand(robot.link[v, u] == n.link, f"link {n.link}: the point is on link {robot.link[v, u]}", s)
        if s.paper:
            first = int(np.argmin(np.where(robot.link == n.link, distances, np.inf)))
            demand((v, u) == np.unravel_index(first, distances.shape), "not the first of the nearest pixels", s)
        if brute is not None:
            error = max(error, abs(n.distance - float(brute[robot.link == n.link].min())))
    demand(error <= TOLERANCE, f"a minimum is {error:.1e} m off", s)
    return error


def _some(mask: np.ndarray, number: int) -> np.ndarray:
    """At most so many of the pixels, the same ones each time."""
    index = np.flatnonzero(mask)
    chosen = np.zeros_like(mask)
    chosen.flat[np.random.default_rng(0).permutation(index)[:number]] = True
    return chosen
