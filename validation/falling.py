"""What falls through air, what comes to rest on the table, and discs cut out of a lattice."""

from __future__ import annotations

import math

import numpy as np

from gendom.materials import Material
from gendom.sim import AIR_DENSITY, GRAVITY, Body, Table, cloth, rope
from gendom.sim.thin.shells import Shells
from validation.bench import WEIGHTLESS, Bench, Row, case, relative, vanishing
from validation.readings import mechanics, swing
from validation.specimens import across, circle
from validation.stretching import THICKNESS, rigidity

LIGHT = Material(E=2.0e6, nu=0.3, density=200.0)

HOERNER = "(Hoerner 1965, Fluid-Dynamic Drag, chapter 3: c = 1.2 of a plate, 1.1 of a cylinder)"
TOUCHES = "a body at rest touches the table with its surface"


@case("terminal-speed", "falls through air", "mpm")
@case("rod-falls", "a rope in air", "thin")
def falls(bench: Bench) -> list[Row]:
    """A rope that falls level, and a sheet of the MPM that falls flat, until they are as fast as
    they get."""
    soft, rows = Material(E=2.0e4, nu=0.3, density=200.0), []
    string = rope(diameter=0.005, length=0.2)
    if bench.engine == "mpm":
        string = rope(diameter=0.005, length=0.04, cells_across=1.5)
        sheet = cloth(width=0.04, height=0.04, thickness=0.001, dx=0.01)
        rows.append(terminal_speed(bench, sheet, soft, "a sheet's"))
    return [*rows, terminal_speed(bench, string, soft, "a level rope's")]


def terminal_speed(bench: Bench, body: Body, material: Material, whose: str) -> Row:
    """Mean speed of fall when a body is as fast as it gets, of mass over all."""
    if body.kind == "rope":
        by_density = math.pi * body.thickness / (2.0 * 1.1)
        source = "sqrt(pi density d g / (2 rho c)) " + HOERNER
    else:
        by_density = 2.0 * body.thickness / 1.2
        source = "sqrt(2 m g / (rho c A)) " + HOERNER
    speed = math.sqrt(by_density * material.density * -GRAVITY[2] / AIR_DENSITY)
    s = bench.simulate(body, [material], air_density=AIR_DENSITY)
    s.run([4.0 * speed / -GRAVITY[2]])
    now = mechanics(s)
    found = -float(now.P[2]) / now.mass
    return relative(f"{whose} terminal speed", "m/s", speed, found, 0.03, source)


@case("resting", "what lies on the table", "mpm")
def resting(bench: Bench) -> list[Row]:
    """A rope and a cloth that fall by two cells and lie for a while."""
    # the table is away from the grid's nodes
    d, h, dx, table = 0.01, 0.002, 0.01, 0.1
    bodies = [
        (
            f"a rope's axis, {across(cells)}",
            rope(
                diameter=d, length=12.0 * d,
                start=(0.0013, 0.0007, table + d / 2.0 + 2.0 * d / cells),
                direction=(1.0, 0.3, 0.0), cells_across=cells,
            ),
        )
        for cells in ((1.5,) if bench.quick else (1.0, 1.5, 2.0))
    ]  # fmt: skip
    corner = (0.0013, 0.0007, table + h / 2.0 + 2.0 * dx)
    sheet = cloth(width=0.1, height=0.1, thickness=h, dx=dx, corner=corner)
    bodies.append((f"the middle of a cloth {h / dx:g} cells thick", sheet))
    rows, material = [], Material(E=1.0e5, nu=0.3, density=500.0)
    for name, body in bodies:
        s = bench.simulate(body, [material], table=Table(height=table), air_density=AIR_DENSITY)
        x = s.run([1.0])[0, 0].astype(float)
        centres = x.reshape(-1, body.section, 3).mean(axis=1)[:, 2]
        off = (centres - table - body.thickness / 2.0) / body.dx
        far = float(off[np.argmax(np.abs(off))])
        name = f"height of {name}, beside half its thickness, worst place"
        rows.append(vanishing(name, far, 0.1, TOUCHES, "cells"))
    return rows


def rests(bench: Bench, body: Body, material: Material, name: str) -> Row:
    """A row of how far from half its thickness a dropped rod or shell lies, over that."""
    s = bench.simulate(body, [material], table=Table(height=0.0), air_density=AIR_DENSITY)
    half = body.thickness / 2.0
    off = float(np.abs(s.run([1.0])[0, 0, :, 2] / half - 1.0).max())
    return vanishing(f"height of {name}", off, 1e-6, TOUCHES)


# ---- discs ---------------------------------------------------------------------------------------

RADIUS = 0.1
"""Of discs [m]."""

DISC = Material(E=2.0e7, nu=0.3, density=1000.0)

POINTS = {15: 0.10, 28: 0.03, 45: 0.03}
"""Along a lattice's longer side, and the share of theory that errors may have."""

LEISSA = "5.358 sqrt(D / (rho h)) / R^2, nu 0.3 (Leissa 1969, Vibration of Plates, table 2.5)"


@case("shell-discs", "discs cut out of a lattice", "thin")
def discs(bench: Bench) -> list[Row]:
    """Mass and its centre, terminal speed, and vibration of discs."""
    falls = terminal_speed(bench, _disc(15), LIGHT, "a disc's")
    return [*_masses(), falls, *_vibrations(bench)]


def _disc(points: int, *holes: np.ndarray) -> Body:
    """Of ``RADIUS``, with so many points across."""
    outline = [circle(RADIUS), *holes]
    return cloth(outline=outline, thickness=THICKNESS, dx=0.02, points=(points, points))


def _masses() -> list[Row]:
    """Of discs with a hole beside their middle: those of their area."""
    hole, at = 0.3 * RADIUS, np.array([0.4 * RADIUS, 0.2 * RADIUS])
    left = math.pi * (RADIUS**2 - hole**2)
    errors, centre = [], []
    for points in POINTS:
        body = _disc(points, circle(hole) + at)
        assert body.cut is not None
        errors.append(abs(body.cut.area.sum() / left - 1.0))
        found = body.cut.area @ body.points[:, :2] / left
        centre.append(float(np.abs(found + math.pi * hole**2 / left * at).max()) / RADIUS)
    name, off = "mass of discs with a hole over that of their area, less 1", max(centre)
    return [
        vanishing(name, max(errors), 1e-12, "pi (R^2 - r^2) h rho"),
        vanishing("error of the centre of mass over R", off, 1e-12, "-r^2 d / (R^2 - r^2)"),
    ]


def _vibrations(bench: Bench) -> list[Row]:
    """A disc in space that swings between two saddles, in its first mode."""
    omega = 5.3583 * math.sqrt(rigidity(DISC) / (DISC.density * THICKNESS)) / RADIUS**2
    rows = []
    for points, allowed in POINTS.items():
        if bench.quick and points > 40:
            continue
        body = _disc(points)
        s = bench.simulate(body, [DISC], gravity=WEIGHTLESS)
        assert isinstance(s.engine, Shells)
        saddle = (body.points[:, 0] ** 2 - body.points[:, 1] ** 2) / RADIUS**2
        s.set_velocities(np.outer(0.01 * THICKNESS * omega * saddle, (0.0, 0.0, 1.0)))
        t = np.linspace(0.2, 2.2, 61) * 2.0 * math.pi / omega
        z = s.run(t)[:, 0, :, 2] @ (s.engine.model.mass[0] * saddle)
        found, _ = swing(t, z / np.abs(z).max(), omega)
        hertz = (omega / (2.0 * math.pi), found / (2.0 * math.pi))
        name = f"frequency of a free disc, {points} points across"
        rows.append(relative(name, "Hz", *hertz, allowed, LEISSA))
    return rows
