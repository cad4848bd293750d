"""Bars, ropes, strips and discs that vibrate, and what damps them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0, jn_zeros

from gendom.materials import Material
from gendom.sim import GRAVITY, Gripper, rope, stable_substep
from validation.bench import WEIGHTLESS, Bench, Row, absolute, case, relative, vanishing
from validation.readings import swing
from validation.references import (
    ROOT,
    damped_frequency,
    first_mode,
    gravity_for,
    lowest_frequency,
    round_frequency,
)
from validation.specimens import (
    across,
    clamp_beyond,
    clamped_strip,
    end,
    particle_rope,
)
from validation.stretching import BAR_SIDE, clamped_bar

DIAMETER, LENGTH = 0.01, 0.1
"""Of ropes that ring down [m]."""

MATERIAL = Material(E=4.0e6, nu=0.3, density=1000.0)
"""Of ropes that ring down."""

BAR = "omega = pi c / (2 L), c = sqrt(E / rho) (Rayleigh 1877, Theory of Sound I, chapter VII)"
LINEAR_SOLID = (
    "s^2 + omega0^2 (1 + s tau / (1 + s tau)) = 0, the standard linear solid's complex modulus in "
    "a beam's first mode; for omega0 tau << 1 the decay rate is omega0^2 tau / 2 (Flugge 1975, "
    "Viscoelasticity; Simo and Hughes 1998, chapter 10)"
)
RELAXED = "a standard linear solid at rest has relaxed to the elastic law"
OWN = (
    "each exchange with the grid smooths what is curved within a cell (APIC), as a viscosity "
    "would; the range was measured on grids of several phases"
)
CHAIN = (
    "T = 2 pi / omega, omega = (j01 / 2) sqrt(g / L) (D. Bernoulli 1738; Lamb, Higher Mechanics)"
)
STIFF = (
    "lowest mode of E I w'''' - (T w')' = rho A omega^2 w, clamped and stretched, by Ritz's "
    "method (Rayleigh 1877, Theory of Sound I, chapter VIII)"
)

OWN_RANGE = {1.5: (0.08, 0.16), 2.0: (0.05, 0.11), 3.0: (0.0, 0.03)}
"""By cells across: between what the time of the viscosity that stands for the grid's own damping
was found [ms], for a rope 10 mm thick with E / density = 4000 m^2/s^2 at the default substep."""


@case("axial-vibration", "a clamped bar", "mpm")
def axial_vibration(bench: Bench) -> list[Row]:
    """A bar clamped at one end, given its first mode's velocity, without gravity."""
    rows, material = [], Material(E=1.0e6, nu=0.3)
    c = math.sqrt(material.E_over_rho)
    for cells, slenderness in ((2, 10),) if bench.quick else ((2, 10), (4, 10), (4, 20)):
        L = slenderness * BAR_SIDE
        omega = math.pi * c / (2.0 * L)
        s = clamped_bar(bench, cells, L, material, pull=0.0, damping=0.0)
        x = s.body.x
        ahead = np.clip(x[:, 0], 0.0, None)
        v = np.zeros_like(x)
        v[:, 0] = 1e-3 * c * np.sin(math.pi * ahead / (2.0 * L))
        s.set_velocities(v)
        t = np.linspace(0.0, 2.0 * 2.0 * math.pi / omega, 81)
        found, _ = swing(t, end(s.run(t)[:, 0], s.body)[:, 0], omega)
        name = f"first axial frequency, {across(cells)}, L = {slenderness} sides"
        rows.append(relative(name, "Hz", _hertz(omega), _hertz(found), 0.02, BAR))
    return rows


@case("ring-down", "a rope with material damping", "mpm")
def particles_ring_down(bench: Bench) -> list[Row]:
    """A rope ten diameters long, pushed in its first mode (8.8 Hz), with and without damping.

    What it loses without is the grid's; as the time of a viscosity (twice the decay rate over
    omega^2) it does not depend on the mode, but on cells and substep.
    """
    cells, times = (2.0, (0.01,)) if bench.quick else (3.0, (0.001, 0.003, 0.01))
    omega = round_frequency(MATERIAL, DIAMETER / 4.0, LENGTH)
    rows = []
    worlds = [replace(MATERIAL, damping=tau) for tau in times]
    tips = _rung(bench, cells, worlds, omega)
    for tau, found in zip(times, tips, strict=True):
        rows += _decay_rows(omega, tau, *found, f"damping {1e3 * tau:g} ms, {across(cells)}")
    for cells in (1.5,) if bench.quick else OWN_RANGE:
        ((frequency, rate),) = _rung(bench, cells, [MATERIAL], omega)
        least, most = OWN_RANGE[cells]
        name = f"the grid's own damping, {across(cells)} (for information)"
        own, half = 1e3 * 2.0 * rate / frequency**2, (most - least) / 2.0
        rows.append(absolute(name, "ms", (least + most) / 2.0, own, half, OWN))
    return rows


@case("rod-ring-down", "a rope with material damping", "thin", "rope")
@case("shell-ring-down", "a strip with material damping", "thin", "strip")
def ring_down(bench: Bench, kind: str) -> list[Row]:
    """A clamped body pushed in its first mode, with damping of 1, 3 and 10 ms and without."""
    times = (0.0, 0.001, 0.003, 0.01)
    if kind == "rope":
        material, L = MATERIAL, LENGTH
        body = rope(diameter=DIAMETER, length=2.0 * L, start=(-L, 0, 0), points=33)
        hand = Gripper.still((-L, 0, 0), radius=L)
        omega = round_frequency(material, DIAMETER / 4.0, L)
    else:
        material, L, h = Material(E=2.0e7, nu=0.0, density=1000.0), 0.15, 0.002
        body, hand = clamped_strip(L, 0.02, h, (49, 3), back=L)
        omega = ROOT**2 * math.sqrt(material.E_over_rho / 12.0) * h / L**2
    worlds = [replace(material, damping=tau) for tau in times]
    s = bench.simulate(body, worlds, grippers=[hand], gravity=WEIGHTLESS)
    y, _, _ = first_mode(body.points[:, 0], L)
    s.set_velocities(np.outer(0.01 * L * omega * y, (0.0, 0.0, 1.0)))
    t = _two_periods(omega)
    rows = []
    for tau, tip in zip(times, s.run(t)[:, :, -1, 2].T, strict=True):
        frequency, rate = swing(t, tip, omega)
        if tau > 0.0:
            rows += _decay_rows(omega, tau, frequency, rate, f"damping {1e3 * tau:g} ms")
        else:
            own, why = 1e3 * 2.0 * rate / frequency**2, "a leapfrog has no damping"
            rows.append(vanishing("what the integrator itself damps", own, 0.002, why, "ms"))
    return rows


@case("damped-sag", "a sag with and without damping", "mpm")
def damped_sag(bench: Bench) -> list[Row]:
    """The same rope at rest under its weight, with damping of 10 ms and without.

    Both in the same substeps: how far grippers give depends on those, see ``grip``.
    """
    omega = round_frequency(MATERIAL, DIAMETER / 4.0, LENGTH)
    worlds = [MATERIAL, replace(MATERIAL, damping=0.01)]
    body, clamp = particle_rope(LENGTH, DIAMETER, 1.5)
    x = bench.settle(
        body, worlds, omega, periods=40.0, grippers=[clamp],
        substep=stable_substep(worlds[1], DIAMETER / 1.5),
        gravity=(0.0, 0.0, -gravity_for(0.02 * LENGTH, MATERIAL, DIAMETER / 4.0, LENGTH)),
    )  # fmt: skip
    plain, damped = (float(-z) for z in end(x, body)[:, 2])
    name = "sag of a tip with damping 10 ms beside that without"
    return [relative(name, "m", plain, damped, 1e-4, RELAXED)]


def _decay_rows(omega: float, tau: float, frequency: float, rate: float, size: str) -> list[Row]:
    expected, decay = damped_frequency(omega, tau)
    hertz = (_hertz(expected), _hertz(frequency))
    return [
        relative(f"decay rate, {size}", "1/s", decay, rate, 0.05, LINEAR_SOLID),
        relative(f"frequency, {size}", "Hz", *hertz, 0.02, LINEAR_SOLID),
    ]


def _rung(
    bench: Bench, cells: float, materials: list[Material], omega: float
) -> list[tuple[float, float]]:
    """Angular frequency [rad/s] and decay rate [1/s] of each world after a push in the first mode.

    It starts with 1 % of its length times ``omega`` at the tip, and is watched from half a period
    on, when the branch has forgotten the start, for two.
    """
    body, clamp = particle_rope(LENGTH, DIAMETER, cells)
    s = bench.simulate(body, materials, grippers=[clamp], gravity=WEIGHTLESS)
    speed, z = 0.01 * LENGTH * omega, body.x[:, 2]
    y, slope, bend = first_mode(body.x[:, 0], LENGTH)
    v = np.stack([-speed * slope * z, 0.0 * z, speed * y], axis=1)
    C = np.zeros((len(z), 3, 3))
    C[:, 2, 0], C[:, 0, 2], C[:, 0, 0] = speed * slope, -speed * slope, -speed * bend * z
    s.set_velocities(v, C)
    t = _two_periods(omega)
    return [swing(t, tip, omega) for tip in end(s.run(t), body)[..., 2].T]


def _two_periods(omega: float) -> NDArray[np.float64]:
    return np.linspace(0.5, 2.5, 81) * 2.0 * math.pi / omega


def _hertz(omega: float) -> float:
    return omega / (2.0 * math.pi)


@case("hanging-chain", "a soft rope's swing", "mpm")
@case("rod-hanging", "a soft rope's swing", "thin")
def hanging(bench: Bench) -> list[Row]:
    """A soft rope 100 diameters long (the MPM's 60 in the quick run) that swings in its first mode.

    It starts stretched by its weight; the MPM's at rest, by 2 % of its length aside.
    """
    particles, d, g, nu = bench.engine == "mpm", 0.005, -GRAVITY[2], 0.3
    L = d * (60 if particles and bench.quick else 100)
    cells, points = (1.0, 33) if bench.quick else (1.5, 65)
    size = across(cells) if particles else f"{points} points"
    back = 3.0 * d / cells if particles else 0.05 * L
    count: dict[str, Any] = {"cells_across": cells} if particles else {"points": points}
    start = (0.0, 0.0, back if particles else 0.0)
    body = rope(diameter=d, length=L + back, start=start, direction=(0.0, 0.0, -1.0), **count)
    x = (body.x if particles else body.points).copy()
    along = body.material_coordinates[:, 0] if particles else -x[:, 2]
    below = np.clip(L + back - along, 0.0, L)
    specific = 50.0 * g * L
    x[:, 2] -= g * (L**2 - below**2) / (2.0 * specific)
    chain = jn_zeros(0, 1)[0] / 2.0 * math.sqrt(g / L)
    stiff = lowest_frequency(specific, d / 4.0, L, g)
    if particles:
        x[:, :2] *= 1.0 - nu * np.where(below < L, g * below / specific, 0.0)[:, None]
        x[:, 0] += 0.02 * L * j0(jn_zeros(0, 1)[0] * np.sqrt(below / L))
    hand = Gripper.still((0, 0, 0), radius=back)
    s = bench.simulate(
        body, [Material(E=1000.0 * specific, nu=nu, density=1000.0)], positions=x,
        grippers=[clamp_beyond((0.0, 0.0, 1.0), d) if particles else hand],
    )  # fmt: skip
    if particles:
        t = np.linspace(0.0, 1.5 * 2.0 * math.pi / chain, 91)
        tip, near = end(s.run(t)[:, 0], body)[:, 0], chain
    else:
        s.set_velocities(np.outer((1.0 - below / L) ** 2 * 0.02 * L * stiff, (1.0, 0.0, 0.0)))
        t, near = np.linspace(0.0, 3.0 * 2.0 * math.pi / stiff, 181), stiff
        # without what is faster than five samples: higher modes of a soft rope
        tip = np.pad(s.run(t)[:, 0, -1, 0], 2, mode="edge")
        tip = np.convolve(tip, np.full(5, 0.2), mode="valid")
    period = 2.0 * math.pi / swing(t, tip, near)[0]
    rows, name = [], f"period with bending stiffness and stretch, {size}"
    if particles:
        expected = 2.0 * math.pi / chain
        rows.append(relative(f"period of a chain, {size}", "s", expected, period, 0.02, CHAIN))
    return [*rows, relative(name, "s", 2.0 * math.pi / stiff, period, 0.01, STIFF)]
