"""Coulomb's friction: on the table, on slopes, and between layers of one body."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from gendom.materials import Material
from gendom.sim import GRAVITY, Body, Simulator, Table, cloth, rope
from validation.bench import WEIGHTLESS, Bench, Row, absolute, case, relative, vanishing
from validation.falling import LIGHT, rests, terminal_speed
from validation.references import COULOMB
from validation.specimens import block, clamp_beyond

SLIDES, STOPS, STICKS = (
    f"{formula}, {COULOMB}"
    for formula in ("g (sin a - mu cos a)", "v^2 / (2 mu g)", "no slip below atan(mu)")
)

G = -GRAVITY[2]

# ---- blocks, ropes and cloths on the table -------------------------------------------------------

SIDE = 0.04
"""Of blocks [m]."""

MATERIAL = Material(E=1.0e6, nu=0.3, density=1000.0)


@case("sliding", "a block pushed along the table", "mpm")
def sliding(bench: Bench) -> list[Row]:
    """A block pushed along the table, until it stops."""
    friction, v = np.array([0.2, 0.5]), 1.0
    s = _put_down(bench, _standing_block(), friction, np.tile(GRAVITY, (2, 1)))
    before = s.positions().mean(axis=1)[:, 0]
    s.set_velocities((v, 0.0, 0.0))
    s.run([1.5 * v / (friction.min() * G)])
    way = s.positions().mean(axis=1)[:, 0] - before
    rows = []
    for mu, found in zip(friction, way, strict=True):
        name = f"stopping distance at mu = {mu:g}"
        rows.append(relative(name, "m", v**2 / (2.0 * mu * G), float(found), 0.03, STOPS))
    return rows


@case("sticking", "what lies on a slope", "mpm")
def sticking(bench: Bench) -> list[Row]:
    """A block, a rope and a cloth under tilted gravity, for 0.5 s below and above the angle of
    friction."""
    mu, time, rows = 0.3, 0.5, []
    string = rope(diameter=SIDE / 2.0, length=5.0 * SIDE, start=(0.0, 0.0, SIDE / 4.0))
    sheet = cloth(width=0.1, height=0.1, thickness=0.002, dx=0.02, corner=(0.0, 0.0, 0.001))
    for name, body in (("block", _standing_block()), ("rope", string), ("cloth", sheet)):
        shares = np.array([0.8, 0.95, 1.1, 1.25] if name == "block" else [0.95, 1.1])
        s = _put_down(bench, body, np.full(len(shares), mu), _tilted(mu, shares))
        s.run([0.1])
        x0, v0 = (a.mean(axis=1)[:, 0].astype(float) for a in (s.positions(), s.velocities()))
        s.run([0.1 + time])
        x1, v1 = (a.mean(axis=1)[:, 0].astype(float) for a in (s.positions(), s.velocities()))
        for w, share in enumerate(shares):
            if share < 1.0:
                way = f"way of a {name} in 0.5 s at {share:g} atan(mu)"
                rows.append(vanishing(way, x1[w] - x0[w], 1e-4, STICKS, "m"))
            else:
                way = f"acceleration of a {name} at {share:g} atan(mu)"
                expected, found = _slides(mu, share), (v1[w] - v0[w]) / time
                rows.append(relative(way, "m/s^2", expected, found, 0.05, SLIDES))
    return rows


def _tilted(mu: float, shares: NDArray[np.floating]) -> NDArray[np.floating]:
    """[W, 3] gravity on slopes of these shares of the angle of friction [m/s^2]."""
    angle = shares * math.atan(mu)
    return G * np.stack([np.sin(angle), 0.0 * angle, -np.cos(angle)], axis=1)


def _slides(mu: float, share: float) -> float:
    """Acceleration on a slope of a share of the angle of friction that is above 1 [m/s^2]."""
    angle = share * math.atan(mu)
    return G * (math.sin(angle) - mu * math.cos(angle))


def _standing_block() -> Body:
    """A block of three cells whose lowest particles are on a table at height 0.

    One of two cells would tremble, see docs/validation.md.
    """
    dx = SIDE / 3.0
    return block((2.0 * SIDE, SIDE, SIDE), dx, centre=(0.003, 0.001, SIDE / 2.0 - dx / 4.0))


def _put_down(bench: Bench, body: Body, friction: ArrayLike, gravity: ArrayLike) -> Simulator:
    """A body at rest under its weight, one world for each friction and gravity, without air.

    A first simulator with damping lets it come to rest; a second, without, starts from there.
    Otherwise it bounces, and slides while the table hardly carries it.

    Args:
        bench: How to run.
        body: It begins where it touches the table, at height 0.
        friction: [W].
        gravity: [W, 3] [m/s^2].
    """
    mu = np.asarray(friction, dtype=float)
    omega = math.pi * MATERIAL.wave_speed / (2.0 * SIDE)
    worlds = [MATERIAL] * len(mu)
    # friction that holds everything, so that nothing slides away before its time
    x = bench.simulate(
        body, worlds, table=Table(height=0.0, friction=10.0), gravity=gravity,
        velocity_damping=omega,
    )  # fmt: skip
    x.run([20.0 / omega])
    table = Table(height=0.0, friction=mu)
    return bench.simulate(body, worlds, table=table, gravity=gravity, positions=x.positions())


@case("rod-table", "ropes on the table", "thin")
def rods_on_the_table(bench: Bench) -> list[Row]:
    """A rope dropped on the table; ropes on slopes below and above the angle of friction."""
    body = rope(diameter=0.01, length=0.2, start=(0, 0, 0.02), direction=(1, 0.2, 0))
    rested = rests(bench, body, MATERIAL, "a resting rope over its radius")
    return [rested, *_on_slopes(bench, body.moved((0, 0, 0.005 - 0.02)), MATERIAL)]


@case("shell-falls", "sheets in air and on the table", "thin")
def sheets_on_the_table(bench: Bench) -> list[Row]:
    """A sheet that falls flat through air, and one that comes to rest on the table; on slopes."""
    body = cloth(width=0.1, height=0.1, thickness=0.001, dx=0.02, points=(9, 9))
    dropped = body.moved((0, 0, 0.02))
    return [
        terminal_speed(bench, body, LIGHT, "a sheet's"),
        rests(bench, dropped, LIGHT, "a resting sheet over half its thickness"),
        *_on_slopes(bench, body.moved((0, 0, 0.0005)), LIGHT),
    ]


def _on_slopes(bench: Bench, body: Body, material: Material) -> list[Row]:
    """A rod or shell that lies on the table under tilted gravity, below and above the angle of
    friction."""
    mu, shares, time = 0.3, np.array([0.95, 1.05]), 0.5
    table = Table(height=0.0, friction=mu)
    s = bench.simulate(body, [material] * 2, table=table, gravity=_tilted(mu, shares))
    x = s.run([0.0, time]).mean(axis=2)[..., 0]
    rows = []
    for w, (share, expected) in enumerate(zip(shares, (0.0, _slides(mu, 1.05)), strict=True)):
        found = float(2.0 * (x[1, w] - x[0, w]) / time**2)
        name = f"acceleration at {share:g} atan(mu)"
        rows.append(absolute(name, "m/s^2", expected, found, 2e-3, SLIDES))
    return rows


# ---- layers of one rod or shell ------------------------------------------------------------------

SOFT = Material(E=1.0e3, nu=0.0, density=500.0)
"""In 40 ms its waves go 57 mm far."""

SPACING, STRAIGHT, FOLD = 0.005, 40, 12
"""Distance of a hairpin's points [m]; edges of each of its layers, and of what joins them."""


@case("rod-layers", "a doubled rope that rubs", "thin", "rope")
@case("shell-layers", "a folded cloth that rubs", "thin", "cloth")
def layers(bench: Bench, kind: str) -> list[Row]:
    """A body that lies doubled, the lower half held: the upper one slides on it, or sticks.

    Two worlds in which the upper layer is pushed, and two with tilted gravity, for 40 ms. Read are
    the last 75 mm of it. The fold, 105 mm away, cannot yet pull at them: what the body is made of
    is so soft that its waves are slower.
    """
    thickness, time, speed = 0.002, 0.04, 0.1
    pushed, mu, shares = np.array([0.2, 0.5]), 0.3, np.array([0.95, 1.25])
    line = _hairpin(thickness)
    n, length = len(line), (len(line) - 1) * SPACING
    rows = 1 if kind == "rope" else 5
    if kind == "rope":
        body = rope(diameter=thickness, length=length, points=n)
    else:
        height, points = 4 * SPACING, (n, rows)
        body = cloth(width=length, height=height, thickness=thickness, dx=0.01, points=points)
    x = body.points.reshape(rows, n, 3).copy()
    x[..., [0, 2]] = line
    v = np.zeros((4, rows, n, 3))
    v[:2, :, -STRAIGHT - 1 :, 0] = -speed
    gravity = _tilted(mu, np.append(0.0 * pushed, shares))
    s = bench.simulate(
        body,
        [SOFT] * 4,
        positions=x.reshape(-1, 3),
        cfl=0.25,
        gravity=gravity * [-1.0, 1.0, 1.0],  # what lies above points along -x
        grippers=[clamp_beyond((0, 0, -1), point=(0.1, 0.01, 0.3 * thickness))],
        self_contact=True,
        self_friction=np.append(pushed, [mu, mu]),
    )
    s.set_velocities(v.reshape(4, -1, 3))
    places = s.run([0.0, time]).reshape(2, 4, rows, n, 3)[..., -16:, 0]
    way = (places[0] - places[1]).mean(axis=(1, 2)).astype(float)
    left = -float(s.velocities().reshape(4, rows, n, 3)[0, :, -16:, 0].mean())
    what = f"of a {kind}'s layer on another"
    slows, stops = pushed[0] * G, speed**2 / (2.0 * pushed[1] * G)
    found, mu_g = 2.0 * way / time**2, "mu g, " + COULOMB
    names = [f"{name} {what}" for name in ("deceleration", "stopping distance", "acceleration")]
    sticks, slides = (f"{names[2]} at {share:g} atan(mu)" for share in shares)
    slowed = (speed - left) / time
    return [
        relative(f"{names[0]}, mu = {pushed[0]:g}", "m/s^2", slows, slowed, 0.03, mu_g),
        relative(f"{names[1]}, mu = {pushed[1]:g}", "m", stops, float(way[1]), 0.03, STOPS),
        vanishing(sticks, float(found[2]), 5e-3, STICKS, "m/s^2"),
        relative(slides, "m/s^2", _slides(mu, shares[1]), float(found[3]), 0.05, SLIDES),
    ]


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


# ---- sheets of particles that do not touch -------------------------------------------------------

FREE = "Newton's first law; shape functions of two particles 3 cells apart share no node"
STUCK = (
    "bodies that share nodes of the grid share their velocity (APIC has one velocity a node) and "
    "end as one rigid body: angular momentum, affine velocities included (Jiang et al. 2015)"
)


@case("layers", "sheets that slide without touching", "mpm")
def sliding_sheets(bench: Bench) -> list[Row]:
    """Two sheets in free space, one above the other, for 0.1 s; without gravity and air.

    A gap is the distance of the nearest particles of both. Nothing touches, so all speed ought to
    be left. Below three cells nothing of the sliding is: the pair turns as one body, and those rows
    say so. From two cells on that depends on the phase of the grid: here the sheets share as many
    nodes as they can.
    """
    dx, speed, rows = 0.01, 0.02, []
    sheet = cloth(width=0.08, height=0.08, thickness=0.001, dx=dx, corner=(0.0013, 0.0007, 0.0021))
    half = sheet.num_particles
    for gap in (0.5, 1.0, 2.0, 3.0):
        distance = gap * dx + float(np.ptp(sheet.x[:, 2]))
        body = stacked(sheet, distance)
        s = bench.simulate(body, [Material(E=1.0e5, nu=0.3)], gravity=WEIGHTLESS)
        v = np.zeros_like(body.x)
        v[:half, 0], v[half:, 0] = -speed / 2.0, speed / 2.0
        s.set_velocities(v)
        s.run([0.1])
        u = s.velocities()[0, :, 0].astype(float)
        left = (u[half:].mean() - u[:half].mean()) / speed
        name = f"share of the speed left after 0.1 s at a gap of {gap:g} cell{'s' * (gap != 1)}"
        if gap >= 3.0:
            rows.append(absolute(name, "-", 1.0, left, bench.round_off(1e-6, 1e-5), FREE))
        else:
            # Of each unit of mass V d / 4 of angular momentum stays; the last term of its moment
            # of inertia is that of affine velocities.
            square = distance**2 / 4.0
            turning = square / (float(np.var(sheet.x[:, 0])) + square + dx**2 / 2.0)
            rows.append(absolute(f"{name} (for information)", "-", turning, left, 0.005, STUCK))
    return rows


def stacked(sheet: Body, distance: float) -> Body:
    """A sheet and another one, not joined to it, so far above [m]."""
    up, places, lattice = [0.0, 0.0, distance], sheet.material_coordinates, sheet.lattice
    return replace(
        sheet,
        x=np.concatenate([sheet.x, sheet.x + up]),
        material_coordinates=np.concatenate([places, places + up]),
        lattice=np.concatenate([lattice, lattice + sheet.num_particles]),
    )
