"""Ropes and strips that bend under their own weight."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from gendom.arrays import Array
from gendom.materials import Material
from gendom.sim import GRAVITY, Gripper, Simulator, cloth, rope
from validation import specimens
from validation.bench import Bench, Row, absolute, case, over_theory, relative, vanishing, worst
from validation.elastica import hung, sag
from validation.references import (
    ROMERO,
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

BEAM = (
    "w L^4 / (8 E I) + w L^2 / (2 kappa G A) (Gere and Timoshenko, Mechanics of Materials; "
    "kappa = 10 (1 + nu) / (12 + 11 nu), Cowper 1966)"
)
ROUND = (
    "w L^4 / (8 E I) + w L^2 / (2 kappa G A), L from where the sphere cuts the axis (Gere and "
    "Timoshenko, Mechanics of Materials; kappa: Cowper 1966)"
)


# ---- strips of particles -------------------------------------------------------------------------


@case("cantilever", "a strip's small sag", "mpm")
def cantilever(bench: Bench) -> Iterator[Row]:
    """A strip ten times as long as thick that sags by 2 % of its length, on finer and finer grids.

    Shear has 1 % of the sag at this slenderness.
    """
    L, nu = LENGTH, MATERIAL.nu
    kappa = 10.0 * (1.0 + nu) / (12.0 + 11.0 * nu)
    sag = 0.02 * L * (1.0 + 8.0 * (1.0 + nu) * (GYRATION / L) ** 2 / kappa)
    specific = -GRAVITY[2] * L**4 / (8.0 * GYRATION**2 * 0.02 * L)
    for cells in (1, 2) if bench.quick else (1, 2, 4, 8):
        s, omega = _particle_strip(bench, cells, L, specific, [-GRAVITY[2]])
        tip = -float(end(s.run([11.0 / omega])[0, 0], s.body)[2])
        # bounds as for ropes in a gripper
        allowed = 0.04 if cells == 1 else 0.02
        yield relative(f"sag of the tip, {across(cells)}", "m", sag, tip, allowed, BEAM)


@case("elastica", "a strip's large sag", "mpm")
def strip_elastica(bench: Bench) -> Iterator[Row]:
    """A clamped strip of 1, 2 and 3 bending lengths, large deflection.

    Worlds of equal material: gravity sets the bending length (E I / w)^(1/3).
    """
    ratios = np.array([1.0, 2.0] if bench.quick else [1.0, 2.0, 3.0])
    cells, L, bound = (1, 15.0, 0.06) if bench.quick else (2, 25.0, 0.02)
    L, specific = L * DIAMETER, 400.0
    gravity = specific * GYRATION**2 * ratios**3 / L**3
    s, omega = _particle_strip(bench, cells, L, specific, gravity)
    body, x = s.body, s.run([12.0 / omega])[0] / L
    at = specimens.stations(body) / L - 3.0 * body.dx / L
    source = (
        "heavy elastica E I theta'' = w (L - s) cos theta, solved by collocation (Wang 1986, "
        "'A critical review of the heavy elastica')"
    )
    for w, ratio in enumerate(ratios):
        size = f"L = {ratio:g} bending lengths, {across(cells)}"
        curve = hung(ratio**3 * np.linspace(0.2, 1.0, 5), tol=1e-8)[-1]
        for name, i, expected in zip("xz", (0, 2), curve(1.0)[2:], strict=True):
            tip = end(x[w], body)[i]
            yield absolute(f"tip's {name} / L, {size}", "-", expected, tip, bound, source)
        here = specimens.sections(x[w], body)[at > 0.0][:, [0, 2]]
        far = np.linalg.norm(here - curve(at[at > 0.0])[2:].T, axis=1).max()
        yield vanishing(f"largest distance from the elastica / L, {size}", far, bound, source)


def _particle_strip(
    bench: Bench, cells: int, L: float, specific: float, gravity: ArrayLike
) -> tuple[Simulator, float]:
    """A strip, 2 cells wide, whose free part reaches from x = 0 over L [m], with E / density
    ``specific`` [m^2/s^2] and one world for each ``gravity`` [W] downwards [m/s^2].

    Returns:
        The simulator, damped critically in its first mode, and that mode's angular frequency
        [rad/s].
    """
    dx = DIAMETER / cells
    corner = (-3.0 * dx, -dx, 0.0)
    body = cloth(width=L + 3.0 * dx, height=2.0 * dx, thickness=DIAMETER, dx=dx, corner=corner)
    worlds = [replace(MATERIAL, E=1000.0 * specific)] * len(down(gravity))
    omega = beam_frequency(worlds[0], GYRATION, L)
    s = bench.simulate(
        body, worlds, grippers=[clamp_beyond(reach=DIAMETER)], gravity=down(gravity),
        velocity_damping=2.0 * omega,
    )  # fmt: skip
    return s, omega


# ---- ropes in grippers ---------------------------------------------------------------------------

PLANES = {
    0.3: {0.6: 0.02, 0.75: 0.02, 1.2: 0.02, 2.0: 0.02},
    0.45: {0.6: 0.05, 1.0: 0.02, 1.5: 0.06, 2.0: 0.05},
}
"""Errors of the sag that are allowed where a plane holds, by nu and by cells across; those at nu
0.45 are known, not wanted."""


@case("grip", "a rope held by a sphere", "mpm")
def grip(bench: Bench) -> Iterator[Row]:
    """A rope ten diameters long, held by a sphere of 0.75 diameters, at random phases of the grid.

    Twenty of them (two in the quick run) measure the sag; two are watched for 8 s. Where the grip
    ends material is held by springs as stiff as the material. Damping makes substeps shorter; a
    separate row measures whether that shows. Further rows hold the rope across a plane, on coarser
    grids and nearly incompressible.
    """
    worlds, until, sag = *((2, 3.0) if bench.quick else (20, 8.0)), 0.02 * LENGTH
    omega = round_frequency(MATERIAL, DIAMETER / 4.0, LENGTH)
    for cells in (1.0,) if bench.quick else (1.0, 1.5):
        size = across(cells)
        (sags,) = _held_sags(bench, cells, worlds, [16.0 / omega])
        for name, found in (("least", sags.min()), ("largest", sags.max())):
            name = f"{name} sag at {worlds} phases of the grid, {size}"
            yield relative(name, "m", sag, found, 0.02, ROUND)
        (sags,) = _held_sags(bench, cells, 2, [40.0 / omega], replace(MATERIAL, damping=0.01))
        name = f"least sag with damping 10 ms, {size} (for information)"
        yield relative(name, "m", sag, sags.min(), 0.04, ROUND)
        first, last = _held_sags(bench, cells, 2, [2.0, until])
        name = f"creep between 2 and {until:g} s over the sag, {size}"
        creep = np.abs(last / first - 1.0).max()
        yield vanishing(name, creep, 0.001, "equilibrium: what hangs still stays")
    for nu, by_cells in {} if bench.quick else PLANES.items():
        material = replace(MATERIAL, nu=nu)
        for cells, allowed in by_cells.items():
            (sags,) = _held_sags(bench, cells, 2, [16.0 / omega], material, plane=True)
            name = f"sag where a plane holds, nu {nu}, {across(cells)}"
            yield relative(name, "m", sag, worst(sags, sag), allowed, ROUND)


def _held_sags(
    bench: Bench, cells: float, worlds: int, times: list[float], material: Material = MATERIAL,
    *, plane: bool = False,
) -> Array:  # fmt: skip
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
def rods_held(bench: Bench) -> Iterator[Row]:
    """A rope held by spheres that end anywhere between two points."""
    radius = np.linspace(0.02, 0.05, 13)
    free, k = 0.2 - radius, DIAMETER / 4.0
    omega = round_frequency(MATERIAL, k, free.max())
    hands = [[Gripper.still((0, 0, 0), radius=r)] for r in radius]
    g = down([gravity_for(0.02 * L, MATERIAL, k, L) for L in free])
    for points in (13, 25) if bench.quick else (13, 25, 49):
        body = rope(diameter=DIAMETER, length=0.2, points=points)
        worlds, allowed = [MATERIAL] * len(free), 0.02 if points < 25 else 0.01
        x = bench.settle(body, worlds, omega, periods=30.0, grippers=hands, gravity=g)
        sags = -x[:, -1, 2] / (0.02 * free)
        for name, found in (("least", sags.min()), ("largest", sags.max())):
            yield over_theory(
                f"{name} of 13 sags over theory, {points} points", found, allowed, ROUND
            )


# ---- rods and shells -----------------------------------------------------------------------------


@case("shell-strips", "strips' sags", "thin")
def strips_held(bench: Bench) -> Iterator[Row]:
    """Strips that sag by 2 % of their length: along both axes, where the clamp ends anywhere; and
    along the threads of a weave, where it ends on a point."""
    L, material, k = 0.2, replace(STIFF, nu=0.0), 0.002 / math.sqrt(12.0)
    woven = replace(material, warp=2.0, weft=0.5)
    some = [0.03] if bench.quick else np.linspace(0.02, 0.04, 5)
    strips = (
        (0, "strip along the first axis", material, 1.0, some, (23, 4), 0.02),
        (1, "strip along the second axis", material, 1.0, some, (23, 4), 0.02),
        (0, "strip along the warp", woven, woven.warp, [None], (22, 4), 0.01),
        (1, "strip along the weft", woven, woven.weft, [None], (22, 4), 0.01),
    )
    for axis, name, made, times, backs, points, allowed in strips[:: 3 if bench.quick else 1]:
        alike, sags = replace(material, E=times * material.E), []  # bends as a weave does
        g, omega = 8.0 * 0.02 * unit_gravity(alike, k, L), beam_frequency(alike, k, L)
        for back in backs:
            body, hand = clamped_strip(L, 0.03, 0.002, points, axis=axis, back=back)
            x = bench.settle(body, [made], omega, grippers=[hand], gravity=(0, 0, -g))
            sags.append(-x[0, body.points[:, axis] > L - 1e-9, 2].mean() / (0.02 * L))
        for which, found in {"least": min(sags), "largest": max(sags)}.items():
            if which == "least" or len(sags) > 1:
                which = f"{which} " * (len(sags) > 1)
                yield over_theory(f"{which}sag over theory, {name}", found, allowed, BEAM)


@case("rod-cantilever", "ropes' sags over four decades", "thin", "rods", 65, 1000.0)
@case("shell-cantilever", "strips' sags over decades", "thin", "strips", 49, 300.0)
def sags_over_decades(bench: Bench, of: str, points: int, most: float) -> Iterator[Row]:
    """Level ropes or strips of cloth under weights over decades."""
    if bench.quick:
        points, most = 33, 100.0
    loads = np.geomspace(0.1, most, 3 if bench.quick else 9)
    name = f"sag of {of} over theory, Gamma 0.1 to {most:g}, worst of {len(loads)}, {points} points"
    source = (
        "heavy elastica E I theta'' = w (L - s) cos theta (Wang 1986), solved by collocation; the "
        f"cantilever of {ROMERO}"
    )
    yield over_theory(name, worst(sags(bench, of, loads, points) / sag(loads)), 0.03, source)


def sags(bench: Bench, of: str, loads: ArrayLike, points: int, *, periods: float = 14.0) -> Array:
    """[W] as ``sag``, of ``rods`` or ``strips`` at rest under weights [W]; ``periods`` as of
    ``Bench.settle``."""
    k, Gamma = SPAN / 400.0, np.asarray(loads, dtype=float)
    if of == "rods":
        material, (body, hand) = STIFF, clamped_rope(SPAN, 4.0 * k, points)
    else:  # without Poisson's ratio wide strips bend as narrow ones do
        material = replace(STIFF, nu=0.0)
        body, hand = clamped_strip(SPAN, SPAN / 20.0, math.sqrt(12.0) * k, (points, 2))
    omega, g = beam_frequency(material, k, SPAN), Gamma * unit_gravity(material, k, SPAN)
    s = bench.simulate(
        body, [material] * len(g), grippers=[hand], gravity=down(g),
        velocity_damping=2.0 * np.maximum(omega, np.sqrt(g / SPAN)),
    )  # fmt: skip
    tip = s.run([periods / omega])[0][:, points - 1].astype(float)
    return -tip[:, 2] / tip[:, 0]


@case("rod-order", "finer and finer ropes", "thin", "rods")
@case("shell-order", "finer and finer strips", "thin", "strips")
def sag_orders(bench: Bench, of: str) -> Iterator[Row]:
    """Level ropes or strips that sag by 0.01 % of their length, of 16, 32 and 64 edges.

    The error of n edges is c / n^2 (1 - 3 / n) or so: the order grows from below to 2.
    """
    nu, share, counts = STIFF.nu, 1e-4, (16, 32, 64)
    if bench.quick and of == "strips":
        counts = counts[:-1]
    shear = 8.0 * (7.0 + 6.0 * nu) / 6.0 / 400.0**2 if of == "rods" else 0.0
    found = [sags(bench, of, [8.0 * share], n + 2, periods=20.0)[0] for n in counts]
    errors = [abs(one / (share * (1.0 + shear)) - 1.0) for one in found]
    source = (
        "w L^4 / (8 E I), of rods + w L^2 / (2 kappa G A) (Timoshenko; kappa = 6 (1 + nu) / "
        "(7 + 6 nu), Cowper 1966); of a lattice order 2: differences are central"
    )
    for n, (coarse, fine), allowed in zip(counts, pairwise(errors), (0.25, 0.15), strict=False):
        name = f"order of a {of[:-1].replace('rod', 'rope')}'s sag, from {n} to {2 * n} edges"
        yield absolute(name, "-", 2.0, math.log2(coarse / fine), allowed, source)
