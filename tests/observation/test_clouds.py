"""Clouds compared: Chamfer distance against brute force, densities, and what cameras see."""

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.observation import DensityGrid, chamfer, visible, visible_on_sheet
from gendom.sim import rope


def test_chamfer_matches_brute_force():
    """Mean nearest distance from A to B plus that from B to A: not squared, not halved. `of_b`
    limits the mean from B to A, while every point of B may be the nearest; a mask without a point
    counts all."""
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(40, 3)), rng.normal(size=(25, 3)) + np.array([0.5, 0.0, 0.0])
    d = np.linalg.norm(a[:, None] - b[None], axis=2)
    whole = d.min(axis=1).mean() + d.min(axis=0).mean()
    assert chamfer(a, b) == pytest.approx(whole, rel=1e-12)
    assert chamfer(a, b) == pytest.approx(chamfer(b, a), rel=1e-12)
    assert chamfer(a, a) == 0.0
    of_b = np.arange(len(b)) % 3 == 0
    expected = d.min(axis=1).mean() + d.min(axis=0)[of_b].mean()
    assert chamfer(a, b, of_b=of_b) == pytest.approx(expected, rel=1e-12)
    assert expected != pytest.approx(whole, rel=1e-3)
    assert chamfer(a, b, of_b=np.zeros(len(b), bool)) == chamfer(a, b)


@pytest.mark.parametrize("bad", [np.zeros((0, 3)), np.zeros((4, 2)), np.zeros(3)])
def test_clouds_that_are_none(bad):
    """The error names the cloud, first or second, and its shape."""
    good = np.zeros((2, 3))
    with pytest.raises(ParameterError, match=r"a is \("):
        chamfer(bad, good)
    with pytest.raises(ParameterError, match=r"b is \("):
        chamfer(good, bad)


# Densities.

GRID = DensityGrid(origin=np.array([-1.0, 0.5, 2.0]), cell=0.1, shape=(20, 12, 16))


def cloud(n, seed=0, *, margin=0.25):
    """[n, 3] points that stay ``margin`` away from the sides of GRID."""
    size = GRID.cell * (np.array(GRID.shape) - 1)
    u = np.random.default_rng(seed).uniform(size=(n, 3))
    return GRID.origin + margin + u * (size - 2.0 * margin)


def shaped(density):
    """Densities on the grid's own axes."""
    return density.reshape(*density.shape[:-1], *GRID.shape)


def test_a_point_on_a_node_weighs_it_most():
    """Weights of a point on node (3, 4, 5): 3/4 a side in the middle, 1/8 beside it."""
    d = shaped(GRID.splat((GRID.origin + 0.1 * np.array([3, 4, 5]))[None]))
    side = np.array([0.125, 0.75, 0.125])
    assert d[2:5, 3:6, 4:7] == pytest.approx(np.einsum("i,j,k->ijk", side, side, side))
    assert np.count_nonzero(d > 1e-15) == 27
    # points off the grid are ignored
    p = cloud(9)
    size = GRID.cell * (np.array(GRID.shape) - 1)
    for axis in range(3):
        for side in (-1.0, 1.0):
            away = GRID.origin + size / 2.0 + side * (size / 2.0 + 0.5) * np.eye(3)[axis]
            d = GRID.splat(np.concatenate([p, away[None]]))
            assert np.allclose(d, 0.9 * GRID.splat(p), atol=1e-12)


@pytest.mark.parametrize("n", [1, 7, 200])
def test_density_has_the_clouds_mean(n):
    """Weights sum to one, the density's centre is the cloud's, and each axis' variance is
    cell^2 / 4 wider. A cloud moved by one cell has the same density one node further."""
    p = cloud(n)
    d = shaped(GRID.splat(p))
    assert d.sum() == pytest.approx(1.0, abs=1e-12) and d.min() >= 0.0
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


# Visibility.


def sphere(n=2000):
    """[n, 3] points spread evenly on a unit sphere (a golden spiral)."""
    z = 1.0 - 2.0 * (np.arange(n) + 0.5) / n
    turn = np.arange(n) * np.pi * (3.0 - np.sqrt(5.0))
    r = np.sqrt(1.0 - z**2)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


@pytest.mark.parametrize("towards", [None, (0, 0, 1), (-2, 1, -2)])
def test_a_camera_sees_half_a_sphere(towards):
    """From afar the hemisphere that faces the camera is seen, the other is not; without cameras
    the view is from above. Two on both sides see what either sees."""
    p = sphere()
    direction = np.array(towards or (0, 0, 1)) / np.linalg.norm(towards or 1)
    camera = 50.0 * direction[None]
    seen = visible(p, camera_positions=None if towards is None else camera)
    facing = p @ direction
    assert seen.mean() == pytest.approx(0.5, abs=0.05)
    assert seen[facing > 0.15].all() and not seen[facing < -0.15].any()
    both = visible(p, camera_positions=np.concatenate([camera, -camera]))
    one, other = (visible(p, camera_positions=c) for c in (camera, -camera))
    assert np.array_equal(both, one | other) and both.mean() > 0.97


def test_a_rope_from_above_shows_its_upper_side():
    """The whole upper row of a lying rope is seen, the lower row is not but at its ends. One, two
    or three points hide nothing."""
    body = rope(diameter=0.02, length=0.3, start=(0.0, 0.0, 0.01), cells_across=2.0)
    seen = visible(body.x)
    z, along = body.x[:, 2], body.x[:, 0]
    inside = (along > 0.01) & (along < 0.29)
    assert seen[np.isclose(z, z.max())].all()
    assert not seen[np.isclose(z, z.min()) & inside].any()
    assert all(visible(np.eye(3)[:n]).all() for n in (1, 2, 3))


def folded(turn, n=41):
    """Points, normals and spacing of a sheet of 0.2 x 0.4 m: one half level at z = 0, the other
    turned up and over about y by an angle [rad]."""
    u, v = (
        g.ravel() for g in np.meshgrid(np.linspace(-0.2, 0.2, 2 * n - 1), np.linspace(0, 0.2, n))
    )
    over = u > 0.0
    c, s = np.cos(turn), np.sin(turn)
    x = np.stack([np.where(over, u * c, u), v, np.where(over, u * s, 0.0)], axis=1)
    normal = np.where(over[:, None], [-s, 0.0, c], [0.0, 0.0, 1.0])
    return x, normal, over, 0.2 / (n - 1)


def test_what_a_sheet_hides_of_itself_is_not_seen():
    """The half that is folded over, 40 mm above at its end, hides the lower one from above."""
    x, normal, over, spacing = folded(np.pi - 0.2)
    well = 0.2 * -x[:, 0] > 0.01  # apart are both halves
    seen = {}
    for z, shown in ((1.0, over), (-1.0, ~over)):
        camera = [[-0.1, 0.1, z]]
        seen[z] = visible_on_sheet(x, normal, x, spacing=spacing, camera_positions=camera)
        assert seen[z][shown].mean() > 0.98 and not seen[z][~shown & well].any()
    cameras = [[-0.1, 0.1, z] for z in seen]
    both = visible_on_sheet(x, normal, x, spacing=spacing, camera_positions=cameras)
    assert np.array_equal(both, seen[1.0] | seen[-1.0])


def test_what_is_seen_aslant_is_not_measured():
    """From above a half that stands nearly upright is not, one that leans by 45 degrees is."""
    for turn, shown in ((np.radians(85.0), False), (np.radians(45.0), True)):
        x, normal, over, spacing = folded(turn)
        seen = visible_on_sheet(x, normal, x, spacing=spacing)
        assert seen[over].all() if shown else not seen[over].any()
        assert seen[~over & (x[:, 0] < -0.01)].all()


def test_shapes_that_do_not_fit():
    """Points are [n > 0, 3], cameras [K, 3]."""
    good = np.zeros((4, 3))
    with pytest.raises(ParameterError, match="points"):
        visible(np.zeros((0, 3)))
    with pytest.raises(ParameterError, match="camera_positions"):
        visible(np.eye(3), camera_positions=[[1.0, 2.0]])
    for arrays in ((good, good[:2], good), (good[:, :2],) * 3, (good, good, good[:0])):
        with pytest.raises(ParameterError, match="points and normals"):
            visible_on_sheet(*arrays, spacing=0.01)
