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

import math

import numpy as np

from gendom.arrays import Array
from gendom.reality.objects import RealRope


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
        from gendom.reality.kernels import bound, twist  # Warp, which takes long to import

        self._held = slice(first, last + 2)
        x = vertices[self._held]
        edges = np.diff(x, axis=0)
        length = np.linalg.norm(edges, axis=1)
        # Half of each clamped edge belongs to its vertex between the clamps.
        GJ = rope.material.lame[0] * math.pi * rope.diameter**4 / 32.0  # of a round section
        stiffness = GJ / (length.sum() - 0.5 * (length[0] + length[-1]))
        self._lag = stiffness * rope.material.damping
        t = edges[0] / length[0]
        start = np.cross(t, np.eye(3)[np.argmin(np.abs(t))])
        self._x, self._forces, self._moment = x.copy(), np.zeros_like(vertices), np.zeros((1, 3))
        self._clamp = np.array([start, start, start])
        self._numbers = np.array([stiffness, 0.0, 0.0])
        own = self._x, self._clamp, self._numbers, self._forces[self._held], self._moment
        self._twist = bound(twist, *own)
        self._twist.launch()
        self._end = rotation.T @ self._clamp[2]
        self._numbers[2] = 0.0

    @property
    def angle(self) -> float:
        """Now [rad]; it may pass several turns."""
        return float(self._numbers[2])

    def load(self, vertices: Array, rotation: Array, seconds: float) -> tuple[Array, Array]:
        """Forces [V, 3] on the vertices now [N], and the moment [3] on the last clamp [N m].

        Args:
            vertices: [V, 3] [m].
            rotation: [3, 3] of the second clamp.
            seconds: Since the last call [s].
        """
        self._x[:] = vertices[self._held]
        self._clamp[1] = rotation @ self._end
        self._numbers[1] = self._lag / seconds
        self._forces[:] = 0.0
        self._twist.launch()
        return self._forces.copy(), self._moment[0].copy()
