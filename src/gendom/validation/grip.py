"""Ropes held by a gripper's sphere, as estimates hold them: free length, and whether it stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim import Gripper, Simulator, rope
from gendom.validation.check import Check, Settings
from gendom.validation.damping import (
    DIAMETER,
    LENGTH,
    elastic_frequency,
    gravity_for,
)
from gendom.validation.specimens import across, end

MATERIAL = Material(E=1.0e6, nu=0.3, density=1000.0)

RADIUS = 0.75 * DIAMETER
"""Of the sphere: what estimates hold a rope with where nothing else is known [m]."""

SAG = 0.02 * LENGTH
"""[m]."""

BEAM = (
    "w L^4 / (8 E I) + w L^2 / (2 kappa G A), L from where the sphere cuts the axis (Gere and "
    "Timoshenko, Mechanics of Materials; kappa: Cowper 1966)"
)
STAYS = "equilibrium: what hangs still stays"

ALLOWED = {1.0: 0.04, 1.5: 0.02}
"""By cells across."""


def grip(settings: Settings) -> list[Check]:
    """A rope ten diameters long, held by a sphere of 0.75 diameters, at random phases of the grid.

    Six of them (two in the quick run) measure the sag; two are watched for 8 s. Where the grip ends
    material is held by springs as stiff as substeps allow; damping makes these shorter, the springs
    stiffer, and sags less. A separate row measures how much.
    """
    checks = []
    worlds, until = (2, 3.0) if settings.quick else (6, 8.0)
    omega = elastic_frequency(MATERIAL, DIAMETER / 4.0, LENGTH)
    for cells, allowed in ALLOWED.items():
        phases = np.random.default_rng(0).uniform(0.0, DIAMETER / cells, (worlds, 3))
        sags = _sags(held_ropes(settings, cells, phases), phases, [16.0 / omega])[0]
        for name, sag in (("least", sags.min()), ("largest", sags.max())):
            checks.append(
                Check.within_share(
                    f"{name} sag at {worlds} phases of the grid, {across(cells)}",
                    "m",
                    SAG,
                    float(sag),
                    allowed,
                    BEAM,
                )
            )
        damped = replace(MATERIAL, damping=0.01)
        sags = _sags(held_ropes(settings, cells, phases[:2], damped), phases[:2], [40.0 / omega])
        checks.append(
            Check.within_share(
                f"least sag with damping 10 ms, {across(cells)} (for information)",
                "m",
                SAG,
                float(sags.min()),
                0.04,
                BEAM,
            )
        )
        first, last = _sags(held_ropes(settings, cells, phases[:2]), phases[:2], [2.0, until])
        checks.append(
            Check.within(
                f"creep between 2 and {until:g} s over the sag, {across(cells)}",
                "-",
                0.0,
                float(np.abs(last / first - 1.0).max()),
                0.001,
                STAYS,
            )
        )
    return checks


def held_ropes(
    settings: Settings, cells: float, phases: NDArray[np.floating], material: Material = MATERIAL
) -> Simulator:
    """A rope of which ``LENGTH`` is free, one world a shift [W, 3] [m]; critically damped."""
    back = RADIUS + 0.25 * DIAMETER
    body = rope(
        diameter=DIAMETER, length=LENGTH + back, start=(-back, 0.0, 0.0), cells_across=cells
    )
    hands = [[Gripper.still(shift - [RADIUS, 0.0, 0.0], radius=RADIUS)] for shift in phases]
    return settings.simulator(
        body,
        [material] * len(phases),
        grippers=hands,
        positions=body.x + phases[:, None],
        gravity=(0.0, 0.0, -gravity_for(SAG, MATERIAL, DIAMETER / 4.0, LENGTH)),
        velocity_damping=2.0 * elastic_frequency(MATERIAL, DIAMETER / 4.0, LENGTH),
        air_density=0.0,
    )


def _sags(s: Simulator, phases: NDArray[np.floating], times: list[float]) -> NDArray[np.floating]:
    """[T, W] how far tips hang below the gripper [m]."""
    return phases[:, 2] - end(s.run(times), s.body)[..., 2]
