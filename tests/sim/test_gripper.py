"""Gripper paths: interpolation, spin from orientations, and many of them as arrays."""

import numpy as np

from gendom.sim import Gripper


def path(**changes):
    """Arguments of a gripper with three knots."""
    places = [[0.0, 0.0, 0.0], [1.0, 0.0, 2.0], [1.0, 4.0, 0.0]]
    return {"time": [0.0, 1.0, 3.0], "position": places, "radius": 0.01, **changes}


def test_positions_between_and_beyond_knots():
    """Straight lines between knots; still before the first and after the last."""
    at = Gripper(**path()).position_at([-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 9.0])
    expected = [[0, 0, 0], [0, 0, 0], [0.5, 0, 1], [1, 0, 2], [1, 2, 1], [1, 4, 0], [1, 4, 0]]
    assert np.allclose(at, expected, atol=1e-12)
    assert np.array_equal(Gripper(**path()).position_at(0.5), [0.5, 0.0, 1.0])
