"""How broad a rope looks across views."""

import numpy as np
import pytest

from gendom.observation import breadth_across

CAMERAS = np.array([[0.4, -0.7, 0.4], [0.4, 0.7, 0.4]])


def strips(diameter, moved, noise=0.003, points=3000, seed=0):
    """A hanging rope as two cameras see it, one of them `moved` sideways: points and their feet."""
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
    return feet + off, feet, np.tile([0.0, 0.0, 1.0], (points, 1))


@pytest.mark.parametrize("moved", [0.0, 0.004])
@pytest.mark.parametrize("diameter", [0.003, 0.006, 0.015])
def test_breadth_is_the_diameter_whatever_depth_and_calibration_do(diameter, moved):
    points, feet, tangent = strips(diameter, moved)
    seen = breadth_across(points, feet, tangent, CAMERAS, noise=0.003)
    assert seen == pytest.approx(diameter, rel=0.3)


def test_few_points_show_no_breadth():
    points, feet, tangent = strips(0.006, 0.0, points=150)
    assert breadth_across(points, feet, tangent, CAMERAS, noise=0.003) is None
