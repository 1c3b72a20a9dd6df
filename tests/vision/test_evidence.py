"""The kernel that explains residuals says what numpy says."""

import numpy as np
import pytest

from hrc.contact.proprioception import ProprioceptionConfig, SurfaceSamples, explanation
from hrc.model import Dynamics, load_spec, pinocchio_model
from hrc.vision.kernels import Evidence

KNOWN = ProprioceptionConfig()
DYNAMICS = Dynamics(pinocchio_model(load_spec().compile(), armature=False))
SAMPLES = SurfaceSamples(700, DYNAMICS.kinematics(np.zeros(7))[0])


@pytest.mark.parametrize("strength", [0.0, 1.0, 100.0, 3000.0])
def test_it_agrees_with_numpy(strength: float) -> None:
    rng, evidence = np.random.default_rng(7), Evidence(SAMPLES.wrenches, SAMPLES.of_link)
    for _ in range(5):
        r, J_links = rng.normal(size=7) * strength, rng.normal(size=(7, 7, 6)) * rng.uniform(0.1, 10.0)
        found = evidence(r, J_links, KNOWN.friction, KNOWN.f_typical, KNOWN.f_range)
        expected = explanation(SAMPLES, r, J_links, KNOWN.friction, KNOWN.f_typical, KNOWN.f_range)
        for name in ("log_evidence", "force", "misfit2"):
            a, b = getattr(found, name), getattr(expected, name)
            assert a.shape == b.shape
            assert np.isfinite(a).all()
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * max(1.0, strength * strength))


def test_samples_of_a_link_may_be_few() -> None:
    few = SurfaceSamples(50, DYNAMICS.kinematics(np.zeros(7))[0])
    assert min(part.stop - part.start for part in few.of_link.values()) < 16
    r, J_links = np.arange(7.0) - 3.0, np.random.default_rng(1).normal(size=(7, 7, 6))
    found = Evidence(few.wrenches, few.of_link)(r, J_links, 0.3, 30.0, (5.0, 150.0))
    expected = explanation(few, r, J_links, 0.3, 30.0, (5.0, 150.0))
    np.testing.assert_allclose(found.log_evidence, expected.log_evidence, rtol=1e-9, atol=1e-9)
