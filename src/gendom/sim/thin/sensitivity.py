"""Derivatives of equilibria by parameters: implicit differentiation in forward mode.

As long as no point changes between free, sticking and sliding, the unbalanced forces R(u, a, p)
stay 0 while a parameter p changes the shape u and the shape of the previous frame, a:

    R_u du = -(R_p + R_a da),

with the exact tangent R_u of Newton's method. Held points move with their gripper, sticking points
with their position in the previous frame. All parameters share one factorisation for each frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.errors import ParameterError
from gendom.sim.thin import rotation
from gendom.sim.thin.balance import Balance, copied, factor
from gendom.sim.thin.grips import border_of_rod_adjoint, border_of_shell_adjoint
from gendom.sim.thin.poses import Paths
from gendom.sim.thin.run import Event, put

Array = NDArray[np.float64]

PARAMETERS = (
    "E", "nu", "density", "thickness", "friction", "gravity", "gripper_radius",
    "gripper_offset",
)  # fmt: skip
"""Parameters by which shapes can be differentiated, see ``Simulator.equilibria``."""


@dataclass
class _Grip:
    """Derivatives of a closed gripper of one world by each of P parameters."""

    back: Array
    """[4] conjugate of its orientation when it closed."""
    place: Array
    """[n, 3, P] of held points relative to its centre, in world axes when it closed."""
    turn: Array
    """[n, 3, P] of held directions, in the same axes."""
    stiffer: Array
    """[M, n, P] of the border's stiffness, see ``Grip.stiffer``."""


class Sensitivity:
    """Derivatives by parameters, propagated from shape to shape.

    Args:
        balance: The unbalanced forces.
        names: Names from ``PARAMETERS``.

    Raises:
        ParameterError: If a name is unknown, or the derivative is not available for the body.
    """

    def __init__(self, balance: Balance, names: Sequence[str]):
        unknown = sorted(set(names) - set(PARAMETERS))
        if unknown:
            raise ParameterError(
                f"equilibria are not differentiated by {', '.join(unknown)}",
                fix=f"choose of {', '.join(PARAMETERS)}",
            )
        e = self.engine = balance.engine
        self.balance = balance
        if names and e.setting.self_contact:
            raise ParameterError(
                "contact of a body with itself is not differentiated", fix="self_contact=False"
            )
        if "thickness" in names and e.setting.body.width is not None and e.kind == "rod":
            raise ParameterError("flat ropes are not differentiated by their thickness")
        G = e.closed.shape[1]
        self.shapes = {"gravity": (3,), "gripper_radius": (G,), "gripper_offset": (G, 3)}
        self.columns: dict[str, slice] = {}
        for name in dict.fromkeys(names):
            first = max((c.stop for c in self.columns.values()), default=0)
            size = int(np.prod(self.shapes.get(name, ())))
            self.columns[name] = slice(first, first + size)
        self.P = max((c.stop for c in self.columns.values()), default=0)
        W, n = e.num_worlds, e.num_points
        self.shape = np.zeros((W, n, balance.components, self.P))
        """[W, n, C, P] derivatives of the current shapes."""
        self.anchor = np.zeros((W, n, 3, self.P))
        """[W, n, 3, P] derivatives of the points in the previous frame."""
        self.grips: list[dict[int, _Grip]] = [{} for _ in range(W)]
        self.slopes = e.zeros(e.body.stiffness.shape if self.P else (0, 0, 0))
        self.sloped = copied(balance.engine, balance.body)
        self.sloped.stiffness = self.slopes

    def switch(self, events: Sequence[Event]) -> None:
        """Update the derivatives of grippers that close or open."""
        for event in events:
            for k, w in enumerate(int(w) for w in event.worlds):
                if event.closes:
                    self.grips[w][event.g] = self._closed(event, k, w)
                else:
                    self.grips[w].pop(event.g, None)

    def begin(self, worlds: NDArray[np.int64]) -> None:
        """Start a frame: slip is measured from the current shapes."""
        self.anchor[worlds] = self.shape[worlds][:, :, :3]

    def values(self, w: int) -> dict[str, Array]:
        """Derivatives of world w's points by parameter name, [n, 3, ...]."""
        n = self.engine.num_points
        return {
            name: self.shape[w, :, :3, at].reshape(n, 3, *self.shapes.get(name, ()))
            for name, at in self.columns.items()
        }

    def solve(self, w: int, time: float) -> None:
        """Compute derivatives of world w's shape, which is in equilibrium at this time [s].

        Raises:
            SimulationError: If the tangent is singular.
        """
        b = self.balance
        f = b.forces(w)
        on = b.supports(w, f)
        _, d = b.unbalanced(w, f, on)
        J = b.jacobian(w, f, on, d)
        free = ~on.fixed.reshape(-1)
        du = self._supported(w, time, on)
        loads = self._loads(w, f, on, d).reshape(-1, self.P)
        loads += J @ np.where(on.fixed[..., None], du, 0.0).reshape(-1, self.P)
        loads += self._by_anchor(w, f, on, d).reshape(-1, self.P)
        du = du.reshape(-1, self.P)
        factors = factor(J[free][:, free], b.components)
        if factors is None:
            raise self.engine.setting.error(
                w,
                time,
                "derivatives are not determined: nothing resists some motion of the body",
                where="implicit differentiation",
                fix="a gripper that holds more of it, or derivatives=()",
            )
        du[free] = factors.solve(-loads[free])
        self.shape[w] = du.reshape(self.shape[w].shape)

    # ---- held points -----------------------------------------------------------------------------

    def _closed(self, event: Event, k: int, w: int) -> _Grip:
        e, g, P = self.engine, event.g, self.P
        n, shape = e.num_points, self.shape[w]
        centre, radius = self._centre(g), np.zeros(P)
        if "gripper_radius" in self.columns:
            radius[self.columns["gripper_radius"].start + g] = 1.0
        stiffer = np.zeros((len(e.stiffened), n, P))
        for m, i in np.argwhere(event.grip.stiffer[k] != 1.0):
            bar = np.zeros_like(event.grip.stiffer)
            bar[k, m, i] = 1.0
            if e.kind == "rod":
                by = border_of_rod_adjoint(event.grip, event.x, event.pose, e.model.length, bar)
            else:
                by = border_of_shell_adjoint(event.grip, event.x, event.pose, e.model, bar)
            by_x, by_centre, by_radius = (of[k] for of in by)
            stiffer[m, i] = (
                np.einsum("na,nap->p", by_x, shape[:, :3]) + by_centre @ centre + by_radius * radius
            )
        turn = shape[:, 3:] if self.balance.components == 6 else np.zeros((n, 3, P))
        back = rotation.conjugate(event.pose.q[k])
        return _Grip(back, shape[:, :3] - centre, turn.copy(), stiffer)

    def _centre(self, g: int) -> Array:
        """Derivative [3, P] of gripper g's centre."""
        by = np.zeros((3, self.P))
        if "gripper_offset" in self.columns:
            first = self.columns["gripper_offset"].start + 3 * g
            by[:, first : first + 3] = np.eye(3)
        return by

    def _supported(self, w: int, time: float, on: Any) -> Array:
        """Derivative [n, C, P] of components that are not free; 0 for free ones."""
        e = self.engine
        du = np.zeros_like(self.shape[w])
        for g, grip in self.grips[w].items():
            pose = Paths(e.stacked).pose(g, np.array([w]), np.array([time]))
            since = rotation.product(pose.q[0], grip.back)
            points, edges = e.holds[w, g] & 1 > 0, e.holds[w, g] & 2 > 0
            R = rotation.turned(since, np.eye(3)).T
            du[points, :3] = np.einsum("ab,nbp->nap", R, grip.place[points]) + self._centre(g)
            if self.balance.components == 6:
                du[edges, 3:] = np.einsum("ab,nbp->nap", R, grip.turn[edges])
        sticks = on.touches & ~on.slides
        du[sticks, :2] = self.anchor[w][sticks, :2]
        if "thickness" in self.columns:
            at = self.columns["thickness"].start
            du[on.touches, 2, at] = 0.5
            du[..., :3, at] += 0.5 * on.walls
        return du

    # ---- loads -----------------------------------------------------------------------------------

    def _loads(self, w: int, f: Array, on: Any, d: Array) -> Array:
        """Derivative [n, C, P] of the unbalanced forces at constant shape."""
        b, mu = self.balance, self.balance.friction(w)
        loads = np.zeros((*f.shape, self.P))
        weight = b.mass[w][:, None] * b.gravity[w]
        for name, at in self.columns.items():
            first = at.start
            if name in ("E", "nu", "thickness"):
                loads[..., first] = self._elastic(w, self.engine.stiffness_slopes(w, name))
            if name in ("density", "thickness"):
                loads[:, :3, first] += weight * self.engine.mass_slope(w, name)
            if name == "gravity":
                loads[:, :3, at] = b.mass[w][:, None, None] * np.eye(3)
        for p in range(self.P):
            if any(np.any(grip.stiffer[..., p]) for grip in self.grips[w].values()):
                loads[..., p] += self._elastic(w, self._border(w, p))
        loads[:, :2] += mu * loads[:, 2:3] * d[..., None]
        if "friction" in self.columns:
            loads[:, :2, self.columns["friction"].start] += f[:, 2:3] * d
        return loads

    def _border(self, w: int, p: int) -> Array:
        """Derivative [R, n] of the stiffness at grippers' borders."""
        e = self.engine
        k = e.body.stiffness[w].numpy()[:, e.slots].astype(float)
        slope = np.zeros_like(k)
        for g, grip in self.grips[w].items():
            for m, rows in enumerate(e.stiffened):
                slope[rows] += k[rows] * grip.stiffer[m, :, p] / e.stiffer[w, g, m]
        return slope

    def _elastic(self, w: int, stiffness: Array) -> Array:
        """Elastic forces [n, C] with another stiffness [R, n]; they are linear in it."""
        put(self.slopes, slice(w, w + 1), self.engine.rows(stiffness)[None])
        return self.balance.tangent.forces(w, self.sloped)

    def _by_anchor(self, w: int, f: Array, on: Any, d: Array) -> Array:
        """Derivative [n, C, P] of friction by the anchors, which change its direction."""
        loads = np.zeros((*f.shape, self.P))
        i = np.flatnonzero(on.slides)
        if len(i) and self.balance.friction(w) > 0.0:
            turn = self.balance.turning(w, f, on, d, i)
            loads[i, :2] = -np.einsum("nab,nbp->nap", turn, self.anchor[w][i, :2])
        return loads
