"""Laws of rotations and transforms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hrc import geometry as g

vectors = arrays(float, 3, elements=st.floats(-2, 2))
quaternions = arrays(float, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.1)


@given(quaternions)
def test_a_quaternion_survives_the_rotation(q):
    R = g.rotation_from_quaternion(q)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(g.rotation_from_quaternion(g.quaternion_from_rotation(R)), R, atol=1e-12)


@given(quaternions, vectors, vectors)
def test_the_inverse_undoes(q, p, x):
    T = g.transform(g.rotation_from_quaternion(q), p)
    np.testing.assert_allclose(g.apply(g.inverse(T), g.apply(T, x)), x, atol=1e-10)


@given(vectors, vectors)
def test_skew_is_the_vector_product(a, b):
    np.testing.assert_allclose(g.skew(a) @ b, np.cross(a, b), atol=1e-12)


def test_the_camera_looks_along_its_z_and_is_level():
    T = g.look_at([2.2, 0.0, 0.75], [0.0, 0.0, 0.55])
    p = g.apply(g.inverse(T), [0.0, 0.0, 0.55])
    assert p[2] > 2.0
    np.testing.assert_allclose(p[:2], 0.0, atol=1e-12)
    above = g.apply(g.inverse(T), [0.0, 0.0, 0.65])
    assert above[1] < 0.0  # y of an optical frame points down
    assert T[2, 0] == pytest.approx(0.0)
