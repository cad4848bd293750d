"""Clouds compared: Chamfer distance against brute force, what cameras see, and how broad."""

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.observation import breadth_across, chamfer, visible, visible_on_sheet


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
    assert all(visible(np.eye(3)[:n]).all() for n in (1, 2, 3))  # few points hide nothing


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


@pytest.mark.parametrize("bad", [np.zeros((0, 3)), np.zeros((4, 2)), np.zeros(3)])
def test_shapes_that_do_not_fit(bad):
    """The error names the array; points are [n > 0, 3], cameras [K, 3]."""
    good = np.zeros((4, 3))
    for name, refused in (
        (r"a is \(", lambda: chamfer(bad, good)),
        (r"b is \(", lambda: chamfer(good, bad)),
        ("points", lambda: visible(bad)),
        ("camera_positions", lambda: visible(good, camera_positions=[[1.0, 2.0]])),
        ("points and normals", lambda: visible_on_sheet(good, bad, good, spacing=0.01)),
    ):
        with pytest.raises(ParameterError, match=name):
            refused()


CAMERAS = np.array([[0.4, -0.7, 0.4], [0.4, 0.7, 0.4]])


def breadth_of(diameter, moved, noise=0.003, points=3000, seed=0):
    """How broad a hanging rope looks to two cameras, one of them `moved` sideways."""
    rng = np.random.default_rng(seed)
    feet = np.tile([0.4, 0.0, 0.0], (points, 1))
    feet[:, 2] = rng.uniform(0.05, 0.35, points)
    camera = rng.integers(0, len(CAMERAS), points)
    view = feet - CAMERAS[camera]
    view[:, 2] = 0.0
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    across = diameter / 2.0 * rng.uniform(-1.0, 1.0, points)
    front = np.sqrt((diameter / 2.0) ** 2 - across**2)
    off = (noise * rng.standard_normal(points) - front)[:, None] * view
    off[:, 0] += across + np.where(camera == 1, moved, 0.0)
    tangent = np.tile([0.0, 0.0, 1.0], (points, 1))
    return breadth_across(feet + off, feet, tangent, CAMERAS, noise=noise)


@pytest.mark.parametrize("moved", [0.0, 0.004])
@pytest.mark.parametrize("diameter", [0.003, 0.006, 0.015])
def test_breadth_is_the_diameter_whatever_depth_and_calibration_do(diameter, moved):
    assert breadth_of(diameter, moved) == pytest.approx(diameter, rel=0.3)
    assert breadth_of(diameter, moved, points=150) is None  # few points show none
