"""Formulas of beams, ropes and plates, solved without the simulator, and their sources."""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import eigh

from gendom.materials import Material

ROOT = 1.8751040687
"""beta L of a cantilever's first mode: cos(beta L) cosh(beta L) = -1."""

BEAM = (
    "w L^4 / (8 E I) + w L^2 / (2 kappa G A) (Gere and Timoshenko, Mechanics of Materials; "
    "kappa = 10 (1 + nu) / (12 + 11 nu), Cowper 1966)"
)
ELASTICA = (
    "heavy elastica E I theta'' = w (L - s) cos theta, solved by collocation (Wang 1986, "
    "'A critical review of the heavy elastica')"
)
ROMERO = (
    "Romero et al. 2021, 'Physical validation of simulators in computer graphics', ACM "
    "Transactions on Graphics 40(4)"
)
COULOMB = "Coulomb friction (Coulomb 1785)"
STAYS = "equilibrium: what hangs still stays"
LEAPFROG = (
    "a leapfrog keeps energy but for an oscillation (Hairer, Lubich, Wanner 2006); "
    "velocities are read half a step before positions"
)


def beam_frequency(material: Material, k: float, L: float) -> float:
    """Angular frequency of a slender cantilever's first mode [rad/s].

    Args:
        material: What it is made of.
        k: Radius of gyration [m].
        L: Length [m].
    """
    return 3.516 * math.sqrt(material.E_over_rho) * k / L**2


def unit_gravity(material: Material, k: float, L: float) -> float:
    """Gravity at which rho g A L^3 / (E I) is 1 [m/s^2]; arguments as ``beam_frequency``."""
    return material.E_over_rho * k**2 / L**3


def round_frequency(material: Material, k: float, L: float) -> float:
    """Angular frequency of a round cantilever's first mode, shear counted [rad/s].

    1 / omega^2 = 1 / omega_bending^2 + 1 / omega_shear^2 (Dunkerley 1894); arguments as
    ``beam_frequency``.
    """
    bending = ROOT**2 * math.sqrt(material.E_over_rho) * k / L**2
    shear = math.pi / 2.0 * math.sqrt(shear_modulus(material) / material.density) / L
    return (bending**-2 + shear**-2) ** -0.5


def shear_modulus(material: Material) -> float:
    """G times the shear coefficient of a round section, kappa = 6 (1 + nu) / (7 + 6 nu) [Pa].

    Source: Cowper (1966), "The shear coefficient in Timoshenko's beam theory".
    """
    nu = material.nu
    return 6.0 * (1.0 + nu) / (7.0 + 6.0 * nu) * material.E / (2.0 * (1.0 + nu))


def gravity_for(sag: float, material: Material, k: float, L: float) -> float:
    """Gravity under which a round cantilever sags so much, w L^4 / (8 E I) + w L^2 / (2 kappa G A)
    [m/s^2]; other arguments as ``beam_frequency``."""
    bending = L**4 / (8.0 * material.E_over_rho * k**2)
    return sag / (bending + L**2 * material.density / (2.0 * shear_modulus(material)))


def first_mode(x: NDArray[np.floating], L: float) -> tuple[NDArray[np.floating], ...]:
    """Deflection of a cantilever's first mode, 1 at the tip, and its first two derivatives."""
    b = ROOT / L
    s = np.clip(x, 0.0, None)
    ratio = (math.cosh(ROOT) + math.cos(ROOT)) / (math.sinh(ROOT) + math.sin(ROOT))
    y = np.cosh(b * s) - np.cos(b * s) - ratio * (np.sinh(b * s) - np.sin(b * s))
    y1 = np.sinh(b * s) + np.sin(b * s) - ratio * (np.cosh(b * s) - np.cos(b * s))
    y2 = np.cosh(b * s) + np.cos(b * s) - ratio * (np.sinh(b * s) + np.sin(b * s))
    return y / 2.0, b * y1 / 2.0, b * b * y2 / 2.0


def damped_frequency(omega: float, tau: float) -> tuple[float, float]:
    """Angular frequency [rad/s] and decay rate [1/s] of a standard linear solid's oscillation.

    Args:
        omega: Of the elastic oscillation [rad/s].
        tau: Time of the branch [s].
    """
    s = np.roots([tau, 1.0, 2.0 * omega**2 * tau, omega**2])
    s = s[np.argmax(s.imag)]
    return float(s.imag), float(-s.real)


def lowest_frequency(specific: float, k: float, L: float, g: float, *, terms: int = 50) -> float:
    """Lowest angular frequency of a rope clamped at its top and hanging down [rad/s].

    Rayleigh's quotient of bending and tension over mass, minimised over (1 - s / L)^2 times
    Legendre polynomials of s, the rest length from the lower end. The tension's share is divided
    by the local stretch 1 + g s / specific.

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


def corner_sags(nu: float, degree: int = 16) -> tuple[float, float]:
    """Sags of a square plate held at its four corners, in its middle and halfway along a side, in
    units of q a^4 / D.

    Of the even polynomials that are 0 at the corners, the one of least energy D / 2 integral of
    (w_xx + w_yy)^2 - 2 (1 - nu) (w_xx w_yy - w_xy^2), minus the load's work.

    Args:
        nu: Poisson's ratio.
        degree: Of the polynomials along each axis.
    """
    at, weight = legendre.leggauss(degree + 2)
    even = np.eye(degree + 1)[::2]

    def values(s: NDArray[np.floating], m: int = 0) -> NDArray[np.float64]:
        """[terms, s] m-th derivatives."""
        return np.array([legendre.legval(s, legendre.legder(c, m)) for c in even])

    d = [values(at, m) for m in range(3)]
    times = {(i, j): (d[i] * weight) @ d[j].T for i in range(3) for j in range(3)}
    K = np.kron(times[2, 2], times[0, 0]) + np.kron(times[0, 0], times[2, 2])
    K += nu * (np.kron(times[2, 0], times[0, 2]) + np.kron(times[0, 2], times[2, 0]))
    K += 2.0 * (1.0 - nu) * np.kron(times[1, 1], times[1, 1])
    terms = len(even)
    work = np.kron(d[0] @ weight, d[0] @ weight)
    # all terms are 1 at the corners: their sum is 0 there
    held = np.ones((1, terms**2))
    system = np.block([[K, held.T], [held, np.zeros((1, 1))]])
    shape = np.linalg.solve(system, np.append(work, 0.0))[:-1].reshape(terms, terms)
    centre = values(np.zeros(1))[:, 0]
    # the square from -1 to 1 is two units wide
    return float(centre @ shape @ centre) / 16.0, float(centre @ shape.sum(axis=1)) / 16.0
