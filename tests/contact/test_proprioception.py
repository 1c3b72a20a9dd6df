"""Where it pushes, from the joints alone: laws of the localization on residuals that are made from a known push."""

import numpy as np
import pytest

from hrc.contact.proprioception import ProprioceptionConfig, ResidualLocalizer, SurfaceSamples
from hrc.geometry import apply
from hrc.jacobian import Terms
from hrc.model import Dynamics, load_spec, pinocchio_model

DT = 0.005
DYNAMICS = Dynamics(pinocchio_model(load_spec().compile(), armature=False))
TERMS = DYNAMICS.terms(np.deg2rad([5.0, 27.0, -10.0, -83.0, 8.0, 69.0, 0.0]), np.zeros(7))
SAMPLES = SurfaceSamples(1000, TERMS.T_world_link)


def localizer(**config) -> ResidualLocalizer:
    return ResidualLocalizer(ProprioceptionConfig(**config), SAMPLES)


def of_link(link: int, every: int = 7) -> range:
    part = SAMPLES.of_link[link]
    return range(part.start, part.stop, every)


def push(k: int, strength: float = 30.0, slope: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A place in the world, and a force there: into the surface, and `slope` times as much along it."""
    T = TERMS.T_world_link[SAMPLES.link[k]]
    along = slope * SAMPLES.axes[0, k]
    return apply(T, SAMPLES.p[k]), strength * T[:3, :3] @ (SAMPLES.inward[k] + along)


def residual(k: int, terms: Terms = TERMS, **how) -> np.ndarray:
    p, F = push(k, **how)
    return terms.J_contact(int(SAMPLES.link[k]), p).T @ F


# -- samples ---------------------------------------------------------------------------------------------------------


def test_samples_lie_on_the_surface_and_look_into_the_robot():
    assert len(SAMPLES.p) == pytest.approx(1000, abs=7)
    np.testing.assert_allclose(np.linalg.norm(SAMPLES.axes, axis=2), 1.0, atol=1e-12)
    np.testing.assert_allclose((SAMPLES.axes[0] * SAMPLES.axes[2]).sum(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(SAMPLES.axes[2], SAMPLES.inward)
    for link in range(1, 8):
        part = SAMPLES.of_link[link]
        assert (SAMPLES.link[part] == link).all()
        middle = SAMPLES.p[part].mean(axis=0)
        assert ((middle - SAMPLES.p[part]) * SAMPLES.inward[part]).sum(axis=1).mean() > 0.02


def test_samples_are_even_and_cover_what_is_exposed():
    gaps = []
    for link in range(1, 8):
        p = SAMPLES.p[SAMPLES.of_link[link]]
        apart = np.linalg.norm(p[:, None] - p, axis=2) + np.eye(len(p))
        gaps.append(apart.min(axis=1))
    assert np.concatenate(gaps).min() > 0.5 * SAMPLES.spacing
    assert SAMPLES.spacing < 0.025
    assert (SAMPLES.area > 0.0).all()
    assert 0.4 < SAMPLES.area.sum() < 0.6  # of the 0.61 m2 of all seven links


def test_what_a_neighbour_covers_is_no_candidate():
    world = SAMPLES.in_world(TERMS.T_world_link).T
    elbow = TERMS.T_world_link[4, :3, 3]
    hub = SAMPLES.p[SAMPLES.of_link[4]]
    assert world.shape == SAMPLES.p.shape
    assert np.linalg.norm(hub, axis=1).min() > 0.04, "the middle of the elbow is inside links 3 and 4"
    assert np.linalg.norm(world - elbow, axis=1).min() > 0.04


# -- law of the place ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("link", [4, 5, 6, 7])
def test_a_push_without_noise_is_found_where_it_is(link):
    errors, right = [], []
    for k in of_link(link):
        guess = localizer().update(residual(k), TERMS, DT)
        errors.append(np.linalg.norm(guess.p_world - push(k)[0]))
        right.append(guess.link == link)
    assert np.median(errors) <= SAMPLES.spacing
    assert np.mean(right) >= 0.8


@pytest.mark.parametrize("link", [3, 4, 5, 6, 7])
@pytest.mark.parametrize("slope", [0.0, 0.35])
def test_the_radius_holds_what_it_promises(link, slope):
    inside = []
    for k in of_link(link):
        guess = localizer(content=0.9).update(residual(k, slope=slope), TERMS, DT)
        inside.append(np.linalg.norm(guess.p_world - push(k)[0]) <= guess.radius)
    assert np.mean(inside) >= 0.75


@pytest.mark.parametrize("link", [3, 4, 5, 6, 7])
def test_place_and_force_together_explain_the_residual(link):
    """Wherever on the line of action it is put: what yields to the force there yields to the push."""
    for k in of_link(link):
        r = residual(k)
        guess = localizer().update(r, TERMS, DT)
        felt = TERMS.J_contact(guess.link, guess.p_world).T @ guess.F_world
        assert np.linalg.norm(felt - r) <= 0.15 * np.linalg.norm(r) + 0.2
        assert guess.misfit < 1.0
        assert felt @ r > 0.0


def test_a_sliding_push_is_found_too():
    errors = [np.linalg.norm(localizer().update(residual(k, slope=0.3), TERMS, DT).p_world - push(k, slope=0.3)[0])
              for k in of_link(6)]
    assert np.median(errors) <= 2.0 * SAMPLES.spacing


@pytest.mark.parametrize("friction", [0.0, 0.28])
def test_the_force_pushes_and_never_pulls(friction):
    for k in of_link(5):
        for r in (residual(k), -residual(k), residual(k, slope=2.0)):
            guess = localizer(friction=friction).update(r, TERMS, DT)
            local = TERMS.T_world_link[guess.link, :3, :3].T @ guess.F_world
            at = int(np.argmin(np.linalg.norm(SAMPLES.p - guess.p_link, axis=1) + (SAMPLES.link != guess.link)))
            normal = float(local @ SAMPLES.inward[at])
            assert normal >= -1e-9
            if friction == 0.0:
                np.testing.assert_allclose(local, normal * SAMPLES.inward[at], atol=1e-9)


def test_a_pull_is_told_from_a_push():
    """The opposite residual is a push from the other side, not one at the same place."""
    for k in of_link(6, every=11):
        there, back = (localizer().update(sign * residual(k), TERMS, DT) for sign in (1.0, -1.0))
        assert there.F_world @ back.F_world < 0.0
        assert np.linalg.norm(there.p_world - back.p_world) > 0.03


def test_joints_beyond_the_contact_are_silent_and_that_is_used():
    """A push on link 4 leaves joints 5 to 7 alone: a link farther out is much less probable than in the reverse case."""
    outer = []
    for link in (4, 6):
        sides = []
        for k in of_link(link):
            located = localizer()
            located.update(residual(k), TERMS, DT)
            sides.append(located.weights[SAMPLES.link > 5].sum())
        outer.append(np.mean(sides))
    assert outer[0] < 0.1
    assert outer[1] > 0.8


def test_two_pushes_are_no_single_one():
    part, other = of_link(6, every=9), of_link(3, every=9)
    alone = [localizer().update(residual(k), TERMS, DT).misfit for k in part]
    both = [localizer().update(residual(k) - residual(j), TERMS, DT).misfit for k, j in zip(part, other, strict=False)]
    assert max(alone) < 1.0
    assert np.mean(both) > 2.0 * np.mean(alone)


# -- law of the probability ------------------------------------------------------------------------------------------


def test_weights_are_a_probability_and_so_is_that_of_the_link():
    located = localizer()
    assert located.weights.sum() == pytest.approx(1.0)
    guess = located.update(residual(SAMPLES.of_link[5].start + 20), TERMS, DT)
    assert located.weights.sum() == pytest.approx(1.0)
    assert (located.weights >= 0.0).all()
    by_link = [located.weights[SAMPLES.of_link[i]].sum() for i in range(1, 8)]
    assert guess.probability == pytest.approx(max(by_link))
    assert guess.link == 1 + int(np.argmax(by_link))


def test_more_error_in_the_residual_is_less_certainty():
    radii = []
    for scale in (1.0, 3.0, 10.0):
        config = {"sigma": tuple(scale * s for s in ProprioceptionConfig().sigma), "silent": 0.0}
        radii.append(np.mean([localizer(**config).update(residual(k), TERMS, DT).radius for k in of_link(5)]))
    assert radii[0] < radii[1] < radii[2]


def test_a_stronger_push_is_located_better():
    located = localizer(sigma_relative=0.0, memory=0.0)
    radii = [np.mean([located.update(residual(k, strength=f), TERMS, DT).radius for k in of_link(5)]) for f in (6.0, 60.0)]
    assert radii[1] < radii[0]


def test_the_radius_is_never_finer_than_the_samples():
    assert all(localizer().update(residual(k, strength=100.0), TERMS, DT).radius >= SAMPLES.spacing for k in of_link(7))


# -- in time ---------------------------------------------------------------------------------------------------------


def test_no_residual_is_no_place_and_is_forgotten():
    located = localizer()
    assert located.update(np.zeros(7), TERMS, DT) is None
    located.update(residual(SAMPLES.of_link[6].start), TERMS, DT)
    assert located.update(0.5 * np.asarray(ProprioceptionConfig().sigma), TERMS, DT) is None
    np.testing.assert_allclose(located.weights, localizer().weights)


def test_evidence_is_averaged_over_the_memory_and_outlived_by_the_next_contact():
    before, after = residual(SAMPLES.of_link[6].start + 5), residual(SAMPLES.of_link[4].start + 5)
    fresh = localizer()
    fresh.update(after, TERMS, DT)
    for memory, differs in ((0.0, False), (0.5, True)):
        located = localizer(memory=memory)
        for r in (before, after):
            located.update(r, TERMS, DT)
        assert (np.abs(located.weights - fresh.weights).sum() > 0.1) == differs
    for _ in range(2000):
        located.update(after, TERMS, DT)
    np.testing.assert_allclose(located.weights, fresh.weights, atol=1e-4)


def test_the_same_residual_gives_the_same_bits():
    noise = np.random.default_rng(4).normal(0.0, 0.1, (20, 7))
    runs = []
    for _ in range(2):
        located = ResidualLocalizer(ProprioceptionConfig(), SurfaceSamples(1000, TERMS.T_world_link))
        for e in noise:
            guess = located.update(residual(SAMPLES.of_link[5].start + 9) + e, TERMS, DT)
        runs.append((located.weights, guess))
    assert np.array_equal(runs[0][0], runs[1][0])
    assert np.array_equal(runs[0][1].F_world, runs[1][1].F_world)
    assert runs[0][1].radius == runs[1][1].radius
