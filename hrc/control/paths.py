"""Closed paths for the end effector, by arc length: position continuous, tangent continuous, unit speed but in the corners."""

import math
from bisect import bisect_right
from pathlib import Path as File
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hrc.errors import ConfigError

Array = NDArray[np.float64]
APART = 1e-3
"""Two waypoints in a row are at least this far apart [m]."""


class Path(Protocol):
    """A curve in the world: `length` [m], after which it begins again, and the point at each arc length."""

    length: float

    def at(self, s: float) -> Array:
        """The point [m] (3,) at arc length s [m]; any s, since the path is closed."""
        ...


class Polygon:
    """Straight sides through corners (n, 3) [m], each corner rounded by a parabola that begins `rounding` [m] before it.

    Arc length is counted along the sharp polygon. Two points make a line that is run to and fro.
    """

    def __init__(self, corners: Array, rounding: float) -> None:
        self._corners = np.asarray(corners, np.float64)
        sides = np.roll(self._corners, -1, axis=0) - self._corners
        self._lengths = np.linalg.norm(sides, axis=1)
        if len(self._corners) < 2 or self._lengths.min() < APART:
            raise ConfigError(f"a path needs at least two waypoints, each {1e3 * APART:g} mm or more from the next")
        self._directions = sides / self._lengths[:, None]
        self._ends = np.cumsum(self._lengths).tolist()  # asked for one by one: numpy would take five times as long
        self._rounding = np.minimum(rounding, 0.4 * np.minimum(self._lengths, np.roll(self._lengths, 1)))
        self.length = float(self._ends[-1])

    def at(self, s: float) -> Array:
        """The point [m] (3,) at arc length s [m]."""
        s = s % self.length
        k = min(bisect_right(self._ends, s), len(self._ends) - 1)
        left = self._ends[k] - s
        along = self._lengths[k] - left
        after = (k + 1) % len(self._corners)
        if along < self._rounding[k]:
            return self._corner(k, along)
        if left < self._rounding[after]:
            return self._corner(after, -left)
        return self._corners[k] + along * self._directions[k]

    def _corner(self, k: int, w: float) -> Array:
        """The parabola around corner k, `w` [m] after the corner: tangent to both sides."""
        before, after, r = self._directions[k - 1], self._directions[k], self._rounding[k]
        return self._corners[k] + w * before + (after - before) * ((w + r) ** 2 / (4.0 * r))


class Circle:
    """A circle in a vertical plane x = constant."""

    def __init__(self, centre: Array, radius: float, phase: float) -> None:
        self._centre, self._radius, self._phase = np.asarray(centre, np.float64), radius, phase
        self.length = 2.0 * math.pi * radius

    def at(self, s: float) -> Array:
        """The point [m] (3,) at arc length s [m]."""
        angle = self._phase + s / self._radius
        return self._centre + self._radius * np.array([0.0, math.cos(angle), math.sin(angle)])


class Point:
    """A path that stays where it is."""

    def __init__(self, p: Array) -> None:
        self._p = np.asarray(p, np.float64)
        self.length = 1.0

    def at(self, s: float) -> Array:  # noqa: ARG002 (every arc length is here)
        """The point [m] (3,)."""
        return self._p


def read_waypoints(file: str) -> Array:
    """Points (n, 3) [m] from a text file: x, y, z in a line, separated by commas or blanks; # begins a comment.

    Raises ConfigError, with the line, for a file that is missing or holds anything else.
    """
    if not file:
        raise ConfigError("task.waypoints names no file: a text file with x, y, z [m] in each line")
    path = File(file)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"the waypoints in {path.name} cannot be read: {error}") from None
    points = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            point = [float(word) for word in words]
        except ValueError:
            point = []
        if len(point) != 3 or not all(map(math.isfinite, point)):
            raise ConfigError(f"{path.name}, line {number}: a waypoint is x, y, z in metres, not {line.strip()!r}")
        points.append(point)
    if len(points) < 2:
        raise ConfigError(f"{path.name} holds {len(points)} waypoint(s); a path needs at least two")
    return np.array(points)
