"""Where is the contact, and whose? Residual and vision together give it a place, and not for longer than it is felt."""

import numpy as np
import pytest

from hrc.contact.estimate import ContactTracker, TrackerConfig
from hrc.contact.force import ForceConfig
from hrc.contact.proprioception import ProprioceptionConfig, ResidualLocalizer, SurfaceSamples
from hrc.contact.residual import Detector, ObserverConfig
from hrc.geometry import apply
from hrc.messages import Nearest
from hrc.model import Dynamics, load_spec, pinocchio_model

DT = 0.005
DYNAMICS = Dynamics(pinocchio_model(load_spec().compile(), armature=False))
TERMS = DYNAMICS.terms(np.deg2rad([5.0, 27.0, -10.0, -83.0, 8.0, 69.0, 0.0]), np.zeros(7))
SAMPLES = SurfaceSamples(1500, TERMS.T_world_link)
NOWHERE = {"felt_radius": 0.0}
"""Without the joints' own idea of the place."""


def place(link: int, share: float = 0.5) -> int:
    """A sample of a link, `share` of the way through its list."""
    part = SAMPLES.of_link[link]
    return part.start + int(share * (part.stop - part.start - 1))


def point(k: int) -> np.ndarray:
    return apply(TERMS.T_world_link[SAMPLES.link[k]], SAMPLES.p[k])


def push(k: int, strength: float = 30.0) -> np.ndarray:
    return strength * TERMS.T_world_link[SAMPLES.link[k], :3, :3] @ SAMPLES.inward[k]


def residual(k: int, strength: float = 30.0) -> np.ndarray:
    return TERMS.J_contact(int(SAMPLES.link[k]), point(k)).T @ push(k, strength)


def near(k: int, distance: float = 0.01) -> Nearest:
    return Nearest(0, 0, int(SAMPLES.link[k]), point(k), SAMPLES.p[k], distance, (0, 0))


class Felt:
    """A tracker with its detector, stepped together."""

    def __init__(self, **config) -> None:
        self.detector = Detector(ObserverConfig())
        localizer = ResidualLocalizer(ProprioceptionConfig(), SAMPLES)
        self.tracker = ContactTracker(TrackerConfig(**config), ForceConfig(), localizer, DT)

    def step(self, r, *seen: Nearest, keep: bool = False):
        self.detector.update(np.asarray(r, float))
        return self.tracker.update(np.asarray(r, float), self.detector, seen, TERMS, keep=keep)

    def run(self, seconds: float, *args, **kw):
        return [self.step(*args, **kw) for _ in range(round(seconds / DT))][-1]


@pytest.mark.parametrize("share", [0.3, 0.7])
@pytest.mark.parametrize("link", [4, 5, 6, 7])
def test_a_seen_and_felt_contact_has_its_place_and_force(link, share):
    k = place(link, share)
    contact = Felt().step(residual(k), near(k))
    assert contact is not None
    assert contact.seen
    assert np.linalg.norm(contact.p_world - point(k)) < 0.04
    if contact.link == link and contact.sigma_min > 0.1:
        assert np.linalg.norm(contact.F_world - push(k)) < 11.0


def test_nothing_felt_is_no_contact_however_near():
    assert Felt().step(np.zeros(7), near(place(5), 0.0)) is None


def test_a_bystander_is_not_taken_for_the_one_who_pushes():
    """30 N on link 5 from where nobody sees it, and something near link 3: the place is that which the joints feel."""
    k = place(5)
    felt = Felt()
    assert felt.step(residual(k), near(place(3))) is None
    contact = felt.run(0.2, residual(k), near(place(3)))
    assert not contact.seen
    assert contact.link == 5
    assert np.linalg.norm(contact.p_world - point(k)) < 0.06


def test_vision_decides_between_places_that_the_joints_cannot_tell_apart():
    """A push on link 3 is felt by two joints only; with an obstacle in sight its place is known all the same."""
    k = place(3, 0.6)
    unseen, seen = Felt(felt_radius=1.0).run(0.3, residual(k, 60.0)), Felt().run(0.3, residual(k, 60.0), near(k))
    assert seen.seen
    assert np.linalg.norm(seen.p_world - point(k)) < 0.04
    assert unseen.radius > seen.radius


def test_a_contact_whose_place_is_told_too_badly_has_none():
    assert Felt(**NOWHERE).run(1.0, residual(place(5))) is None
    two = residual(place(4)) - residual(place(6))
    assert Felt(felt_misfit=0.1).run(1.0, two) is None


def test_an_obstacle_out_of_reach_explains_nothing():
    k = place(5)
    assert Felt(reach=0.05, **NOWHERE).step(residual(k), near(k, 0.06)) is None


def test_a_lost_place_is_kept_for_a_while_and_longer_where_the_arm_still_acts_at_it():
    k = place(5)
    for keep, after in ((False, False), (True, True)):
        felt = Felt(hold=0.2, **NOWHERE)
        felt.step(residual(k), near(k))
        assert felt.run(0.15, residual(k), keep=keep) is not None
        assert (felt.run(0.5, residual(k), keep=keep) is not None) == after


def test_another_link_must_be_the_likeliest_for_a_time():
    here, there = place(5), place(6)
    felt = Felt(switch=0.15)
    assert felt.run(0.3, residual(here), near(here), near(there)).link == 5
    assert felt.run(0.1, residual(there), near(here), near(there)).link == 5
    assert felt.run(0.4, residual(there), near(here), near(there)).link == 6


@pytest.mark.parametrize("every", [1, 2, 7])
def test_on_another_link_the_force_is_known_as_well_as_there(every):
    """A covariance is kept between two looks for the place, but not that of another link."""
    here, there = place(5), place(6)
    felt = Felt(switch=0.15, every=every)
    old = felt.run(0.3, residual(here), near(here), near(there))
    before = old
    while (contact := felt.step(residual(there), near(here), near(there))).link == 5:
        before = contact
    assert contact.F_covariance is not before.F_covariance
    assert contact.F_covariance is not None
    assert old.F_covariance is not None
    assert not np.allclose(contact.F_covariance, old.F_covariance)


def test_the_place_glides_over_its_link():
    part = SAMPLES.of_link[5]
    apart = np.linalg.norm(SAMPLES.p[part] - SAMPLES.p[place(5)], axis=1)
    here, there = place(5), part.start + int(np.argmin(np.abs(apart - 0.06)))
    felt = Felt(smoothing=0.1)
    first = felt.run(0.5, residual(here), near(here)).p_link
    assert np.linalg.norm(felt.step(residual(there), near(there)).p_link - first) < 0.01
    assert np.linalg.norm(felt.run(1.0, residual(there), near(there)).p_link - SAMPLES.p[there]) < 0.03


def test_what_is_felt_no_more_is_forgotten():
    k = place(5)
    felt = Felt()
    assert felt.run(0.3, residual(k), near(k)) is not None
    assert felt.step(np.zeros(7), near(k)) is None
    assert felt.step(residual(place(6)), near(place(6))).link == 6


def test_the_gate_is_the_force_at_which_detection_ends():
    k = place(5)
    felt = Felt()
    contact = felt.run(0.5, residual(k), near(k))
    share = contact.F_gate / np.linalg.norm(contact.F_world)
    assert felt.step(1.02 * share * residual(k), near(k)) is not None
    assert felt.step(0.98 * share * residual(k), near(k)) is None
