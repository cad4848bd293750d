"""Ropes and strips that vibrate, and what damps them."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import j0, jn_zeros

from gendom.materials import Material
from gendom.sim import GRAVITY, Gripper, rope
from validation.bench import WEIGHTLESS, Bench, Row, absolute, case, relative, vanishing
from validation.readings import swing
from validation.references import (
    ROOT,
    damped_frequency,
    first_mode,
    lowest_frequency,
    round_frequency,
)
from validation.specimens import across, clamp_beyond, clamped_strip, end, particle_rope

OWN_RANGE = {1.5: (0.08, 0.16), 2.0: (0.05, 0.11), 3.0: (0.0, 0.03)}
"""By cells across: between what the time of the viscosity that stands for the grid's own damping
was found [ms], for a rope 10 mm thick with E / density = 4000 m^2/s^2 at the default substep."""


@case("ring-down", "a rope with material damping", "mpm", "")
@case("rod-ring-down", "a rope with material damping", "thin", "rope")
@case("shell-ring-down", "a strip with material damping", "thin", "strip")
def ring_down(bench: Bench, kind: str) -> Iterator[Row]:
    """A clamped body pushed in its first mode, with damping of 1, 3 and 10 ms and without.

    What particles lose without is the grid's; as the time of a viscosity (twice the decay rate over
    omega^2) it does not depend on the mode, but on cells and substep.
    """
    cells, times = 3.0, (0.001, 0.003, 0.01)
    if bench.quick:
        cells, times = 2.0, times[-1:]
    if kind == "strip":
        material, L, h = Material(E=2.0e7, nu=0.0, density=1000.0), 0.15, 0.002
        omega = ROOT**2 * math.sqrt(material.E_over_rho / 12.0) * h / L**2
    else:
        material, L = Material(E=4.0e6, nu=0.3, density=1000.0), 0.1
        omega = round_frequency(material, L / 40.0, L)

    source = (
        "s^2 + omega0^2 (1 + s tau / (1 + s tau)) = 0, the standard linear solid's complex modulus "
        "in a beam's first mode; for omega0 tau << 1 the decay rate is omega0^2 tau / 2 (Flugge "
        "1975, Viscoelasticity; Simo and Hughes 1998, chapter 10)"
    )
    body = (bench, kind, material, L, omega)
    found = _rung(*body, cells, (0.0, *times) if kind else times)
    if kind:
        frequency, rate = found.pop(0)
        own, why = 2e3 * rate / frequency**2, "a leapfrog has no damping"
        yield vanishing("what the integrator itself damps", own, 0.002, why, "ms")
    for tau, (frequency, rate) in zip(times, found, strict=True):
        expected, decay = damped_frequency(omega, tau)
        size = f"damping {1e3 * tau:g} ms" + ("" if kind else f", {across(cells)}")
        yield relative(f"decay rate, {size}", "1/s", decay, rate, 0.05, source)
        hertz = (expected / (2.0 * math.pi), frequency / (2.0 * math.pi))
        yield relative(f"frequency, {size}", "Hz", *hertz, 0.02, source)
    for cells in () if kind else (1.5,) if bench.quick else OWN_RANGE:
        ((frequency, rate),) = _rung(*body, cells, (0.0,))
        least, most = OWN_RANGE[cells]
        name = f"the grid's own damping, {across(cells)} (for information)"
        own, middle, half = 2e3 * rate / frequency**2, (least + most) / 2.0, (most - least) / 2.0
        why = (
            "each exchange with the grid smooths what is curved within a cell (APIC), as a "
            "viscosity would; the range was measured on grids of several phases"
        )
        yield absolute(name, "ms", middle, own, half, why)


def _rung(
    bench: Bench, kind: str, material: Material, L: float, omega: float, cells: float,
    times: tuple[float, ...],
) -> list[tuple[float, float]]:  # fmt: skip
    """Angular frequency and decay rate of each, after half a period, when the branch of the
    material has forgotten the start."""
    if kind == "strip":
        body, hand = clamped_strip(L, 0.02, 0.002, (49, 3), back=L)
    elif kind:
        body = rope(diameter=L / 10.0, length=2.0 * L, start=(-L, 0, 0), points=33)
        hand = Gripper.still((-L, 0, 0), radius=L)
    else:
        body, hand = particle_rope(L, L / 10.0, cells)
    worlds = [replace(material, damping=tau) for tau in times]
    s = bench.simulate(body, worlds, grippers=[hand], gravity=WEIGHTLESS)
    speed, t = 0.01 * L * omega, np.linspace(0.5, 2.5, 81) * 2.0 * math.pi / omega
    if kind:
        s.set_velocities(np.outer(speed * first_mode(body.points[:, 0], L)[0], (0, 0, 1)))
        tips = s.run(t)[:, :, -1, 2]
    else:
        z, (y, slope, bend) = body.x[:, 2], first_mode(body.x[:, 0], L)
        v = np.stack([-speed * slope * z, 0.0 * z, speed * y], axis=1)
        C = np.zeros((len(z), 3, 3))
        C[:, 2, 0], C[:, 0, 2], C[:, 0, 0] = speed * slope, -speed * slope, -speed * bend * z
        s.set_velocities(v, C)
        tips = end(s.run(t), body)[..., 2]
    return [swing(t, tip, omega) for tip in tips.T]


@case("hanging-chain", "a soft rope's swing", "mpm")
@case("rod-hanging", "a soft rope's swing", "thin")
def hanging(bench: Bench) -> Iterator[Row]:
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
    specific, root = 50.0 * g * L, jn_zeros(0, 1)[0]
    x[:, 2] -= g * (L**2 - below**2) / (2.0 * specific)
    chain, stiff = root / 2.0 * math.sqrt(g / L), lowest_frequency(specific, d / 4.0, L, g)
    hand = Gripper.still((0, 0, 0), radius=back)
    if particles:
        hand = clamp_beyond((0.0, 0.0, 1.0), d)
        x[:, :2] *= 1.0 - nu * np.where(below < L, g * below / specific, 0.0)[:, None]
        x[:, 0] += 0.02 * L * j0(root * np.sqrt(below / L))
    material = Material(E=1000.0 * specific, nu=nu, density=1000.0)
    s = bench.simulate(body, [material], positions=x, grippers=[hand])
    if particles:
        t, near = np.linspace(0.0, 1.5 * 2.0 * math.pi / chain, 91), chain
        tip = end(s.run(t)[:, 0], body)[:, 0]
    else:
        s.set_velocities(np.outer((1.0 - below / L) ** 2 * 0.02 * L * stiff, (1.0, 0.0, 0.0)))
        t, near = np.linspace(0.0, 3.0 * 2.0 * math.pi / stiff, 181), stiff
        # without what is faster than five samples: higher modes of a soft rope
        tip = np.pad(s.run(t)[:, 0, -1, 0], 2, mode="edge")
        tip = np.convolve(tip, np.full(5, 0.2), mode="valid")
    period = 2.0 * math.pi / swing(t, tip, near)[0]
    if particles:
        source = (
            "T = 2 pi / omega, omega = (j01 / 2) sqrt(g / L) (D. Bernoulli 1738; Lamb, Higher "
            "Mechanics)"
        )
        expected = 2.0 * math.pi / chain
        yield relative(f"period of a chain, {size}", "s", expected, period, 0.02, source)
    source = (
        "lowest mode of E I w'''' - (T w')' = rho A omega^2 w, clamped and stretched, by Ritz's "
        "method (Rayleigh 1877, Theory of Sound I, chapter VIII)"
    )
    name = f"period with bending stiffness and stretch, {size}"
    yield relative(name, "s", 2.0 * math.pi / stiff, period, 0.01, source)
