"""Formulas of beams and ropes, solved without the simulator.

Arguments named alike: a ``material``; k, a section's radius of gyration [m]; L, a length [m].
"""

import math

import numpy as np
from numpy.polynomial import Legendre, legendre
from scipy.linalg import eigh

from gendom.arrays import Array
from gendom.materials import Material

ROOT = 1.8751040687
"""beta L of a cantilever's first mode: cos(beta L) cosh(beta L) = -1."""

ROMERO = (
    "Romero et al. 2021, 'Physical validation of simulators in computer graphics', ACM "
    "Transactions on Graphics 40(4)"
)


def beam_frequency(material: Material, k: float, L: float) -> float:
    """Angular frequency of a slender cantilever's first mode [rad/s]."""
    return 3.516 * math.sqrt(material.E_over_rho) * k / L**2


def unit_gravity(material: Material, k: float, L: float) -> float:
    """Gravity at which rho g A L^3 / (E I) is 1 [m/s^2]."""
    return material.E_over_rho * k**2 / L**3


def round_frequency(material: Material, k: float, L: float) -> float:
    """Angular frequency of a round cantilever's first mode, shear counted [rad/s].

    1 / omega^2 = 1 / omega_bending^2 + 1 / omega_shear^2 (Dunkerley 1894).
    """
    bending = ROOT**2 * math.sqrt(material.E_over_rho) * k / L**2
    shear = math.pi / 2.0 * math.sqrt(_shear_modulus(material) / material.density) / L
    return (bending**-2 + shear**-2) ** -0.5


def gravity_for(sag: float, material: Material, k: float, L: float) -> float:
    """Gravity under which a round cantilever sags so much, w L^4 / (8 E I) + w L^2 / (2 kappa G A)
    [m/s^2]."""
    bending = L**4 / (8.0 * material.E_over_rho * k**2)
    return sag / (bending + L**2 * material.density / (2.0 * _shear_modulus(material)))


def _shear_modulus(material: Material) -> float:
    """G times the shear coefficient of a round section, kappa = 6 (1 + nu) / (7 + 6 nu) [Pa].

    Source: Cowper (1966), "The shear coefficient in Timoshenko's beam theory".
    """
    nu = material.nu
    return 6.0 * (1.0 + nu) / (7.0 + 6.0 * nu) * material.E / (2.0 * (1.0 + nu))


def first_mode(x: Array, L: float) -> tuple[Array, ...]:
    """Deflection of a cantilever's first mode, 1 at the tip, and its first two derivatives."""
    b = ROOT / L
    s = b * np.clip(x, 0.0, None)
    ratio = (math.cosh(ROOT) + math.cos(ROOT)) / (math.sinh(ROOT) + math.sin(ROOT))
    y = np.cosh(s) - np.cos(s) - ratio * (np.sinh(s) - np.sin(s))
    y1 = np.sinh(s) + np.sin(s) - ratio * (np.cosh(s) - np.cos(s))
    y2 = np.cosh(s) + np.cos(s) - ratio * (np.sinh(s) + np.sin(s))
    return y / 2.0, b * y1 / 2.0, b * b * y2 / 2.0


def damped_frequency(omega: float, tau: float) -> tuple[float, float]:
    """Angular frequency and decay rate of a standard linear solid [rad/s, 1/s], of the elastic
    oscillation's ``omega`` [rad/s] and the time ``tau`` of its branch [s]."""
    s = np.roots([tau, 1.0, 2.0 * omega**2 * tau, omega**2])
    s = s[np.argmax(s.imag)]
    return float(s.imag), float(-s.real)


def lowest_frequency(specific: float, k: float, L: float, g: float, *, terms: int = 30) -> float:
    """Lowest angular frequency of a rope clamped at its top and hanging down [rad/s].

    Rayleigh's quotient of bending and tension over mass, minimised over (1 - s / L)^2 times
    Legendre polynomials of s, the rest length from the lower end. The tension's share is divided
    by the local stretch 1 + g s / specific, with E / density ``specific`` [m^2/s^2].
    """
    y, weight = legendre.leggauss(4 * terms)
    s, weight = (y + 1.0) * L / 2.0, weight * L / 2.0
    clamped = Legendre.fromroots([L, L], domain=[0.0, L]) / L**2
    shapes = [clamped * Legendre.basis(n, domain=[0.0, L]) for n in range(terms)]
    w, w1, w2 = (np.array([f.deriv(m)(s) for f in shapes]) for m in range(3))
    tension = g * s / (1.0 + g * s / specific)
    stiffness = (w1 * weight * tension) @ w1.T + specific * k**2 * (w2 * weight) @ w2.T
    mass = (w * weight) @ w.T
    return math.sqrt(eigh(stiffness, mass, eigvals_only=True, subset_by_index=[0, 0])[0])
