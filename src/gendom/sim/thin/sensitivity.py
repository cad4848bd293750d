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
from gendom.sim.thin.slopes import WEAVE

Array = NDArray[np.float64]

PARAMETERS = (
    "E", "nu", "density", "thickness", "width", "membrane", "weave", "stiffness", "rest_strains",
    "friction", "gravity", "positions", "gripper_positions", "gripper_rotations", "gripper_radius",
    "gripper_offset",
)  # fmt: skip
"""Parameters by which shapes can be differentiated, see ``Simulator.equilibria``."""


@dataclass
class _Grip:
    """Derivatives of a closed gripper of one world by each of P parameters."""

    back: Array
    """[4] conjugate of its orientation when it closed."""
    place: Array
    """[n, 3, P] of held points relative to it, in world axes when it closed."""
    turn: Array
    """[n, 3, P] of held directions, in the same axes."""
    stiffer: Array
    """[M, n, P] of the border's stiffness, see ``Grip.stiffer``."""


class Sensitivity:
    """Derivatives by parameters, propagated from shape to shape.

    Args:
        balance: The unbalanced forces.
        names: Names from ``PARAMETERS``.
        began: Whether the simulator has been run before.

    Raises:
        ParameterError: If a name is unknown, or the derivative is not available for the body.
    """

    def __init__(self, balance: Balance, names: Sequence[str], *, began: bool):
        e = self.engine = balance.engine
        self.balance = balance
        self._check(names, began)
        W, n, (G, K) = e.num_worlds, e.num_points, e.stacked["time"].shape[1:]
        self.shapes = {
            "gravity": (3,),
            "weave": (len(WEAVE),),
            "stiffness": (n,),
            "positions": (n, 3),
            "rest_strains": (n, e.natural.stop - e.natural.start),
            "gripper_radius": (G,),
            "gripper_offset": (G, 3),
            "gripper_positions": (G, K, 3),
            "gripper_rotations": (G, K, 3),
        }
        self.columns: dict[str, slice] = {}
        for name in dict.fromkeys(names):
            first = max((c.stop for c in self.columns.values()), default=0)
            size = int(np.prod(self.shapes.get(name, ())))
            self.columns[name] = slice(first, first + size)
        self.P = max((c.stop for c in self.columns.values()), default=0)
        self.slopes = {
            name: e.slopes(name)
            for name in ("E", "nu", "density", *e.parameters())
            if name in self.columns or (name in WEAVE and "weave" in self.columns)
        }
        self.shape = np.zeros((W, n, balance.components, self.P))
        """[W, n, C, P] derivatives of the current shapes."""
        if "positions" in self.columns:
            self._begin_at_positions()
        self.anchor = np.zeros((W, n, 3, self.P))
        """[W, n, 3, P] derivatives of the points in the previous frame."""
        self.grips: list[dict[int, _Grip]] = [{} for _ in range(W)]
        self.other = e.zeros(e.body.stiffness.shape if self.P else (0, 0, 0))
        self.sloped = copied(balance.engine, balance.body)
        self.sloped.stiffness = self.other

    def _check(self, names: Sequence[str], began: bool) -> None:
        e, has = self.engine, self.engine.parameters()
        unknown = sorted(set(names) - set(PARAMETERS))
        if unknown:
            raise ParameterError(
                f"equilibria are not differentiated by {', '.join(unknown)}",
                fix=f"choose of {', '.join(PARAMETERS)}",
            )
        if names and e.setting.self_contact:
            raise ParameterError(
                "contact of a body with itself is not differentiated", fix="self_contact=False"
            )
        for name, of in (
            ("width", "a flat rope has a width"),
            ("membrane", "a cloth whose material has a membrane's modulus has one"),
            ("weave", "a cloth has a weave"),
        ):
            if name in names and name not in has and not (name == "weave" and "warp" in has):
                raise ParameterError(f"there is no derivative by {name}: only {of}")
        if "positions" in names and began:
            raise ParameterError(
                "derivatives by positions are those by the initial ones",
                fix="a simulator that has not been run",
            )

    def _begin_at_positions(self) -> None:
        """Set the derivatives of the first shapes by their own points."""
        e, n, at = self.engine, self.engine.num_points, self.columns["positions"]
        points = np.eye(3 * n).reshape(n, 3, 3 * n)
        self.shape[:, :, :3, at] = points
        if self.balance.components == 6:  # directions follow from points
            steps = np.diff(e.component(slice(0, 3)), axis=1)
            first, k = e.model.rest_q[0], 3 * (n - 1)
            bars = np.eye(k).reshape(k, n - 1, 3)
            for w, step in enumerate(steps):
                by_step = rotation.transported_adjoint(
                    np.broadcast_to(first, (k, 4)), np.broadcast_to(step, (k, n - 1, 3)), bars
                ).reshape(k, k)
                turns = by_step @ np.diff(points, axis=0).reshape(k, 3 * n)
                self.shape[w, :-1, 3:, at] = turns.reshape(n - 1, 3, 3 * n)

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
        (centre, turned), radius = self._pose(g, w, event.time[k]), np.zeros(P)
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
        place = shape[:, :3] - centre - _carried(event.x[k] - event.pose.centre[k], turned)
        return _Grip(back, place, turn - turned, stiffer)

    def _pose(self, g: int, w: int, time: float) -> tuple[Array, Array]:
        """Derivatives [3, P] of gripper g's centre, and of its rotation in world axes."""
        centre, turn = np.zeros((3, self.P)), np.zeros((3, self.P))
        if "gripper_offset" in self.columns:
            first = self.columns["gripper_offset"].start + 3 * g
            centre[:, first : first + 3] = np.eye(3)
        knots = {"gripper_positions": centre, "gripper_rotations": turn}
        if any(name in self.columns for name in knots):
            slopes = Paths(self.engine.stacked).slopes(g, w, time)
            size = slopes[0][0].size
            for (name, by), slope in zip(knots.items(), slopes, strict=True):
                if name in self.columns:
                    first = self.columns[name].start + size * g
                    by[:, first : first + size] = slope.reshape(3, size)
        return centre, turn

    def _supported(self, w: int, time: float, on: Any) -> Array:
        """Derivative [n, C, P] of components that are not free; 0 for free ones."""
        e = self.engine
        du = np.zeros_like(self.shape[w])
        x = self.balance.points(w)
        for g, grip in self.grips[w].items():
            pose = Paths(e.stacked).pose(g, np.array([w]), np.array([time]))
            since = rotation.product(pose.q[0], grip.back)
            points, edges = e.holds[w, g] & 1 > 0, e.holds[w, g] & 2 > 0
            R = rotation.turned(since, np.eye(3)).T
            centre, turned = self._pose(g, w, time)
            carried = centre + _carried(x[points] - pose.centre[0], turned)
            du[points, :3] = np.einsum("ab,nbp->nap", R, grip.place[points]) + carried
            if self.balance.components == 6:
                du[edges, 3:] = np.einsum("ab,nbp->nap", R, grip.turn[edges]) + turned
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
            for k, p in enumerate(range(at.start, at.stop)):
                model = self.slopes.get(WEAVE[k] if name == "weave" else name)
                if model is not None:
                    if model.stiffness.ndim:
                        loads[..., p] = self._elastic(w, model.stiffness[w])
                    if model.mass.ndim:
                        loads[:, :3, p] += weight * model.mass[w]
                elif name == "stiffness":
                    loads[..., p] = self._elastic(w, self.engine.stiffness_by_share(w, k))
                elif name == "rest_strains":
                    loads[..., p] = self._strained(w, k)
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
        put(self.other, slice(w, w + 1), self.engine.rows(stiffness)[None])
        return self.balance.tangent.forces(w, self.sloped)

    def _strained(self, w: int, k: int) -> Array:
        """Derivative [n, C] of elastic forces by the stress-free strain number k, in which they
        are linear."""
        e, tangent = self.engine, self.balance.tangent
        rest = e.body.rest.numpy().astype(float)
        S = e.natural.stop - e.natural.start
        rest[0, e.natural.start + k % S, e.slots[k // S]] += 1.0
        strained = copied(e, self.balance.body)
        strained.rest = e.array(rest)
        return tangent.forces(w, strained) - tangent.forces(w)

    def _by_anchor(self, w: int, f: Array, on: Any, d: Array) -> Array:
        """Derivative [n, C, P] of friction by the anchors, which change its direction."""
        loads = np.zeros((*f.shape, self.P))
        i = np.flatnonzero(on.slides)
        if len(i) and self.balance.friction(w) > 0.0:
            turn = self.balance.turning(w, f, on, d, i)
            loads[i, :2] = -np.einsum("nab,nbp->nap", turn, self.anchor[w][i, :2])
        return loads


def _carried(x: Array, turned: Array) -> Array:
    """Motion [n, 3, P] of points x [n, 3] with rotations [3, P] about the origin."""
    return np.cross(turned.T, x[:, None]).swapaxes(1, 2)
