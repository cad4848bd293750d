"""Which parts cameras see: spheres, ropes, folded sheets, several cameras."""

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.observation import visible, visible_on_sheet
from gendom.sim import rope


def sphere(n=2000):
    """[n, 3] points spread evenly on a unit sphere (a golden spiral)."""
    z = 1.0 - 2.0 * (np.arange(n) + 0.5) / n
    turn = np.arange(n) * np.pi * (3.0 - np.sqrt(5.0))
    r = np.sqrt(1.0 - z**2)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


@pytest.mark.parametrize("towards", [(0, 0, 1), (1, 0, 0), (-2, 1, -2)])
def test_a_camera_sees_half_a_sphere(towards):
    """From afar the hemisphere that faces the camera is seen, the other is not."""
    p = sphere()
    direction = np.array(towards) / np.linalg.norm(towards)
    seen = visible(p, camera_positions=(50.0 * direction)[None])
    facing = p @ direction
    assert seen.mean() == pytest.approx(0.5, abs=0.05)
    assert seen[facing > 0.15].all()
    assert not seen[facing < -0.15].any()


def test_a_near_camera_sees_less():
    """From distance d the cap z > 1 / d is seen, a share (1 - 1 / d) / 2 of the sphere."""
    p = sphere()
    seen = visible(p, camera_positions=[[0.0, 0.0, 2.0]])
    assert seen.mean() == pytest.approx(0.25, abs=0.05)
    assert p[seen, 2].min() > 0.3


def test_two_cameras_see_what_either_sees():
    """Cameras on both sides see the whole sphere; the union is exact."""
    p = sphere()
    cameras = np.array([(0.0, 0.0, 50.0), (0.0, 0.0, -50.0)])
    both = visible(p, camera_positions=cameras)
    one, other = (visible(p, camera_positions=c[None]) for c in cameras)
    assert np.array_equal(both, one | other)
    assert both.mean() > 0.97
    assert one.mean() < 0.6 and other.mean() < 0.6


def test_from_above_is_a_camera_high_up():
    """Without cameras the view is from above."""
    p = sphere()
    seen = visible(p)
    assert seen[p[:, 2] > 0.15].all()
    assert not seen[p[:, 2] < -0.15].any()


def test_a_rope_from_above_shows_its_upper_side():
    """The whole upper row of a lying rope is seen, the lower row is not but at its ends."""
    body = rope(diameter=0.02, length=0.3, start=(0.0, 0.0, 0.01), cells_across=2.0)
    seen = visible(body.x)
    z, along = body.x[:, 2], body.x[:, 0]
    inside = (along > 0.01) & (along < 0.29)
    assert seen[np.isclose(z, z.max())].all()
    assert not seen[np.isclose(z, z.min()) & inside].any()


def test_few_points_hide_nothing():
    """One, two or three points are all seen."""
    for n in (1, 2, 3):
        assert visible(np.eye(3)[:n]).all()


def test_shapes_that_do_not_fit():
    """Points are [n > 0, 3], cameras [K, 3]."""
    with pytest.raises(ParameterError, match="points"):
        visible(np.zeros((0, 3)))
    with pytest.raises(ParameterError, match="camera_positions"):
        visible(np.eye(3), camera_positions=[[1.0, 2.0]])


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
    camera = [[-0.1, 0.1, 1.0]]
    seen = visible_on_sheet(x, normal, x, spacing=spacing, camera_positions=camera)
    apart = 0.2 * -x[:, 0]  # of both halves
    well = apart > 0.01
    assert seen[over].mean() > 0.98 and not seen[~over & well].any()
    below = [[-0.1, 0.1, -1.0]]
    other = visible_on_sheet(x, normal, x, spacing=spacing, camera_positions=below)
    assert other[~over].mean() > 0.98 and not other[over & well].any()
    both = visible_on_sheet(x, normal, x, spacing=spacing, camera_positions=[*camera, *below])
    assert np.array_equal(both, seen | other)


def test_what_is_seen_aslant_is_not_measured():
    """From above a half that stands nearly upright is not, one that leans by 45 degrees is."""
    for turn, shown in ((np.radians(85.0), False), (np.radians(45.0), True)):
        x, normal, over, spacing = folded(turn)
        seen = visible_on_sheet(x, normal, x, spacing=spacing)
        assert seen[over].all() if shown else not seen[over].any()
        assert seen[~over & (x[:, 0] < -0.01)].all()


def test_bad_shapes_of_a_sheet_are_refused():
    good = np.zeros((4, 3))
    for points, normals, sheet in (
        (good, good[:2], good),
        (good[:, :2],) * 3,
        (good, good, good[:0]),
    ):
        with pytest.raises(ParameterError, match="points and normals"):
            visible_on_sheet(points, normals, sheet, spacing=0.01)
