"""Forces of thin bodies and their derivatives by points and directions, as a sparse matrix.

Components C of a point are its position and, for rods, also the direction of the edge that begins
there, as a rotation about the world's axes.
"""

from typing import Any

import numpy as np
import scipy.sparse as sparse
import warp as wp
from numpy.typing import NDArray

from gendom.sim.thin.relaxing import make_relaxing
from gendom.sim.thin.types import MODEL_BARS


class Tangent:
    """Elastic forces of single worlds, and their derivatives.

    Args:
        engine: Rods or shells.
        body: Body of the kernels, without damping and air.

    A point exerts forces on its neighbours in a rod, and in a shell on points up to two away along
    both axes. Points that share no neighbour are probed together (graph colouring).
    """

    def __init__(self, engine: Any, body: Any):
        e, n = engine, engine.num_points
        self.engine, self.body = engine, body
        self.kernels = make_relaxing(e.real, e.kind)
        rod = e.kind == "rod"
        self.components = C = 6 if rod else 3
        shape, reach = ((1, n), 1) if rod else (e.model.shape, 2)
        at = np.arange(n) if rod else e.model.at
        row, column = (a.reshape(-1)[at] for a in np.indices(shape))
        number = np.full(shape, -1)
        number[row, column] = np.arange(n)
        width = 2 * reach + 1
        high = 1 if rod else width
        colour = (row % high) * width + column % width
        self.colours = high * width
        near = []
        for down in range(-(high // 2), high // 2 + 1):
            for right in range(-reach, reach + 1):
                r, c = row + down, column + right
                there = (r >= 0) & (r < shape[0]) & (c >= 0) & (c < shape[1])
                there[there] = number[r[there], c[there]] >= 0
                near.append(np.stack([np.flatnonzero(there), number[r[there], c[there]]]))
        of, by = np.concatenate(near, axis=1)
        a, b = np.indices((C, C))
        rows = (of[:, None, None] * C + a).reshape(-1)
        columns = (by[:, None, None] * C + b).reshape(-1)
        order = np.lexsort((rows, columns))
        self.rows = rows[order]
        self.starts = np.searchsorted(columns[order], np.arange(n * C + 1))
        self.probe = (colour[of][:, None, None] * C + a).reshape(-1)[order]
        self.component = np.broadcast_to(b, (len(of), C, C)).reshape(-1)[order]
        self.slot = np.broadcast_to(e.slots[by][:, None, None], (len(of), C, C)).reshape(-1)[order]
        colours = np.full(e.row_length, -1, dtype=np.int32)
        colours[e.slots] = colour
        self.colour = e.array(colours, wp.int32)
        self.bars = e.types.Bars()
        self.bars.state = e.zeros((e.num_worlds, e.state_bars, e.row_length))
        self.bars.model = e.zeros((e.num_worlds, MODEL_BARS, e.row_length))
        self.bars.scratch = e.zeros((e.num_worlds, e.scratch_bars, e.row_length))

    def forces(self, w: int, body: Any = None) -> NDArray[np.float64]:
        """Elastic forces [N] and torques [N m] of world w, [n, C]."""
        e = self.engine
        out = e.zeros((1, self.components, e.row_length))
        body = self.body if body is None else body
        e.launch(self.kernels.balance, slice(w, w + 1), [body, e.state, out])
        return out.numpy()[0][:, e.slots].T.astype(float)

    def stiffness(self, w: int) -> sparse.csc_matrix:
        """Derivatives [n C, n C] of world w's forces."""
        e, C = self.engine, self.components
        out = e.zeros((self.colours * C, C, e.row_length))
        e.launch(
            self.kernels.tangent,
            slice(w, w + 1),
            [self.body, e.state, self.colour, self.colours, self.bars, out],
        )
        values = out.numpy()[self.probe, self.component, self.slot].astype(float)
        size = e.num_points * C
        return sparse.csc_matrix((values, self.rows, self.starts), shape=(size, size))
