"""The same contacts with what the joints feel of them: residual and vision together, as the cell uses them."""

import functools
from collections.abc import Sequence

import numpy as np

from app.bench.touches import POSTURE, Touch, poses
from hrc.config import Config
from hrc.contact.proprioception import ResidualLocalizer, SurfaceSamples
from hrc.geometry import Array
from hrc.messages import Nearest
from hrc.model import Dynamics, load_spec, pinocchio_model

FORCE = 20.0
"""Of every contact [N]."""
SLOPE = 0.3
"""Its part along the surface, to either side, at most."""


def fuse(contacts: Sequence[Touch], seen: Sequence[Sequence[Nearest]], config: Config, seed: int, *,
         noise: bool) -> list[Nearest | None]:
    """The place of each contact, which presses with FORCE, from its residual and what vision offers.

    noise: of the residual, with the standard deviations that the localizer expects of a realistic robot. The point is sure if
    its radius is small enough for the arm to act at it although no camera sees it.
    """
    rng = np.random.default_rng([seed, 0xFE17])
    dynamics, localizer = _dynamics(), ResidualLocalizer(config.proprioception, _samples(config.proprioception.samples))
    found: list[Nearest | None] = []
    for contact, near in zip(contacts, seen, strict=True):
        terms = dynamics.terms(contact.q, np.zeros(7))
        r = terms.J_contact(contact.link, contact.point).T @ _force(contact.normal, rng)
        r = r + noise * rng.normal(size=7) * config.proprioception.sigma
        localizer.reset()
        guess = localizer.update(r, terms, 0.005, [n for n in near if n.distance <= config.tracker.reach])
        found.append(None if guess is None else Nearest(
            0, 0, guess.link, guess.p_world, guess.p_link, 0.0, (0, 0),
            sure=guess.radius <= config.control.abort_radius))
    return found


def _force(normal: Array, rng: np.random.Generator) -> Array:
    """Into the surface, and up to SLOPE along it."""
    aside = np.cross(normal, rng.normal(size=3))
    return FORCE * (-normal + rng.uniform(0.0, SLOPE) * aside / np.linalg.norm(aside))


@functools.cache
def _dynamics() -> Dynamics:
    return Dynamics(pinocchio_model(load_spec().compile(), armature=False))


@functools.cache
def _samples(count: int) -> SurfaceSamples:
    return SurfaceSamples(count, poses(POSTURE))
