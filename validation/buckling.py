"""Twisted ropes, and loads under which ropes, strips and rings leave their shape.

Bend-twist, lateral buckling and stick-slip are tests of Romero et al. (2021); Michell's ring is
older. Weights are in the units of ``validation.elastica``. A critical load is read off four
others: its mode's rate of growth, squared, is 0 there.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from gendom.arrays import Array
from gendom.materials import Material
from gendom.sim import Gripper, Table, rope
from validation.bench import WEIGHTLESS, Bench, Row, case, moved, over_theory, relative, worst
from validation.bending import SPAN
from validation.bending import STIFF as MATERIAL
from validation.elastica import WARPING, critical_load, lateral_load, tip_friction
from validation.readings import critical_share, mechanics
from validation.references import ROMERO, beam_frequency, unit_gravity
from validation.specimens import across, clamp_beyond, clamped_rope, clamped_strip, down

SHARES = np.array([0.9, 0.95, 1.05, 1.1])
"""Loads over the critical one."""

SLENDER = SPAN / 75.0
"""Diameter of ropes of length ``SPAN`` [m]."""


@case("torsion", "a twisted rope", "mpm")
@case("rod-twist", "a twisted rope", "thin")
def torsion(bench: Bench) -> Iterator[Row]:
    """A rope six diameters long, one end clamped, the other turned by 0.1 rad about its axis.

    Its elastic energy gives the stiffness: that of the twist alone, as both ends stay in place.
    """
    d, angle, material = 0.01, 0.1, Material(E=1.0e6, nu=0.3, density=1000.0)
    G = material.lame[0]
    L, particles = 6.0 * d, bench.engine == "mpm"
    omega, expected = math.pi * math.sqrt(G / material.density) / L, G * math.pi * d**4 / 32.0 / L
    near, far = clamp_beyond(reach=d), clamp_beyond((1.0, 0.0, 0.0), d, point=(L, 0.0, 0.0))
    turn = Rotation.from_rotvec([(0.0, 0.0, 0.0), (angle, 0.0, 0.0)]).as_quat()
    place = np.repeat(far.position_at([0.0]), 2, axis=0)
    hand = Gripper(time=[0.0, 40.0 / omega], position=place, quat_xyzw=turn, radius=far.radius)
    options = {"grippers": [near, hand], "gravity": WEIGHTLESS, "velocity_damping": omega}
    for cells in (1.0, 2.0) if bench.quick or not particles else (0.6, 1.0, 1.5, 2.0, 3.0):
        back, size = 3.0 * d / cells, across(cells)
        count: dict[str, Any] = {"cells_across": cells}
        if not particles:
            edges = round(9 * cells)
            back, size, count = L / edges, f"{edges + 3} points", {"points": edges + 3}
        start = (-back, 0.0, 0.0)
        body = rope(diameter=d, length=L + 2.0 * back, start=start, **count)
        s = bench.simulate(body, [material], **options)
        s.run([60.0 / omega])
        source = (
            "U = G J angle^2 / (2 L), J = pi d^4 / 32, of a round bar (Coulomb 1784; Gere and "
            "Timoshenko, Mechanics of Materials)"
        )
        found, allowed = 2.0 * mechanics(s).elastic / angle**2, 0.05 if particles else 0.01
        yield relative(f"torsional stiffness, {size}", "N m/rad", expected, found, allowed, source)


@case("shell-lateral", "a strip on its edge", "thin")
def strip_falls_over(bench: Bench) -> Iterator[Row]:
    """A strip of cloth that stands on its edge under its weight; fifteen times as long as wide.

    It is 20 times as wide as thick: its deflection before has half a per cent.
    """
    aspect, points, shares = 15.0, 17 if bench.quick else 33, np.array([0.95, 1.0, 1.05])
    width = SPAN / aspect
    body, hand = clamped_strip(SPAN, width, width / 20.0, (points, 3))
    material = Material(E=MATERIAL.E, nu=0.0, density=MATERIAL.density)
    load = lateral_load(2.0 * WARPING / aspect**2)
    k = width / 20.0 / math.sqrt(12.0)
    omega = beam_frequency(material, k, SPAN)
    # G J over E I is 4 G / E; its weight pulls along y
    g = load * math.sqrt(2.0) * shares * unit_gravity(material, k, SPAN)
    s = bench.simulate(
        body, [material] * len(shares), grippers=[hand], gravity=np.outer(g, (0.0, -1.0, 0.0)),
        velocity_damping=2.0 * omega,
    )  # fmt: skip
    # in the plane it is stiff, and soon at rest
    s.run([3.0 / omega])
    bent = np.clip(body.points[:, 0] / SPAN, 0.0, None) ** 2
    s.set_velocities(np.outer(bent, (0.0, 0.0, 1e-5)))
    t = (3.0 + np.linspace(6.0, 9.0, 7)) / omega
    found = load * critical_share(shares, t, s.run(t)[:, :, points - 1, 2], 2.0 * omega)
    name = "critical weight of a standing strip, q L^3 / sqrt(E I G J)"
    source = (
        "12.85 sqrt(E I G J) / L^3 (Timoshenko and Gere, Theory of Elastic Stability, 6.3), and "
        "the clamp that keeps its section from warping (Vlasov 1961); lateral buckling of "
        f"{ROMERO}"
    )
    yield relative(name, "-", load, found, 0.03, source)


@case("rod-bend-twist", "curls that leave their plane", "thin")
def curls_leave_plane(bench: Bench) -> Iterator[Row]:
    """Ropes that are curved when free of stress, clamped level and curved upwards, or hanging.

    They stay in their plane under little weight; a hanging one comes back to it under more.
    """
    tests: Sequence[tuple[str, float, float, tuple[float, float]]] = (
        ("clamped level, leaves", 5.0, 0.0, (12.0, 20.0)),
        ("clamped level, leaves", 4.0, 0.0, (8.0, 13.0)),
        ("clamped level, leaves", 6.0, 0.0, (20.0, 30.0)),
        ("hanging, leaves", 6.0, -math.pi / 2.0, (10.0, 18.0)),
        ("hanging, comes back to", 6.0, -math.pi / 2.0, (20.0, 32.0)),
    )
    source = (
        "plane heavy elastica, and where Kirchhoff's equations have a solution beside it; "
        f"bend-twist of {ROMERO}, after Miller et al. 2014"
    )
    for does, curvature, angle, between in tests[:1] if bench.quick else tests:
        twisting = 1.0 / (1.0 + MATERIAL.nu)
        load = critical_load(between, curvature=curvature, angle=angle, torsion=twisting)
        found = load * curl_leaves(bench, load, curvature, angle, 33 if bench.quick else 49)
        name = f"weight at which a curl of {curvature:g} rad, {does} its plane"
        yield relative(name, "E I / L^3", load, found, 0.03, source)


def curl_leaves(bench: Bench, load: float, curvature: float, angle: float, points: int) -> float:
    """Weight at which a rope of a natural curvature leaves its plane or comes back, over ``load``,
    from four weights beside it."""
    body, hand = clamped_rope(SPAN, SLENDER, points, curvature=curvature, angle=angle)
    k = SLENDER / 4.0
    omega = beam_frequency(MATERIAL, k, SPAN)
    gravity = down(load * SHARES * unit_gravity(MATERIAL, k, SPAN))
    options = {"grippers": [hand], "gravity": gravity, "velocity_damping": 2.0 * omega}
    s = bench.simulate(body, [MATERIAL] * len(SHARES), **options)
    s.run([20.0 / omega])
    s.set_velocities(np.outer(np.linspace(0.0, 1.0, points) ** 2, (0.0, 1e-5, 0.0)))
    t = (20.0 + np.linspace(10.0, 15.0, 11)) / omega
    return critical_share(SHARES, t, s.run(t)[:, :, -1, 1], 2.0 * omega)


@case("rod-stick-slip", "tips on the table", "thin")
def tips_slip(bench: Bench) -> Iterator[Row]:
    """Upright ropes that are let down on the table: friction at which their tips begin to slip."""
    friction = np.array([0.1, 0.2, 0.3] if bench.quick else [0.1, 0.15, 0.2, 0.25, 0.3])
    source = (
        "elastica whose tip stands still, H / V = mu at its end (Sano, Yamaguchi and Wada 2017, "
        "'Slip morphology of elastic strips on frictional rigid substrates'); stick-slip of "
        f"{ROMERO}"
    )
    for load in (0.0,) if bench.quick else (0.0, 10.0):
        found = worst(tip_friction(load, slips(bench, load, friction)) / friction)
        name = f"H / V where tips slip over mu, Gamma {load:g}, worst of {len(friction)}"
        yield over_theory(name, found, 0.03, source)


def slips(bench: Bench, load: float, friction: ArrayLike) -> Array:
    """[W] how far upright ropes are let down when their tips slip, over L, for friction [W]; 0.33
    where they have not."""
    mu = np.asarray(friction, dtype=float)
    points, deepest, frames = 33, 0.33, 1000
    body, hand = clamped_rope(SPAN, SLENDER, points, angle=-math.pi / 2.0)
    start = np.array([0.0, 0.0, SPAN + SLENDER / 2.0])
    k = SLENDER / 4.0
    omega, unit = beam_frequency(MATERIAL, k, SPAN), unit_gravity(MATERIAL, k, SPAN)
    # slowly at first: a tip that is dropped on the table slips before it is loaded
    share = np.linspace(0.0, 1.0, 101)
    until = 120.0 / omega
    path = hand.position_at(0.0) + start + down(deepest * SPAN * share**2)
    lowered = Gripper(time=until * share, position=path, radius=hand.radius)
    # a small sideways gravity decides where it buckles to
    gravity = (0.005 * unit, 0.0, -load * unit)
    s = bench.simulate(
        moved(body, start), [MATERIAL] * len(mu), grippers=[lowered], gravity=gravity,
        table=Table(height=0.0, friction=mu), velocity_damping=omega,
    )  # fmt: skip
    t = np.linspace(0.0, 1.0, frames + 1)[1:]
    x = s.run(t * until, particles=[points - 1])[:, :, 0, 0].astype(float)
    slipped = np.abs(x - x[frames // 10]) > 2e-4 * SPAN
    slipped[: frames // 10] = False
    slipped[-1] = True
    return deepest * t[slipped.argmax(axis=0)] ** 2


@case("rod-ring", "a twisted ring", "thin")
def ring_writhes(bench: Bench) -> Iterator[Row]:
    """A straight rope bent to a closed ring and twisted at its seam, until it leaves its plane.

    It is read off four smaller twists. The seam's two sides are held, one over the other: without
    self-contact nothing is between. Each twist has two worlds, of which one is kicked. A turn of
    the whole ring about the seam's tangent costs nothing; it stays as it is, and differences in
    time are free of it.
    """
    edges, critical = 24 if bench.quick else 48, 2.0 * math.pi * math.sqrt(3.0) * (1 + MATERIAL.nu)
    shares, l = np.array([0.8, 0.85, 0.9, 0.95]), SPAN / edges
    body = rope(diameter=SLENDER, length=SPAN + 2.0 * l, start=(-l, 0, 0), points=edges + 3)
    omega = 4.0 * beam_frequency(MATERIAL, SLENDER / 4.0, SPAN)
    rest, damping, times = 100.0 / omega, 4.0 * omega, (20.0 / omega, 80.0 / omega)
    seam = Gripper.still((-0.5 * l, 0.0, 0.0), radius=0.5 * l)
    hands = [[seam, _seam(edges, l, times, share * critical)] for share in np.repeat(shares, 2)]
    options = {"grippers": hands, "gravity": WEIGHTLESS, "velocity_damping": damping}
    s = bench.simulate(body, [MATERIAL] * len(hands), **options)
    s.run([rest])
    around = 2.0 * math.pi * np.clip(np.arange(-1, edges + 2) / edges, 0.0, 1.0)
    turn, shape = 1.0 - np.cos(around), 1.0 - np.cos(2.0 * around)
    kick = np.zeros((len(hands), edges + 3, 3))
    kick[::2, :, 2] = 3e-2 * (shape - turn * (shape @ turn) / (turn @ turn))
    s.set_velocities(kick)
    t = rest + np.linspace(6.0, 14.0, 17) / omega
    z = s.run(t)[..., 2].astype(float)
    moved = np.linalg.norm(np.diff(z[:, ::2] - z[:, 1::2], axis=0), axis=2)
    # twists to the left and to the right are alike
    share = critical_share(shares**2, 0.5 * (t[1:] + t[:-1]), moved, damping)
    source = (
        "twist 2 pi sqrt(3) E I / (G J) of a closed ring (Michell 1889; Zajac 1962; Goriely 2006, "
        "'Twisted elastic rings and the rediscoveries of Michell's instability')"
    )
    found = critical * math.sqrt(share)
    yield relative("critical twist of a ring", "rad", critical, found, 0.03, source)


def _seam(edges: int, l: float, times: tuple[float, float], twist: float) -> Gripper:
    """What bends ``edges`` free edges of length l, from 0 along x on, to a ring, and twists them.

    The chain is that of equal turns between edges, half of them beside what is held.
    """
    share = np.linspace(0.0, 1.0, 61)
    turn = 2.0 * math.pi * share
    angle = turn[:, None] * (np.arange(edges) + 0.5) / edges
    end = l * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=2).sum(axis=1)
    end += 0.5 * l * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    bending = Rotation.from_rotvec(np.outer(turn, (0.0, 0.0, 1.0)))
    twisting = Rotation.from_rotvec(np.outer(twist * share[1:], (1.0, 0.0, 0.0))) * bending[-1]
    return Gripper(
        time=np.append(times[0] * share, times[0] + (times[1] - times[0]) * share[1:]),
        position=np.concatenate([end, np.repeat(end[-1:], len(share) - 1, axis=0)]),
        quat_xyzw=np.concatenate([bending.as_quat(), twisting.as_quat()]),
        radius=0.5 * l,
    )
