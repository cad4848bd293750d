"""A soft rope that hangs and swings."""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import eigh
from scipy.special import j0, jn_zeros

from gendom.materials import Material
from gendom.sim import GRAVITY, rope
from gendom.validation.check import Check, Settings
from gendom.validation.specimens import across, clamp_beyond, end, swing

CHAIN = (
    "T = 2 pi / omega, omega = (j01 / 2) sqrt(g / L) (D. Bernoulli 1738; Lamb, Higher Mechanics)"
)
STIFF = (
    "lowest mode of E I w'''' - (T w')' = rho A omega^2 w, clamped and stretched, by Ritz's "
    "method (Rayleigh 1877, Theory of Sound I, chapter VIII)"
)


def hanging_chain(settings: Settings) -> list[Check]:
    """A rope 100 diameters long (60 in the quick run) that swings by 2 % of its length.

    It starts at rest in its first mode, already stretched by its weight.
    """
    d = 0.005
    slenderness, cells = (60, 1.0) if settings.quick else (100, 1.5)
    L, k, g = slenderness * d, d / 4.0, -GRAVITY[2]
    nu, specific = 0.3, 50.0 * g * L
    dx = d / cells
    back = 3.0 * dx
    body = rope(
        diameter=d,
        length=L + back,
        start=(0.0, 0.0, back),
        direction=(0.0, 0.0, -1.0),
        cells_across=cells,
    )
    below = np.clip(L + back - body.material_coordinates[:, 0], 0.0, L)
    omega = jn_zeros(0, 1)[0] / 2.0 * math.sqrt(g / L)
    strain = np.where(below < L, g * below / specific, 0.0)
    x = body.x.copy()
    x[:, 2] -= g * (L**2 - below**2) / (2.0 * specific)
    x[:, :2] *= 1.0 - nu * strain[:, None]
    x[:, 0] += 0.02 * L * j0(jn_zeros(0, 1)[0] * np.sqrt(below / L))
    clamp = clamp_beyond((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), d)
    material = Material(E=1000.0 * specific, nu=nu, density=1000.0)
    s = settings.simulator(body, [material], grippers=[clamp], positions=x, air_density=0.0)
    t = np.linspace(0.0, 1.5 * 2.0 * math.pi / omega, 91)
    found, _ = swing(t, end(s.run(t)[:, 0], body)[:, 0], omega)
    stiff = lowest_frequency(specific, k, L, g)
    period = 2.0 * math.pi / found
    return [
        Check.within_share(
            f"period of a chain, {across(cells)}",
            "s",
            2.0 * math.pi / omega,
            period,
            0.02,
            CHAIN,
        ),
        Check.within_share(
            f"period with bending stiffness and stretch, {across(cells)}",
            "s",
            2.0 * math.pi / stiff,
            period,
            0.01,
            STIFF,
        ),
    ]


def lowest_frequency(specific: float, k: float, L: float, g: float, *, terms: int = 50) -> float:
    """Lowest angular frequency of a rope clamped at its top and hanging down [rad/s].

    Ritz's method: Rayleigh's quotient of bending and tension over mass, minimised over (1 - s /
    L)^2 times Legendre polynomials of s, the rest length from the lower end. The tension's share
    is divided by the local stretch 1 + g s / specific.

    Args:
        specific: E / density [m^2/s^2].
        k: Radius of gyration of the section [m].
        L: Rest length [m].
        g: Gravity [m/s^2].
        terms: Number of polynomials.
    """
    y, weight = legendre.leggauss(4 * terms)
    s, weight = (y + 1.0) * L / 2.0, weight * L / 2.0
    top, top1, top2 = (1.0 - s / L) ** 2, -2.0 / L * (1.0 - s / L), 2.0 / L**2
    values = np.empty((3, terms, len(y)))
    for n in range(terms):
        one = np.eye(terms)[n]
        p, p1, p2 = (
            (2.0 / L) ** m * legendre.legval(y, legendre.legder(one, m) if m else one)
            for m in range(3)
        )
        values[0, n] = top * p
        values[1, n] = top * p1 + top1 * p
        values[2, n] = top * p2 + 2.0 * top1 * p1 + top2 * p
    w, w1, w2 = values
    tension = g * s / (1.0 + g * s / specific)
    stiffness = (w1 * weight * tension) @ w1.T + specific * k**2 * (w2 * weight) @ w2.T
    mass = (w * weight) @ w.T
    return math.sqrt(eigh(stiffness, mass, eigvals_only=True, subset_by_index=[0, 0])[0])
