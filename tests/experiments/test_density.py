"""Densities of clouds, and their transpose."""

import numpy as np
import pytest

from experiments.adam import DensityGrid
from gendom.errors import ParameterError

GRID = DensityGrid(origin=np.array([-1.0, 0.5, 2.0]), cell=0.1, shape=(20, 12, 16))


def cloud(n, seed=0, *, margin=0.25):
    """[n, 3] points that stay ``margin`` away from the sides of GRID."""
    size = GRID.cell * (np.array(GRID.shape) - 1)
    u = np.random.default_rng(seed).uniform(size=(n, 3))
    return GRID.origin + margin + u * (size - 2.0 * margin)


def shaped(density):
    """Densities on the grid's own axes."""
    return density.reshape(*density.shape[:-1], *GRID.shape)


def test_points_off_the_grid_are_ignored():
    p, size = cloud(9), GRID.cell * (np.array(GRID.shape) - 1)
    for side in (*np.eye(3), *-np.eye(3)):
        away = GRID.origin + size / 2.0 + side * (size / 2.0 + 0.5)
        d = GRID.splat(np.concatenate([p, away[None]]))
        assert np.allclose(d, 0.9 * GRID.splat(p), atol=1e-12)


@pytest.mark.parametrize("n", [1, 7, 200])
def test_density_has_the_clouds_mean(n):
    """Weights of 3 nodes an axis sum to one, the density's centre is the cloud's, and each axis'
    variance is cell^2 / 4 wider. A cloud moved by one cell has the same density one node further.
    """
    p = cloud(n)
    d = shaped(GRID.splat(p))
    assert d.sum() == pytest.approx(1.0, abs=1e-12) and d.min() >= 0.0
    assert np.count_nonzero(d > 1e-15) <= 27 * n
    for axis in range(3):
        along = d.sum(axis=tuple(a for a in range(3) if a != axis))
        at = GRID.origin[axis] + GRID.cell * np.arange(GRID.shape[axis])
        mean = along @ at
        assert mean == pytest.approx(p[:, axis].mean())
        variance = along @ (at - mean) ** 2
        assert variance == pytest.approx(p[:, axis].var() + GRID.cell**2 / 4.0)
        there = shaped(GRID.splat(p + GRID.cell * np.eye(3)[axis]))
        assert np.allclose(np.roll(d, 1, axis=axis), there, atol=1e-12)


@pytest.mark.parametrize("margin", [0.0, 0.07])
def test_a_grid_around_points_holds_them(margin):
    """No weight of the points, nor of any within the margin, is lost; the longest side is full."""
    p = np.random.default_rng(3).uniform(size=(40, 3)) * [2.0, 1.0, 0.5]
    grid = DensityGrid.around(p, margin=margin, resolution=24)
    corners = np.array([p.min(axis=0) - margin, p.max(axis=0) + margin])
    assert max(grid.shape) == 24
    for q in (p, corners):
        assert grid.splat(q).sum() == pytest.approx(1.0, abs=1e-9)
    assert grid.cell == pytest.approx(np.ptp(corners, axis=0).max() / 21.0)


@pytest.mark.parametrize(
    ("points", "options", "words"),
    [
        (np.zeros((0, 3)), {}, "finite points"),
        ([[0.0, np.nan, 0.0]], {}, "finite points"),
        ([[0.0, 0.0, 0.0]] * 3, {}, "coincide"),
        ([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], {"resolution": 3}, "needs"),
    ],
)
def test_bad_grids_are_refused(points, options, words):
    with pytest.raises(ParameterError, match=words):
        DensityGrid.around(points, **options)


def test_the_transpose_is_the_derivative():
    """<bar, d splat> = <transpose bar, d points>, also where nodes lie off the grid."""
    rng = np.random.default_rng(3)
    p = np.stack([cloud(30, seed, margin=-0.05) for seed in (1, 2)])
    bar, v, h = rng.normal(size=(2, GRID.num_nodes)), rng.normal(size=p.shape), 1e-6
    ahead, behind = (GRID.splat(p + s * h * v) for s in (1.0, -1.0))
    expected = ((ahead - behind) * bar).sum() / (2.0 * h)
    assert (GRID.splat_transpose(p, bar) * v).sum() == pytest.approx(expected, rel=1e-6)
