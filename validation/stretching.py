"""Bars and sheets that are stretched, vibrate along or are bent two ways: moduli of a material."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gendom.arrays import Array
from gendom.materials import Material
from gendom.sim import Gripper, cloth
from validation.bench import WEIGHTLESS, Bench, Row, absolute, case, over_theory, relative
from validation.specimens import across, block, clamp_beyond, sections, stations

THICKNESS = 0.002
"""Of sheets [m]."""

MATERIAL = Material(E=2.0e7, nu=0.0, density=1000.0)
"""Of sheets."""

# ---- bars ----------------------------------------------------------------------------------------


@case("tension", "a bar under its own weight", "mpm")
def tension(bench: Bench) -> Iterator[Row]:
    """A clamped bar that hangs along its axis, strain 0.2 % at the clamp.

    Its weight is the known load. E is the slope of load over mean strain of the sections, away
    from clamp and end by 1.5 sides; nu compares their contraction. The last row repeats the
    measurement under strong damping, which must not carry weight.
    """
    cells, side, strain, g = 2 if bench.quick else 4, 0.01, 2.0e-3, 9.81
    L, dx = 8.0 * side, side / cells
    material = Material(E=1000.0 * g * L / strain, nu=0.3, density=1000.0)
    omega = math.pi * math.sqrt(material.E_over_rho) / (2.0 * L)
    body = block((L + 3.0 * dx, side, side), dx, centre=((L - 3.0 * dx) / 2.0, 0.0, 0.0))
    at = stations(body) - 3.0 * dx
    part = (at > 1.5 * side) & (at < L - 1.5 * side)
    load, hand = material.density * g * (L - at[part]), clamp_beyond(reach=side)
    bar = "uniaxial tension: sigma = rho g (L - x) = E strain, contraction nu strain (Hooke)"
    for damping, time in ((0.2 * omega, 80.0 / omega), (2.0 * omega, 14.0 / omega)):
        options = {"gravity": (g, 0.0, 0.0), "velocity_damping": damping}
        s = bench.simulate(body, [material], grippers=[hand], **options)
        x = s.run([time])[0, 0].astype(float)
        stretch = np.gradient(sections(x - body.x, body)[:, 0], at)[part]
        E = np.polyfit(stretch, load, 1)[0]
        if damping > omega:
            name = f"E read back, damping x substep = {damping * float(s.substep[0]):.2g}"
            still = bar + "; at rest damping has no velocity to act on"
            yield relative(name, "Pa", material.E, E, 0.02, still)
            return
        # lateral displacement per distance from the axis, by least squares over each section
        y0, y = (a[:, 1:].reshape(len(at), -1) for a in (body.x, x))
        narrow = ((y - y0) * y0).sum(axis=1)[part] / (y0**2).sum(axis=1)[part]
        nu = -np.polyfit(stretch, narrow, 1)[0]
        yield relative(f"E read back, {across(cells)}", "Pa", material.E, E, 0.02, bar)
        yield relative(f"nu read back, {across(cells)}", "-", material.nu, nu, 0.02, bar)


@case("order", "orders of convergence", "mpm")
def order(bench: Bench) -> Iterator[Row]:
    """A free bar that vibrates along its axis, for 0.4 periods.

    Its analytic answer gives the order of the error when cells and substeps shrink together. With
    cells as they are shorter substeps are not better: each exchange with the grid smooths
    velocities by the same share, so what is smoothed away grows with their number, and so do the
    differences between answers.
    """
    counts, shares = (8, 16, 32, 64), (0.2, 0.1, 0.05, 0.025)
    if bench.quick:
        counts, shares = counts[:-1], shares[:-1]

    def exponent(sizes: Array, errors: list[Any]) -> float:
        logs = [math.log(math.sqrt(np.mean(e**2))) for e in errors]
        return float(np.polyfit(np.log(sizes), logs, 1)[0])

    wave = (
        "u = (v0 / omega) cos(pi x / L) sin(omega t), omega = pi sqrt(E / rho) / L, nu = 0; order "
        "2 of quadratic B-splines (Steffen, Kirby, Berzins 2008) and of the leapfrog that "
        "symplectic Euler is for positions (Hairer, Lubich, Wanner 2006)"
    )
    name = f"order in dx with dt / dx fixed, bar of {counts[0]} to {counts[-1]} cells"
    errors = [u - exact for u, exact in (_wave(bench, n, 0.2) for n in counts)]
    found = exponent(1.0 / np.array(counts), errors)
    yield absolute(name, "-", 2.0, found, bench.round_off(0.3, 0.6), wave)
    smoothing = (
        "APIC smooths once a substep, whatever its length (Jiang et al. 2015): a loss that grows "
        "as 1 / dt"
    )
    name = "exponent of dt in what halved substeps change, dx fixed, bar of 16 cells"
    answers = [_wave(bench, 16, share)[0] for share in shares]
    found = exponent(np.array(shares[:-1]), [a - b for a, b in pairwise(answers)])
    yield absolute(name, "-", -1.0, found, 0.2, smoothing)


def _wave(bench: Bench, cells: int, share: float) -> tuple[Array, Array]:
    """Displacement of each section, simulated and analytic, in units of the amplitude [S]."""
    L, material = 0.1, Material(E=1.0e5, nu=0.0, density=1000.0)
    dx, c = L / cells, math.sqrt(material.E_over_rho)
    omega = math.pi * c / L
    body = block((L, 2.0 * dx, 2.0 * dx), dx, centre=(L / 2.0, 0.0, 0.0))
    s = bench.simulate(body, [material], gravity=WEIGHTLESS, cfl=share)
    # small enough to be linear, large enough for single precision
    speed = (1e-4 if bench.dtype == "float64" else 1e-2) * c
    v = np.zeros_like(body.x)
    v[:, 0] = speed * np.cos(math.pi * body.material_coordinates[:, 0] / L)
    s.set_velocities(v)
    time = 0.4 * 2.0 * math.pi / omega
    x = s.run([time])[0, 0].astype(float)
    u = sections(x - body.x, body)[:, 0] / (speed / omega)
    return u, np.cos(math.pi * stations(body) / L) * math.sin(omega * time)


# ---- sheets --------------------------------------------------------------------------------------


@case("shell-plates", "strips and squares that bend two ways", "thin")
def plates(bench: Bench) -> Iterator[Row]:
    """Strips bent by turned ends, and squares that sag under their weight between four corners."""
    yield from _bent_strips(bench)
    yield from _squares(bench)


def _bent_strips(bench: Bench) -> Iterator[Row]:
    """Ten times as long as wide and bent to an arc; read is how they curve across in the middle."""
    L, width, R, back, points = 0.4, 0.04, 10.0, 0.02, (23, 5) if bench.quick else (41, 9)
    body = cloth(
        width=L + 2.0 * back, height=width, thickness=THICKNESS, dx=0.02, points=points,
        corner=(-0.5 * L - back, -0.5 * width, 0.0),
    )  # fmt: skip
    turned = np.linspace(0.0, 0.5 * L / R, 13)
    # from an arc's end to the centre of a sphere so wide that it looks flat
    x = 0.5 * L * np.sinc(turned / math.pi) + 100.0 * np.cos(turned)
    z = -0.5 * L * np.sinc(turned / (2.0 * math.pi)) * np.sin(turned / 2.0)
    z -= 100.0 * np.sin(turned)
    hands = [
        Gripper(
            time=np.linspace(0.0, 1.0, len(turned)),
            position=np.stack([side * x, 0.0 * x, z], axis=1), radius=100.0,
            quat_xyzw=Rotation.from_rotvec(np.outer(side * turned, (0.0, 1.0, 0.0))).as_quat(),
        )
        for side in (-1.0, 1.0)
    ]  # fmt: skip
    worlds = [replace(MATERIAL, nu=nu) for nu in (0.1, 0.4)]
    omega = 22.4 * math.sqrt(MATERIAL.E_over_rho / 12.0) * THICKNESS / L**2
    options = {"grippers": hands, "gravity": WEIGHTLESS}
    rest = bench.settle(body, worlds, omega, periods=16.0 + omega, **options)
    z, i = rest.reshape(-1, *points[::-1], 3)[..., 2], points[0] // 2
    along = np.diff(z[..., i - 1 : i + 2], 2, axis=-1).mean(axis=(1, 2))
    over = np.diff(z[..., i], 2, axis=-1).mean(axis=-1)
    spacings = ((L + 2.0 * back) / (points[0] - 1), width / (points[1] - 1))
    ratios = -over / along * (spacings[0] / spacings[1]) ** 2
    for m, ratio in zip(worlds, ratios, strict=True):
        name = f"curvature across over that along a bent strip, with the other sign, nu {m.nu:g}"
        source = (
            "kappa_y = -nu kappa_x of a narrow strip under end moments (Timoshenko, Theory of "
            "Plates and Shells, chapter 2)"
        )
        yield relative(name, "-", m.nu, ratio, 0.02, source)


def _squares(bench: Bench) -> Iterator[Row]:
    """They sag by 1 % of their thickness."""
    a, sag, material = 0.2, 0.01 * THICKNESS, replace(MATERIAL, nu=0.3)
    D = material.E * THICKNESS**3 / (12.0 * (1.0 - material.nu**2))
    areal = material.density * THICKNESS
    # of the even polynomials of degree 16 that are 0 at the corners, those of least energy
    middle, side = 0.0255065005726, 0.0177474190003
    corners = [(0.5 * i * a, 0.5 * j * a, 0.0) for i in (-1, 1) for j in (-1, 1)]
    # of the first mode (Leissa 1969, Vibration of Plates)
    omega = 7.1 * math.sqrt(D / areal) / a**2
    source = (
        "0.02551 and 0.01775 q a^4 / D in the middle and halfway along a side, nu 0.3, by Ritz's "
        "method with polynomials of degree 16 (plates supported at corners: Timoshenko, Theory of "
        "Plates and Shells)"
    )
    for n in (11,) if bench.quick else (11, 21):
        corner = (-0.5 * a, -0.5 * a, 0.0)
        x = bench.settle(
            cloth(width=a, height=a, thickness=THICKNESS, dx=0.02, points=(n, n), corner=corner),
            [material], omega, grippers=[Gripper.still(at, radius=1e-4) for at in corners],
            gravity=(0, 0, -sag / middle * D / (areal * a**4)),
        )  # fmt: skip
        z = -x[0, :, 2].reshape(n, n) / sag
        for place, found in (
            ("in the middle", z[n // 2, n // 2]),
            ("halfway along a side", z[0, n // 2] * middle / side),
        ):
            name = f"sag over theory of a square held at its corners, {place}, {n} points"
            yield over_theory(name, found, 0.01, source)
