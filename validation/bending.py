"""Ropes and strips that bend under their own weight."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import quad
from scipy.optimize import brentq

from gendom.materials import Material
from gendom.sim import GRAVITY, Gripper, Simulator, cloth, rope
from validation import specimens
from validation.bench import Bench, Row, absolute, case, over_theory, relative, vanishing, worst
from validation.elastica import heavy_elastica, sag
from validation.references import (
    BEAM,
    ELASTICA,
    ROMERO,
    STAYS,
    beam_frequency,
    gravity_for,
    round_frequency,
    unit_gravity,
)
from validation.specimens import across, clamp_beyond, clamped_rope, clamped_strip, down, end

DIAMETER, LENGTH = 0.01, 0.1
"""Of the MPM's ropes; a strip is as thick [m]."""

GYRATION = DIAMETER / math.sqrt(12.0)
"""Radius of gyration of a strip's section [m]."""

MATERIAL = Material(E=1.0e6, nu=0.3, density=1000.0)

SPAN = 0.3
"""Free length of what sags over decades of weights [m]."""

STIFF = replace(MATERIAL, E=2.0e7)
"""Of what sags over decades of weights."""

ROUND = (
    "w L^4 / (8 E I) + w L^2 / (2 kappa G A), L from where the sphere cuts the axis (Gere and "
    "Timoshenko, Mechanics of Materials; kappa: Cowper 1966)"
)
GRADED = (
    "integral of w (L - s)^3 / (2 E(s) I) by quadrature (Gere and Timoshenko, Mechanics of "
    "Materials), E(s) = E0 exp(a s)"
)
CATENARY = (
    "z = a cosh(x / a) (J. Bernoulli, Huygens, Leibniz 1691); its ends are clamped level, which "
    "takes some of it"
)
DECADES = (
    "heavy elastica E I theta'' = w (L - s) cos theta (Wang 1986), solved by collocation; the "
    f"cantilever of {ROMERO}"
)


@case("cantilever", "a strip's small sag", "mpm")
def cantilever(bench: Bench) -> list[Row]:
    """A strip ten times as long as thick that sags by 2 % of its length, on finer and finer grids.

    Shear has 1 % of the sag at this slenderness.
    """
    L, nu, rows = LENGTH, MATERIAL.nu, []
    kappa = 10.0 * (1.0 + nu) / (12.0 + 11.0 * nu)
    sag = 0.02 * L * (1.0 + 8.0 * (1.0 + nu) * (GYRATION / L) ** 2 / kappa)
    specific = -GRAVITY[2] * L**4 / (8.0 * GYRATION**2 * 0.02 * L)
    for cells in (1, 2) if bench.quick else (1, 2, 4, 8):
        s, omega = _particle_strip(bench, cells, L, specific, [-GRAVITY[2]])
        tip = -float(end(s.run([11.0 / omega])[0, 0], s.body)[2])
        # bounds as for ropes in a gripper
        allowed = 0.04 if cells == 1 else 0.02
        rows.append(relative(f"sag of the tip, {across(cells)}", "m", sag, tip, allowed, BEAM))
    return rows


@case("elastica", "a strip's large sag", "mpm")
def strip_elastica(bench: Bench) -> list[Row]:
    """A clamped strip of 1, 2 and 3 bending lengths, large deflection, and whether it stays.

    Worlds of equal material: gravity sets the bending length (E I / w)^(1/3).
    """
    ratios = np.array([1.0, 2.0] if bench.quick else [1.0, 2.0, 3.0])
    fine, L, bound = (1, 15.0, 0.06) if bench.quick else (2, 25.0, 0.02)
    L, specific, rows = L * DIAMETER, 400.0, []
    for cells, worlds in ((fine, ratios),) if bench.quick else ((fine, ratios), (1, ratios[-1:])):
        gravity = specific * GYRATION**2 * worlds**3 / L**3
        s, omega = _particle_strip(bench, cells, L, specific, gravity)
        body, x = s.body, s.run(np.array([0.8, 0.9, 1.0]) * 12.0 / omega) / L
        at = specimens.stations(body) / L - 3.0 * body.dx / L
        tips = end(x, body)
        moved = np.linalg.norm(tips - tips[-1], axis=-1).max(axis=0)
        for w, ratio in enumerate(worlds):
            size = f"L = {ratio:g} bending lengths, {across(cells)}"
            if cells == fine:
                curve = heavy_elastica(ratio)
                for name, i, expected in zip("xz", (0, 2), curve(1.0), strict=True):
                    name = f"tip's {name} / L, {size}"
                    rows.append(absolute(name, "-", expected, tips[-1, w, i], bound, ELASTICA))
                here = specimens.sections(x[-1, w], body)[at > 0.0][:, [0, 2]]
                far = np.linalg.norm(here - curve(at[at > 0.0]).T, axis=1).max()
                name = f"largest distance from the elastica / L, {size}"
                rows.append(vanishing(name, far, bound, ELASTICA))
            # the first mode, damped critically, has (1 + 9.6) exp(-9.6) = 0.0007 of its start to go
            rows.append(vanishing(f"way of the resting tip / L, {size}", moved[w], 0.001, STAYS))
    return rows


def _particle_strip(
    bench: Bench, cells: int, L: float, specific: float, gravity: ArrayLike
) -> tuple[Simulator, float]:
    """A strip, 2 cells wide, whose free part reaches from x = 0 over L.

    Args:
        bench: How to run.
        cells: Cells across the thickness.
        L: Free length [m].
        specific: E / density [m^2/s^2].
        gravity: [W] downwards, one world each [m/s^2].

    Returns:
        The simulator, damped critically in its first mode, and that mode's angular frequency
        [rad/s].
    """
    dx = DIAMETER / cells
    body = cloth(
        width=L + 3.0 * dx, height=2.0 * dx, thickness=DIAMETER, dx=dx,
        corner=(-3.0 * dx, -dx, 0.0),
    )  # fmt: skip
    worlds = [replace(MATERIAL, E=1000.0 * specific)] * len(down(gravity))
    omega = beam_frequency(worlds[0], GYRATION, L)
    s = bench.simulate(
        body, worlds, grippers=[clamp_beyond(reach=DIAMETER)], gravity=down(gravity),
        velocity_damping=2.0 * omega,
    )  # fmt: skip
    return s, omega


# ---- ropes and strips in grippers ----------------------------------------------------------------

PLANES = {
    0.3: {0.6: 0.02, 0.75: 0.02, 1.2: 0.02, 2.0: 0.02},
    0.45: {0.6: 0.05, 1.0: 0.02, 1.5: 0.06, 2.0: 0.05},
}
"""Errors of the sag that are allowed where a plane holds, by nu and by cells across; those at nu
0.45 are known, not wanted."""


@case("grip", "a rope held by a sphere", "mpm")
def grip(bench: Bench) -> list[Row]:
    """A rope ten diameters long, held by a sphere of 0.75 diameters, at random phases of the grid.

    Twenty of them (two in the quick run) measure the sag; two are watched for 8 s. Where the grip
    ends material is held by springs as stiff as the material. Damping makes substeps shorter; a
    separate row measures whether that shows. Further rows hold the rope across a plane, on coarser
    grids and nearly incompressible.
    """
    worlds, until, sag, rows = *((2, 3.0) if bench.quick else (20, 8.0)), 0.02 * LENGTH, []
    omega = round_frequency(MATERIAL, DIAMETER / 4.0, LENGTH)
    for cells in (1.0, 1.5):
        size = across(cells)
        (sags,) = _held_sags(bench, cells, worlds, [16.0 / omega])
        for name, found in (("least", sags.min()), ("largest", sags.max())):
            name = f"{name} sag at {worlds} phases of the grid, {size}"
            rows.append(relative(name, "m", sag, found, 0.02, ROUND))
        (sags,) = _held_sags(bench, cells, 2, [40.0 / omega], replace(MATERIAL, damping=0.01))
        name = f"least sag with damping 10 ms, {size} (for information)"
        rows.append(relative(name, "m", sag, sags.min(), 0.04, ROUND))
        first, last = _held_sags(bench, cells, 2, [2.0, until])
        name = f"creep between 2 and {until:g} s over the sag, {size}"
        rows.append(vanishing(name, np.abs(last / first - 1.0).max(), 0.001, STAYS))
    for nu, by_cells in {} if bench.quick else PLANES.items():
        material = replace(MATERIAL, nu=nu)
        for cells, allowed in by_cells.items():
            (sags,) = _held_sags(bench, cells, 2, [16.0 / omega], material, plane=True)
            name = f"sag where a plane holds, nu {nu}, {across(cells)}"
            rows.append(relative(name, "m", sag, worst(sags, sag), allowed, ROUND))
    return rows


def _held_sags(
    bench: Bench, cells: float, worlds: int, times: list[float], material: Material = MATERIAL,
    *, plane: bool = False,
) -> NDArray[np.floating]:  # fmt: skip
    """[T, W] how far tips hang below a sphere or a plane that holds all but ``LENGTH`` [m].

    Each world is shifted at random against the grid.
    """
    phases = np.random.default_rng(0).uniform(0.0, DIAMETER / cells, (worlds, 3))
    if plane:
        body, hand = specimens.particle_rope(LENGTH, DIAMETER, cells)
    else:
        # what estimates hold a rope with where nothing else is known
        radius = 0.75 * DIAMETER
        start = (-DIAMETER, 0.0, 0.0)
        body = rope(diameter=DIAMETER, length=LENGTH + DIAMETER, start=start, cells_across=cells)
        hand = Gripper.still((-radius, 0.0, 0.0), radius=radius)
    k = DIAMETER / 4.0
    s = bench.simulate(
        body, [material] * worlds, positions=body.x + phases[:, None],
        grippers=[[replace(hand, position=np.asarray(hand.position) + shift)] for shift in phases],
        gravity=(0.0, 0.0, -gravity_for(0.02 * LENGTH, material, k, LENGTH)),
        velocity_damping=2.0 * round_frequency(material, k, LENGTH),
    )  # fmt: skip
    return phases[:, 2] - end(s.run(times), body)[..., 2]


@case("rod-held", "ropes in grippers", "thin")
def rods_held(bench: Bench) -> list[Row]:
    """A rope held by spheres that end anywhere between two points."""
    rows, radius = [], np.linspace(0.02, 0.05, 13)
    free, k = 0.2 - radius, DIAMETER / 4.0
    for points in (13, 25) if bench.quick else (13, 25, 49):
        body = rope(diameter=DIAMETER, length=0.2, points=points)
        omega = round_frequency(MATERIAL, k, free.max())
        hands = [[Gripper.still((0, 0, 0), radius=r)] for r in radius]
        g = down([gravity_for(0.02 * L, MATERIAL, k, L) for L in free])
        worlds, allowed = [MATERIAL] * len(free), 0.02 if points < 25 else 0.01
        x = bench.settle(body, worlds, omega, periods=30.0, grippers=hands, gravity=g)
        sags = -x[:, -1, 2] / (0.02 * free)
        for name, found in (("least", sags.min()), ("largest", sags.max())):
            name = f"{name} of 13 sags over theory, {points} points"
            rows.append(over_theory(name, found, allowed, ROUND))
    return rows


@case("shell-strips", "strips' sags", "thin")
def strips_held(bench: Bench) -> list[Row]:
    """Clamped strips along both axes that sag by 2 % of their length; the clamp ends anywhere."""
    L, material, k, rows = 0.2, replace(STIFF, nu=0.0), 0.002 / math.sqrt(12.0), []
    g, omega = 8.0 * 0.02 * unit_gravity(material, k, L), beam_frequency(material, k, L)
    for axis, name in ((0, "first"), (1, "second")):
        sags = []
        for back in np.linspace(0.02, 0.04, 2 if bench.quick else 5):
            body, hand = clamped_strip(L, 0.03, 0.002, (23, 4), axis=axis, back=float(back))
            x = bench.settle(body, [material], omega, grippers=[hand], gravity=(0, 0, -g))
            sags.append(-x[0, body.points[:, axis] > L - 1e-9, 2].mean() / (0.02 * L))
        for which, found in (("least", min(sags)), ("largest", max(sags))):
            which = f"{which} sag over theory, strip along the {name} axis"
            rows.append(over_theory(which, found, 0.02, BEAM))
    return rows


@case("rod-elastica", "a rope's large sag", "thin")
def rod_elastica(bench: Bench) -> list[Row]:
    """A rope of 1, 2 and 3 bending lengths, clamped level; the clamp ends on a point."""
    ratios, back, points, rows = np.array([1.0, 2.0, 3.0]), 0.02, 33 if bench.quick else 65, []
    k = 0.001
    x = bench.settle(
        rope(diameter=4.0 * k, length=SPAN + back, start=(-back, 0, 0), points=points),
        [STIFF] * len(ratios), beam_frequency(STIFF, k, SPAN),
        grippers=[Gripper.still((-back, 0, 0), radius=back)],
        gravity=down(ratios**3 * unit_gravity(STIFF, k, SPAN)),
    )  # fmt: skip
    for ratio, tip in zip(ratios, x[:, -1, [0, 2]] / SPAN, strict=True):
        far = float(np.linalg.norm(tip - heavy_elastica(ratio)(1.0)))
        name = f"tip's distance from the elastica / L, {ratio:g} bending lengths, {points} points"
        rows.append(vanishing(name, far, 0.003, ELASTICA))
    return rows


@case("rod-graded", "ropes stiffer or softer at their tip", "thin")
def rods_graded(bench: Bench) -> list[Row]:
    """Level ropes that get ten times as stiff, or as soft, from the clamp to the tip."""
    rates, L, sag = np.array([1.0, -1.0]) * math.log(10.0), 0.2, 1e-3
    body, hand = clamped_rope(L, L / 100.0, 41)
    # sags over w L^4 / (E0 I), and loads under which they are 0.5 % of the length
    theory = [quad(lambda s, a=a: 0.5 * (1 - s) ** 3 * math.exp(-a * s), 0, 1)[0] for a in rates]
    g = sag / np.array(theory) * unit_gravity(STIFF, L / 400.0, L) / L
    stiffness = np.exp(np.outer(rates, np.clip(body.points[:, 0] / L, 0.0, None)))
    options = {"grippers": [hand], "gravity": down(g), "stiffness": stiffness}
    x = bench.settle(body, [STIFF] * 2, 1.24 * np.sqrt(g / sag), periods=24.0, **options)
    names = (
        f"sag over theory of a rope ten times as {as_} at its tip" for as_ in ("stiff", "soft")
    )
    return [
        over_theory(name, tip / sag, 0.01, GRADED)
        for name, tip in zip(names, -x[:, -1, 2], strict=True)
    ]


@case("rod-cantilever", "ropes' sags over four decades", "thin", "rods")
@case("shell-cantilever", "strips' sags over decades", "thin", "strips")
def sags_over_decades(bench: Bench, of: str) -> list[Row]:
    """Level ropes or strips of cloth under weights over decades."""
    points, most = (65, 1000.0) if of == "rods" else (49, 300.0)
    if bench.quick:
        points, most = 33, 100.0
    loads = np.geomspace(0.1, most, 3 if bench.quick else 9)
    name = f"sag of {of} over theory, Gamma 0.1 to {most:g}, worst of {len(loads)}, {points} points"
    return [over_theory(name, worst(sags(bench, of, loads, points) / sag(loads)), 0.03, DECADES)]


def sags(bench: Bench, of: str, loads: ArrayLike, points: int) -> NDArray[np.float64]:
    """[W] as ``sag``, of ``rods`` or ``strips`` at rest under weights [W]."""
    k, Gamma = SPAN / 400.0, np.asarray(loads, dtype=float)
    if of == "rods":
        material, (body, hand) = STIFF, clamped_rope(SPAN, 4.0 * k, points)
    else:  # without Poisson's ratio wide strips bend as narrow ones do
        material = replace(STIFF, nu=0.0)
        body, hand = clamped_strip(SPAN, SPAN / 20.0, math.sqrt(12.0) * k, (points, 2))
    omega = beam_frequency(material, k, SPAN)
    g = Gamma * unit_gravity(material, k, SPAN)
    s = bench.simulate(
        body, [material] * len(g), grippers=[hand], gravity=down(g),
        velocity_damping=2.0 * np.maximum(omega, np.sqrt(g / SPAN)),
    )  # fmt: skip
    tip = s.run([14.0 / omega])[0][:, points - 1].astype(float)
    return -tip[:, 2] / tip[:, 0]


@case("rod-catenary", "a rope between two hands", "thin")
def catenary(bench: Bench) -> list[Row]:
    """A thin soft rope that hangs from two points as far apart as 0.7 of its length."""
    L, points = 0.6, 65
    span = 0.7 * L
    body = rope(diameter=0.002, length=L, start=(-L / 2, 0, 0), points=points)
    # the middle is let down while the ends come together
    ways = [[(side * L / 2, 0, 0), (side * span / 2, 0, 0)] for side in (-1.0, 1.0)]
    hands = [Gripper(time=[0.0, 1.0], position=way, radius=0.001) for way in ways]
    s = bench.simulate(body, [replace(STIFF, E=5.0e6)], grippers=hands, velocity_damping=4.0)
    middle = -float(s.run([4.0])[0, 0, points // 2, 2])
    a = brentq(lambda a: 2.0 * a * math.sinh(span / (2.0 * a)) - L, 0.05, 10.0)
    assert isinstance(a, float)
    expected = a * (math.cosh(span / (2.0 * a)) - 1.0)
    return [relative("sag of a hanging rope", "m", expected, middle, 0.02, CATENARY)]
