"""Newton's method for static equilibria: supports of a body, and unbalanced forces.

A point is free, held by a gripper, or on the table. On the table it sticks to its position in the
previous frame, or slides with the friction mu N against its displacement since then. Walls are
frictionless.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from gendom.materials import STANDARD_GRAVITY
from gendom.sim.thin import rotation
from gendom.sim.thin.run import put
from gendom.sim.thin.tangent import Tangent
from gendom.sim.thin.types import X

ITERATIONS = 12
"""Maximum number of linear systems solved for one equilibrium."""

LONGEST = 0.3
"""Largest displacement of a point in one Newton step [spacings]."""

WIDEST = 0.5
"""Largest rotation of an edge in one Newton step [rad]."""

SINGULAR = 1e-14
"""Ratio of pivots below which the matrix counts as singular."""


@dataclass
class Supports:
    """Supports of the points of one world."""

    fixed: NDArray[np.bool_]
    """[n, C] mask of components that are not free."""
    touches: NDArray[np.bool_]
    """[n] whether a point presses on the table."""
    slides: NDArray[np.bool_]
    """[n] whether a point slides on the table."""
    slip: NDArray[np.float64]
    """[n, 2] horizontal displacement since the previous frame [m]."""
    walls: NDArray[np.float64]
    """[n, 3] 1 at lower walls, -1 at upper ones."""


def copied(engine: Any, body: Any) -> Any:
    """Return a copy of a body's struct that shares its arrays."""
    twin = engine.types.Body()
    for name in engine.types.Body.vars:
        setattr(twin, name, getattr(body, name))
    return twin


class Balance:
    """Unbalanced forces and equilibria of single worlds.

    Args:
        engine: Rods or shells.
        body: Body of the kernels, without damping and air, with anchors.
    """

    def __init__(self, engine: Any, body: Any):
        e = self.engine = engine
        self.body = body
        self.tangent = Tangent(engine, body)
        self.components = C = self.tangent.components
        W, n = e.num_worlds, e.num_points
        self.gravity, self.mu = body.gravity.numpy().astype(float), body.friction.numpy()
        self.mass = np.broadcast_to(1.0 / e.per_mass, (W, n))
        pull = np.linalg.norm(self.gravity, axis=1)
        self.unit = np.where(pull > 0.0, pull, STANDARD_GRAVITY)
        """[W] acceleration that is the unit of residuals, gravity if there is any [m/s^2]."""
        self.scale = np.repeat((self.mass * self.unit[:, None])[:, :, None], C, axis=2)
        """[W, n, C] unit of force or torque for residuals."""
        self.missing = np.zeros((n, C), dtype=bool)
        """[n, C] mask of components that do not exist."""
        if C == 6:
            self.scale[:, :-1, 3:] *= e.model.length[:, None]
            self.missing[-1, 3:] = True
        self.eps = float(np.finfo(e.setting.dtype).eps)
        extent = float(np.abs(e.component(X)).max()) + e.spacing
        self.near = 64.0 * self.eps * max(extent, 1.0)
        """Distance that counts as 0 [m]."""
        rows, stiffest = (3, 2.0 / e.spacing) if C == 6 else (4, 8.0 / e.spacing**2)
        k = stiffest * e.body.stiffness.numpy()[:, :rows].max()
        self.rounding = float(2.0 * self.eps * extent * k / self.scale[..., 0].min())
        """Rounding error of residuals."""

    # ---- forces ----------------------------------------------------------------------------------

    def forces(self, w: int) -> NDArray[np.float64]:
        """Sum of elastic forces and weight, [n, C]."""
        f = self.tangent.forces(w)
        f[:, :3] += self.mass[w][:, None] * self.gravity[w]
        return f

    def friction(self, w: int) -> float:
        return float(self.mu[w])

    def points(self, w: int) -> NDArray[np.float64]:
        return self.engine.state[w].numpy()[X][:, self.engine.slots].T.astype(float)

    def anchor(self, w: int) -> NDArray[np.float64]:
        return self.body.anchor[w].numpy()[:, self.engine.slots].T.astype(float)

    def supports(self, w: int, f: NDArray[np.float64]) -> Supports:
        """Supports of the points of world w in its current shape, under forces [n, C]."""
        e, x = self.engine, self.points(w)
        holds = e.holds[w]
        held, turned = np.any(holds & 1, axis=0), np.any(holds & 2, axis=0)
        fixed = self.missing.copy()
        fixed[held, :3] = True
        if self.components == 6:
            fixed[turned, 3:] = True
        slip = (x - self.anchor(w))[:, :2]
        touches = np.zeros(len(x), dtype=bool)
        slides = touches
        if self.body.table:
            touches = ~held & (x[:, 2] <= self.body.radius + self.near) & (f[:, 2] < 0.0)
            fixed[touches, 2] = True
            far = np.linalg.norm(slip, axis=1) > self.near
            slides = touches & (far if self.friction(w) > 0.0 else True)
            fixed[touches & ~slides, :2] = True
        walls = np.zeros_like(x)
        if self.body.walls:
            r, free = self.body.radius, ~fixed[:, :3]
            lower, upper = np.array(self.body.box_lower) + r, np.array(self.body.box_upper) - r
            walls += free & (x <= lower + self.near) & (f[:, :3] < 0.0)
            walls -= free & (x >= upper - self.near) & (f[:, :3] > 0.0)
            fixed[:, :3] |= walls != 0.0
        return Supports(fixed, touches, slides, slip, walls)

    def unbalanced(
        self, w: int, f: NDArray[np.float64], on: Supports
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Forces with friction [n, C], 0 in components that are not free, and slip directions
        [n, 2]."""
        left = f.copy()
        size = np.linalg.norm(on.slip, axis=1)
        d = np.where(on.slides[:, None], on.slip / np.maximum(size, 1e-300)[:, None], 0.0)
        left[:, :2] += self.friction(w) * f[:, 2:3] * d
        left[on.fixed] = 0.0
        return left, d

    def jacobian(
        self, w: int, f: NDArray[np.float64], on: Supports, d: NDArray[np.float64]
    ) -> sparse.csc_matrix:
        """Derivative [n C, n C] of ``unbalanced`` with respect to the shape."""
        J, C, mu = self.tangent.stiffness(w), self.components, self.friction(w)
        i = np.flatnonzero(on.slides)
        if len(i) and mu > 0.0:
            n = len(f)
            # friction depends on the normal force and on the direction of slip
            rows = np.concatenate([i * C, i * C + 1])
            entries = mu * np.concatenate([d[i, 0], d[i, 1]])
            size = n * C
            lift = sparse.csc_matrix((entries, (rows, np.tile(i * C + 2, 2))), shape=(size, size))
            turn = self.turning(w, f, on, d, i)
            a, b = np.indices((2, 2))
            rows = (i[:, None, None] * C + a).reshape(-1)
            columns = (i[:, None, None] * C + b).reshape(-1)
            turning = sparse.csc_matrix((turn.reshape(-1), (rows, columns)), shape=(size, size))
            J = J + lift @ J + turning
        return J.tocsc()

    def turning(
        self, w: int, f: NDArray[Any], on: Supports, d: NDArray[Any], i: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Derivative [k, 2, 2] of the friction on points i with respect to their slip."""
        across = np.stack([-d[i, 1], d[i, 0]], axis=1)
        by = self.friction(w) * f[i, 2] / np.linalg.norm(on.slip[i], axis=1)
        return by[:, None, None] * across[:, :, None] * across[:, None, :]

    # ---- Newton's method -------------------------------------------------------------------------

    def solve(self, w: int, tolerance: float) -> int:
        """Move world w to equilibrium with its current supports.

        The shape stays unchanged if that fails, or if self-contact is possible, since self-contact
        has no tangent.

        Returns:
            The number of linear systems solved.
        """
        e = self.engine
        if e.setting.self_contact:
            return 0
        start = e.state[w].numpy().copy()
        before = np.inf
        f = self.forces(w)
        on = self.supports(w, f)
        for k in range(ITERATIONS + 1):
            left, d = self.unbalanced(w, f, on)
            residual = np.abs(left / self.scale[w]).max()
            if residual <= max(0.1 * tolerance, 0.5 * self.rounding):
                return k
            if k == ITERATIONS or not residual <= 10.0 * before:
                break
            before = residual
            step = self._step(w, f, on, d, left)
            if step is None:
                break
            self._move(w, step)
            f = self.forces(w)
            on = replace(on, slip=(self.points(w) - self.anchor(w))[:, :2])
        if residual > tolerance:
            self.put_rows(w, start)
        return k

    def _step(self, w: int, f: Any, on: Supports, d: Any, left: Any) -> Any:
        free = np.flatnonzero(~on.fixed.reshape(-1))
        J = self.jacobian(w, f, on, d)[free][:, free]
        factors = factor(J, self.components)
        if factors is None:
            return None
        step = factors.solve(-left.reshape(-1)[free])
        full = np.zeros(left.size)
        full[free] = step
        full = full.reshape(left.shape)
        far = np.abs(full[:, :3]).max() / (LONGEST * self.engine.spacing)
        if self.components == 6:
            far = max(far, np.abs(full[:, 3:]).max() / WIDEST)
        return full / max(1.0, far)

    def _move(self, w: int, step: NDArray[np.float64]) -> None:
        e = self.engine
        rows = e.state[w].numpy().copy()
        rows[X, e.slots] += step[:, :3].T
        if self.components == 6:
            Q = slice(6, 10)
            q = rows[Q][:, e.slots].T.astype(float)
            turn = np.concatenate([0.5 * step[:, 3:], np.ones((len(q), 1))], axis=1)
            q = rotation.product(turn, q)
            rows[Q, e.slots] = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
        self.put_rows(w, rows)

    def put_rows(self, w: int, rows: NDArray[Any]) -> None:
        put(self.engine.state, slice(w, w + 1), rows[None])


def factor(J: Any, components: int) -> Any:
    """LU factors of a matrix: banded for a rod, of symmetric pattern for a shell.

    Returns:
        None if the matrix is singular, i.e. nothing resists some motion of the body.
    """
    options: dict[str, Any] = {"permc_spec": "NATURAL"}
    if components == 3:
        options = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.01}
        options["options"] = {"SymmetricMode": True}
    try:
        factors = splu(J.tocsc(), **options)
    except RuntimeError:  # a pivot that is exactly 0
        return None
    pivots = np.abs(factors.U.diagonal())
    return factors if pivots.min(initial=np.inf) > SINGULAR * pivots.max(initial=0.0) else None
