"""Clamped ropes that ring down: what the material takes, and what the grid takes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim import Simulator, rope, stable_substep
from gendom.validation.check import Check, Settings
from gendom.validation.specimens import across, clamp_beyond, end, swing

DIAMETER = 0.01
"""[m]."""

MATERIAL = Material(E=4.0e6, nu=0.3, density=1000.0)

ROOT = 1.8751040687
"""beta L of a cantilever's first mode: cos(beta L) cosh(beta L) = -1."""

LINEAR_SOLID = (
    "s^2 + omega0^2 (1 + s tau / (1 + s tau)) = 0, the standard linear solid's complex modulus in "
    "a beam's first mode; for omega0 tau << 1 the decay rate is omega0^2 tau / 2 (Flugge 1975, "
    "Viscoelasticity; Simo and Hughes 1998, chapter 10)"
)


OWN = (
    "each exchange with the grid smooths what is curved within a cell (APIC), as a viscosity "
    "would; the range was measured on grids of several phases"
)

OWN_RANGE = {1.5: (0.08, 0.16), 2.0: (0.05, 0.11), 3.0: (0.0, 0.03)}
"""By cells across: between what the time of the viscosity that stands for the grid's own damping
was found [ms], for a rope 10 mm thick with E / density = 4000 m^2/s^2 at the default substep."""

LENGTH = 10.0 * DIAMETER


def ring_down(settings: Settings) -> list[Check]:
    """A rope ten diameters long, pushed in its first mode (8.8 Hz), with and without damping.

    What it loses without is the grid's; as the time of a viscosity (twice the decay rate over
    omega^2) it does not depend on the mode, but on cells and substep.
    """
    cells, times = (2.0, (0.01,)) if settings.quick else (3.0, (0.001, 0.003, 0.01))
    omega = elastic_frequency(MATERIAL, DIAMETER / 4.0, LENGTH)
    worlds = [replace(MATERIAL, damping=tau) for tau in times]
    found = rung(cantilever_rope(settings, cells, worlds), omega)
    checks = []
    for tau, (frequency, rate) in zip(times, found, strict=True):
        expected, decay = damped_frequency(omega, tau)
        size = f"damping {1e3 * tau:g} ms, {across(cells)}"
        checks += [
            Check.within_share(f"decay rate, {size}", "1/s", decay, rate, 0.05, LINEAR_SOLID),
            Check.within_share(
                f"frequency, {size}",
                "Hz",
                expected / (2.0 * math.pi),
                frequency / (2.0 * math.pi),
                0.02,
                LINEAR_SOLID,
            ),
        ]
    for cells in (1.5,) if settings.quick else OWN_RANGE:
        ((frequency, rate),) = rung(cantilever_rope(settings, cells, [MATERIAL]), omega)
        least, most = OWN_RANGE[cells]
        checks.append(
            Check.within(
                f"the grid's own damping, {across(cells)} (for information)",
                "ms",
                (least + most) / 2.0,
                1e3 * 2.0 * rate / frequency**2,
                (most - least) / 2.0,
                OWN,
            )
        )
    return checks


def damped_sag(settings: Settings) -> list[Check]:
    """The same rope at rest under its weight, with damping of 10 ms and without.

    Both in the same substeps: how far grippers give depends on those, see ``grip``.
    """
    omega = elastic_frequency(MATERIAL, DIAMETER / 4.0, LENGTH)
    worlds = [MATERIAL, replace(MATERIAL, damping=0.01)]
    s = cantilever_rope(
        settings,
        1.5,
        worlds,
        substep=stable_substep(worlds[1], DIAMETER / 1.5),
        gravity=(0.0, 0.0, -gravity_for(0.02 * LENGTH, MATERIAL, DIAMETER / 4.0, LENGTH)),
        velocity_damping=2.0 * omega,
    )
    plain, damped = -end(s.run([40.0 / omega])[0], s.body)[:, 2]
    return [
        Check.within_share(
            "sag of a tip with damping 10 ms beside that without",
            "m",
            float(plain),
            float(damped),
            1e-4,
            "a standard linear solid at rest has relaxed to the elastic law",
        )
    ]


def cantilever_rope(
    settings: Settings, cells: float, materials: list[Material], **options: Any
) -> Simulator:
    """A rope whose free part reaches from x = 0 over ``LENGTH``, one world a material."""
    dx = DIAMETER / cells
    back = 3.0 * dx
    body = rope(
        diameter=DIAMETER,
        length=LENGTH + back,
        start=(-back, 0.0, 0.0),
        cells_across=cells,
    )
    clamp = clamp_beyond((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), DIAMETER)
    given: dict[str, Any] = {"gravity": (0.0, 0.0, 0.0), "air_density": 0.0}
    return settings.simulator(body, materials, grippers=[clamp], **(given | options))


def rung(s: Simulator, omega: float) -> list[tuple[float, float]]:
    """Angular frequency [rad/s] and decay rate [1/s] of each world after a push in the first mode.

    It starts with 1 % of its length times ``omega`` at the tip, and is watched from half a period
    on, when the branch has forgotten the start, for two.
    """
    body, speed = s.body, 0.01 * LENGTH * omega
    y, slope, bend = first_mode(body.x[:, 0], LENGTH)
    z = body.x[:, 2]
    v = np.stack([-speed * slope * z, 0.0 * z, speed * y], axis=1)
    C = np.zeros((len(z), 3, 3))
    C[:, 2, 0], C[:, 0, 2], C[:, 0, 0] = speed * slope, -speed * slope, -speed * bend * z
    s.set_velocities(v, C)
    t = np.linspace(0.5, 2.5, 81) * 2.0 * math.pi / omega
    tips = end(s.run(t), body)[..., 2]
    return [swing(t, tip, omega) for tip in tips.T]


def first_mode(x: NDArray[np.floating], L: float) -> tuple[NDArray[np.floating], ...]:
    """Deflection of a cantilever's first mode, 1 at the tip, and its first two derivatives."""
    b = ROOT / L
    s = np.clip(x, 0.0, None)
    ratio = (math.cosh(ROOT) + math.cos(ROOT)) / (math.sinh(ROOT) + math.sin(ROOT))
    y = np.cosh(b * s) - np.cos(b * s) - ratio * (np.sinh(b * s) - np.sin(b * s))
    y1 = np.sinh(b * s) + np.sin(b * s) - ratio * (np.cosh(b * s) - np.cos(b * s))
    y2 = np.cosh(b * s) + np.cos(b * s) - ratio * (np.sinh(b * s) + np.sin(b * s))
    return y / 2.0, b * y1 / 2.0, b * b * y2 / 2.0


def elastic_frequency(material: Material, k: float, L: float) -> float:
    """Angular frequency of a round cantilever's first mode, shear counted [rad/s].

    1 / omega^2 = 1 / omega_bending^2 + 1 / omega_shear^2 (Dunkerley 1894).

    Args:
        material: What it is made of.
        k: Radius of gyration [m].
        L: Length [m].
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
    [m/s^2]."""
    bending = L**4 / (8.0 * material.E_over_rho * k**2)
    return sag / (bending + L**2 * material.density / (2.0 * shear_modulus(material)))


def damped_frequency(omega: float, tau: float) -> tuple[float, float]:
    """Angular frequency [rad/s] and decay rate [1/s] of a standard linear solid's oscillation.

    Args:
        omega: Of the elastic oscillation [rad/s].
        tau: Time of the branch [s].
    """
    s = np.roots([tau, 1.0, 2.0 * omega**2 * tau, omega**2])
    s = s[np.argmax(s.imag)]
    return float(s.imag), float(-s.real)
