"""Orders of convergence in the substep, in the size of a cell, and in the distance of points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim import GRAVITY
from validation.bench import WEIGHTLESS, Bench, Row, absolute, case
from validation.bending import SPAN, STIFF
from validation.references import beam_frequency, unit_gravity
from validation.specimens import block, clamped_rope, clamped_strip, sections, stations

LENGTH = 0.1
"""Of the bar [m]."""

EULER = "symplectic Euler is of order 1: x - x0 - v0 t - g t^2 / 2 = g h t / 2"
WAVE = (
    "u = (v0 / omega) cos(pi x / L) sin(omega t), omega = pi sqrt(E / rho) / L, nu = 0; order 2 of "
    "quadratic B-splines (Steffen, Kirby, Berzins 2008) and of the leapfrog that symplectic Euler "
    "is for positions (Hairer, Lubich, Wanner 2006)"
)
SMOOTHING = (
    "APIC smooths once a substep, whatever its length (Jiang et al. 2015): a loss that grows as "
    "1 / dt"
)
TIMOSHENKO = (
    "w L^4 / (8 E I), of rods + w L^2 / (2 kappa G A) (Timoshenko; kappa = 6 (1 + nu) / "
    "(7 + 6 nu), Cowper 1966); of a lattice order 2: differences are central"
)


@case("order", "orders of convergence", "mpm")
def order(bench: Bench) -> list[Row]:
    """A falling block; a free bar that vibrates along its axis for half a period.

    The bar's analytic answer gives the order of the error when cells and substeps shrink
    together. With cells as they are shorter substeps are not better: each exchange with the grid
    smooths velocities by the same share, so what is smoothed away grows with their number, and so
    do the differences between answers.
    """
    falls = [_fall_error(bench, h) for h in (4e-4, 2e-4, 1e-4)]
    counts = (8, 16, 32) if bench.quick else (8, 16, 32, 64)
    errors = []
    for n in counts:
        u, exact = _wave(bench, n, 0.2)
        errors.append(math.sqrt(np.mean((u - exact) ** 2)))
    shares = (0.2, 0.1, 0.05) if bench.quick else (0.2, 0.1, 0.05, 0.025)
    answers = [_wave(bench, 16, share)[0] for share in shares]
    steps = [math.sqrt(np.mean((a - b) ** 2)) for a, b in pairwise(answers)]
    of_falls, of_waves, of_steps = (
        _exponent([1.0, 0.5, 0.25], falls),
        _exponent([1.0 / n for n in counts], errors),
        _exponent(shares[:-1], steps),
    )
    cells = f"order in dx with dt / dx fixed, bar of {counts[0]} to {counts[-1]} cells"
    exact, near = bench.round_off(1e-6, 0.05), bench.round_off(0.3, 0.6)
    halved = "exponent of dt in what halved substeps change, dx fixed, bar of 16 cells"
    return [
        absolute("order in dt, fall of a block", "-", 1.0, of_falls, exact, EULER),
        absolute(cells, "-", 2.0, of_waves, near, WAVE),
        absolute(halved, "-", -1.0, of_steps, 0.2, SMOOTHING),
    ]


def _fall_error(bench: Bench, h: float) -> float:
    """Distance of a falling block from the parabola after 0.1 s in substeps h [m]."""
    dx, t = 0.01, 0.1
    body = block((2 * dx, 2 * dx, 2 * dx), dx)
    x = bench.simulate(body, [Material(E=1.0e4)], substep=h).run([t])[0, 0].astype(float)
    return float(np.abs(x - body.x - np.array(GRAVITY) * t**2 / 2.0).max())


def _wave(
    bench: Bench, cells: int, share: float
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Displacement of each section, simulated and analytic, in units of the amplitude [S]."""
    dx, material = LENGTH / cells, Material(E=1.0e5, nu=0.0, density=1000.0)
    c = math.sqrt(material.E_over_rho)
    omega = math.pi * c / LENGTH
    body = block((LENGTH, 2.0 * dx, 2.0 * dx), dx, centre=(LENGTH / 2.0, 0.0, 0.0))
    s = bench.simulate(body, [material], gravity=WEIGHTLESS, cfl=share)
    # small enough to be linear, large enough for single precision
    speed = (1e-4 if bench.dtype == "float64" else 1e-2) * c
    v = np.zeros_like(body.x)
    v[:, 0] = speed * np.cos(math.pi * body.material_coordinates[:, 0] / LENGTH)
    s.set_velocities(v)
    time = 0.4 * 2.0 * math.pi / omega
    x = s.run([time])[0, 0].astype(float)
    u = sections(x - body.x, body)[:, 0] / (speed / omega)
    return u, np.cos(math.pi * stations(body) / LENGTH) * math.sin(omega * time)


def _exponent(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """p of errors ~ sizes^p, by least squares of their logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])


@case("rod-order", "finer and finer ropes", "thin", "rope")
@case("shell-order", "finer and finer strips", "thin", "strip")
def sag_orders(bench: Bench, of: str) -> list[Row]:
    """Level ropes or strips that sag by a little, of 16, 32 and 64 edges.

    The error of n edges is c / n^2 (1 - 3 / n) or so: the order grows from below to 2.
    """
    counts = (16, 32, 64)
    errors = [abs(_sag(bench, of, n) - 1.0) for n in counts]
    rows = []
    for n, (coarse, fine), allowed in zip(counts, pairwise(errors), (0.25, 0.15), strict=False):
        name = f"order of a {of}'s sag, from {n} to {2 * n} edges"
        rows.append(absolute(name, "-", 2.0, math.log2(coarse / fine), allowed, TIMOSHENKO))
    return rows


def _sag(bench: Bench, of: str, edges: int) -> float:
    """Sag of 0.01 % of the length, so that it is linear, over theory."""
    k, sag = SPAN / 400.0, 1e-4 * SPAN
    if of == "rope":
        material, shear = STIFF, 8.0 * (7.0 + 6.0 * STIFF.nu) / 6.0 * (k / SPAN) ** 2
        body, hand = clamped_rope(SPAN, 4.0 * k, edges + 2)
    else:
        material, shear = replace(STIFF, nu=0.0), 0.0
        body, hand = clamped_strip(SPAN, SPAN / 20.0, math.sqrt(12.0) * k, (edges + 2, 2))
    g = 8.0 * unit_gravity(material, k, SPAN) * sag / SPAN
    omega = beam_frequency(material, k, SPAN)
    options = {"grippers": [hand], "gravity": (0, 0, -g)}
    x = bench.settle(body, [material], omega, periods=20.0, **options)
    return -float(x[0, edges + 1, 2]) / (sag * (1.0 + shear))
