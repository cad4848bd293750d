"""The rod model: element parameters from a rope's centre line and materials, and derivatives.

Edge e = 0 .. n - 2 lies between points e and e + 1; joint i lies at point i, between edges i - 1
and i. Rows of edges and joints have n numbers like rows of points; unused entries are 0.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim.bodies import Body
from gendom.sim.thin import rotation
from gendom.sim.thin.types import ParameterDerivatives, by_modulus


@dataclass(frozen=True)
class Section:
    """A round cross-section, or its derivatives by the diameter."""

    area: float
    """[m^2]."""
    bending: float
    """Second moment of area about an axis in it [m^4]; half the torsion constant."""
    breadth: float
    """Width exposed to the air [m]."""

    @classmethod
    def of(cls, diameter: float) -> "Section":
        area = math.pi / 4.0 * diameter**2
        return cls(area, area * diameter**2 / 16.0, diameter)

    @classmethod
    def derivatives(cls, diameter: float) -> "Section":
        """Derivatives by the diameter."""
        return cls(math.pi / 2.0 * diameter, math.pi / 16.0 * diameter**3, 1.0)

    def turning(self, length: NDArray[np.float64]) -> NDArray[np.float64]:
        """Moment of inertia of stiff edges over density and length, [m^4]."""
        return self.bending + self.area * length**2 / 12.0


@dataclass(frozen=True)
class RodModel:
    """The elements of W rods of one shape."""

    section: Section
    length: NDArray[np.float64]
    """[n - 1] lengths of edges at rest [m]."""
    rest_q: NDArray[np.float64]
    """[n - 1, 4] directions at rest, without twist."""
    rest: NDArray[np.float64]
    """[7, n] 1 / length, and the stress-free strains of edges and joints."""
    stiffness: NDArray[np.float64]
    """[W, 6, n] stiffness of two shears and stretch [N], and of two bending directions and twist
    over length [N m]."""
    mass: NDArray[np.float64]
    """[W, n] mass of points [kg]."""
    inertia: NDArray[np.float64]
    """[W, n] moment of inertia of edges [kg m^2]."""
    tributary: NDArray[np.float64]
    """[n] length of rod represented by each point [m]."""

    @classmethod
    def of(
        cls, body: Body, materials: Sequence[Material], share: NDArray[np.floating]
    ) -> "RodModel":
        """Make the model of a rope; ``share`` [W, n] is E at each point over its material's E."""
        section = Section.of(body.thickness)
        step = np.diff(body.points, axis=0)
        length = np.linalg.norm(step, axis=1)
        rest_q = rotation.transported(rotation.first_frame(step[0]), step)
        n = len(body.points)
        rest = np.zeros((7, n))
        rest[0, :-1] = 1.0 / length
        rest[3, :-1] = 1.0
        rest[4:, 1:-1] = joint_strains(rest_q).T
        tributary = np.zeros(n)
        tributary[:-1] += 0.5 * length
        tributary[1:] += 0.5 * length
        density = np.array([m.density for m in materials])[:, None]
        inertia = np.zeros((len(materials), n))
        inertia[:, :-1] = density * length * section.turning(length)
        moduli, _ = _moduli(section, materials)
        return cls(
            section=section,
            length=length,
            rest_q=rest_q,
            rest=rest,
            stiffness=moduli[:, :, None] * _shares(share, length),
            mass=density * section.area * tributary,
            inertia=inertia,
            tributary=tributary,
        )

    def derivatives(
        self, name: str, body: Body, materials: Sequence[Material], share: NDArray[np.floating]
    ) -> ParameterDerivatives:
        """Derivatives by ``E``, ``nu``, ``density``, ``membrane`` or ``thickness`` (diameter)."""
        if name in ("E", "membrane"):
            per = np.repeat(by_modulus(name, materials), 3, axis=1)
            return ParameterDerivatives(stiffness=self.stiffness * per[:, :, None])
        shares = _shares(share, self.length)
        if name == "nu":
            return ParameterDerivatives(
                stiffness=_moduli(self.section, materials)[1][:, :, None] * shares
            )
        if name == "density":
            per_density = 1.0 / np.array([[m.density] for m in materials])
            return ParameterDerivatives(mass=per_density, inertia=per_density)
        by = Section.derivatives(body.thickness)
        inertia = np.zeros((1, len(self.tributary)))
        inertia[:, :-1] = by.turning(self.length) / self.section.turning(self.length)
        return ParameterDerivatives(
            stiffness=_moduli(by, materials)[0][:, :, None] * shares,
            mass=np.full((len(materials), 1), by.area / self.section.area),
            inertia=inertia,
            drag=by.breadth / self.section.breadth,
            thickness=1.0,
        )

    def share_bar(
        self, materials: Sequence[Material], stiffness_bar: NDArray[np.floating]
    ) -> NDArray[np.float64]:
        """Derivatives by shares [W, n], given those by ``stiffness`` [W, 6, n]."""
        moduli, _ = _moduli(self.section, materials)
        bar, length = stiffness_bar * moduli[:, :, None], self.length
        edges, joints = bar[:, :3, :-1].sum(axis=1), bar[:, 3:, 1:-1].sum(axis=1)
        found = np.zeros((len(bar), bar.shape[2]))
        found[:, :-1] += 0.5 * edges
        found[:, 1:] += 0.5 * edges
        found[:, 1:-1] += joints / (0.5 * (length[:-1] + length[1:]))
        return found

    def longest_step(self, damped: NDArray[np.bool_]) -> NDArray[np.float64]:
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
        return 2.0 / np.sqrt(np.where(damped, 2.0, 1.0) * fastest)


def joint_strains(q: NDArray[np.floating]) -> NDArray[np.float64]:
    """Bending and twist [..., n - 2, 3] [rad] between directions [..., n - 1, 4], see rod.h."""
    p = rotation.between(q[..., :-1, :], q[..., 1:, :])
    return 4.0 * p[..., :3] / (1.0 + p[..., 3:])


def _shares(share: NDArray[np.floating], length: NDArray[np.floating]) -> NDArray[np.float64]:
    """Each element's ratio of E to its material's E, [W, 6, n]; for joints divided by their length,
    half of both edges."""
    W, n = share.shape
    rows = np.zeros((W, 6, n))
    rows[:, :3, :-1] = 0.5 * (share[:, :-1] + share[:, 1:])[:, None]
    rows[:, 3:, 1:-1] = (share[:, 1:-1] / (0.5 * (length[:-1] + length[1:])))[:, None]
    return rows


def _moduli(
    section: Section, materials: Sequence[Material]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Stiffness [W, 6] for shear, shear, stretch [N], bending, bending, twist [N m^2], and its
    derivative with respect to nu.

    Source of the shear coefficient kappa: Cowper (1966), "The shear coefficient in Timoshenko's
    beam theory".
    """
    E = np.array([m.E for m in materials])
    along = np.array([m.in_plane for m in materials])
    nu = np.array([m.nu for m in materials])
    per, slope = 0.5 / (1.0 + nu), -0.5 / (1.0 + nu) ** 2
    kappa, kappa_slope = 6.0 * (1.0 + nu) / (7.0 + 6.0 * nu), 6.0 / (7.0 + 6.0 * nu) ** 2
    A, I, J = section.area, section.bending, 2.0 * section.bending
    none = np.zeros_like(E)
    shear, by_shear = (f * along * A for f in (kappa * per, kappa_slope * per + kappa * slope))
    values = [shear, shear, along * A, E * I, E * I, E * per * J]
    by_nu = [by_shear, by_shear, none, none, none, E * slope * J]
    return np.stack(values, axis=1), np.stack(by_nu, axis=1)
