"""Sheets and ropes that fall through air."""

from __future__ import annotations

import math

from gendom.materials import Material
from gendom.sim import AIR_DENSITY, GRAVITY, Body, cloth, rope
from gendom.validation.check import Check, Settings

HOERNER = "(Hoerner 1965, Fluid-Dynamic Drag, chapter 3: c = 1.2 of a plate, 1.1 of a cylinder)"

MATERIAL = Material(E=2.0e4, nu=0.3, density=200.0)


def terminal_speed(settings: Settings) -> list[Check]:
    """A sheet that falls flat, and a rope that falls level, until both are as fast as they get."""
    dx, thickness, diameter = 0.01, 0.001, 0.005
    sheet = cloth(width=4.0 * dx, height=4.0 * dx, thickness=thickness, dx=dx)
    string = rope(diameter=diameter, length=8.0 * diameter, cells_across=1.5)
    rho, g, material = AIR_DENSITY, -GRAVITY[2], MATERIAL
    by_area = 2.0 * material.density * g / rho
    return [
        Check.within_share(
            name, "m/s", speed, _speed(settings, body, 4.0 * speed / g), 0.03, source
        )
        for name, body, speed, source in (
            (
                "a sheet's terminal speed",
                sheet,
                math.sqrt(by_area * thickness / 1.2),
                "sqrt(2 m g / (rho c A)) " + HOERNER,
            ),
            (
                "a level rope's terminal speed",
                string,
                math.sqrt(by_area * math.pi * diameter / 4.0 / 1.1),
                "sqrt(pi density d g / (2 rho c)) " + HOERNER,
            ),
        )
    ]


def rope_falls(settings: Settings) -> list[Check]:
    """A level rope that falls through air until it is as fast as it gets."""
    d = 0.005
    speed = math.sqrt(math.pi * MATERIAL.density * -GRAVITY[2] * d / (2.0 * AIR_DENSITY * 1.1))
    s = settings.simulator(
        rope(diameter=d, length=0.2), [MATERIAL], engine="thin", air_density=AIR_DENSITY
    )
    s.run([4.0 * speed / -GRAVITY[2]])
    return [
        Check.within_share(
            "a level rope's terminal speed", "m/s", speed,
            -float(s.velocities()[0, :, 2].mean()), 0.03,
            "sqrt(pi density d g / (2 rho c)) " + HOERNER,
        )
    ]  # fmt: skip


def _speed(settings: Settings, body: Body, time: float) -> float:
    """Mean speed of fall after ``time`` [m/s]."""
    s = settings.simulator(body, [MATERIAL], air_density=AIR_DENSITY)
    s.run([time])
    return -float(s.velocities()[0, :, 2].mean())
