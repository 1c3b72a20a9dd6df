"""What keeps the arm off the table and off itself while a contact leads it: nothing in Eq. (7) does (an extension)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrc.geometry import closest_points
from hrc.jacobian import Terms

Array = NDArray[np.float64]
NEAR = 0.03
"""Parts of the arm are kept this far from each other [m]."""
COLUMN, UPPER_ARM, FOREARM, HAND = 0.10, 0.095, 0.095, 0.08
"""Radii of the capsules that hold the shells of base and shoulder, upper arm, forearm, and wrist with tool [m]."""


class Part(NamedTuple):
    """A capsule: a segment [m] (3,), (3,) that moves with a link, and its radius [m]."""

    link: int
    start: Array
    end: Array
    radius: float


def away(terms: Terms, floor: float, gain: float) -> Array:
    """Joint velocity [rad/s] (7,) away from what is too near: gain [1/s] times how much, for each; zero where there is room.

    floor: height [m] that elbow, wrist and end effector are kept above.
    """
    shoulder, elbow, wrist = (terms.T_world_link[link, :3, 3] for link in (2, 4, 6))
    dq = np.zeros(7)
    for link, point in ((4, elbow), (6, wrist), (7, terms.x)):
        if point[2] < floor:
            dq += _along(terms.J_contact(link, point)[2], gain * (floor - float(point[2])))
    column = Part(0, np.array([0.0, 0.0, 0.0]), shoulder, COLUMN)
    hand = Part(7, wrist, terms.x, HAND)
    for one, other in ((hand, column), (Part(5, elbow, wrist, FOREARM), column), (hand, Part(3, shoulder, elbow, UPPER_ARM))):
        dq += _apart(terms, one, other, gain)
    return dq


def distance(one: Part, other: Part) -> tuple[float, Array, Array]:
    """Between the surfaces of two parts [m], negative where they overlap, and the nearest points of their axes (3,), (3,)."""
    p, q = closest_points(one.start, one.end, other.start, other.end)
    return float(np.linalg.norm(p - q)) - one.radius - other.radius, p, q


def _apart(terms: Terms, one: Part, other: Part, gain: float) -> Array:
    gap, p, q = distance(one, other)
    if gap >= NEAR:
        return np.zeros(7)
    n = (p - q) / max(float(np.linalg.norm(p - q)), 1e-9)
    J = terms.J_contact(one.link, p) - (terms.J_contact(other.link, q) if other.link else 0.0)
    return _along(n @ J, gain * (NEAR - gap))


def _along(J: Array, speed: float) -> Array:
    """The smallest joint velocity with J dq = speed [m/s], damped where J (7,) is small."""
    return J * (speed / float(J @ J + 1e-3))
