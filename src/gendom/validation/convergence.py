"""Orders of convergence in the substep, in the size of a cell, and in the distance of points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim import GRAVITY
from gendom.validation.check import Check, Settings
from gendom.validation.master_curves import LENGTH as SPAN
from gendom.validation.master_curves import clamped_rope, clamped_strip
from gendom.validation.specimens import block, sections, stations

LENGTH = 0.1

EULER = "symplectic Euler is of order 1: x - x0 - v0 t - g t^2 / 2 = g h t / 2"
WAVE = "u = (v0 / omega) cos(pi x / L) sin(omega t), omega = pi sqrt(E / rho) / L, nu = 0"
SPLINE = (
    "order 2 of quadratic B-splines (Steffen, Kirby, Berzins 2008) and of the leapfrog that "
    "symplectic Euler is for positions (Hairer, Lubich, Wanner 2006)"
)
SMOOTHING = (
    "APIC smooths once a substep, whatever its length (Jiang et al. 2015): a loss that grows as "
    "1 / dt"
)

TIMOSHENKO = (
    "w L^4 / (8 E I), of rods + w L^2 / (2 kappa G A) (Timoshenko; kappa = 6 (1 + nu) / "
    "(7 + 6 nu), Cowper 1966); of a lattice order 2: differences are central"
)


def order(settings: Settings) -> list[Check]:
    """A falling block; a free bar that vibrates along its axis for half a period.

    The bar's analytic answer gives the order of the error when cells and substeps shrink
    together. With cells as they are shorter substeps are not better: each exchange with the grid
    smooths velocities by the same share, so what is smoothed away grows with their number, and so
    do the differences between answers.
    """
    counts = (8, 16, 32) if settings.quick else (8, 16, 32, 64)
    errors = [_wave_error(settings, n) for n in counts]
    shares = (0.2, 0.1, 0.05) if settings.quick else (0.2, 0.1, 0.05, 0.025)
    answers = [_wave(settings, 16, share)[0] for share in shares]
    steps = [math.sqrt(np.mean((a - b) ** 2)) for a, b in pairwise(answers)]
    return [
        Check.within(
            "order in dt, fall of a block",
            "-",
            1.0,
            _slope([1.0, 0.5, 0.25], [_fall_error(settings, h) for h in (4e-4, 2e-4, 1e-4)]),
            settings.round_off(1e-6, 0.05),
            EULER,
        ),
        Check.within(
            f"order in dx with dt / dx fixed, bar of {counts[0]} to {counts[-1]} cells",
            "-",
            2.0,
            _slope([1.0 / n for n in counts], errors),
            settings.round_off(0.3, 0.6),
            f"{WAVE}; {SPLINE}",
        ),
        Check.within(
            "exponent of dt in what halved substeps change, dx fixed, bar of 16 cells",
            "-",
            -1.0,
            _slope(shares[:-1], steps),
            0.2,
            SMOOTHING,
        ),
    ]


def rods_sag(settings: Settings) -> list[Check]:
    """Level ropes that sag by a little, of 16, 32 and 64 edges."""
    return _sag_orders(settings, "rope")


def strips_sag(settings: Settings) -> list[Check]:
    """Level strips of cloth that sag by a little, of 16, 32 and 64 cells."""
    return _sag_orders(settings, "strip")


def _sag_orders(settings: Settings, of: str) -> list[Check]:
    """The error of n edges is c / n^2 (1 - 3 / n) or so: the order grows from below to 2."""
    counts = (16, 32, 64)
    errors = [abs(_sag(settings, of, n) - 1.0) for n in counts]
    return [
        Check.within(
            f"order of a {of}'s sag, from {n} to {2 * n} edges", "-", 2.0,
            math.log2(coarse / fine), allowed, TIMOSHENKO,
        )
        for n, (coarse, fine), allowed in zip(counts, pairwise(errors), (0.25, 0.15), strict=False)
    ]  # fmt: skip


def _sag(settings: Settings, of: str, edges: int) -> float:
    """Sag of 0.01 % of the length, so that it is linear, over theory."""
    k, nu = SPAN / 400.0, 0.3 if of == "rope" else 0.0
    material = Material(E=2.0e7, nu=nu, density=1000.0)
    if of == "rope":
        body, hand = clamped_rope(4.0 * k, edges + 2)
        shear = 8.0 * (7.0 + 6.0 * nu) / 6.0 * (k / SPAN) ** 2
    else:
        body, hand = clamped_strip(math.sqrt(12.0) * k, SPAN / 20.0, (edges + 2, 2))
        shear = 0.0
    omega = 3.516 * math.sqrt(material.E_over_rho) * k / SPAN**2
    sag = 1e-4 * SPAN
    g = 8.0 * material.E_over_rho * k**2 * sag / SPAN**4
    s = settings.simulator(
        body, [material], engine="thin", grippers=[hand], gravity=(0, 0, -g), air_density=0.0,
        velocity_damping=2.0 * omega,
    )  # fmt: skip
    tip = s.run([20.0 / omega], particles=[edges + 1])[0, 0, 0]
    return -float(tip[2]) / (sag * (1.0 + shear))


def _fall_error(settings: Settings, h: float) -> float:
    """Distance of a falling block from the parabola after 0.1 s in substeps h [m]."""
    dx, t = 0.01, 0.1
    s = settings.simulator(block((2 * dx, 2 * dx, 2 * dx), dx), [Material(E=1.0e4)], substep=h)
    x = s.run([t])[0, 0].astype(float)
    return float(np.abs(x - s.body.x - np.array(GRAVITY) * t**2 / 2.0).max())


def _wave(
    settings: Settings, cells: int, share: float
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Displacement of each section, simulated and analytic, in units of the amplitude [S]."""
    dx, material = LENGTH / cells, Material(E=1.0e5, nu=0.0, density=1000.0)
    c = math.sqrt(material.E_over_rho)
    omega = math.pi * c / LENGTH
    body = block((LENGTH, 2.0 * dx, 2.0 * dx), dx, centre=(LENGTH / 2.0, 0.0, 0.0))
    s = settings.simulator(body, [material], gravity=(0.0, 0.0, 0.0), cfl=share)
    # small enough to be linear, large enough for single precision
    speed = (1e-4 if settings.dtype == "float64" else 1e-2) * c
    v = np.zeros_like(body.x)
    v[:, 0] = speed * np.cos(math.pi * body.material_coordinates[:, 0] / LENGTH)
    s.set_velocities(v)
    time = 0.4 * 2.0 * math.pi / omega
    x = s.run([time])[0, 0].astype(float)
    u = sections(x - body.x, body)[:, 0] / (speed / omega)
    return u, np.cos(math.pi * stations(body) / LENGTH) * math.sin(omega * time)


def _wave_error(settings: Settings, cells: int) -> float:
    """Root mean square error of the wave, in units of its amplitude."""
    u, exact = _wave(settings, cells, 0.2)
    return math.sqrt(np.mean((u - exact) ** 2))


def _slope(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """Exponent p of errors ~ sizes^p, by least squares of their logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])
