"""Two forces at once: exact where the joints tell them apart, likely where they do not, and one where one will do."""

import dataclasses

import numpy as np
import pytest

from hrc.contact.estimate import ContactTracker, TrackerConfig
from hrc.contact.force import Doubt, ForceConfig, estimate_force, estimate_forces
from hrc.contact.pair import PairConfig, PairFinder
from hrc.contact.proprioception import ProprioceptionConfig, ResidualLocalizer, SurfaceSamples
from hrc.contact.residual import Detector, ObserverConfig
from hrc.geometry import apply
from hrc.messages import Contact, Nearest
from hrc.model import Dynamics, load_spec, pinocchio_model

DT = 0.005
DYNAMICS = Dynamics(pinocchio_model(load_spec().compile(), armature=False))
TERMS = DYNAMICS.terms(np.deg2rad([5.0, 27.0, -10.0, -83.0, 8.0, 69.0, 0.0]), np.zeros(7))
TWISTED = DYNAMICS.terms(np.deg2rad([30.0, 60.0, 50.0, -80.0, 60.0, 70.0, 20.0]), np.zeros(7))
SAMPLES = SurfaceSamples(1500, TERMS.T_world_link)
KNOWN = ProprioceptionConfig()
SIGMA = np.asarray(KNOWN.sigma)
FIRM = ForceConfig(epsilon=1e-4)
"""Every direction that the joints feel at all counts, as it may when the residual is exact."""


def point(k: int, terms=TERMS) -> np.ndarray:
    return apply(terms.T_world_link[SAMPLES.link[k]], SAMPLES.p[k])


def jacobian(k: int, terms=TERMS) -> np.ndarray:
    return terms.J_contact(int(SAMPLES.link[k]), point(k, terms))


def push(k: int, strength: float) -> np.ndarray:
    return strength * TERMS.T_world_link[SAMPLES.link[k], :3, :3] @ SAMPLES.inward[k]


def touch(k: int) -> Nearest:
    return Nearest(0, 0, int(SAMPLES.link[k]), point(k), SAMPLES.p[k], 0.01, (0, 0))


def some(link: int, count: int, seed: int = 0) -> list[int]:
    part = SAMPLES.of_link[link]
    return [int(k) for k in np.random.default_rng(seed + link).integers(part.start, part.stop, count)]


# -- the law ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("links", [(4, 6), (4, 7), (5, 6), (5, 7), (6, 7)])
def test_two_forces_are_exact_where_the_joints_tell_them_apart(links):
    told = 0
    for a, b in zip(*(some(link, 40) for link in links), strict=True):
        Js = [jacobian(k, TWISTED) for k in (a, b)]
        F = np.random.default_rng(a).uniform(-40.0, 40.0, (2, 3))
        found = estimate_forces(Js, Js[0].T @ F[0] + Js[1].T @ F[1], FIRM)
        if not found.doubt:
            np.testing.assert_allclose(found.F, F, atol=1e-6)
            told += 1
    assert told > 20


@pytest.mark.parametrize("links", [(4, 6), (4, 7), (5, 6), (5, 7), (6, 7)])
def test_at_the_usual_damping_no_two_forces_are_told_by_the_joints_alone(links):
    """The wrist's axes are within a hand's breadth of every point that two more joints would have to feel."""
    for a, b in zip(*(some(link, 40) for link in links), strict=True):
        found = estimate_forces([jacobian(k, TWISTED) for k in (a, b)], np.ones(7), ForceConfig())
        assert found.doubt
        assert found.sigma_min < 0.05


def test_opposite_forces_on_one_link_cannot_be_told():
    for a, b in zip(some(6, 20), some(6, 20, seed=1), strict=True):
        found = estimate_forces([jacobian(a), jacobian(b)], np.ones(7), FIRM)
        assert found.doubt is Doubt.OPPOSED
        along = point(a) - point(b)
        np.testing.assert_allclose(jacobian(a).T @ along - jacobian(b).T @ along, 0.0, atol=1e-9)


@pytest.mark.parametrize("link", [1, 2, 3])
def test_no_force_near_the_shoulder_is_told_from_another(link):
    for a, b in zip(some(link, 10), some(6, 10), strict=True):
        assert estimate_forces([jacobian(a), jacobian(b)], np.ones(7), FIRM).doubt is Doubt.UNFELT


def test_forces_at_the_wrist_and_forearm_that_feel_alike_are_said_to():
    a, b = some(4, 1)[0], some(5, 1)[0]
    assert estimate_forces([jacobian(a), jacobian(b)], np.ones(7), FIRM).doubt is Doubt.ALIKE  # six joints would be needed


def test_one_force_is_eq_5_and_three_are_too_many():
    J, F = jacobian(some(6, 1)[0]), np.array([3.0, -20.0, 11.0])
    found = estimate_forces([J], J.T @ F, FIRM)
    assert not found.doubt
    np.testing.assert_allclose(found.F, [F], atol=1e-9)
    assert estimate_forces([jacobian(some(link, 1)[0], TWISTED) for link in (4, 5, 6)], np.ones(7), FIRM).doubt


# -- hands -----------------------------------------------------------------------------------------------------------


def felt_at(k: int, strength: float, rng: np.random.Generator) -> np.ndarray:
    """The residual of a push a centimetre from where vision puts it."""
    return TERMS.J_contact(int(SAMPLES.link[k]), point(k) + rng.normal(0.0, 0.01, 3)).T @ push(k, strength)


def found(r: np.ndarray, a: int, b: int):
    return PairFinder(PairConfig(after=0.0), SAMPLES, DT).update(r, [touch(a), touch(b)], TERMS, ForceConfig(), KNOWN)


@pytest.mark.parametrize("links", [(4, 6), (4, 7), (5, 6), (5, 7)])
def test_two_hands_are_better_known_as_two_than_as_one(links):
    rng, errors, alone, inside = np.random.default_rng(0), [], [], []
    for a, b in zip(*(some(link, 60) for link in links), strict=True):
        f = rng.uniform(15.0, 40.0, 2)
        r = felt_at(a, f[0], rng) + felt_at(b, f[1], rng) + SIGMA * rng.standard_normal(7)
        pair, F = found(r, a, b), np.concatenate([push(a, f[0]), push(b, f[1])])
        if pair is None:
            continue
        e = pair.F.ravel() - F
        errors.append(np.linalg.norm(e))
        inside.append(e @ np.linalg.solve(pair.covariance, e) < 12.6)  # 95 % of a chi-squared of 6
        ones = (np.r_[estimate_force(jacobian(a), r, ForceConfig()).F, 0.0, 0.0, 0.0],
                np.r_[0.0, 0.0, 0.0, estimate_force(jacobian(b), r, ForceConfig()).F])
        alone.append(min(np.linalg.norm(one - F) for one in ones))
    assert len(errors) > 60 * 0.4
    assert np.median(errors) < 0.5 * np.median(alone)
    assert np.mean(inside) >= 0.85


@pytest.mark.parametrize(("link", "other"), [(4, 6), (5, 7), (6, 4), (7, 5)])
def test_one_hand_beside_a_bystander_stays_one(link, other):
    """Something else is as near as a touch, but does not push."""
    rng = np.random.default_rng(link)
    twos = [found(felt_at(a, 30.0, rng) + SIGMA * rng.standard_normal(7), a, b)
            for a, b in zip(some(link, 60), some(other, 60), strict=True)]
    assert sum(pair is not None for pair in twos) <= 2


def test_two_touches_on_one_link_stay_one_contact():
    for a, b in zip(some(6, 30), some(6, 30, seed=1), strict=True):
        assert found(hands(a, b), a, b) is None


def hands(a: int, b: int, strength=(30.0, 25.0)) -> np.ndarray:
    return jacobian(a).T @ push(a, strength[0]) + jacobian(b).T @ push(b, strength[1])


def apart() -> tuple[int, int]:
    """Places on links 4 and 6 where two pushes are far from what one could do."""
    def evidence(a: int, b: int) -> float:
        pair = found(hands(a, b), a, b)
        return pair.evidence if pair is not None else 0.0
    return max(zip(some(4, 30), some(6, 30), strict=True), key=lambda places: evidence(*places))


class Felt:
    """A tracker with its detector, stepped together."""

    def __init__(self, **config) -> None:
        self.detector = Detector(ObserverConfig())
        self.tracker = ContactTracker(
            TrackerConfig(), ForceConfig(), ResidualLocalizer(KNOWN, SAMPLES), DT, PairConfig(**config))

    def run(self, seconds: float, r: np.ndarray, *touching: int):
        seen = [touch(k) for k in touching]
        for _ in range(round(seconds / DT)):
            self.detector.update(r)
            self.tracker.update(r, self.detector, seen, TERMS, keep=False, touches=seen)
        return self.tracker.contacts


def covariance(contact: Contact) -> np.ndarray:
    assert contact.F_covariance is not None
    assert contact.F_covariance.shape == (3, 3)
    return contact.F_covariance


def test_two_contacts_come_after_a_while_the_stronger_first_and_go_with_the_hand():
    a, b = apart()
    felt = Felt(after=0.1, hold=0.2)
    assert len(felt.run(0.08, hands(a, b), a, b)) <= 1
    contacts = felt.run(0.2, hands(a, b), a, b)
    assert {c.link for c in contacts} == {4, 6}
    assert felt.tracker.doubt
    strengths = [np.linalg.norm(c.F_world) for c in contacts]
    assert strengths[0] * 2.0 > strengths[1]
    assert all(np.linalg.eigvalsh(covariance(c)).min() > 0.0 for c in contacts)
    alone = jacobian(a).T @ push(a, 30.0)
    assert len(felt.run(0.1, alone, a)) == 2
    assert [c.link for c in felt.run(0.4, alone, a)] == [4]
    assert not felt.run(0.01, np.zeros(7))


def test_the_main_contact_does_not_flicker_between_equal_hands():
    a, b = apart()
    felt, links = Felt(), []
    felt.run(0.3, hands(a, b), a, b)
    for k in range(40):
        wobble = 1.0 + 0.1 * (-1) ** k
        links.append(felt.run(DT, hands(a, b, (28.0 * wobble, 28.0 / wobble)), a, b)[0].link)
    assert len(set(links)) == 1


def test_a_contact_carries_how_well_its_force_is_known():
    k = some(5, 1)[0]
    contact = Felt().run(0.3, jacobian(k).T @ push(k, 30.0), k)[0]
    e = contact.F_world - push(k, 30.0)
    assert e @ np.linalg.solve(covariance(contact), e) < 16.3
    assert np.sqrt(np.trace(covariance(contact))) < 30.0


def test_a_touch_that_hides_its_contact_is_less_sure():
    a, b = apart()
    known = found(hands(a, b), a, b)
    finder = PairFinder(PairConfig(after=0.0, evidence=0.0), SAMPLES, DT)
    unsure = [dataclasses.replace(touch(k), sure=False) for k in (a, b)]
    guessed = finder.update(hands(a, b), unsure, TERMS, ForceConfig(), KNOWN)
    assert guessed.places[0].deviation > known.places[0].deviation
    assert np.trace(guessed.covariance) > np.trace(known.covariance)
    assert guessed.evidence < known.evidence
