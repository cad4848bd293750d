"""Bars along x: axial vibration, and tension under their own weight."""

from __future__ import annotations

import math

import numpy as np

from gendom.materials import Material
from gendom.sim import Simulator
from gendom.validation.check import Check, Settings
from gendom.validation.specimens import across, block, clamp_beyond, end, sections, stations, swing

SIDE = 0.01
"""Edge of the square section [m]."""

ROD = "omega = pi c / (2 L), c = sqrt(E / rho) (Rayleigh 1877, Theory of Sound I, chapter VII)"
HOOKE = "uniaxial tension: sigma = rho g (L - x) = E strain, contraction nu strain (Hooke)"


def axial_vibration(settings: Settings) -> list[Check]:
    """A bar clamped at one end, given its first mode's velocity, without gravity."""
    checks = []
    for cells, slenderness in ((2, 10),) if settings.quick else ((2, 10), (4, 10), (4, 20)):
        L = slenderness * SIDE
        material = Material(E=1.0e6, nu=0.3)
        c = math.sqrt(material.E_over_rho)
        omega = math.pi * c / (2.0 * L)
        s = clamped_bar(settings, cells, L, material, pull=0.0, damping=0.0)
        body = s.body
        ahead = np.clip(body.x[:, 0], 0.0, None)
        v = np.zeros_like(body.x)
        v[:, 0] = 1e-3 * c * np.sin(math.pi * ahead / (2.0 * L))
        s.set_velocities(v)
        t = np.linspace(0.0, 2.0 * 2.0 * math.pi / omega, 81)
        found, _ = swing(t, end(s.run(t)[:, 0], body)[:, 0], omega)
        checks.append(
            Check.within_share(
                f"first axial frequency, {across(cells)}, L = {slenderness} sides",
                "Hz",
                omega / (2.0 * math.pi),
                found / (2.0 * math.pi),
                0.02,
                ROD,
            )
        )
    return checks


def tension(settings: Settings) -> list[Check]:
    """A clamped bar that hangs along its axis, strain 0.2 % at the clamp.

    Its weight is the known load. E is the slope of load over mean strain of the sections, away
    from clamp and end by 1.5 sides; nu compares their contraction. The last row repeats the
    measurement under strong damping, which must not carry weight.
    """
    cells = 2 if settings.quick else 4
    L = 8.0 * SIDE
    strain, g = 2.0e-3, 9.81
    material = Material(E=1000.0 * g * L / strain, nu=0.3, density=1000.0)
    omega = math.pi * math.sqrt(material.E_over_rho) / (2.0 * L)

    def read(damping: float, time: float) -> tuple[float, float, float]:
        """E [Pa], nu [-] and damping times substep [-] of a bar at rest."""
        s = clamped_bar(settings, cells, L, material, pull=g, damping=damping)
        x = s.run([time])[0, 0].astype(float)
        body = s.body
        at = stations(body) - 3.0 * body.dx
        part = (at > 1.5 * SIDE) & (at < L - 1.5 * SIDE)
        stretch = np.gradient(sections(x - body.x, body)[:, 0], at)[part]
        # lateral displacement per distance from the axis, by least squares over each section
        count = len(at)
        y0, y = (a[:, 1:].reshape(count, -1) for a in (body.x, x))
        narrow = ((y - y0) * y0).sum(axis=1)[part] / (y0**2).sum(axis=1)[part]
        load = material.density * g * (L - at[part])
        E = float(np.polyfit(stretch, load, 1)[0])
        return E, -float(np.polyfit(stretch, narrow, 1)[0]), damping * float(s.substep[0])

    E, nu, _ = read(0.2 * omega, 80.0 / omega)
    damped, _, ratio = read(2.0 * omega, 14.0 / omega)
    size = across(cells)
    return [
        Check.within_share(f"E read back, {size}", "Pa", material.E, E, 0.02, HOOKE),
        Check.within_share(f"nu read back, {size}", "-", material.nu, nu, 0.02, HOOKE),
        Check.within_share(
            f"E read back, damping x substep = {ratio:.2g}",
            "Pa",
            material.E,
            damped,
            0.02,
            HOOKE + "; at rest damping has no velocity to act on",
        ),
    ]


def clamped_bar(
    settings: Settings, cells: int, L: float, material: Material, *, pull: float, damping: float
) -> Simulator:
    """A bar whose free part reaches from x = 0 over L; gravity ``pull`` along x [m/s^2]."""
    dx = SIDE / cells
    back = 3.0 * dx
    body = block((L + back, SIDE, SIDE), dx, centre=((L - back) / 2.0, 0.0, 0.0))
    clamp = clamp_beyond((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), SIDE)
    return settings.simulator(
        body, [material], grippers=[clamp], gravity=(pull, 0.0, 0.0), velocity_damping=damping
    )
