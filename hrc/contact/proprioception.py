"""Where does it push? The place of a contact from the joints, with what a camera sees or without.

A force F at a point p of link i shows in the residual as r = J_c(p)^T F, Eq. (3). Each of many samples of the robot's
surface is asked how well a force that pushes into it, roughly along the normal, would explain the residual; all of them
together are a probability of where the contact is. What the joints cannot tell apart stays spread out: points on one line of
action on one link, and forces through the axes of the outer joints.

The friction cone on the surface as the measure of a candidate, and the recursion over time, are from Manuelli & Tedrake,
"Localizing external contact using proprioceptive sensors: the contact particle filter" (IROS 2016). The candidates are fixed
samples instead of moving particles, as in the optimization of Likar & Zlajpah, "External joint torque-based estimation of
contact information" (Int. J. Adv. Robot. Syst. 11, 2014) and the classes on the surface of Zwiener et al., "Contact point
localization for articulated manipulators with proprioceptive sensors and machine learning" (ICRA 2018). New is that the force
is not fitted but integrated out in closed form: a link on which only one exact force and place would do is thereby less
probable than one on which many do, which tells the links apart where the best fits are equally good.
"""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from hrc import meshes
from hrc.geometry import apply
from hrc.jacobian import Terms
from hrc.messages import Nearest
from hrc.parameters import Parameters, param

Array = NDArray[np.float64]
LIFT = 0.012
"""A place of the surface is exposed if a fingertip fits over it, this far out [m]: else another link covers it."""
CANDIDATES = 8
"""The samples are chosen from this many times as many places."""
NEGLIGIBLE = 1e-4
"""Samples with less than this part of the largest weight do not take part in finding the point."""
NOTHING = 1e-6
"""Nor do samples of a smaller weight than this take part in finding the radius: all of them together weigh next to nothing."""
HEAVIEST = 64
"""The point is one of this many samples at most."""


@dataclass(frozen=True)
class ProprioceptionConfig(Parameters):
    """How a contact that only the joints feel is localized on the robot's surface."""

    samples: int = param(1500, low=50, high=10_000, live=False)
    """Number of places on the surface of all links that are considered: 1500 leave none farther than 1.4 cm from one."""
    sigma: tuple[float, ...] = param((0.15, 0.25, 0.1, 0.15, 0.08, 0.05, 0.07), low=0.001, high=20.0, unit="N m")
    """Error of each joint's residual without contact: model, friction, noise (standard deviation)."""
    sigma_relative: float = param(0.012, low=0.0, high=0.5)
    """What is added to it in a contact, as a part of the largest residual: the true point lies between the samples."""
    silent: float = param(3.0, low=0.0, high=100.0)
    """A residual that nowhere exceeds its sigma this many times says nothing about a place."""
    friction: float = param(0.28, low=0.0, high=2.0)
    """Typical tangential force, as a part of the normal force (standard deviation in each of two directions)."""
    f_typical: float = param(30.0, low=1.0, high=1000.0, unit="N")
    """Typical strength of a contact (mean of an exponential distribution): of two explanations the weaker force is likelier."""
    f_range: tuple[float, ...] = param((5.0, 150.0), low=0.1, high=1000.0, unit="N")
    """The weakest and the strongest normal force that is considered."""
    memory: float = param(0.05, low=0.0, high=5.0, unit="s")
    """Time over which the evidence is averaged. The error hardly changes within a contact, so a longer one gains nothing."""
    sight: float = param(0.05, low=0.005, high=0.5, unit="m")
    """How far the contact may be from the point of the surface that vision takes for the nearest to an obstacle (standard
    deviation)."""
    sight_gap: float = param(0.03, low=0.002, high=0.5, unit="m")
    """How far an obstacle in contact may seem to be from the surface (standard deviation)."""
    unseen: float = param(0.02, low=0.0, high=1.0)
    """How likely a contact is where vision sees no obstacle, against right where it sees one."""
    content: float = param(0.9, low=0.1, high=0.999)
    """The radius of a guess is so large that the contact is within it with this probability."""

    @property
    def deviations(self) -> float:
        """How many standard deviations of a point's position in each direction make the radius that holds it."""
        return _deviations(self.content)


@functools.cache
def _deviations(content: float) -> float:
    return math.sqrt(2.0 * float(gammaincinv(1.5, content)))


@dataclass(frozen=True, eq=False)
class Guess:
    """Where the residual says the contact is.

    link, p_link [m] (3,) (fixed to the link), p_world [m] (3,): the most central of the likely places on the likeliest link.
    F_world: force on the robot [N] (3,) that goes with it. probability: of that link. radius [m]: around p_world, holds the
    contact with the probability `content`, on whatever link. misfit: the part of the residual that even this place leaves
    unexplained, in standard deviations (root mean square over the joints); far above 1 it is not one contact. seen: whether
    vision sees an obstacle there.
    """

    link: int
    p_link: Array
    p_world: Array
    F_world: Array
    probability: float
    radius: float
    misfit: float
    seen: bool = False


class SurfaceSamples:
    """Evenly spread places on the exposed surface of links 1 to 7. Built once, it does not change.

    p (n, 3) [m] and inward (n, 3), the unit normal into the robot, in the frame of link (n,); area (n,) [m2] of surface
    that a place stands for; spacing [m]: no exposed place is farther than this from a sample.
    """

    def __init__(self, count: int, T_world_link: Array) -> None:
        """T_world_link: poses (8, 4, 4) at any usual posture, where what the neighbours cover is left out."""
        parts = meshes.robot("perception")
        areas = np.array([_area(part) for part in parts[1:]])
        found: list[tuple[Array, Array]] = []
        for link, area in enumerate(areas, start=1):
            p, outward = _spread(parts[link], math.ceil(CANDIDATES * count * area / areas.sum()))
            keep = _exposed(p, outward, link, parts, T_world_link)
            found.append((p[keep], outward[keep]))
        places = sum(len(p) for p, _ in found)
        choices = [_farthest(p, max(1, round(count * len(p) / places))) for p, _ in found]
        self.p = np.concatenate([p[c.chosen] for (p, _), c in zip(found, choices, strict=True)])
        self.inward = np.concatenate([-outward[c.chosen] for (_, outward), c in zip(found, choices, strict=True)])
        self.link = np.concatenate([np.full(len(c.chosen), i) for i, c in enumerate(choices, start=1)])
        self.area = np.concatenate([c.share for c in choices]) * areas.sum() / (CANDIDATES * count)
        self.spacing = max(c.gap for c in choices)
        first = np.searchsorted(self.link, range(1, 9))
        self.of_link = {i: slice(int(first[i - 1]), int(first[i])) for i in range(1, 8)}
        self._first = first[:7]
        self._homogeneous = np.vstack([self.p.T, np.ones(len(self.p))])
        self.axes = _axes(self.inward)
        wrenches = np.concatenate([self.axes, np.cross(self.p, self.axes)], axis=2).transpose(0, 2, 1)
        self.wrenches = np.ascontiguousarray(wrenches)
        """Unit forces at the samples, along two tangents and inward, with their moments, in link frames (3, 6, n)."""

    def in_world(self, T_world_link: Array) -> Array:
        """The places in the world [m] (3, n): what is made of them runs along the samples."""
        places = np.empty((3, len(self.p)))
        for i, part in self.of_link.items():
            np.matmul(T_world_link[i, :3], self._homogeneous[:, part], out=places[:, part])
        return places

    def by_link(self, values: Array) -> Array:
        """Sums of what there is for each sample (n,) over the links 1 to 7, (7,)."""
        return np.add.reduceat(values, self._first)


class Explanation(Protocol):
    """For each sample: log evidence (n,), the force along its axes [N] (3, n), squared misfit (n,)."""

    @property
    def log_evidence(self) -> Array:
        """Up to a constant."""
        ...

    @property
    def force(self) -> Array:
        """The likeliest."""
        ...

    @property
    def misfit2(self) -> Array:
        """What that leaves unexplained, in variances."""
        ...


Explain = Callable[[Array, Array, float, float, Sequence[float]], Explanation]
"""Like `explanation`, at samples that it knows already."""


class _Explained(NamedTuple):
    log_evidence: Array
    force: Array
    misfit2: Array


class ResidualLocalizer:
    """The probability of every sample, from the residual, over successive control ticks of one contact."""

    def __init__(self, config: ProprioceptionConfig, samples: SurfaceSamples, explain: Explain | None = None) -> None:
        """explain: does for these samples what `explanation` does, quicker."""
        self.config = config
        self.samples = samples
        self._explain: Explain = explain or functools.partial(explanation, samples)
        self.reset()

    def reset(self) -> None:
        """Forget the contact."""
        self._log: Array | None = None
        self.weights = self.samples.area / self.samples.area.sum()
        """Probability of every sample (n,), as of the last update; before it, everywhere alike."""

    def update(self, r: Array, terms: Terms, dt: float, seen: Sequence[Nearest] = ()) -> Guess | None:
        """Where the contact is, given one; None, with all forgotten, when the residual r [N m] (7,) is mere noise.

        dt: time since the last update [s]. seen: what vision offers, a point of the surface for each link near an obstacle. It
        multiplies the probability near those points: a contact that is felt elsewhere outweighs a bystander.
        """
        c = self.config
        sigma = np.asarray(c.sigma)
        if float(np.max(np.abs(r) / sigma)) <= c.silent:
            self.reset()
            return None
        found = self._explained(r, np.hypot(sigma, c.sigma_relative * float(np.abs(r).max())), terms)
        if self._log is None:
            self._log = found.log_evidence.copy()
        else:
            self._log = self._log + (found.log_evidence - self._log) * (dt / (dt + c.memory))
        places = self.samples.in_world(terms.T_world_link)
        sight = self._sight(places, seen)
        weights = self.samples.area * np.exp(self._log - self._log.max()) * sight
        self.weights = weights / weights.sum()
        return self._guess(found, terms.T_world_link, places, sight)

    def _sight(self, places: Array, seen: Sequence[Nearest]) -> Array:
        """How likely vision makes a contact at each sample (n,), against right where it sees an obstacle touch."""
        c = self.config
        likely = np.full(places.shape[1], c.unseen)
        for n in seen:
            off = places - n.p_world[:, None]
            off = (off * off).sum(axis=0)
            likely += np.exp(-0.5 * (off / c.sight**2 + (n.distance / c.sight_gap) ** 2))
        return likely

    def _explained(self, r: Array, sigma: Array, terms: Terms) -> Explanation:
        c, R = self.config, terms.T_world_link[1:, None, :3, :3]
        J_links = (terms.J_links().reshape(7, 2, 3, 7).transpose(0, 1, 3, 2) @ R).transpose(0, 2, 1, 3).reshape(7, 7, 6)
        return self._explain(r / sigma, J_links / sigma[:, None], c.friction, c.f_typical, c.f_range)

    def _guess(self, found: Explanation, T_world_link: Array, places: Array, sight: Array) -> Guess:
        s, w = self.samples, self.weights
        of_links = s.by_link(w)
        link = 1 + int(np.argmax(of_links))
        first, on_link = s.of_link[link].start, w[s.of_link[link]]
        heavy = np.flatnonzero(on_link > NEGLIGIBLE * on_link.max())
        heavy = first + heavy[np.argsort(-on_link[heavy], kind="stable")[:HEAVIEST]]
        # The weighted mean may lie inside the arm, between two sides of it; the sample with the least mean distance does not.
        p = s.p[heavy]
        size2, dots = (p * p).sum(axis=1), p @ p.T
        apart = np.sqrt(np.maximum(size2[:, None] + size2 - 2.0 * dots, 0.0))
        k = int(heavy[np.argmin(apart @ w[heavy])])
        p_world = places[:, k].copy()
        likely = np.flatnonzero(w > NOTHING)
        off = places[:, likely] - p_world[:, None]
        distance = np.sqrt((off * off).sum(axis=0))
        order = np.argsort(distance, kind="stable")
        last = int(np.searchsorted(np.cumsum(w[likely[order]]), self.config.content))
        F_world = T_world_link[link, :3, :3] @ (found.force[:, k] @ s.axes[:, k])
        misfit = math.sqrt(max(float(found.misfit2[k]), 0.0) / 7.0)
        radius = math.hypot(float(distance[order[last]]), s.spacing)  # what lies between the samples is not known
        return Guess(link, s.p[k].copy(), p_world, F_world, float(of_links[link - 1]), radius, misfit,
                     bool(sight[k] > 2.0 * self.config.unseen))


def explanation(samples: SurfaceSamples, r: Array, J_links: Array, friction: float, f_typical: float,
                f_range: Sequence[float]) -> Explanation:
    """The evidence of r at each sample: its probability density, the force there being unknown.

    r: residual (7,); J_links (7, 7, 6): by link and joint, what a wrench on the link, in its frame, does to the joint; both in
    units of the residual's error. friction: typical tangential part of the normal force. f_typical: typical normal force,
    f_range: its bounds [N].

    With A = J_c^T D in units of sigma, D the standard deviations of the force along the sample's axes, r is Gaussian with
    covariance I + A A^T; the normal force, which comes last, takes only its positive half.
    """
    J = np.zeros((3, 7, len(samples.p)))  # J_c^T by column, in units of sigma per newton
    for J_i, (i, part) in zip(J_links, samples.of_link.items(), strict=True):
        np.matmul(J_i[:i], samples.wrenches[:, :, part], out=J[:, :i, part])  # the joints beyond do not feel it
    b = r @ J
    g00, g11, g22 = np.einsum("kjn,kjn->kn", J, J)
    g10, g21 = np.einsum("kjn,kjn->kn", J[1:], J[:2])
    g20 = np.einsum("jn,jn->n", J[2], J[0])
    normal = np.minimum(np.maximum(b[2] / (g22 + 1e-9), f_range[0]), f_range[1])  # best without friction
    across = friction * normal
    D = np.stack([across, across, normal])
    b *= D
    # Cholesky factor of I + A^T A, and y with L y = A^T r.
    aside2, both = across * across, across * normal
    l00 = np.sqrt(1.0 + g00 * aside2)
    l10, l20 = g10 * aside2 / l00, g20 * both / l00
    l11 = np.sqrt(1.0 + g11 * aside2 - l10 * l10)
    l21 = (g21 * both - l20 * l10) / l11
    l22 = np.sqrt(1.0 + g22 * (normal * normal) - l20 * l20 - l21 * l21)
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    y2 = (b[2] - l20 * y0 - l21 * y1) / l22
    x2 = np.maximum(y2, 0.0) / l22
    x1 = (y1 - l21 * x2) / l11
    x0 = (y0 - l10 * x1 - l20 * x2) / l00
    tangential = y0 * y0 + y1 * y1
    log_evidence = 0.5 * tangential + _log_half_gaussian(y2) - np.log(l00 * l11 * l22) - normal / f_typical
    misfit2 = r @ r - tangential - np.square(np.maximum(y2, 0.0))
    return _Explained(log_evidence, np.stack([x0, x1, x2]) * D, misfit2)


def _log_half_gaussian(y: Array) -> Array:
    """log(exp(y^2 / 2) Phi(y)), Phi by the bound of its tail that is exact at 0 and far out (to 1 % between)."""
    x = np.abs(y)
    mills = math.sqrt(2.0 / math.pi) / (x + np.sqrt(x * x + 8.0 / math.pi))  # exp(x^2 / 2) Phi(-x)
    tail = mills * np.exp(-0.5 * np.square(np.minimum(x, 9.0)))  # farther out, it is nothing beside 1
    return 0.5 * np.square(np.maximum(y, 0.0)) + np.log(np.where(y < 0.0, mills, 1.0 - tail))


# -- samples ---------------------------------------------------------------------------------------------------------


def _area(mesh: meshes.Mesh) -> float:
    return float(np.linalg.norm(_crosses(mesh), axis=1).sum()) / 2.0


def _crosses(mesh: meshes.Mesh) -> Array:
    """Twice each triangle's area, along its outward normal (m, 3)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _spread(mesh: meshes.Mesh, count: int) -> tuple[Array, Array]:
    """Places (n, 3) with the same area each, and the outward normals there: along the list of triangles, and over each of
    them by the additive recurrence of the plastic number."""
    crosses = _crosses(mesh)
    size = np.linalg.norm(crosses, axis=1)
    covered = np.cumsum(size)
    k = np.arange(count)
    face = np.searchsorted(covered, (k + 0.5) * covered[-1] / count)
    u, v = np.modf(k * 0.7548776662466927)[0], np.modf(k * 0.5698402909980532)[0]
    u, v = np.where(u + v > 1.0, [1.0 - u, 1.0 - v], [u, v])
    a, b, c = (mesh.vertices[mesh.faces[face, j]] for j in range(3))
    return a + u[:, None] * (b - a) + v[:, None] * (c - a), crosses[face] / size[face, None]


def _exposed(p: Array, outward: Array, link: int, parts: tuple[meshes.Mesh, ...], T_world_link: Array) -> NDArray[np.bool_]:
    """Which places (n, 3) of a link have free air over them: not inside a link up to two joints away."""
    above = apply(T_world_link[link], p + LIFT * outward)
    free = np.ones(len(p), bool)
    for other in range(max(0, link - 2), min(7, link + 2) + 1):
        if other != link:
            mesh, T = parts[other], T_world_link[other]
            q = (above - T[:3, 3]) @ T[:3, :3]
            nearest = np.argmin((mesh.vertices**2).sum(axis=1) - 2.0 * q @ mesh.vertices.T, axis=1)
            free &= ((q - mesh.vertices[nearest]) * mesh.normals[nearest]).sum(axis=1) > 0.0
    return free


class _Choice(NamedTuple):
    """chosen: indices of places; share: how many places are nearest to each; gap: farthest of a place from a chosen one."""

    chosen: NDArray[np.intp]
    share: NDArray[np.intp]
    gap: float


def _farthest(p: Array, count: int) -> _Choice:
    """`count` of the places p (n, 3), each the farthest from all those chosen before."""
    index, nearest = np.zeros(count, np.intp), np.zeros(len(p), np.intp)
    gap = np.full(len(p), np.inf)
    for i in range(count):
        index[i] = int(np.argmax(gap))
        distance = np.sqrt(((p - p[index[i]]) ** 2).sum(axis=1))
        nearest[distance < gap] = i
        gap = np.minimum(gap, distance)
    return _Choice(index, np.bincount(nearest, minlength=count), float(gap.max()))


def _axes(inward: Array) -> Array:
    """Two tangents and the inward normal (3, n, 3)."""
    aside = np.where(np.abs(inward[:, :1]) < 0.6, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    tangent = np.cross(inward, aside)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.asarray(np.stack([tangent, np.cross(inward, tangent), inward]), np.float64)
