"""Poses of grippers along their paths, and their derivatives.

Shapes: W worlds, G grippers, K knots.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.sim.thin import rotation

Array = NDArray[Any]


@dataclass
class Pose:
    """Pose and velocity of a gripper in each world."""

    centre: Array
    """[W, 3] centre [m]."""
    q: Array
    """[W, 4] orientation."""
    velocity: Array
    """[W, 3] velocity of the centre [m/s]."""
    spin: Array
    """[W, 3] angular velocity [rad/s]."""


@dataclass
class PoseBars:
    """Derivatives by the parts of a ``Pose``; for q by a rotation in world axes."""

    centre: Array
    q: Array
    velocity: Array
    spin: Array


class Paths:
    """Gripper paths as arrays of ``Grippers``, with derivatives by their knots."""

    def __init__(self, stacked: dict[str, NDArray[Any]]):
        self.stacked = stacked
        shape = stacked["position"].shape
        self.position_bar = np.zeros(shape)
        self.turn_bar = np.zeros(shape)

    def _segment(self, g: int, w: Array, t: Array) -> tuple[Array, Array, Array]:
        """Knot that begins the segment just before times t, elapsed share of that segment, and
        1 / its duration [1/s], 0 outside the path; [W] each."""
        time = self.stacked["time"][w, g]
        last = time.shape[1] - 2
        k = np.clip(np.sum(time < t[:, None], axis=1) - 1, 0, last)
        rows = np.arange(len(w))
        begin, end = time[rows, k], time[rows, k + 1]
        span = end - begin
        inside = (span > 0.0) & (t > begin) & (t <= end)
        share = np.where(span > 0.0, (t - begin) / np.where(span > 0.0, span, 1.0), 0.0)
        return k, np.clip(share, 0.0, 1.0), np.where(inside, 1.0, 0.0) / np.where(inside, span, 1.0)

    def pose(self, g: int, w: Array, t: Array) -> Pose:
        """Pose of gripper g of worlds w [W] at times t [W] [s], with velocities just before t."""
        k, share, rate = self._segment(g, w, t)
        p, turn = self.stacked["position"], self.stacked["turn"][w, g, k]
        step = p[w, g, k + 1] - p[w, g, k]
        q = rotation.product(_exp(share[:, None] * turn), self.stacked["orientation"][w, g, k])
        turns = self.stacked["turns"][w, g, None] == 1
        return Pose(
            centre=p[w, g, k] + share[:, None] * step,
            q=np.where(turns, q, [0.0, 0.0, 0.0, 1.0]),
            velocity=rate[:, None] * step,
            spin=np.where(turns, rate[:, None] * turn, 0.0),
        )

    def pose_adjoint(self, g: int, w: Array, t: Array, bars: PoseBars) -> None:
        """Transpose of ``pose``; each world may occur at most once."""
        k, share, rate = self._segment(g, w, t)
        share, rate = share[:, None], rate[:, None]
        moved = rate * bars.velocity
        self.position_bar[w, g, k] += (1.0 - share) * bars.centre - moved
        self.position_bar[w, g, k + 1] += share * bars.centre + moved
        turns = self.stacked["turns"][w, g, None] == 1
        turn = self.stacked["turn"][w, g, k]
        gone = _exp(share * turn)
        # exp(share turn): its left Jacobian times share
        J = np.linalg.inv(rotation.left_jacobian_inverse(share * turn))
        by_turn = share * np.einsum("wab,wa->wb", J, bars.q) + rate * bars.spin
        inverse = rotation.left_jacobian_inverse(turn)
        after = np.einsum("wab,wa->wb", inverse, by_turn)
        before = rotation.turned(rotation.conjugate(gone), bars.q)
        before -= np.einsum("wab,wb->wa", inverse, by_turn)
        self.turn_bar[w, g, k] += np.where(turns, before, 0.0)
        self.turn_bar[w, g, k + 1] += np.where(turns, after, 0.0)


def _exp(turn: Array) -> Array:
    """Quaternions [..., 4] of rotation vectors [..., 3]."""
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(0.5 * angle / np.pi) * turn, np.cos(0.5 * angle)], axis=-1)
