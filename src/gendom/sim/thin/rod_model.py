"""The rod model: element parameters from a rope's centre line and materials, and derivatives.

Edge e = 0 .. n - 2 lies between points e and e + 1; joint i lies at point i, between edges i - 1
and i. Rows of edges and joints have n numbers like rows of points; unused entries are 0.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim.setting import DRAG, Setting, spread
from gendom.sim.thin import rotation
from gendom.sim.thin.types import Lines, ParameterDerivatives, by_modulus

Array = NDArray[Any]

SHORTEST = 0.02
"""Smallest length represented by a joint at a gripper's border, over its usual length."""


class RodModel:
    """The elements of W rods of one shape."""

    def __init__(self, setting: Setting):
        points, diameter, materials = setting.body.points, setting.body.thickness, setting.materials
        W, n, step = len(materials), len(points), np.diff(points, axis=0)
        self.materials, self.diameter = materials, diameter
        self.length = length = np.linalg.norm(step, axis=1)
        """[n - 1] lengths of edges at rest [m]."""
        self.rest_q = rotation.transported(rotation.first_frame(step[0]), step)
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
        density = np.array([m.density for m in materials])[:, None]
        area, bending = _section(diameter)
        factor = spread(setting.mass, (W, n), "mass")
        self.mass = density * area * self.tributary * factor
        """[W, n] mass of points [kg]."""
        self.inertia = np.zeros((W, n))
        """[W, n] moment of inertia of edges [kg m^2]."""
        self.inertia[:, :-1] = density * length * (bending + area * length**2 / 12.0)
        share = spread(setting.stiffness, (W, n), "stiffness")
        self.shares = np.zeros((W, 6, n))
        """[W, 6, n] each element's ratio of E to its material's E; for joints over their length."""
        self.shares[:, :3, :-1] = 0.5 * (share[:, :-1] + share[:, 1:])[:, None]
        joints = 0.5 * (length[:-1] + length[1:])
        self.shares[:, 3:, 1:-1] = (share[:, 1:-1] / joints)[:, None]
        self.stiffness = _moduli(diameter, materials)[0][:, :, None] * self.shares
        """[W, 6, n] stiffness of two shears and stretch [N], and of two bending directions and
        twist over length [N m]."""
        self.drag = 0.5 * DRAG["rope"] * diameter * self.tributary
        """[n] drag of points over the density of the air."""

    @cached_property
    def lines(self) -> list[Lines]:
        n = len(self.tributary)
        exist = np.ones((1, n - 1), dtype=bool)
        return [Lines(np.arange(n)[None], self.length, exist, SHORTEST)]

    @property
    def flat(self) -> Array:
        """[n, 1] places along the rod [m]."""
        return np.concatenate([[0.0], np.cumsum(self.length)])[:, None]

    def derivatives(self, name: str) -> ParameterDerivatives:
        """Derivatives by ``E``, ``nu``, ``density``, ``membrane`` or ``thickness`` (diameter)."""
        if name == "nu":
            by_nu = _moduli(self.diameter, self.materials)[1]
            return ParameterDerivatives(stiffness=by_nu[:, :, None] * self.shares)
        if name == "density":
            per_density = 1.0 / np.array([[m.density] for m in self.materials])
            return ParameterDerivatives(mass=per_density, inertia=per_density)
        if name == "thickness":  # the section's area grows as d^2, its second moment as d^4
            d, (area, bending) = self.diameter, _section(self.diameter)
            flat = area * self.length**2 / 12.0
            turning = (4.0 * bending + 2.0 * flat) / (bending + flat) / d
            per = np.repeat([2.0, 4.0], 3)[:, None] / d
            return ParameterDerivatives(
                self.stiffness * per, 2.0 / d, np.append(turning, 0.0), 1.0 / d, 1.0
            )
        per = np.repeat(by_modulus(name, self.materials), 3, axis=1)
        return ParameterDerivatives(stiffness=self.stiffness * per[:, :, None])

    def share_bar(self, stiffness_bar: Array) -> Array:
        """Derivatives by E at each point over its material's [W, n], given those by ``stiffness``
        [W, 6, n]."""
        bar = stiffness_bar * _moduli(self.diameter, self.materials)[0][:, :, None]
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
        damped = np.array([m.damping > 0.0 for m in self.materials])
        return 2.0 / np.sqrt(np.where(damped, 2.0, 1.0) * fastest)


def joint_strains(q: Array) -> Array:
    """Bending and twist [..., n - 2, 3] [rad] between directions [..., n - 1, 4], see rod.h."""
    p = rotation.between(q[..., :-1, :], q[..., 1:, :])
    return 4.0 * p[..., :3] / (1.0 + p[..., 3:])


def _section(diameter: float) -> tuple[float, float]:
    """Area of a round section [m^2], and its second moment about an axis in it [m^4]."""
    area = math.pi / 4.0 * diameter**2
    return area, area * diameter**2 / 16.0


def _moduli(diameter: float, materials: Sequence[Material]) -> tuple[Array, Array]:
    """Stiffness [W, 6] for shear, shear, stretch [N], bending, bending, twist [N m^2], and its
    derivative with respect to nu.

    Source of the shear coefficient kappa: Cowper (1966), "The shear coefficient in Timoshenko's
    beam theory".
    """
    E, along, nu = np.array([[m.E, m.in_plane, m.nu] for m in materials]).T
    per, slope = 0.5 / (1.0 + nu), -0.5 / (1.0 + nu) ** 2
    kappa, kappa_slope = 6.0 * (1.0 + nu) / (7.0 + 6.0 * nu), 6.0 / (7.0 + 6.0 * nu) ** 2
    (A, I), none = _section(diameter), np.zeros_like(E)
    shear, by_shear = (f * along * A for f in (kappa * per, kappa_slope * per + kappa * slope))
    values = [shear, shear, along * A, E * I, E * I, E * per * (2.0 * I)]
    by_nu = [by_shear, by_shear, none, none, none, E * slope * (2.0 * I)]
    return np.stack(values, axis=1), np.stack(by_nu, axis=1)
