"""The triangles of a cloth.

Squares are halved along one diagonal and the other by turns: halved all alike, a sheet of MuJoCo
4.0 resists bending along the diagonals 3.4 times as much as across them.

Its bending energy of a square of side h, w up: hinges over the edges see the curvature
(w_up + w_down - 2 w) / h^2 of the vertices where no diagonal ends, those over the diagonals see
+-(twist). A vertex where diagonals end can be higher or lower than its neighbours by any u h^2 / 4,
so with stiffness a over the edges and g a / 4 over the diagonals the energy an area is

    a / 2 min_u [(w_xx + u)^2 + (w_yy + u)^2 + g (w_xy^2 + u^2)]
    = a / 2 [w_xx^2 + w_yy^2 - (w_xx + w_yy)^2 / (2 + g) + g w_xy^2].

That is a plate's for g = 2 alone, with a rigidity of 3 a / 4 and a Poisson's ratio (of bending) of
-1/3. MuJoCo has g = 4: 5 a / 6 over the sides, 4 a / 3 over the diagonals.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

SHEET_NU = -1.0 / 3.0
"""Poisson's ratio of bending; that of the material counts in a sheet's rigidity and its plane."""


def grid(
    along: int, across: int, spacing: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.intp]]:
    """A flat rectangle.

    Args:
        along: Vertices along its first side.
        across: Vertices along its second side.
        spacing: Between neighbours [m].

    Returns:
        Vertices [along * across, 2] [m], those of the second side one after another, and
        triangles [F, 3].
    """
    at = np.arange(along * across).reshape(along, across)
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    even = np.indices(a.shape).sum(axis=0) % 2 == 0
    first = np.stack([a, b, np.where(even, c, d)], axis=-1)
    second = np.stack([np.where(even, a, b), c, d], axis=-1)
    triangles = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    points = spacing * np.indices((along, across)).reshape(2, -1).T.astype(np.float64)
    return points, triangles
