"""Torsional stiffness of a rope, which MuJoCo's one-dimensional flex lacks.

A rod's centre line does not tell how its sections are turned, but where both its ends are clamped,
twist spreads along it at once (much faster than it bends), and one angle is left: how far the last
section is turned against the first, carried there along the rod without twist. For a rod that is
straight and round at rest it is the same along the rod, and

    E = 1/2 GJ m^2 / L,    dm/dx_(i-1) = -k_i / (2 |e_(i-1)|),    dm/dx_(i+1) = k_i / (2 |e_i|),

at each vertex i between the clamps, dm/dx_i being minus the sum of both, with the discrete
curvature binormal k_i = 2 e_(i-1) x e_i / (|e_(i-1)| |e_i| + e_(i-1) . e_i): Bergou, Wardetzky,
Robinson, Audoly and Grinspun, "Discrete elastic rods", 2008, sections 4.2 and 6. The moment on
what clamps the last section is -GJ m / L along its edge. As in bending, the damping time is what a
rate of strain is worth in strain.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from gendom.arrays import Array
from gendom.reality.objects import RealRope

_ONE = np.eye(3)
_CROSS = np.swapaxes(np.cross(_ONE[:, None], _ONE[None]), 1, 2).reshape(3, 9)  # b @ it: b x


def torsion_rigidity(rope: RealRope) -> float:
    """GJ of a round section [N m^2]: E / (2 (1 + nu)) pi d^4 / 32."""
    G = rope.material.E / (2.0 * (1.0 + rope.material.nu))
    return G * math.pi * rope.diameter**4 / 32.0


def transported(edges: Array, director: npt.ArrayLike) -> Array:
    """A director [3] of the first edge, carried to the last one without twist.

    Args:
        edges: [n, 3] along the rod [m].
        director: [3] at right angles to the first edge; what is along it does not count.
    """
    t = edges / np.sqrt(np.einsum("ij,ij->i", edges, edges))[:, None]
    u = np.asarray(director, dtype=float)
    u = u - (u @ t[0]) * t[0]
    # From edge to edge the least turn: about their binormal b, R = c 1 + [b] + b b^T / (1 + c).
    cosine = np.einsum("ij,ij->i", t[:-1], t[1:])
    binormal = cross(t[:-1], t[1:])
    turns = (binormal / (1.0 + cosine)[:, None])[:, :, None] * binormal[:, None, :]
    turns += cosine[:, None, None] * _ONE + (binormal @ _CROSS).reshape(-1, 3, 3)
    while len(turns) > 1:
        odd = turns[-1:] if len(turns) % 2 else turns[:0]
        turns = np.concatenate([turns[1::2] @ turns[: len(turns) - len(odd) : 2], odd])
    for turn in turns:
        u = turn @ u
    return u / math.sqrt(u @ u)


def cross(a: Array, b: Array) -> Array:
    """a x b [..., 3], several times as fast as NumPy's."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


class Twist:
    """The twist of a rope between two clamps; it is 0 at first.

    Args:
        rope: The rope.
        vertices: [V, 3] where it is when its second end is clamped, free of twist [m].
        first: The edge that the first clamp holds: from this vertex to the next.
        last: The edge that the second clamp holds, beyond the first.
        rotation: [3, 3] orientation of the second clamp; the first one stands still.
    """

    def __init__(self, rope: RealRope, vertices: Array, first: int, last: int, rotation: Array):
        self._first, self._last = first, last
        edges = self._edges(vertices)
        length = np.linalg.norm(edges, axis=1)
        # Half of each clamped edge belongs to its vertex between the clamps.
        self._stiffness = torsion_rigidity(rope) / (length.sum() - 0.5 * (length[0] + length[-1]))
        self._damping = rope.material.damping
        t = edges[0] / length[0]
        self._start = np.cross(t, np.eye(3)[np.argmin(np.abs(t))])
        self._end = rotation.T @ transported(edges, self._start)
        self.angle = 0.0
        """Now [rad]; it may pass several turns."""

    def load(self, vertices: Array, rotation: Array, seconds: float) -> tuple[Array, Array]:
        """Forces [V, 3] on the vertices now [N], and the moment [3] on the last clamp [N m].

        Args:
            vertices: [V, 3] [m].
            rotation: [3, 3] of the second clamp.
            seconds: Since the last call [s].
        """
        edges = self._edges(vertices)
        length = np.sqrt(np.einsum("ij,ij->i", edges, edges))
        along = edges[-1] / length[-1]
        u, end = transported(edges, self._start), rotation @ self._end
        angle = math.atan2(float(cross(u, end) @ along), float(u @ end))
        angle += 2.0 * math.pi * round((self.angle - angle) / (2.0 * math.pi))
        rate = (angle - self.angle) / seconds
        self.angle = angle
        moment = self._stiffness * (angle + self._damping * rate)
        # how the twist changes with the vertices [rad/m]
        a, b = edges[:-1], edges[1:]
        half = cross(a, b) / (length[:-1] * length[1:] + np.einsum("ij,ij->i", a, b))[:, None]
        before, after = -half / length[:-1, None], half / length[1:, None]
        forces = np.zeros_like(vertices)
        held = forces[self._first : self._last + 2]
        held[:-2] -= moment * before
        held[2:] -= moment * after
        held[1:-1] += moment * (before + after)
        return forces, -moment * along

    def _edges(self, vertices: Array) -> Array:
        return np.diff(vertices[self._first : self._last + 2], axis=0)
