"""Chamfer distance against brute force, and which points count."""

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.observation import chamfer


def clouds(n=40, m=25):
    """Two random clouds of different size."""
    rng = np.random.default_rng(0)
    return rng.normal(size=(n, 3)), rng.normal(size=(m, 3)) + np.array([0.5, 0.0, 0.0])


def pairs(a, b):
    """Distances [n, m] of all pairs."""
    return np.linalg.norm(a[:, None] - b[None], axis=2)


def test_chamfer_matches_brute_force():
    """Mean nearest distance from A to B plus that from B to A: not squared, not halved."""
    a, b = clouds()
    d = pairs(a, b)
    assert chamfer(a, b) == pytest.approx(d.min(axis=1).mean() + d.min(axis=0).mean(), rel=1e-12)
    assert chamfer(a, b) == pytest.approx(chamfer(b, a), rel=1e-12)
    assert chamfer(a, a) == 0.0


def test_only_points_that_could_be_shown_count_from_b():
    """``of_b`` limits the mean from B to A; from A to B every point of B may be the nearest."""
    a, b = clouds()
    of_b = np.arange(len(b)) % 3 == 0
    d = pairs(a, b)
    expected = d.min(axis=1).mean() + d.min(axis=0)[of_b].mean()
    assert chamfer(a, b, of_b=of_b) == pytest.approx(expected, rel=1e-12)
    assert chamfer(a, b, of_b=of_b) != pytest.approx(chamfer(a, b), rel=1e-3)
    assert chamfer(a, b, of_b=of_b) != pytest.approx(chamfer(a, b[of_b]), rel=1e-3)


def test_nothing_that_could_be_shown_counts_all():
    """A mask without a point leaves the plain distance, as does one with all."""
    a, b = clouds()
    assert chamfer(a, b, of_b=np.zeros(len(b), bool)) == chamfer(a, b)
    assert chamfer(a, b, of_b=np.ones(len(b), bool)) == chamfer(a, b)


@pytest.mark.parametrize("bad", [np.zeros((0, 3)), np.zeros((4, 2)), np.zeros(3)])
def test_clouds_that_are_none(bad):
    """The error names the cloud, first or second, and its shape."""
    good = np.zeros((2, 3))
    with pytest.raises(ParameterError, match=r"a is \("):
        chamfer(bad, good)
    with pytest.raises(ParameterError, match=r"b is \("):
        chamfer(good, bad)
