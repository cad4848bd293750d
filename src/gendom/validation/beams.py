"""Clamped strips that bend under their own weight: small sags, and the heavy elastica."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_bvp

from gendom.errors import SimulationError
from gendom.materials import Material
from gendom.sim import GRAVITY, Body, Simulator, cloth
from gendom.validation.check import Check, Settings
from gendom.validation.specimens import across, clamp_beyond, end, sections, stations

THICKNESS = 0.01
"""[m]."""

GYRATION = THICKNESS / math.sqrt(12.0)
"""Radius of gyration of the rectangular section [m]."""

BEAM = (
    "w L^4 / (8 E I) + w L^2 / (2 kappa G A) (Gere and Timoshenko, Mechanics of Materials; "
    "kappa = 10 (1 + nu) / (12 + 11 nu), Cowper 1966)"
)
ELASTICA = (
    "heavy elastica E I theta'' = w (L - s) cos theta, solved by collocation (Wang 1986, "
    "'A critical review of the heavy elastica')"
)

# Bounds for sags: as for ropes in a gripper, see ``grip``.
SAG_BOUNDS = {1: 0.04, 2: 0.02, 4: 0.02, 8: 0.02}

NU = 0.3


def cantilever(settings: Settings) -> list[Check]:
    """A strip ten times as long as thick that sags by 2 % of its length, on finer and finer grids.

    Shear has 1 % of the sag at this slenderness.
    """
    L = 10.0 * THICKNESS
    sag = 0.02 * L
    kappa = 10.0 * (1.0 + NU) / (12.0 + 11.0 * NU)
    shear = 8.0 * (1.0 + NU) * (GYRATION / L) ** 2 / kappa
    checks = []
    for cells in (1, 2) if settings.quick else (1, 2, 4, 8):
        specific = -GRAVITY[2] * L**4 / (8.0 * GYRATION**2 * sag)
        s, omega = clamped_strip(settings, cells, L, specific, gravity=[GRAVITY])
        tip = end(s.run([11.0 / omega])[0, 0], s.body)
        checks.append(
            Check.within_share(
                f"sag of the tip, {across(cells)}",
                "m",
                sag * (1.0 + shear),
                -float(tip[2]),
                SAG_BOUNDS[cells],
                BEAM,
            )
        )
    return checks


def elastica(settings: Settings) -> list[Check]:
    """A clamped strip of 1, 2 and 3 bending lengths, large deflection, and whether it stays.

    Three worlds of equal material: gravity sets the bending length (E I / (w))^(1/3).
    """
    if settings.quick:
        cells, slenderness, ratios, bound = 1, 15.0, np.array([1.0, 2.0]), 0.06
    else:
        cells, slenderness, ratios, bound = 2, 25.0, np.array([1.0, 2.0, 3.0]), 0.02
    L = slenderness * THICKNESS
    last, drift, body = _hang(settings, cells, L, ratios)
    at = stations(body) - 3.0 * body.dx
    free = at > 0.0
    checks = []
    for w, ratio in enumerate(ratios):
        curve = heavy_elastica(ratio)
        there = curve(at[free] / L)
        here = sections(last[w], body)[free][:, [0, 2]] / L
        tip = end(last[w], body)[[0, 2]] / L
        size = f"L = {ratio:g} bending lengths, {across(cells)}"
        for name, measured, expected in zip("xz", tip, curve([1.0])[0], strict=True):
            checks.append(
                Check.within(
                    f"tip's {name} / L, {size}",
                    "-",
                    float(expected),
                    float(measured),
                    bound,
                    ELASTICA,
                )
            )
        checks.append(
            Check.within(
                f"largest distance from the elastica / L, {size}",
                "-",
                0.0,
                float(np.linalg.norm(here - there, axis=1).max()),
                bound,
                ELASTICA,
            )
        )
        checks.append(_stays(drift[w] / L, size))
    if not settings.quick:
        _, drift, _ = _hang(settings, 1, L, ratios[-1:])
        checks.append(_stays(drift[0] / L, f"L = {ratios[-1]:g} bending lengths, 1 cell across"))
    return checks


def heavy_elastica(ratio: float) -> Callable[[ArrayLike], NDArray[np.floating]]:
    """Shape of an inextensible strip of ``ratio`` bending lengths (E I / w)^(1/3), clamped level.

    With lengths in units of L and theta the angle above the level: theta'' = ratio^3 (1 - s)
    cos theta, theta(0) = 0, theta'(1) = 0. The load is raised in steps, so that the solution is
    the one that hangs. Source: Wang (1986), "A critical review of the heavy elastica".

    Returns:
        A function from arc lengths [K] in [0, 1] to x and z [K, 2].

    Raises:
        SimulationError: If the collocation does not converge.
    """

    def slopes(s, y, load):
        return np.stack([y[1], load * (1.0 - s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def at_ends(a, b):
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0.0, 1.0, 201)
    y = np.stack([0.0 * s, 0.0 * s, s, 0.0 * s])
    curve = None
    for load in ratio**3 * np.linspace(0.2, 1.0, 5):
        solved = solve_bvp(partial(slopes, load=load), at_ends, s, y, tol=1e-8, max_nodes=20000)
        if not solved.success:
            raise SimulationError(f"the elastica was not solved ({solved.message})")
        s, y, curve = solved.x, solved.y, solved.sol
    assert curve is not None
    return lambda where: curve(np.asarray(where, dtype=float))[2:].T


def clamped_strip(
    settings: Settings, cells: int, L: float, specific: float, *, gravity: ArrayLike
) -> tuple[Simulator, float]:
    """A strip, 2 cells wide, whose free part reaches from x = 0 over L.

    Args:
        settings: How to run.
        cells: Cells across the thickness.
        L: Free length [m].
        specific: E / density [m^2/s^2].
        gravity: [W, 3] one world each [m/s^2].

    Returns:
        The simulator, damped critically in its first mode, and that mode's angular frequency
        [rad/s].
    """
    dx = THICKNESS / cells
    back = 3.0 * dx
    body = cloth(
        width=L + back,
        height=2.0 * dx,
        thickness=THICKNESS,
        dx=dx,
        corner=(-back, -dx, 0.0),
    )
    clamp = clamp_beyond((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), THICKNESS)
    # first mode of a cantilever: (1.875)^2 sqrt(E I / (rho A)) / L^2
    omega = 3.516 * math.sqrt(specific) * GYRATION / L**2
    pull = np.asarray(gravity, dtype=float)
    material = Material(E=1000.0 * specific, nu=NU, density=1000.0)
    s = settings.simulator(
        body,
        [material] * len(pull),
        grippers=[clamp],
        velocity_damping=2.0 * omega,
        gravity=pull,
        air_density=0.0,
    )
    return s, omega


def _hang(
    settings: Settings, cells: int, L: float, ratios: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating], Body]:
    """Last positions [W, N, 3], how far each tip then still moves [W] [m], and the body."""
    specific = 400.0
    gravity = np.zeros((len(ratios), 3))
    gravity[:, 2] = -specific * GYRATION**2 * ratios**3 / L**3
    s, omega = clamped_strip(settings, cells, L, specific, gravity=gravity)
    x = s.run(np.array([0.8, 0.9, 1.0]) * 12.0 / omega)
    tips = end(x, s.body)
    drift = np.linalg.norm(tips - tips[-1], axis=-1).max(axis=0)
    return x[-1], drift, s.body


def _stays(drift: float, size: str) -> Check:
    return Check.within(
        f"way of the resting tip / L, {size}",
        "-",
        0.0,
        float(drift),
        # the first mode, damped critically, has (1 + 9.6) exp(-9.6) = 0.0007 of its start to go
        0.001,
        "equilibrium: what hangs still stays",
    )
