"""Frames without twist, against rotations of SciPy and central differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.sim.thin import rotation

RNG = np.random.default_rng(0)


def test_the_shortest_turn_takes_one_direction_to_the_other():
    a, b = RNG.normal(size=(2, 20, 3))
    b[0] = -2.0 * a[0]
    q = rotation.shortest(a, b)
    unit = b / np.linalg.norm(b, axis=1, keepdims=True)
    along = rotation.turned(q, a / np.linalg.norm(a, axis=1, keepdims=True))
    np.testing.assert_allclose(along, unit, atol=1e-12)
    # its axis is across both
    assert np.abs(np.sum(q[:, :3] * a, axis=1)).max() < 1e-12


@pytest.mark.parametrize("count", [2, 3, 24, 25])
def test_transported_frames_follow_edges_without_twist(count):
    step = np.array([0.3, 0.1, 1.0]) + 0.5 * RNG.normal(size=(count, 3))
    q = rotation.transported(rotation.first_frame(step[0]), step)
    unit = step / np.linalg.norm(step, axis=1, keepdims=True)
    third = np.broadcast_to([0.0, 0.0, 1.0], unit.shape)
    np.testing.assert_allclose(rotation.turned(q, third), unit, atol=1e-12)
    p = rotation.between(q[:-1], q[1:])
    assert np.abs(p[:, 2]).max(initial=0.0) < 1e-12
    assert (np.sum(q[:-1] * q[1:], axis=1) >= 0.0).all()


def test_the_transpose_is_that_of_central_differences():
    first = rotation.first_frame(np.array([0.2, 0.1, 1.0]))
    step = np.array([0.3, 0.1, 1.0]) + 0.4 * RNG.normal(size=(9, 3))
    bar, direction = RNG.normal(size=(2, 9, 3))

    def turn(h):
        """By what frames are turned, in the world's axes, as edges change."""
        at = rotation.transported(first, step + h * direction)
        p = rotation.product(at, rotation.conjugate(rotation.transported(first, step)))
        return float(np.sum(bar * 2.0 * p[:, :3] * np.sign(p[:, 3:])))

    expected = (turn(1e-5) - turn(-1e-5)) / 2e-5
    found = np.sum(rotation.transported_adjoint(first, step, bar) * direction)
    assert found == pytest.approx(expected, rel=1e-8)


def test_the_jacobian_is_that_of_the_exponential():
    turn, d = RNG.normal(size=(2, 3))
    h, back = 1e-6, Rotation.from_rotvec(turn).inv()
    ahead, behind = ((Rotation.from_rotvec(turn + s * h * d) * back).as_rotvec() for s in (1, -1))
    found = rotation.left_jacobian(turn[None])[0] @ d
    np.testing.assert_allclose(found, (ahead - behind) / (2 * h), rtol=1e-7)
