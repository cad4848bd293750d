"""Air, the table and obstacles: terminal speeds, rest, slopes, a rope over a bar, and layers that
slide on each other."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from gendom.arrays import Array
from gendom.materials import Material
from gendom.sim import (
    AIR_DENSITY,
    GRAVITY,
    Body,
    Capsule,
    Gripper,
    Simulator,
    Table,
    cloth,
    rope,
)
from validation.bench import WEIGHTLESS, Bench, Row, case, moved, relative, vanishing
from validation.readings import mechanics
from validation.specimens import across, block, clamp_beyond

G = -GRAVITY[2]

LIGHT = Material(E=2.0e4, nu=0.3, density=200.0)
STIFF = Material(E=1.0e6, nu=0.3, density=1000.0)

HOERNER = "(Hoerner 1965, Fluid-Dynamic Drag, chapter 3: c = 1.2 of a plate, 1.1 of a cylinder)"
SLIDES, STOPS, STICKS, SLOWS = (
    f"{formula}, Coulomb friction (Coulomb 1785)"
    for formula in ("g (sin a - mu cos a)", "v^2 / (2 mu g)", "no slip below atan(mu)", "mu g")
)


@case("terminal-speed", "falls through air", "mpm", "sheet", "level rope")
@case("rod-falls", "a rope in air", "thin", "level rope")
@case("shell-falls", "a sheet in air", "thin", "sheet")
def falls(bench: Bench, *kinds: str) -> Iterator[Row]:
    """Ropes that fall level and sheets that fall flat, until they are as fast as they get."""
    particles = bench.engine == "mpm"
    for kind in kinds:
        if kind == "sheet":
            size, points = (0.04, None) if particles else (0.1, (9, 9))
            dx = 0.01 if particles else 0.02
            body = cloth(width=size, height=size, thickness=0.001, dx=dx, points=points)
            squared = 2.0 * body.thickness / 1.2
            source = "sqrt(2 m g / (rho c A)) " + HOERNER
        else:
            body = rope(diameter=0.005, length=0.2)
            if particles:
                body = rope(diameter=0.005, length=0.04, cells_across=1.5)
            squared = math.pi * body.thickness / (2.0 * 1.1)
            source = "sqrt(pi density d g / (2 rho c)) " + HOERNER
        speed = math.sqrt(squared * LIGHT.density * G / AIR_DENSITY)
        s = bench.simulate(body, [LIGHT], air_density=AIR_DENSITY)
        s.run([4.0 * speed / G])
        now = mechanics(s)
        name = f"a {kind}'s terminal speed"
        yield relative(name, "m/s", speed, -float(now.P[2]) / now.mass, 0.03, source)


# ---- on the table --------------------------------------------------------------------------------


@case("resting", "what lies on the table", "mpm")
@case("rod-table", "a rope on the table", "thin", "rope")
@case("shell-table", "a sheet on the table", "thin", "sheet")
def resting(bench: Bench, kind: str = "") -> Iterator[Row]:
    """What is dropped and lies for a while; a rope or sheet of points is put on slopes, too."""
    source = "a body at rest touches the table with its surface"
    if kind:
        body, _, material = _flat(kind)
        s = bench.simulate(
            moved(body, (0.0, 0.0, 0.02)), [material], table=Table(height=0.0),
            air_density=AIR_DENSITY,
        )  # fmt: skip
        off = np.abs(s.run([1.0])[0, 0, :, 2] / (body.thickness / 2.0) - 1.0).max()
        yield vanishing(f"height of a resting {kind} over half its thickness", off, 1e-6, source)
        yield from _slopes(bench, kind)
        return
    # the table is away from the grid's nodes
    d, h, dx, table = 0.01, 0.002, 0.01, 0.1
    bodies = {}
    for cells in (1.5,) if bench.quick else (1.0, 1.5, 2.0):
        bodies[f"a rope's axis, {across(cells)}"] = rope(
            diameter=d, length=12.0 * d, start=(0.0013, 0.0007, table + d / 2.0 + 2.0 * d / cells),
            direction=(1.0, 0.3, 0.0), cells_across=cells,
        )  # fmt: skip
    corner = (0.0013, 0.0007, table + h / 2.0 + 2.0 * dx)
    sheet = cloth(width=0.1, height=0.1, thickness=h, dx=dx, corner=corner)
    bodies[f"the middle of a cloth {h / dx:g} cells thick"] = sheet
    material = Material(E=1.0e5, nu=0.3, density=500.0)
    for name, body in bodies.items():
        s = bench.simulate(body, [material], table=Table(height=table), air_density=AIR_DENSITY)
        x = s.run([1.0])[0, 0].astype(float)
        centres = x.reshape(-1, body.section, 3).mean(axis=1)[:, 2]
        off = (centres - table - body.thickness / 2.0) / body.dx
        name = f"height of {name}, beside half its thickness, worst place"
        yield vanishing(name, off[np.argmax(np.abs(off))], 0.1, source, "cells")


@case("sticking", "what lies on a slope", "mpm")
def sticking(bench: Bench) -> Iterator[Row]:
    """A block, a rope and a cloth on slopes."""
    for kind in ("block", "rope", "cloth")[: 2 if bench.quick else 3]:
        yield from _slopes(bench, kind)


def _flat(kind: str) -> tuple[Body, Array, Material]:
    """A body that lies on the table, the slopes that it is put on over atan(mu), and what it is
    made of."""
    steps, side = np.array([0.95, 1.1]), 0.04
    if kind == "sheet":
        flat = {"thickness": 0.001, "dx": 0.02, "points": (9, 9), "corner": (0.0, 0.0, 0.0005)}
        return cloth(width=0.1, height=0.1, **flat), steps, replace(LIGHT, E=2.0e6)
    if kind == "cloth":
        flat = {"thickness": 0.002, "dx": 0.02, "corner": (0.0, 0.0, 0.001)}
        return cloth(width=0.1, height=0.1, **flat), steps, STIFF
    if kind == "rope":
        string = rope(diameter=side / 2.0, length=5.0 * side, start=(0.0, 0.0, side / 4.0))
        return string, steps, STIFF
    # of three cells: one of two would tremble, see docs/validation.md
    dx = side / 3.0
    body = block((2.0 * side, side, side), dx, centre=(0.003, 0.001, side / 2.0 - dx / 4.0))
    return body, np.array([0.8, 0.95, 1.1, 1.25]), STIFF


def _slopes(bench: Bench, kind: str) -> Iterator[Row]:
    """What lies under tilted gravity for 0.5 s, below and above the angle of friction."""
    mu, time = 0.3, 0.5
    body, shares, material = _flat(kind)
    gravity = _tilted(mu, shares)
    s = _put_down(bench, body, [material] * len(shares), mu, gravity)
    moments = []
    for t in (0.1, 0.1 + time):
        s.run([t])
        moments.append(
            [a.mean(axis=1)[:, 0].astype(float) for a in (s.positions(), s.velocities())]
        )
    way, gained = np.diff(moments, axis=0)[0]
    for w, share in enumerate(shares):
        if share < 1.0:
            name = f"way of a {kind} in 0.5 s at {share:g} atan(mu)"
            yield vanishing(name, way[w], 1e-4, STICKS, "m")
        else:
            name = f"acceleration of a {kind} at {share:g} atan(mu)"
            yield relative(name, "m/s^2", _slides(mu, share), gained[w] / time, 0.05, SLIDES)


def _tilted(mu: float, shares: Array) -> Array:
    """[W, 3] gravity on slopes of these shares of the angle of friction [m/s^2]."""
    angle = shares * math.atan(mu)
    return G * np.stack([np.sin(angle), 0.0 * angle, -np.cos(angle)], axis=1)


def _slides(mu: float, share: float) -> float:
    """Acceleration on a slope of a share of the angle of friction that is above 1 [m/s^2]."""
    angle = share * math.atan(mu)
    return G * (math.sin(angle) - mu * math.cos(angle))


def _put_down(
    bench: Bench, body: Body, worlds: list[Material], friction: float, gravity: ArrayLike
) -> Simulator:
    """A body at rest under its weight, one world for each gravity [W, 3] [m/s^2], without air.

    A first simulator with damping, and with friction that holds everything, lets it come to rest; a
    second, without, starts from there. Otherwise it bounces, and slides while the table hardly
    carries it.
    """
    omega = math.pi * worlds[0].wave_speed / 0.08
    rough = Table(height=0.0, friction=10.0)
    s = bench.simulate(body, worlds, table=rough, gravity=gravity, velocity_damping=omega)
    s.run([20.0 / omega])
    table = Table(height=0.0, friction=np.full(len(worlds), friction))
    return bench.simulate(body, worlds, table=table, gravity=gravity, positions=s.positions())


# ---- a rope that is drawn over a bar ------------------------------------------------------------


@case("rod-capstan", "a rope that is drawn over a bar", "thin")
def capstan(bench: Bench) -> Iterator[Row]:
    """Two grippers draw a stretched rope over a round bar, at the same speed, without gravity.

    Its damping is that of short waves: left alone they shake the rope so that it sticks at times,
    which takes up to a quarter of the friction.
    """
    radius, d, n, length, speed, time = 0.03, 0.004, 121, 0.3, 0.1, 0.6
    frictions = [0.1, 0.3] if bench.quick else [0.1, 0.3, 0.6]
    material = Material(E=1.0e6, nu=0.3, density=1000.0, membrane=1.0e7, damping=1.0e-4)
    for angle in (math.pi / 2.0, math.pi):
        path, ways = _around(angle, radius + d / 2.0, np.linspace(0.0, 1.02 * length, n))
        hands = [
            Gripper(
                time=[0.0, time], position=[path[k], path[k] + speed * time * way],
                radius=1.2 * length / (n - 1),
            )
            for k, way in zip((0, -1), ways, strict=True)
        ]  # fmt: skip
        bars = [
            [Capsule.between((0, -0.1, 0), (0, 0.1, 0), radius=radius, friction=mu)]
            for mu in frictions
        ]
        s = bench.simulate(
            rope(diameter=d, length=length, points=n), [material] * len(bars), grippers=hands,
            positions=path, obstacles=bars, gravity=WEIGHTLESS,
        )  # fmt: skip
        forces = []
        for t in np.linspace(0.7, 1.0, 20) * time:
            s.run([t])
            forces.append(np.abs(np.einsum("wgk,gk->wg", s.gripper_forces(), ways)))
        slack, tight = np.mean(forces, axis=0).T
        for w, mu in enumerate(frictions):
            name = f"tension over that beyond {math.degrees(angle):.0f} degrees, mu = {mu:g}"
            formula = "exp(mu angle) (Euler 1762; Eytelwein 1808)"
            found = float(tight[w] / slack[w])
            yield relative(name, "-", math.exp(mu * angle), found, 0.01, formula)


def _around(angle: float, radius: float, s: Array) -> tuple[Array, Array]:
    """[n, 3] places so far along a line that goes up to a circle and around it by an angle, as long
    before as beyond it; and its directions at both ends [2, 3]."""
    before = (s[-1] - angle * radius) * 0.7
    turn = np.clip((s - before) / radius, 0.0, angle)
    rest = np.where(s < before, s - before, np.maximum(s - before - angle * radius, 0.0))
    x = -radius * np.cos(turn) + rest * np.sin(turn)
    z = radius * np.sin(turn) + rest * np.cos(turn)
    ends = [[0.0, 0.0, 1.0], [math.sin(angle), 0.0, math.cos(angle)]]
    return np.stack([x, 0.0 * x, z], axis=1), np.array(ends)


# ---- layers of one rod or shell ------------------------------------------------------------------

SPACING, STRAIGHT, FOLD = 0.005, 40, 12
"""Distance of a hairpin's points [m]; edges of each of its layers, and of what joins them."""


@case("rod-layers", "a doubled rope that rubs", "thin", "rope")
@case("shell-layers", "a folded cloth that rubs", "thin", "cloth")
def layers(bench: Bench, kind: str) -> Iterator[Row]:
    """A body that lies doubled, the lower half held: the upper one slides on it, or sticks.

    Two worlds in which the upper layer is pushed, and two with tilted gravity, for 40 ms. Read are
    the last 75 mm of it. The fold, 105 mm away, cannot yet pull at them: what the body is made of
    is so soft that its waves go 57 mm far.
    """
    soft, thickness, time, speed = Material(E=1.0e3, nu=0.0, density=500.0), 0.002, 0.04, 0.1
    pushed, mu, shares = np.array([0.2, 0.5]), 0.3, np.array([0.95, 1.25])
    line = _hairpin(thickness)
    n, length, rows = len(line), (len(line) - 1) * SPACING, 1 if kind == "rope" else 5
    if kind == "rope":
        body = rope(diameter=thickness, length=length, points=n)
    else:
        size = {"width": length, "height": 4 * SPACING, "thickness": thickness}
        body = cloth(**size, dx=0.01, points=(n, rows))
    x = body.points.reshape(rows, n, 3).copy()
    x[..., [0, 2]] = line
    v = np.zeros((4, rows, n, 3))
    v[:2, :, -STRAIGHT - 1 :, 0] = -speed
    # what lies above points along -x
    gravity = _tilted(mu, np.append(0.0 * pushed, shares)) * [-1.0, 1.0, 1.0]
    s = bench.simulate(
        body, [soft] * 4, positions=x.reshape(-1, 3), cfl=0.25, gravity=gravity,
        grippers=[clamp_beyond((0, 0, -1), point=(0.1, 0.01, 0.3 * thickness))],
        self_contact=True, self_friction=np.append(pushed, [mu, mu]),
    )  # fmt: skip
    s.set_velocities(v.reshape(4, -1, 3))
    places = s.run([0.0, time]).reshape(2, 4, rows, n, 3)[..., -16:, 0]
    way = (places[0] - places[1]).mean(axis=(1, 2)).astype(float)
    left = -float(s.velocities().reshape(4, rows, n, 3)[0, :, -16:, 0].mean())
    found, what = 2.0 * way / time**2, f"of a {kind}'s layer on another"
    slows, stops = pushed[0] * G, speed**2 / (2.0 * pushed[1] * G)
    name = f"deceleration {what}, mu = {pushed[0]:g}"
    yield relative(name, "m/s^2", slows, (speed - left) / time, 0.03, SLOWS)
    yield relative(f"stopping distance {what}, mu = {pushed[1]:g}", "m", stops, way[1], 0.03, STOPS)
    sticks, slides = (f"acceleration {what} at {share:g} atan(mu)" for share in shares)
    yield vanishing(sticks, found[2], 5e-3, STICKS, "m/s^2")
    yield relative(slides, "m/s^2", _slides(mu, shares[1]), found[3], 0.05, SLIDES)


def _hairpin(gap: float) -> Array:
    """[n, 2] x and z of a line that goes straight along x, turns, and comes back so far above."""
    s = (np.arange(FOLD) + 0.5) / FOLD

    def turn(bulge: float) -> Array:
        return math.pi * s - bulge * np.sin(2.0 * math.pi * s)

    bulge = brentq(lambda b: SPACING * float(np.sin(turn(b)).sum()) - gap, 0.0, 2.0)
    assert isinstance(bulge, float)
    angle = np.concatenate([np.zeros(STRAIGHT), turn(bulge), np.full(STRAIGHT, math.pi)])
    steps = SPACING * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
