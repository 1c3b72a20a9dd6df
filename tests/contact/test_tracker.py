"""Whose contact is it? What vision offers becomes a contact only when the residual agrees, and not for longer."""

import numpy as np
import pytest

from hrc.contact.estimate import ContactTracker, TrackerConfig
from hrc.contact.force import ForceConfig
from hrc.contact.residual import Detector, ObserverConfig
from hrc.geometry import apply
from hrc.messages import Nearest
from hrc.model import Dynamics, load_spec, pinocchio_model

DT = 0.005
DYNAMICS = Dynamics(pinocchio_model(load_spec().compile(), armature=False))
TERMS = DYNAMICS.terms(np.deg2rad([5.0, 27.0, -10.0, -83.0, 8.0, 69.0, 0.0]), np.zeros(7))
POINTS = {3: (0.0, -0.08, -0.07), 4: (0.0, 0.06, 0.1), 5: (0.05, 0.0, -0.1), 6: (0.07, 0.0, 0.0), 7: (0.0, 0.04, 0.06)}


def near(link: int, distance: float = 0.02, p_link=None) -> Nearest:
    p_link = np.array(POINTS[link] if p_link is None else p_link)
    return Nearest(0, 0, link, apply(TERMS.T_world_link[link], p_link), p_link, distance, (0, 0))


def residual(link: int, force) -> np.ndarray:
    return TERMS.J_contact(link, apply(TERMS.T_world_link[link], POINTS[link])).T @ np.asarray(force, float)


class Felt:
    """A tracker with its detector, stepped together."""

    def __init__(self, **config) -> None:
        self.detector = Detector(ObserverConfig())
        self.tracker = ContactTracker(TrackerConfig(**config), ForceConfig(), DT)

    def step(self, r, *seen: Nearest, keep: bool = False):
        self.detector.update(np.asarray(r, float))
        return self.tracker.update(np.asarray(r, float), self.detector, seen, TERMS, keep=keep)

    def run(self, seconds: float, *args, **kw):
        return [self.step(*args, **kw) for _ in range(round(seconds / DT))][-1]


@pytest.mark.parametrize("link", [4, 5, 6, 7])
def test_a_seen_and_felt_contact_has_its_force(link):
    force = np.array([8.0, -20.0, 6.0])
    contact = Felt().step(residual(link, force), near(link))
    assert contact is not None
    assert contact.link == link
    np.testing.assert_allclose(contact.F_world, force, atol=4.0 if contact.sigma_min < 0.1 else 1e-6)


def test_nothing_felt_is_no_contact_however_near():
    assert Felt().step(np.zeros(7), near(5, 0.0)) is None


def test_a_bystander_is_not_taken_for_the_one_who_pushes():
    """40 N on link 3 from where nobody sees it, and something near link 7: the place is unknown, and said to be."""
    r = residual(3, [0.0, 40.0, 0.0])
    assert Felt().step(r, near(7)) is None
    seen_too = Felt().step(r, near(7, 0.01), near(3, 0.03))
    assert seen_too is not None
    assert seen_too.link == 3
    trusting = Felt(unexplained=1.0).step(r, near(7))
    assert trusting is not None


def test_an_obstacle_out_of_reach_explains_nothing():
    assert Felt(reach=0.05).step(residual(5, [0.0, 30.0, 0.0]), near(5, 0.06)) is None


def test_a_lost_point_is_kept_for_a_while_and_longer_where_the_arm_still_acts_at_it():
    r = residual(5, [0.0, 30.0, 0.0])
    for keep, after in ((False, False), (True, True)):
        felt = Felt(hold=0.2)
        felt.step(r, near(5))
        assert felt.run(0.15, r, keep=keep) is not None
        assert (felt.run(0.5, r, keep=keep) is not None) == after


def test_another_link_must_be_the_nearest_for_a_time():
    r = residual(5, [0.0, 30.0, 0.0]) + residual(4, [0.0, 5.0, 0.0])
    felt = Felt(unexplained=1.0, switch=0.15)
    felt.step(r, near(5))
    both = near(4, 0.01), near(5, 0.02)
    assert felt.run(0.1, r, *both).link == 5
    assert felt.run(0.1, r, *both).link == 4


def test_the_point_glides_over_its_link():
    r = residual(5, [0.0, 30.0, 0.0])
    felt = Felt(smoothing=0.1)
    first = felt.step(r, near(5)).p_link
    jumped = near(5, p_link=first + np.array([0.0, 0.0, 0.05]))
    assert np.linalg.norm(felt.step(r, jumped).p_link - first) < 0.005
    assert np.linalg.norm(felt.run(0.6, r, jumped).p_link - jumped.p_link) < 0.001


def test_the_gate_is_the_force_at_which_detection_ends():
    r = residual(5, [0.0, 30.0, 0.0])
    felt = Felt()
    contact = felt.step(r, near(5))
    share = contact.F_gate / np.linalg.norm(contact.F_world)
    assert felt.step(1.02 * share * r, near(5)) is not None
    assert felt.step(0.98 * share * r, near(5)) is None
