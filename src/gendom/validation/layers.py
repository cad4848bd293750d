"""Layers that slide over each other: without touching, what the grid takes of it; of one rod or
shell, what friction does."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from gendom.materials import Material
from gendom.sim import GRAVITY, Body, Gripper, cloth, rope
from gendom.validation.check import Check, Settings
from gendom.validation.friction import COULOMB

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

SOFT = Material(E=1.0e3, nu=0.0, density=500.0)
"""In 40 ms its waves go 57 mm far."""

SPACING, STRAIGHT, FOLD = 0.005, 40, 12
"""Distance of a hairpin's points [m]; edges of each of its layers, and of what joins them."""


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


def rope_on_itself(settings: Settings) -> list[Check]:
    """A rope that lies doubled, the lower half held: the upper one slides on it, or sticks."""
    return _rubs(settings, "rope")


def cloth_on_itself(settings: Settings) -> list[Check]:
    """A cloth that lies folded, the lower half held: the upper one slides on it, or sticks."""
    return _rubs(settings, "cloth")


def _rubs(settings: Settings, kind: str) -> list[Check]:
    """Two worlds in which the upper layer is pushed, and two with tilted gravity, for 40 ms.

    Read are the last 75 mm of it. The fold, 105 mm away, cannot yet pull at them: what the body is
    made of is so soft that its waves are slower.
    """
    thickness, time, speed, g = 0.002, 0.04, 0.1, -GRAVITY[2]
    pushed, mu, shares = np.array([0.2, 0.5]), 0.3, np.array([0.95, 1.25])
    line = _hairpin(thickness)
    n = len(line)
    rows = 1 if kind == "rope" else 5
    if kind == "rope":
        body = rope(diameter=thickness, length=(n - 1) * SPACING, points=n)
    else:
        body = cloth(
            width=(n - 1) * SPACING, height=4 * SPACING, thickness=thickness, dx=DX,
            points=(n, rows),
        )  # fmt: skip
    x = body.points.reshape(rows, n, 3).copy()
    x[..., [0, 2]] = line
    v = np.zeros((4, rows, n, 3))
    v[:2, :, -STRAIGHT - 1 :, 0] = -speed
    angle = np.concatenate([0.0 * pushed, shares * math.atan(mu)])
    s = settings.simulator(
        body, [SOFT] * 4, engine="thin", positions=x.reshape(-1, 3), air_density=0.0, cfl=0.25,
        gravity=-g * np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=1),
        grippers=[Gripper.still((0.1, 0.01, 0.3 * thickness - 100.0), radius=100.0)],
        self_contact=True, self_friction=np.append(pushed, [mu, mu]),
    )  # fmt: skip
    s.set_velocities(v.reshape(4, -1, 3))
    places = s.run([0.0, time]).reshape(2, 4, rows, n, 3)[..., -16:, 0]
    way = (places[0] - places[1]).mean(axis=(1, 2)).astype(float)
    left = -float(s.velocities().reshape(4, rows, n, 3)[0, :, -16:, 0].mean())
    what = f"a {kind}'s layer on another"
    return [
        Check.within_share(
            f"deceleration of {what}, mu = {pushed[0]:g}", "m/s^2", pushed[0] * g,
            (speed - left) / time, 0.03, "mu g, " + COULOMB,
        ),
        Check.within_share(
            f"stopping distance of {what}, mu = {pushed[1]:g}", "m",
            speed**2 / (2.0 * pushed[1] * g), float(way[1]), 0.03, "v^2 / (2 mu g), " + COULOMB,
        ),
        Check.within(
            f"acceleration of {what} at {shares[0]:g} atan(mu)", "m/s^2", 0.0,
            float(2.0 * way[2] / time**2), 5e-3, "no slip below atan(mu), " + COULOMB,
        ),
        Check.within_share(
            f"acceleration of {what} at {shares[1]:g} atan(mu)", "m/s^2",
            g * (math.sin(angle[3]) - mu * math.cos(angle[3])), float(2.0 * way[3] / time**2), 0.05,
            "g (sin a - mu cos a), " + COULOMB,
        ),
    ]  # fmt: skip


def _hairpin(gap: float) -> NDArray[np.float64]:
    """[n, 2] x and z of a line that goes straight along x, turns, and comes back so far above."""
    s = (np.arange(FOLD) + 0.5) / FOLD

    def turn(bulge: float) -> NDArray[np.float64]:
        return math.pi * s - bulge * np.sin(2.0 * math.pi * s)

    bulge = brentq(lambda b: SPACING * float(np.sin(turn(b)).sum()) - gap, 0.0, 2.0)
    assert isinstance(bulge, float)
    angle = np.concatenate([np.zeros(STRAIGHT), turn(bulge), np.full(STRAIGHT, math.pi)])
    steps = SPACING * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


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
