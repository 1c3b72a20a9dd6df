"""The bent shells of links 1 to 5: what is inside them, and their surface as rings along the bend, in mm.

Mesh frame: the joint below is centred at the origin with its axis along z; the axis of the joint above lies
along y at z = `hub_z`. Every horizontal section is an ellipse |x| <= 60 from y_out(z) to y_in(z), on its inner half
a superellipse; a hub around the upper axis closes it.
"""

import dataclasses
from typing import Any

import numpy as np
import trimesh
from lofting import Array, circle, first_exit, stack
from scipy.interpolate import PchipInterpolator

RADIUS = 60.0
"""Radius of the shells where they are round."""
COLLAR, COLLAR_TOP = 50.0, 17.0
"""Radius and height of the narrow collar that shows in the seams."""
ROUND = 3.0
"""Radius of the rounded rims."""
FADE = 50.0
"""Height below the upper axis over which the sections narrow into the hub."""
SCOOP_START, SCOOP_SLOPE = 71.1, 1.69
"""Link 5 is cut back by a cone around the wrist axis, clear of the wrist ball: where it starts, how steep it is."""


@dataclasses.dataclass(frozen=True)
class Resolution:
    """How finely a part is sampled."""

    around: int
    """Points of a ring (even)."""
    along: int
    """Rings of the bend."""
    rim: int
    """Segments of a rounded rim."""
    tolerance: float
    """Profiles of revolution may deviate this much [mm]."""
    longest: float
    """Longest segment of a profile of revolution [mm]."""


@dataclasses.dataclass(frozen=True)
class Shell:
    """One kind of bent shell."""

    y_out: PchipInterpolator
    y_in: PchipInterpolator
    exponent: PchipInterpolator
    hub_z: float
    hub_y: float
    """Centre of the round back of the hub."""
    hub_depth: float
    """Semi-axis of the back of the hub along y."""
    face_y: float
    """The plane in which the hub ends."""
    fade: float
    """Share of the width of a section left where the hub takes over, so that it disappears inside the hub."""
    scooped: bool
    pacing: tuple[tuple[float, float], ...]
    """Which height on the inner side faces which share of the way along the outer side, for the rings' tilt; none:
    the rings stay level, up to a pole on top of the hub."""

    def inside(self, p: Array) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Whether points (..., 3) lie inside, shape (...,)."""
        x, y, z = np.moveaxis(p, -1, 0)
        h = np.clip(z, COLLAR_TOP, self.hub_z)
        y_out, y_in = self.y_out(h), self.y_in(h)
        centre, half = 0.5 * (y_out + y_in), 0.5 * (y_in - y_out)
        power = np.where(y > centre, self.exponent(h), 2.0)
        near = np.clip((z - self.hub_z) / FADE + 1.0, 0.0, 1.0)
        width = RADIUS * (1.0 - (1.0 - self.fade) * near**2 * (3.0 - 2.0 * near))
        loft = (np.abs(x / width) ** power + np.abs((y - centre) / half) ** power <= 1.0) \
            & (z >= COLLAR_TOP) & (z <= self.hub_z)
        r = np.hypot(x, z - self.hub_z)
        if self.scooped:
            loft &= y <= self.face_y + SCOOP_SLOPE * np.maximum(r - SCOOP_START, 0.0)
        back = np.minimum(y - self.hub_y, 0.0) / self.hub_depth
        rim = np.hypot(np.maximum(r - (RADIUS - ROUND), 0), np.maximum(y - (self.face_y - ROUND), 0)) <= ROUND
        hub = ((r / RADIUS) ** 2 + back**2 <= 1.0) & (y <= self.face_y) & ((y <= self.face_y - ROUND) | rim)
        return loft | hub

    def front(self, z: Array) -> Array:
        """y of the inner side in the plane of symmetry x = 0, shape of z."""
        y = self.y_in(z)
        if self.scooped:
            y = np.minimum(y, self.face_y + SCOOP_SLOPE * np.maximum(self.hub_z - z - SCOOP_START, 0.0))
        return y


def shells(profiles: dict[str, Any]) -> tuple[Shell, Shell]:
    """The shell of links 1 to 4 and that of link 5."""
    def sides(key: str) -> tuple[PchipInterpolator, PchipInterpolator]:
        z, y_out, y_in = np.array(profiles[key], float).T
        return PchipInterpolator(z, y_out), PchipInterpolator(z, y_in)

    ramp = profiles["inner_half_superellipse_exponent"]
    out_a, in_a = sides("silhouette_A_z_yout_yin")
    out_b, in_b = sides("silhouette_B_z_yout_yin")

    def exponent(top: float) -> PchipInterpolator:
        return PchipInterpolator([0.0, *ramp["z"], top], [2.0, *ramp["p"], 2.0])

    return (
        Shell(out_a, in_a, exponent(208.5), 208.5, -33.75, 60.0, -7.5, 0.95, False,
              ((0.0, 19.0), (0.17, 76.0), (0.35, 108.0), (0.56, 122.0), (0.8, 131.0), (0.92, 138.0), (1.0, 148.5))),
        Shell(out_b, in_b, exponent(198.5), 198.5, -46.0, 47.6, -46.0, 0.77, True, ()),
    )


def surface(shell: Shell, detail: Resolution, *, collar: bool, spigot: float) -> trimesh.Trimesh:
    """The closed surface of a shell, in its mesh frame.

    collar: whether the narrow ring below the shell belongs to it; spigot: how far [mm] a stub of the collar's radius
    reaches out of the hub's face, 0 for none.
    """
    n = detail.around
    level = [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]          # from the inner to the outer side, and across

    def flat(radius: float, z: float) -> Array:
        return circle([0, 0, z], radius * np.array(level[0]), radius * np.array(level[1]), n)

    bottom = 0.0 if collar else COLLAR_TOP
    rows = [np.array([[0.0, 0.0, bottom]])]
    rows += [flat(COLLAR, 0.0)] if collar else []
    rows += [flat(COLLAR, COLLAR_TOP)]
    rows += [flat(RADIUS - ROUND * (1 - np.sin(a)), COLLAR_TOP + ROUND * (1 - np.cos(a))) for a in _rim(detail)]
    rows += _bend(shell, detail)
    rows += _round_face(shell, spigot, detail) if shell.pacing else [_pole(shell, rows[-1])]
    return stack(rows)


def _rim(detail: Resolution) -> Array:
    """Angles of the rings of a rounded rim, its first end included, its last left to the ring that follows."""
    return np.linspace(0, np.pi / 2, detail.rim + 1)[:-1] if detail.rim else np.array([])


def _bend(shell: Shell, detail: Resolution) -> list[Array]:
    """The rings from the lower rim to the hub: plane sections, which tilt from level to upright where paced so."""
    start = COLLAR_TOP + (ROUND if detail.rim else 0.0)
    end_y = shell.face_y - (ROUND if detail.rim else 1e-3)
    share = np.linspace(0, 1, detail.along)
    outer = _along(_outer_side(shell, start, end_y), share)
    if shell.pacing:
        inner_z = PchipInterpolator(*np.array(shell.pacing).T)(share)
        inner_z[0] = start
        inner = np.column_stack([shell.front(inner_z), inner_z])
        inner[-1] = [end_y, shell.hub_z - RADIUS]       # the lower edge of the hub, which stands proud of the neck
    else:
        inner = np.column_stack([shell.front(np.minimum(outer[:, 1], shell.hub_z)), outer[:, 1]])
    rows = []
    for (y0, z0), (y1, z1) in zip(inner, outer, strict=True):
        centre = np.array([0.0, 0.5 * (y0 + y1), 0.5 * (z0 + z1)])
        across = np.sqrt(max(RADIUS**2 - max(z0 - shell.hub_z, 0.0) ** 2, 0.0))
        rays = circle([0, 0, 0], [0.0, 0.5 * (y1 - y0), 0.5 * (z1 - z0)], [across, 0, 0], detail.around)
        rows.append(first_exit(shell.inside, np.broadcast_to(centre, rays.shape), rays, 2.6))
    return rows


def _pole(shell: Shell, last: Array) -> Array:
    """The top of the hub above the middle of the last level ring, shape (1, 3)."""
    return first_exit(shell.inside, last.mean(axis=0, keepdims=True) - [[0, 0, 1.0]], np.array([[0, 0, 10.0]]), 1.0)


def _outer_side(shell: Shell, start: float, end_y: float) -> Array:
    """The outer edge of the section x = 0 as a polyline (y, z), from the lower rim over the hub's back to its top."""
    z = np.linspace(start, shell.hub_z, 200)
    top = np.pi / 2 if shell.pacing else np.arcsin(0.985)      # level rings stop short of the pole
    arc = np.linspace(0, top, 60)[1:]
    back = np.column_stack([shell.hub_y - shell.hub_depth * np.cos(arc), shell.hub_z + RADIUS * np.sin(arc)])
    neck = np.column_stack([shell.y_out(z), z])
    if shell.pacing:
        return np.concatenate([neck, back, [[end_y, shell.hub_z + RADIUS]]])
    return np.concatenate([neck, back])


def _round_face(shell: Shell, spigot: float, detail: Resolution) -> list[Array]:
    """The rows from the hub's rim to its axis: the flat face, or the stub that reaches across the joint's gap."""
    def ring(radius: float, y: float) -> Array:
        return circle([0, y, shell.hub_z], [0, 0, radius], [radius, 0, 0], detail.around)

    rim = np.linspace(0, np.pi / 2, detail.rim + 1)[1:] if detail.rim else [0.0]
    radius = ROUND if detail.rim else 0.0
    rows = [ring(RADIUS - radius * (1 - np.cos(a)), shell.face_y - radius * (1 - np.sin(a))) for a in rim]
    end = shell.face_y
    rows.append(ring(COLLAR, shell.face_y))
    if spigot:
        end += spigot
        rows.append(ring(COLLAR, end))
    return [*rows, np.array([[0.0, end, shell.hub_z]])]


def _along(line: Array, share: Array) -> Array:
    """Points at shares of the arc length of a polyline (k, 2), shape (len(share), 2)."""
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    return np.column_stack([np.interp(share * length[-1], length, line[:, i]) for i in range(2)])

