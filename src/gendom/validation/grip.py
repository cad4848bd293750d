"""Ropes held by a gripper's sphere, as estimates hold them: free length, and whether it stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim import Gripper, Simulator, rope
from gendom.validation.check import Check, Settings
from gendom.validation.damping import DIAMETER, LENGTH, elastic_frequency, gravity_for
from gendom.validation.specimens import across, clamp_beyond, end

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

ALLOWED = {1.0: 0.02, 1.5: 0.02}
"""By cells across."""

KNOWN = {
    0.3: {0.6: 0.02, 0.75: 0.02, 1.2: 0.02, 2.0: 0.02},
    0.45: {0.6: 0.05, 1.0: 0.02, 1.5: 0.06, 2.0: 0.05},
}
"""Errors of the sag that are allowed where a plane holds, by nu and by cells across; those at nu
0.45 are known, not wanted."""


def grip(settings: Settings) -> list[Check]:
    """A rope ten diameters long, held by a sphere of 0.75 diameters, at random phases of the grid.

    Twenty of them (two in the quick run) measure the sag; two are watched for 8 s. Where the grip
    ends material is held by springs as stiff as the material. Damping makes substeps shorter; a
    separate row measures whether that shows. Further rows hold the rope across a plane, on coarser
    grids and nearly incompressible.
    """
    checks = []
    worlds, until = (2, 3.0) if settings.quick else (20, 8.0)
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
    for nu, by_cells in {} if settings.quick else KNOWN.items():
        material = replace(MATERIAL, nu=nu)
        for cells, allowed in by_cells.items():
            phases = np.random.default_rng(0).uniform(0.0, DIAMETER / cells, (2, 3))
            s = held_ropes(settings, cells, phases, material, plane=True)
            sags = _sags(s, phases, [16.0 / omega])[0]
            checks.append(
                Check.within_share(
                    f"sag where a plane holds, nu {nu}, {across(cells)}",
                    "m",
                    SAG,
                    float(sags[np.abs(sags - SAG).argmax()]),
                    allowed,
                    BEAM,
                )
            )
    return checks


def held_ropes(
    settings: Settings,
    cells: float,
    phases: NDArray[np.floating],
    material: Material = MATERIAL,
    *,
    plane: bool = False,
) -> Simulator:
    """A rope of which ``LENGTH`` is free, one world a shift [W, 3] [m]; critically damped.

    A sphere holds it, or all that is beyond a plane.
    """
    back = 3.0 * DIAMETER / cells if plane else RADIUS + 0.25 * DIAMETER
    body = rope(
        diameter=DIAMETER, length=LENGTH + back, start=(-back, 0.0, 0.0), cells_across=cells
    )
    hand = Gripper.still((-RADIUS, 0.0, 0.0), radius=RADIUS)
    if plane:
        hand = clamp_beyond((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), DIAMETER)
    return settings.simulator(
        body,
        [material] * len(phases),
        grippers=[[replace(hand, position=np.asarray(hand.position) + shift)] for shift in phases],
        positions=body.x + phases[:, None],
        gravity=(0.0, 0.0, -gravity_for(SAG, material, DIAMETER / 4.0, LENGTH)),
        velocity_damping=2.0 * elastic_frequency(material, DIAMETER / 4.0, LENGTH),
        air_density=0.0,
    )


def _sags(s: Simulator, phases: NDArray[np.floating], times: list[float]) -> NDArray[np.floating]:
    """[T, W] how far tips hang below the gripper [m]."""
    return phases[:, 2] - end(s.run(times), s.body)[..., 2]
