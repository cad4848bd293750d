"""Drag of still air on ropes and cloths, by the square of the speed.

A triangle of area A and unit normal n whose mean velocity is v, a segment of length l whose mean
velocity is v, of which v_perp is what is not along it:

    F = -1/2 rho C |v . n| (v . n) A n,      F = -1/2 rho C d l |v_perp| v_perp.

Their vertices share it equally. Left out are friction along a sheet or a rope (1.33 / sqrt(Re) a
side after Blasius: hundredths of C over 0.3 m), the shelter that parts give each other, and the
mass of the air that is carried along: of a square of side a that moves broadside as a whole
0.478 pi / 4 rho a [kg/m^2] (Blevins, "Formulas for Natural Frequency and Mode Shape", 1979), or
0.14 kg/m^2 for 0.3 m.
"""

import numpy as np
from scipy.sparse import csr_array

from gendom.arrays import Array
from gendom.materials import AIR_DENSITY
from gendom.reality.objects import RealObject, RealRope

SHEET_DRAG = 1.2
"""Drag coefficient of a flat sheet across the flow [-]: a square plate has 1.17 (Hoerner,
"Fluid-Dynamic Drag", 1965, chapter 3; Matthews, "Aeronautical Engineer's Data Book", 2002, fig.
5.13)."""

ROPE_DRAG = 1.1
"""Drag coefficient of a round rope across the flow at Reynolds numbers of 1e3 to 1e5 [-]: a
cylinder has 0.9 to 1.2 (Hoerner, chapter 3; Matthews: 0.98 if 40 diameters long, 1.20 without
ends). A rope of 16 mm has 1e3 at 1 m/s."""


class Air:
    """Still air around one object.

    Args:
        item: The object.
        density: Of the air [kg/m^3].
    """

    def __init__(self, item: RealObject, density: float = AIR_DENSITY):
        self.density = density
        """[kg/m^3]."""
        if isinstance(item, RealRope):
            from gendom.reality.kernels import bound, drag  # Warp, which takes long to import

            self._rope = np.zeros((3, item.vertices, 3))  # x, v and the force
            factor = -0.25 * density * ROPE_DRAG * item.diameter
            self._drag = bound(drag, self._rope[0], self._rope[1], factor, self._rope[2])
            self._triangles = None
            return
        triangles = item.sheet[1]
        self._triangles = triangles
        # [F, V]: a triangle's mean of its vertices; transposed, their equal shares.
        F = len(triangles)
        third = np.full(3 * F, 1.0 / 3.0)
        at = (np.repeat(np.arange(F), 3), triangles.ravel())
        self._mean = csr_array((third, at), shape=(F, int(triangles.max()) + 1))
        self._share = self._mean.T.tocsr()

    def forces(self, x: Array, v: Array) -> Array:
        """[V, 3] on the vertices [N].

        Args:
            x: [V, 3] where they are [m].
            v: [V, 3] their velocities [m/s].
        """
        if self._triangles is None:
            self._rope[0], self._rope[1], self._rope[2] = x, v, 0.0
            self._drag.launch()
            return self._rope[2].copy()
        a, b, c = x[self._triangles.T]
        p, q = b - a, c - a
        # its length is the area; several times as fast as NumPy's
        n = 0.5 * (p[:, [1, 2, 0]] * q[:, [2, 0, 1]] - p[:, [2, 0, 1]] * q[:, [1, 2, 0]])
        area2 = np.einsum("ij,ij->i", n, n)
        through = np.einsum("ij,ij->i", self._mean @ v, n)  # A (v . n)
        size = -0.5 * self.density * SHEET_DRAG * np.abs(through) * through
        size = np.divide(size, area2, out=np.zeros_like(size), where=area2 > 0.0)
        return self._share @ (size[:, None] * n)
