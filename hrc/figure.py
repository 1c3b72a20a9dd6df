"""A person from the waist up, made of capsules and spheres: arms held out along x, z up, the origin at half the height."""

from dataclasses import dataclass

import numpy as np

from hrc.geometry import Array, transform

_Point = tuple[float, float, float]
_TRUNK: tuple[tuple[float, _Point, _Point], ...] = (
    (0.175, (0.0, 0.0, -0.325), (0.0, 0.0, 0.10)),
    (0.081, (0.0, -0.19, 0.16), (0.0, 0.19, 0.16)),
    (0.060, (0.0, 0.0, 0.16), (0.015, 0.0, 0.33)),
    (0.130, (0.025, 0.0, 0.37), (0.025, 0.0, 0.37)))
_ARM: tuple[tuple[float, _Point, _Point], ...] = (
    (0.056, (0.0, 0.24, 0.16), (0.12, 0.29, -0.13)),
    (0.045, (0.12, 0.29, -0.13), (0.42, 0.17, -0.07)),
    (0.056, (0.46, 0.155, -0.06), (0.46, 0.155, -0.06)))
"""Radius and both ends of the axis, as parts of the height: trunk, shoulders, neck, head; then the left arm."""


@dataclass(frozen=True, eq=False)
class Part:
    """A "sphere" (size = (radius,)) or "capsule" (radius, half length of its axis, along z) [m], at T_figure_part (4, 4)."""

    shape: str
    size: tuple[float, ...]
    T_figure_part: Array


def parts(height: float) -> tuple[Part, ...]:
    """The parts of a figure of this height, waist to crown [m]."""
    mirror = np.array([1.0, -1.0, 1.0])
    both = (*_TRUNK, *_ARM, *((radius, mirror * a, mirror * b) for radius, a, b in _ARM))
    return tuple(_part(height * radius, height * np.asarray(a), height * np.asarray(b)) for radius, a, b in both)


def _part(radius: float, a: Array, b: Array) -> Part:
    middle, axis = (a + b) / 2.0, b - a
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        return Part("sphere", (radius,), transform(np.eye(3), middle))
    z = axis / length
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return Part("capsule", (radius, length / 2.0), transform(np.column_stack([x, np.cross(z, x), z]), middle))
