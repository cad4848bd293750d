"""Gripper paths: interpolation, spin from orientations, and many of them as arrays."""

import numpy as np
from scipy.spatial.transform import Rotation

from gendom.sim import Gripper, Grippers


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


def test_turns_carry_one_orientation_into_the_next():
    """exp(turn) times the pose at a knot is the pose at the next, in world axes, by the short way:
    q and -q are one orientation; quaternions need not be of unit length."""
    poses = Rotation.from_rotvec([[0.3, -0.2, 0.1], [1.0, 0.5, -0.7], [-0.4, 0.9, 0.2]])
    q = poses.as_quat() * np.array([[1.0], [-3.0], [0.2]])
    turn = Grippers.of([[Gripper(**path(quat_xyzw=q))]]).arrays["turn"][0, 0]
    for k in range(2):
        turned = Rotation.from_rotvec(turn[k]) * poses[k]
        assert (turned * poses[k + 1].inv()).magnitude() < 1e-12
        assert np.linalg.norm(turn[k]) < np.pi
    assert np.array_equal(turn[2], np.zeros(3))
    assert not Grippers.of([[Gripper(**path())]]).arrays["turn"].any()


def test_stacked_grippers_are_those_that_were_given():
    """Shorter paths repeat their last knot."""
    q = Rotation.from_rotvec([[0, 0, a] for a in (0.0, 0.3, 1.1)]).as_quat()
    turning = Gripper(**path(quat_xyzw=q))
    still = Gripper.still([0.1, 0.2, 0.3], radius=0.02, hold_until=0.7)
    every = [[turning, still], [still, turning]]
    arrays = Grippers.of(every).arrays
    for w, g in np.ndindex(2, 2):
        of, last = every[w][g], [len(np.asarray(every[w][g].time)) - 1]
        knots = np.minimum(np.arange(3), last)
        for name in ("time", "position"):
            np.testing.assert_array_equal(arrays[name][w, g], np.asarray(getattr(of, name))[knots])
        for name in ("radius", "hold_from", "hold_until"):
            assert arrays[name][w, g] == getattr(of, name)
        assert arrays["turns"][w, g] == (of is turning)
    assert np.abs(arrays["orientation"][0, 0] - q).max() < 1e-12
