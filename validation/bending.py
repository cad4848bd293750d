"""Ropes and strips that bend under their own weight."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import quad
from scipy.optimize import brentq

from gendom.materials import Material
from gendom.sim import GRAVITY, Body, Gripper, Simulator, cloth, rope
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
from validation.specimens import (
    across,
    clamp_beyond,
    clamped_rope,
    clamped_strip,
    down,
    end,
    particle_rope,
    sections,
    stations,
)

DIAMETER, LENGTH = 0.01, 0.1
"""Of the MPM's ropes [m]."""

MATERIAL = Material(E=1.0e6, nu=0.3, density=1000.0)
"""Of ropes."""

SPAN = 0.3
"""Free length of what sags over decades of weights [m]."""

STIFF = Material(E=2.0e7, nu=0.3, density=1000.0)
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

# ---- strips of particles -------------------------------------------------------------------------

THICKNESS = 0.01
"""[m]."""

GYRATION = THICKNESS / math.sqrt(12.0)
"""Radius of gyration of the rectangular section [m]."""

SAG_BOUNDS = {1: 0.04, 2: 0.02, 4: 0.02, 8: 0.02}
"""By cells across; as for ropes in a gripper, see ``grip``."""


@case("cantilever", "a strip's small sag", "mpm")
def cantilever(bench: Bench) -> list[Row]:
    """A strip ten times as long as thick that sags by 2 % of its length, on finer and finer grids.

    Shear has 1 % of the sag at this slenderness.
    """
    L, nu = 10.0 * THICKNESS, MATERIAL.nu
    sag = 0.02 * L
    kappa = 10.0 * (1.0 + nu) / (12.0 + 11.0 * nu)
    shear = 8.0 * (1.0 + nu) * (GYRATION / L) ** 2 / kappa
    specific = -GRAVITY[2] * L**4 / (8.0 * GYRATION**2 * sag)
    rows = []
    for cells in (1, 2) if bench.quick else (1, 2, 4, 8):
        s, omega = _particle_strip(bench, cells, L, specific, [-GRAVITY[2]])
        tip = -float(end(s.run([11.0 / omega])[0, 0], s.body)[2])
        name = f"sag of the tip, {across(cells)}"
        rows.append(relative(name, "m", sag * (1.0 + shear), tip, SAG_BOUNDS[cells], BEAM))
    return rows


@case("elastica", "a strip's large sag", "mpm")
def strip_elastica(bench: Bench) -> list[Row]:
    """A clamped strip of 1, 2 and 3 bending lengths, large deflection, and whether it stays.

    Three worlds of equal material: gravity sets the bending length (E I / (w))^(1/3).
    """
    if bench.quick:
        cells, slenderness, ratios, bound = 1, 15.0, np.array([1.0, 2.0]), 0.06
    else:
        cells, slenderness, ratios, bound = 2, 25.0, np.array([1.0, 2.0, 3.0]), 0.02
    L = slenderness * THICKNESS
    last, drift, body = _hang(bench, cells, L, ratios)
    at = stations(body) - 3.0 * body.dx
    free = at > 0.0
    rows = []
    for w, ratio in enumerate(ratios):
        curve = heavy_elastica(ratio)
        here = sections(last[w], body)[free][:, [0, 2]] / L
        tip = end(last[w], body)[[0, 2]] / L
        size = f"L = {ratio:g} bending lengths, {across(cells)}"
        for name, measured, expected in zip("xz", tip, curve(1.0), strict=True):
            rows.append(
                absolute(f"tip's {name} / L, {size}", "-", expected, measured, bound, ELASTICA)
            )
        far = float(np.linalg.norm(here - curve(at[free] / L).T, axis=1).max())
        name = f"largest distance from the elastica / L, {size}"
        rows += [vanishing(name, far, bound, ELASTICA), _stays(drift[w] / L, size)]
    if not bench.quick:
        _, drift, _ = _hang(bench, 1, L, ratios[-1:])
        rows.append(_stays(drift[0] / L, f"L = {ratios[-1]:g} bending lengths, 1 cell across"))
    return rows


def _stays(drift: float, size: str) -> Row:
    # the first mode, damped critically, has (1 + 9.6) exp(-9.6) = 0.0007 of its start to go
    return vanishing(f"way of the resting tip / L, {size}", float(drift), 0.001, STAYS)


def _hang(
    bench: Bench, cells: int, L: float, ratios: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating], Body]:
    """Last positions [W, N, 3], how far each tip then still moves [W] [m], and the body."""
    specific = 400.0
    gravity = specific * GYRATION**2 * ratios**3 / L**3
    s, omega = _particle_strip(bench, cells, L, specific, gravity)
    x = s.run(np.array([0.8, 0.9, 1.0]) * 12.0 / omega)
    tips = end(x, s.body)
    return x[-1], np.linalg.norm(tips - tips[-1], axis=-1).max(axis=0), s.body


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
    dx = THICKNESS / cells
    back = 3.0 * dx
    body = cloth(
        width=L + back, height=2.0 * dx, thickness=THICKNESS, dx=dx, corner=(-back, -dx, 0.0)
    )
    material = replace(MATERIAL, E=1000.0 * specific)
    omega = beam_frequency(material, GYRATION, L)
    pull = down(gravity)
    s = bench.simulate(
        body,
        [material] * len(pull),
        grippers=[clamp_beyond(reach=THICKNESS)],
        velocity_damping=2.0 * omega,
        gravity=pull,
    )
    return s, omega


# ---- ropes in grippers ---------------------------------------------------------------------------

RADIUS = 0.75 * DIAMETER
"""Of the sphere: what estimates hold a rope with where nothing else is known [m]."""

SAG = 0.02 * LENGTH
"""[m]."""

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
    rows = []
    worlds, until = (2, 3.0) if bench.quick else (20, 8.0)
    omega = round_frequency(MATERIAL, DIAMETER / 4.0, LENGTH)
    for cells in (1.0, 1.5):
        size = across(cells)
        (sags,) = _held_sags(bench, cells, worlds, [16.0 / omega])
        for name, found in (("least", sags.min()), ("largest", sags.max())):
            name = f"{name} sag at {worlds} phases of the grid, {size}"
            rows.append(relative(name, "m", SAG, float(found), 0.02, ROUND))
        (sags,) = _held_sags(bench, cells, 2, [40.0 / omega], replace(MATERIAL, damping=0.01))
        name = f"least sag with damping 10 ms, {size} (for information)"
        rows.append(relative(name, "m", SAG, float(sags.min()), 0.04, ROUND))
        first, last = _held_sags(bench, cells, 2, [2.0, until])
        name = f"creep between 2 and {until:g} s over the sag, {size}"
        rows.append(vanishing(name, float(np.abs(last / first - 1.0).max()), 0.001, STAYS))
    for nu, by_cells in {} if bench.quick else PLANES.items():
        material = replace(MATERIAL, nu=nu)
        for cells, allowed in by_cells.items():
            (sags,) = _held_sags(bench, cells, 2, [16.0 / omega], material, plane=True)
            name = f"sag where a plane holds, nu {nu}, {across(cells)}"
            rows.append(relative(name, "m", SAG, worst(sags, SAG), allowed, ROUND))
    return rows


def _held_sags(
    bench: Bench,
    cells: float,
    worlds: int,
    times: list[float],
    material: Material = MATERIAL,
    *,
    plane: bool = False,
) -> NDArray[np.floating]:
    """[T, W] how far tips hang below a sphere or a plane that holds all but ``LENGTH`` [m].

    Each world is shifted at random against the grid.
    """
    phases = np.random.default_rng(0).uniform(0.0, DIAMETER / cells, (worlds, 3))
    if plane:
        body, hand = particle_rope(LENGTH, DIAMETER, cells)
    else:
        back = RADIUS + 0.25 * DIAMETER
        body = rope(
            diameter=DIAMETER, length=LENGTH + back, start=(-back, 0.0, 0.0), cells_across=cells
        )
        hand = Gripper.still((-RADIUS, 0.0, 0.0), radius=RADIUS)
    s = bench.simulate(
        body,
        [material] * worlds,
        grippers=[[replace(hand, position=np.asarray(hand.position) + shift)] for shift in phases],
        positions=body.x + phases[:, None],
        gravity=(0.0, 0.0, -gravity_for(SAG, material, DIAMETER / 4.0, LENGTH)),
        velocity_damping=2.0 * round_frequency(material, DIAMETER / 4.0, LENGTH),
    )
    return phases[:, 2] - end(s.run(times), body)[..., 2]


@case("rod-held", "ropes in grippers", "thin")
def rods_held(bench: Bench) -> list[Row]:
    """A rope held by spheres that end anywhere between two points."""
    rows, radius = [], np.linspace(0.02, 0.05, 13)
    free, k = 0.2 - radius, DIAMETER / 4.0
    for points in (13, 25) if bench.quick else (13, 25, 49):
        body = rope(diameter=DIAMETER, length=0.2, points=points)
        x = bench.settle(
            body,
            [MATERIAL] * len(free),
            round_frequency(MATERIAL, k, free.max()),
            periods=30.0,
            grippers=[[Gripper.still((0, 0, 0), radius=r)] for r in radius],
            gravity=down([gravity_for(0.02 * L, MATERIAL, k, L) for L in free]),
        )
        sags = -x[:, -1, 2] / (0.02 * free)
        for name, found in (("least", sags.min()), ("largest", sags.max())):
            name = f"{name} of 13 sags over theory, {points} points"
            rows.append(over_theory(name, float(found), 0.02 if points < 25 else 0.01, ROUND))
    return rows


@case("shell-strips", "strips' sags", "thin")
def strips_held(bench: Bench) -> list[Row]:
    """Clamped strips along both axes that sag by 2 % of their length; the clamp ends anywhere."""
    L, material, k = 0.2, replace(STIFF, nu=0.0), 0.002 / math.sqrt(12.0)
    g = 8.0 * 0.02 * unit_gravity(material, k, L)
    rows = []
    for axis, name in ((0, "first"), (1, "second")):
        sags = []
        for back in np.linspace(0.02, 0.04, 2 if bench.quick else 5):
            body, hand = clamped_strip(L, 0.03, 0.002, (23, 4), axis=axis, back=float(back))
            omega = beam_frequency(material, k, L)
            x = bench.settle(body, [material], omega, grippers=[hand], gravity=(0, 0, -g))
            tip = body.points[:, axis] > L - 1e-9
            sags.append(-float(x[0, tip, 2].mean()) / (0.02 * L))
        for which, found in (("least", min(sags)), ("largest", max(sags))):
            which = f"{which} sag over theory, strip along the {name} axis"
            rows.append(over_theory(which, found, 0.02, BEAM))
    return rows


# ---- rods and shells, clamped --------------------------------------------------------------------


@case("rod-elastica", "a rope's large sag", "thin")
def rod_elastica(bench: Bench) -> list[Row]:
    """A rope of 1, 2 and 3 bending lengths, clamped level; the clamp ends on a point."""
    ratios = np.array([1.0, 2.0, 3.0])
    d, back, L, points = 0.004, 0.02, 0.3, 33 if bench.quick else 65
    x = bench.settle(
        rope(diameter=d, length=L + back, start=(-back, 0, 0), points=points),
        [STIFF] * len(ratios),
        beam_frequency(STIFF, d / 4.0, L),
        grippers=[Gripper.still((-back, 0, 0), radius=back)],
        gravity=down(ratios**3 * unit_gravity(STIFF, d / 4.0, L)),
    )
    rows = []
    for ratio, tip in zip(ratios, x[:, -1, [0, 2]] / L, strict=True):
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
    along = np.clip(body.points[:, 0] / L, 0.0, None)
    x = bench.settle(
        body,
        [STIFF] * 2,
        1.24 * np.sqrt(g / sag),
        periods=24.0,
        grippers=[hand],
        gravity=down(g),
        stiffness=np.exp(np.outer(rates, along)),
    )
    return [
        over_theory(
            f"sag over theory of a rope ten times as {name} at its tip", -tip / sag, 0.01, GRADED
        )
        for name, tip in zip(("stiff", "soft"), x[:, -1, 2], strict=True)
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
        body, hand = clamped_rope(SPAN, 4.0 * k, points)
        material = STIFF
    else:  # without Poisson's ratio wide strips bend as narrow ones do
        body, hand = clamped_strip(SPAN, SPAN / 20.0, math.sqrt(12.0) * k, (points, 2))
        material = replace(STIFF, nu=0.0)
    omega = beam_frequency(material, k, SPAN)
    g = Gamma * unit_gravity(material, k, SPAN)
    s = bench.simulate(
        body,
        [material] * len(g),
        grippers=[hand],
        gravity=down(g),
        velocity_damping=2.0 * np.maximum(omega, np.sqrt(g / SPAN)),
    )
    tip = s.run([14.0 / omega])[0][:, points - 1].astype(float)
    return -tip[:, 2] / tip[:, 0]


@case("rod-catenary", "a rope between two hands", "thin")
def catenary(bench: Bench) -> list[Row]:
    """A thin soft rope that hangs from two points as far apart as 0.7 of its length."""
    L, points = 0.6, 65
    span = 0.7 * L
    body = rope(diameter=0.002, length=L, start=(-L / 2, 0, 0), points=points)
    # the middle is let down while the ends come together
    hands = [
        Gripper(
            time=[0.0, 1.0],
            position=[(side * L / 2, 0, 0), (side * span / 2, 0, 0)],
            radius=0.001,
        )
        for side in (-1.0, 1.0)
    ]
    s = bench.simulate(body, [replace(STIFF, E=5.0e6)], grippers=hands, velocity_damping=4.0)
    middle = -float(s.run([4.0])[0, 0, points // 2, 2])
    a = brentq(lambda a: 2.0 * a * math.sinh(span / (2.0 * a)) - L, 0.05, 10.0)
    assert isinstance(a, float)
    expected = a * (math.cosh(span / (2.0 * a)) - 1.0)
    return [relative("sag of a hanging rope", "m", expected, middle, 0.02, CATENARY)]
