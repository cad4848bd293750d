"""Which particles cameras see: spheres, ropes, several cameras."""

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.observation import visible
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
