"""Ropes as rods: what the engine, ``ThinEngine``, knows of them.

Edge e = 0 .. n - 2 lies between points e and e + 1; joint i lies at point i, between edges i - 1
and i. Rows of edges and joints have n numbers like rows of points; unused entries are 0.
"""

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.arrays import Array, quaternion
from gendom.sim.lines import fixed_frame
from gendom.sim.setting import DRAG, Setting, spread
from gendom.sim.thin import rotation
from gendom.sim.thin.contact import check_rope
from gendom.sim.thin.types import (
    MARGIN,
    PER_TURN,
    SPIN_BAR,
    TURN_BAR,
    Coefficients,
    Lines,
    V,
    X,
    along,
    parameters_of,
)

SHORTEST = 0.02
"""Smallest length represented by a joint at a gripper's border, over its usual length."""


class RodModel:
    """The elements of W rods of one shape.

    Raises:
        ParameterError: If the body is no rod.
    """

    kind: ClassVar = "rod"
    """Name in the kernels."""
    directed: ClassVar = True
    """Whether edges have directions of their own."""
    state_rows, state_bars, scratch_rows, scratch_bars = 19, 18, 12, 18
    """Numbers of components of states, of derivatives by states, and of their scratch arrays."""
    threads_on_cuda: ClassVar = 32
    """Of a world."""
    cfl = undamped_cfl = 0.95
    """Default shares of the longest stable step of small vibrations, damped and undamped."""
    woven: ClassVar[tuple[str, ...]] = ()
    """Parameters of threads."""
    border_rows: ClassVar = [1, 3]
    """Of the inertia, which change where joints are stiffer at grippers' borders."""

    def __init__(self, setting: Setting):
        points, diameter = setting.body.points, setting.body.thickness
        W, n, step = len(setting.materials), len(points), np.diff(points, axis=0)
        self.parameters, self.diameter = setting.parameters, diameter
        self.length = length = np.linalg.norm(step, axis=1)
        """[n - 1] lengths of edges at rest [m]."""
        require(
            diameter <= length.sum(),
            f"a diameter of {diameter:g} m and a length of {length.sum():g} m are not those of a "
            "rod",
            fix="give metres, or engine='mpm'",
        )
        own, meets = setting.variation.diameter, setting.self_contact or any(setting.obstacles)
        lone = own is None or not (meets or setting.table)
        require(lone, "only rods that meet nothing differ in that", where="diameter")
        self.thickness = spread(diameter if own is None else own, (W,), "diameter")[:, None]
        """[W, 1] diameters [m]."""
        self.widest = float(length.max())
        """Largest distance between neighbouring points [m]."""
        self.apart = 2 + int(np.ceil(diameter / length.min()))
        """Smallest number of points along the rod between parts that can be in self-contact."""
        self.slots, self.row_length = MARGIN + np.arange(n), MARGIN + -(-n // 32) * 32 + MARGIN
        """[n] positions of points in a row, and how long that is."""
        first = quaternion(fixed_frame(step[0]).T)
        self.rest_q = rotation.transported(first, step)
        """[n - 1, 4] directions at rest, without twist."""
        self.rest = np.zeros((7, n))
        """[7, n] 1 / length, and the stress-free strains of edges and joints."""
        self.rest[0, :-1] = 1.0 / length
        self.rest[3, :-1] = 1.0
        self.rest[4:, 1:-1] = joint_strains(self.rest_q).T
        self.tributary = np.zeros(n)
        """[n] length of rod represented by each point [m]."""
        self.tributary[:-1] += 0.5 * length
        self.tributary[1:] += 0.5 * length
        self.turning = setting.variation.turning
        self.heavier = spread(setting.variation.mass, (W, n), "mass")
        """[W, n] mass of points over that of their material."""
        share = spread(setting.variation.stiffness, (W, n), "stiffness")
        self.shares = np.zeros((W, 6, n))
        """[W, 6, n] each element's ratio of E to its material's E; for joints over their length."""
        self.shares[:, :3, :-1] = 0.5 * (share[:, :-1] + share[:, 1:])[:, None]
        joints = 0.5 * (length[:-1] + length[1:])
        self.shares[:, 3:, 1:-1] = (share[:, 1:-1] / joints)[:, None]
        own = self.coefficients(parameters_of(self.thickness, self.parameters))
        self.stiffness, self.mass, self.inertia, self.drag = own
        self.per_turn = np.zeros((W, n))
        """[W, n] inverse moments of inertia of edges [1/(kg m^2)]; 0 where there are none."""
        self.per_turn[:, :-1] = 1.0 / self.inertia[:, :-1]

    def coefficients(self, p: Mapping[str, Array]) -> Coefficients:
        """What follows from parameters [W, 1], which may be complex, see ``parameters_of``.

        Stiffness is that of two shears and stretch [N], and of two bending directions and twist
        over length [N m].
        """
        area, bending = _section(p["thickness"])
        length = np.append(self.length, 0.0)
        mass, turning = p["density"] * area, bending + area * length**2 / 12.0
        return Coefficients(
            stiffness=_moduli(p)[:, :, None] * self.shares,
            mass=mass * self.tributary * self.heavier,
            inertia=self.turning * p["density"] * length * turning,
            drag=0.5 * DRAG["rope"] * p["thickness"] * self.tributary,
        )

    def arrays(self, setting: Setting, air: Array) -> dict[str, Any]:
        """What the kernels' model has of rods, in air of densities [W]."""
        W, n = self.mass.shape
        drag = air[:, None] * self.drag
        rest = np.repeat(self.rest[None], W, axis=0)
        share = spread(setting.variation.natural_curvature, (W,), "natural_curvature")
        rest[:, 4:] *= share[:, None, None]
        rest[:, :1] /= spread(setting.variation.stretch, (W,), "stretch")[:, None, None]
        return {
            "pitch": 0, "first": 0, "end": n, "contact_apart": self.apart,
            "rest": rest, "stiffness": self.stiffness,
            "inertia": np.stack([1.0 / self.mass, self.per_turn, drag, np.ones_like(drag)], axis=1),
        }  # fmt: skip

    @cached_property
    def lines(self) -> list[Lines]:
        n = len(self.tributary)
        return [Lines(np.arange(n)[None], self.length, SHORTEST)]

    def share_bar(self, stiffness_bar: Array) -> Array:
        """Derivatives by E at each point over its material's [W, n], given those by ``stiffness``
        [W, 6, n]."""
        bar = stiffness_bar * _moduli(parameters_of(self.thickness, self.parameters))[:, :, None]
        edges, joints = bar[:, :3, :-1].sum(axis=1), bar[:, 3:, 1:-1].sum(axis=1)
        found = np.zeros((len(bar), bar.shape[2]))
        found[:, :-1] += 0.5 * edges
        found[:, 1:] += 0.5 * edges
        found[:, 1:-1] += joints / (0.5 * (self.length[:-1] + self.length[1:]))
        return found

    def longest_step(self) -> Array:
        """Longest stable step [W] [s] for small vibrations, 2 / omega of the fastest one.

        The vibrations are those of a straight rod whose edges are all as short as the shortest:
        deflection and rotation with the largest wave number that the points resolve, stretching,
        and twisting. A Maxwell branch doubles all stiffness. Source: von Neumann's analysis of the
        elements in ``native/rod.h``.
        """
        l = self.length.min()
        mass = (self.mass[:, :-1] / self.tributary[:-1]).min(axis=1)
        r2 = (self.inertia[:, :-1] / self.length).min(axis=1) / mass
        k = self.stiffness.max(axis=2)
        shear, stretch = k[:, :2].max(axis=1), k[:, 2]
        bending, twist = l * k[:, 3:5].max(axis=1), l * k[:, 5]
        a, b, c = 4.0 * shear / l**2, 2.0 * shear / l, shear + 4.0 * bending / l**2
        # eigenvalues of [[a, b], [b, c]] with masses 1 and r2
        c, b = c / r2, b / np.sqrt(r2)
        fastest = 0.5 * (a + c) + np.sqrt(0.25 * (a - c) ** 2 + b**2)
        fastest = np.maximum(fastest, np.maximum(4.0 * stretch, 4.0 * twist / r2) / l**2) / mass
        return 2.0 / np.sqrt(np.where(self.parameters["damping"] > 0.0, 2.0, 1.0) * fastest)

    # ---- states ----------------------------------------------------------------------------------

    def directions(self, x: Array) -> Array:
        """[W, n - 1, 4] of edges of points x [W, n, 3], with the twist of the rest shape."""
        return rotation.transported(
            np.broadcast_to(self.rest_q[0], (len(x), 4)), np.diff(x, axis=1)
        )

    def spins(self, x: Array, v: Array) -> Array:
        """[W, n - 1, 3] of edges that rotate with their points, not twisting."""
        d, dv = np.diff(x, axis=1), np.diff(v, axis=1)
        return np.cross(d, dv) / np.sum(d**2, axis=2, keepdims=True)

    def by_start(self, x: Array, v: Array, bar: Array) -> tuple[Array, Array]:
        """Derivatives by initial positions and velocities [W, n, 3], given those by the first state
        [W, n, .]."""
        x_bar, v_bar = bar[..., X].copy(), bar[..., V].copy()
        q_bar, spin_bar = bar[:, :-1, TURN_BAR], bar[:, :-1, SPIN_BAR]
        d, dv, spin = np.diff(x, axis=1), np.diff(v, axis=1), self.spins(x, v)
        square = np.sum(d**2, axis=2, keepdims=True)
        _to_ends(v_bar, np.cross(spin_bar, d) / square)
        turned = np.cross(dv, spin_bar) - 2.0 * np.sum(spin * spin_bar, 2, keepdims=True) * d
        _to_ends(x_bar, turned / square)
        first = np.broadcast_to(self.rest_q[0], (len(x_bar), 4))
        _to_ends(x_bar, rotation.transported_adjoint(first, d, q_bar))
        return x_bar, v_bar

    def check_apart(self, x: Array) -> None:
        """Refuse points [n, 3] at which the rod intersects itself."""
        check_rope(x, self.diameter, self.apart)

    # ---- grippers --------------------------------------------------------------------------------

    def held(self, x: Array, centre: Array, radius: Array, taken: Array) -> NDArray[np.int32]:
        """``Grip.holds`` of spheres with centres [k, 3] and radii [k] that close on points
        [k, n, 3]: edges whose midpoints lie in the sphere. If there are none but the sphere cuts
        the centre line, the edge nearest to its centre. Not those that others have ``taken``
        [k, n]."""
        step = np.diff(x, axis=1)
        from_first = centre[:, None] - x[:, :-1]
        middle = np.linalg.norm(from_first - 0.5 * step, axis=2)
        inside = middle < radius[:, None]
        t = np.sum(from_first * step, axis=2) / np.sum(step**2, axis=2)
        nearest = np.linalg.norm(from_first - np.clip(t, 0.0, 1.0)[:, :, None] * step, axis=2)
        touched = (nearest.min(axis=1) < radius) & ~inside.any(axis=1)
        inside[np.flatnonzero(touched), nearest.argmin(axis=1)[touched]] = True
        inside &= (taken[:, :-1] & 2) == 0
        holds = np.zeros(taken.shape, dtype=np.int32)
        holds[:, :-1] |= np.where(inside, 3, 0).astype(np.int32)
        holds[:, 1:] |= inside
        return holds

    def at_borders(self, worlds: Any, stiffer: Array) -> Array:
        """Rows ``border_rows`` [k, 2, n] of the inertia of worlds [k] whose joints at grippers'
        borders are ``stiffer`` [k, 1, n]."""
        one = stiffer[:, 0]
        return np.stack([self.per_turn[worlds] / slower(one), one], axis=1)

    def unstiffened(self, group: slice, stiffer: Array, found: Array) -> Array:
        """Convert derivatives ``found`` by the stiffness with borders to those by the stiffness
        without borders, in place; return the derivatives by ``stiffer`` [k, M, n]."""
        one = stiffer[:, 0]
        bar = np.sum(found[:, 3:6] * self.stiffness[group, 3:], axis=1)
        found[:, 3:6] *= stiffer
        # edges beside stiffer joints have more inertia, according to the stiffer joint
        slow = slower(one)
        by_slow = -found[:, PER_TURN] * self.per_turn[group] / slow**2
        found[:, PER_TURN] /= slow
        at = (one == slow) & (slow > 1.0)
        bar += np.where(at, by_slow, 0.0)
        after = (one[:, 1:] == slow[:, :-1]) & (slow[:, :-1] > 1.0) & ~at[:, :-1]
        bar[:, 1:] += np.where(after, by_slow[:, :-1], 0.0)
        return bar[:, None]


def joint_strains(q: Array) -> Array:
    """Bending and twist [..., n - 2, 3] [rad] between directions [..., n - 1, 4], see rod.h."""
    p = rotation.between(q[..., :-1, :], q[..., 1:, :])
    return 4.0 * p[..., :3] / (1.0 + p[..., 3:])


def _section(diameter: Array) -> tuple[Array, Array]:
    """Area of a round section [m^2], and its second moment about an axis in it [m^4]."""
    area = math.pi / 4.0 * diameter**2
    return area, area * diameter**2 / 16.0


def _moduli(p: Mapping[str, Array]) -> Array:
    """Stiffness [W, 6] for shear, shear, stretch [N], bending, bending, twist [N m^2].

    Source of the shear coefficient kappa: Cowper (1966), "The shear coefficient in Timoshenko's
    beam theory".
    """
    E, nu, (A, I) = p["E"], p["nu"], _section(p["thickness"])
    per, kappa = 0.5 / (1.0 + nu), 6.0 * (1.0 + nu) / (7.0 + 6.0 * nu)
    shear, stretch, bending = kappa * per * along(p) * A, along(p) * A, E * I
    values = [shear, shear, stretch, bending, bending, E * per * (2.0 * I)]
    return np.concatenate(values, axis=1)


def slower(stiffer: Array) -> Array:
    """Factors [W, n] by which the inertia of edges beside stiffer joints at a gripper's border is
    increased, so that the substep stays stable."""
    after = np.concatenate([stiffer[:, 1:], np.ones_like(stiffer[:, :1])], axis=1)
    return np.maximum(1.0, np.maximum(stiffer, after))


def _to_ends(points: Array, edges: Array) -> None:
    """Add derivatives by edges x_(e+1) - x_e [W, n - 1, 3] to the derivatives by points."""
    points[:, 1:] += edges
    points[:, :-1] -= edges
