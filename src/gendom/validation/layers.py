"""Two sheets that slide over each other without touching: what the grid takes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gendom.materials import Material
from gendom.sim import Body, cloth
from gendom.validation.check import Check, Settings

FREE = "Newton's first law; shape functions of two particles 3 cells apart share no node"
STUCK = (
    "bodies that share nodes of the grid share their velocity (APIC has one velocity a node) and "
    "end as one rigid body: angular momentum, affine velocities included (Jiang et al. 2015)"
)

SPEED = 0.02
"""Of the sheets, relative to each other [m/s]."""


WIDTH = 0.08
"""Of the sheets [m]."""

DX = 0.01
"""[m]."""


def sliding_layers(settings: Settings) -> list[Check]:
    """Two sheets in free space, one above the other, for 0.1 s; without gravity and air.

    A gap is the distance of the nearest particles of both. Nothing touches, so all speed ought to
    be left. Below three cells nothing of the sliding is: the pair turns as one body, and those rows
    say so. From two cells on that depends on the phase of the grid: here the sheets share as many
    nodes as they can.
    """
    checks = []
    for gap in (0.5, 1.0, 2.0, 3.0):
        sheet = cloth(
            width=WIDTH, height=WIDTH, thickness=0.001, dx=DX, corner=(0.0013, 0.0007, 0.0021)
        )
        distance = gap * DX + float(np.ptp(sheet.x[:, 2]))
        left = share_left(settings, sheet, distance)
        name = f"share of the speed left after 0.1 s at a gap of {gap:g} cell{'s' * (gap != 1)}"
        if gap >= 3.0:
            checks.append(Check.within(name, "-", 1.0, left, settings.round_off(1e-6, 1e-5), FREE))
        else:
            turning = share_when_stuck(distance, float(np.var(sheet.x[:, 0])), DX)
            checks.append(
                Check.within(f"{name} (for information)", "-", turning, left, 0.005, STUCK)
            )
    return checks


def share_left(settings: Settings, sheet: Body, distance: float) -> float:
    """Relative speed of two sheets after 0.1 s, over that at the start."""
    body = stacked(sheet, distance)
    s = settings.simulator(
        body, [Material(E=1.0e5, nu=0.3)], gravity=(0.0, 0.0, 0.0), air_density=0.0
    )
    v = np.zeros_like(body.x)
    half = sheet.num_particles
    v[:half, 0], v[half:, 0] = -SPEED / 2.0, SPEED / 2.0
    s.set_velocities(v)
    s.run([0.1])
    u = s.velocities()[0, :, 0].astype(float)
    return float(u[half:].mean() - u[:half].mean()) / SPEED


def share_when_stuck(distance: float, variance: float, dx: float) -> float:
    """Relative speed left of two sheets that have become one body, which turns.

    Of each unit of mass V d / 4 of angular momentum stays, and its moment of inertia is variance +
    d^2 / 4 + dx^2 / 2, the last that of affine velocities.

    Args:
        distance: Of the sheets [m].
        variance: Of a sheet's particles along the motion [m^2].
        dx: Size of a cell [m].
    """
    return distance**2 / 4.0 / (variance + distance**2 / 4.0 + dx**2 / 2.0)


def stacked(sheet: Body, distance: float) -> Body:
    """A sheet and another one, not joined to it, so far above [m]."""
    up = np.array([0.0, 0.0, distance])
    return replace(
        sheet,
        x=np.concatenate([sheet.x, sheet.x + up]),
        material_coordinates=np.concatenate(
            [sheet.material_coordinates, sheet.material_coordinates + up]
        ),
        lattice=np.concatenate([sheet.lattice, sheet.lattice + sheet.num_particles]),
    )
