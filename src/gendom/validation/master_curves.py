"""Published tests of rods and shells, each against its curve in dimensionless numbers.

Sags, lateral buckling, bend-twist and stick-slip are the four of Romero et al. (2021); Michell's
ring is older. The curves and their units are those of `gendom.validation.elastica`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gendom.errors import SimulationError
from gendom.materials import Material
from gendom.sim import Body, Gripper, Table, cloth, rope
from gendom.validation.check import Check, Settings
from gendom.validation.elastica import (
    WARPING,
    critical_load,
    lateral_load,
    sag,
    tip_friction,
)

LENGTH = 0.3
"""Of what is free [m]."""

DIAMETER = LENGTH / 75.0
"""[m]."""

MATERIAL = Material(E=2.0e7, nu=0.3, density=1000.0)

ROMERO = (
    "Romero et al. 2021, 'Physical validation of simulators in computer graphics', ACM "
    "Transactions on Graphics 40(4)"
)
SAG = (
    "heavy elastica E I theta'' = w (L - s) cos theta (Wang 1986), solved by collocation; the "
    f"cantilever of {ROMERO}"
)
KIRCHHOFF = "plane heavy elastica, and where Kirchhoff's equations have a solution beside it"
LATERAL = (
    "12.85 sqrt(E I G J) / L^3 (Timoshenko and Gere, Theory of Elastic Stability, 6.3), deflection "
    f"before counted: {KIRCHHOFF}; lateral buckling of {ROMERO}"
)
LATERAL_PLATE = (
    "12.85 sqrt(E I G J) / L^3 (Timoshenko and Gere, Theory of Elastic Stability, 6.3), and the "
    f"clamp that keeps its section from warping (Vlasov 1961); lateral buckling of {ROMERO}"
)
BEND_TWIST = f"{KIRCHHOFF}; bend-twist of {ROMERO}, after Miller et al. 2014"
STICK_SLIP = (
    "elastica whose tip stands still, H / V = mu at its end (Sano, Yamaguchi and Wada 2017, 'Slip "
    f"morphology of elastic strips on frictional rigid substrates'); stick-slip of {ROMERO}"
)
MICHELL = (
    "twist 2 pi sqrt(3) E I / (G J) of a closed ring (Michell 1889; Zajac 1962; Goriely 2006, "
    "'Twisted elastic rings and the rediscoveries of Michell's instability')"
)


# ---- cases ---------------------------------------------------------------------------------------


def rods_sag(settings: Settings) -> list[Check]:
    """Level ropes under weights over four decades."""
    points, most = (33, 100.0) if settings.quick else (65, 1000.0)
    return _sag_checks(settings, "rods", points, most)


def strips_sag(settings: Settings) -> list[Check]:
    """Level strips of cloth under weights over four decades."""
    points, most = (33, 100.0) if settings.quick else (49, 300.0)
    return _sag_checks(settings, "strips", points, most)


def strip_falls_over(settings: Settings) -> list[Check]:
    """A strip of cloth that stands on its edge; fifteen times as long as wide."""
    return [
        Check.within_share(
            "critical weight of a standing strip, q L^3 / sqrt(E I G J)",
            "-",
            *strip_falls(settings, 15.0, 17 if settings.quick else 33),
            0.03,
            LATERAL_PLATE,
        )
    ]


def curls_leave_plane(settings: Settings) -> list[Check]:
    """Ropes that are curved when free of stress, clamped level and curved upwards, or hanging.

    They stay in their plane under little weight; a hanging one comes back to it under more.
    """
    torsion = 1.0 / (1.0 + MATERIAL.nu)
    down = -math.pi / 2.0
    tests = [("clamped level", "leaves", 5.0, 0.0, (12.0, 20.0))]
    if not settings.quick:
        tests += [
            ("clamped level", "leaves", 4.0, 0.0, (8.0, 13.0)),
            ("clamped level", "leaves", 6.0, 0.0, (20.0, 30.0)),
            ("hanging", "leaves", 6.0, down, (10.0, 18.0)),
            ("hanging", "comes back to", 6.0, down, (20.0, 32.0)),
        ]
    checks = []
    for held, does, curvature, angle, between in tests:
        load = critical_load(between, curvature=curvature, angle=angle, torsion=torsion)
        found = curl_leaves(settings, load, curvature, angle, 33 if settings.quick else 49)
        checks.append(
            Check.within_share(
                f"weight at which a curl of {curvature:g} rad, {held}, {does} its plane",
                "E I / L^3", load, load * found, 0.03, BEND_TWIST,
            )
        )  # fmt: skip
    return checks


def tips_slip(settings: Settings, *, frames: int = 1000) -> list[Check]:
    """Upright ropes that are let down on the table: friction at which their tips begin to slip."""
    friction = np.array([0.1, 0.2, 0.3] if settings.quick else [0.1, 0.15, 0.2, 0.25, 0.3])
    checks = []
    for load in (0.0,) if settings.quick else (0.0, 10.0):
        found = tip_friction(load, slips(settings, load, friction, frames)) / friction
        checks.append(
            Check.within_share(
                f"H / V where tips slip over mu, Gamma {load:g}, worst of {len(friction)}",
                "-", 1.0, _worst(found), 0.03, STICK_SLIP,
            )
        )  # fmt: skip
    return checks


def ring_writhes(settings: Settings) -> list[Check]:
    """A straight rope bent to a closed ring and twisted at its seam, until it leaves its plane."""
    critical = 2.0 * math.pi * math.sqrt(3.0) * (1.0 + MATERIAL.nu)
    share = ring_leaves(settings, critical, 24 if settings.quick else 48)
    return [
        Check.within_share(
            "critical twist of a ring", "rad", critical, share * critical, 0.03, MICHELL
        )
    ]


# ---- what is measured ----------------------------------------------------------------------------


def sags(settings: Settings, of: str, loads: ArrayLike, points: int) -> NDArray[np.float64]:
    """[W] as ``sag``, of ``rods`` or ``strips`` at rest under weights [W]."""
    weight = np.asarray(loads, dtype=float)
    k = LENGTH / 400.0
    if of == "rods":
        body, hand = clamped_rope(4.0 * k, points)
        material = MATERIAL
    else:  # without Poisson's ratio wide strips bend as narrow ones do
        body, hand = clamped_strip(math.sqrt(12.0) * k, LENGTH / 20.0, (points, 2))
        material = Material(E=MATERIAL.E, nu=0.0, density=MATERIAL.density)
    omega = _frequency(k, material)
    g = weight * _unit_gravity(k, material)
    s = settings.simulator(
        body, [material] * len(weight), engine="thin", grippers=[hand], air_density=0.0,
        gravity=np.outer(g, (0.0, 0.0, -1.0)),
        velocity_damping=2.0 * np.maximum(omega, np.sqrt(g / LENGTH)),
    )  # fmt: skip
    tip = s.run([14.0 / omega])[0][:, points - 1].astype(float)
    return -tip[:, 2] / tip[:, 0]


def strip_falls(settings: Settings, aspect: float, points: int) -> tuple[float, float]:
    """q L^3 / sqrt(E I G J) at which a strip ``aspect`` times as long as wide falls over, of theory
    and measured. It is 20 times as wide as thick: its deflection before has half a per cent."""
    width = LENGTH / aspect
    thickness = width / 20.0
    body, hand = clamped_strip(thickness, width, (points, 3))
    material = Material(E=MATERIAL.E, nu=0.0, density=MATERIAL.density)
    # G J over E I is 4 G / E
    scale = math.sqrt(2.0)
    load = lateral_load(2.0 * WARPING / aspect**2)
    found = _falls(settings, body, hand, material, thickness, load * scale, points)
    return load, load * found


def curl_leaves(
    settings: Settings, load: float, curvature: float, angle: float, points: int
) -> float:
    """Weight at which a rope of a natural curvature leaves its plane or comes back, over ``load``,
    from four weights beside it."""
    shares = np.array([0.9, 0.95, 1.05, 1.1])
    body, hand = clamped_rope(DIAMETER, points, curvature=curvature, angle=angle)
    k = DIAMETER / 4.0
    omega = _frequency(k, MATERIAL)
    g = load * shares * _unit_gravity(k, MATERIAL)
    s = settings.simulator(
        body, [MATERIAL] * len(shares), engine="thin", grippers=[hand], air_density=0.0,
        gravity=np.outer(g, (0.0, 0.0, -1.0)), velocity_damping=2.0 * omega,
    )  # fmt: skip
    s.run([20.0 / omega])
    kick = np.outer(np.linspace(0.0, 1.0, points) ** 2, (0.0, 1e-5, 0.0))
    s.set_velocities(kick)
    t = (20.0 + np.linspace(10.0, 15.0, 11)) / omega
    return _critical(shares, _squared_rates(t, s.run(t)[:, :, -1, 1], 2.0 * omega))


def slips(
    settings: Settings, load: float, friction: ArrayLike, frames: int = 1000
) -> NDArray[np.float64]:
    """[W] how far upright ropes are let down when their tips slip, over L, for friction [W]; 0.33
    where they have not."""
    mu = np.asarray(friction, dtype=float)
    points, deepest = 33, 0.33
    body, hand = clamped_rope(DIAMETER, points, angle=-math.pi / 2.0)
    start = np.array([0.0, 0.0, LENGTH + DIAMETER / 2.0])
    k = DIAMETER / 4.0
    omega, unit = _frequency(k, MATERIAL), _unit_gravity(k, MATERIAL)
    # slowly at first: a tip that is dropped on the table slips before it is loaded
    share = np.linspace(0.0, 1.0, 101)
    until = 120.0 / omega
    path = hand.position_at(0.0) + start
    path = path - np.outer(deepest * LENGTH * share**2, (0.0, 0.0, 1.0))
    carrying = Gripper(time=until * share, position=path, radius=hand.radius)
    s = settings.simulator(
        body.moved(start), [MATERIAL] * len(mu), engine="thin", grippers=[carrying],
        # a small sideways gravity decides where it buckles to
        gravity=(0.005 * unit, 0.0, -load * unit), table=Table(height=0.0, friction=mu),
        velocity_damping=omega, air_density=0.0,
    )  # fmt: skip
    t = np.linspace(0.0, 1.0, frames + 1)[1:]
    x = s.run(t * until, particles=[points - 1])[:, :, 0, 0].astype(float)
    slipped = np.abs(x - x[frames // 10]) > 2e-4 * LENGTH
    slipped[: frames // 10] = False
    slipped[-1] = True
    return deepest * t[slipped.argmax(axis=0)] ** 2


def ring_leaves(settings: Settings, critical: float, edges: int) -> float:
    """Twist at which a ring leaves its plane, over ``critical``, from four smaller twists.

    The seam's two sides are held, one over the other: without self-contact nothing is between.
    Each twist has two worlds, of which one is kicked. A turn of the whole ring about the seam's
    tangent costs nothing; it stays as it is, and differences in time are free of it.
    """
    shares = np.array([0.8, 0.85, 0.9, 0.95])
    l, k = LENGTH / edges, DIAMETER / 4.0
    body = rope(diameter=DIAMETER, length=LENGTH + 2.0 * l, start=(-l, 0, 0), points=edges + 3)
    omega = 4.0 * _frequency(k, MATERIAL)
    damping = 4.0 * omega
    bent, twisted, rest = 20.0 / omega, 80.0 / omega, 100.0 / omega
    seam = Gripper.still((-0.5 * l, 0.0, 0.0), radius=0.5 * l)
    hands = [
        [seam, _seam(edges, l, (bent, twisted), share * critical)] for share in np.repeat(shares, 2)
    ]
    s = settings.simulator(
        body, [MATERIAL] * len(hands), engine="thin", grippers=hands, gravity=(0, 0, 0),
        air_density=0.0, velocity_damping=damping,
    )  # fmt: skip
    s.run([rest])
    around = 2.0 * math.pi * np.clip(np.arange(-1, edges + 2) / edges, 0.0, 1.0)
    turn, shape = 1.0 - np.cos(around), 1.0 - np.cos(2.0 * around)
    kick = np.zeros((len(hands), edges + 3, 3))
    kick[::2, :, 2] = 3e-2 * (shape - turn * (shape @ turn) / (turn @ turn))
    s.set_velocities(kick)
    t = rest + np.linspace(6.0, 14.0, 17) / omega
    z = s.run(t)[..., 2].astype(float)
    moved = np.linalg.norm(np.diff(z[:, ::2] - z[:, 1::2], axis=0), axis=2)
    squared = _squared_rates(0.5 * (t[1:] + t[:-1]), moved, damping)
    # twists to the left and to the right are alike
    return math.sqrt(_critical(shares**2, squared))


# ---- specimens -----------------------------------------------------------------------------------


def clamped_rope(
    thickness: float,
    points: int,
    *,
    curvature: float = 0.0,
    angle: float = 0.0,
) -> tuple[Body, Gripper]:
    """A rope whose first edge is held, at ``angle``, and whose rest, of ``LENGTH``, begins at 0.

    Args:
        thickness: Or diameter [m].
        points: Of the whole rope.
        curvature: That is free of stress, upwards [1 / L].
        angle: [rad].
    """
    back = LENGTH / (points - 2)
    ds = LENGTH / 4000.0
    theta = angle + curvature * (np.arange(4000) + 0.5) / 4000.0
    along = np.array([math.cos(angle), 0.0, math.sin(angle)])
    line = np.cumsum(ds * np.stack([np.cos(theta), 0.0 * theta, np.sin(theta)], axis=1), axis=0)
    line = np.concatenate([[-back * along, [0.0, 0.0, 0.0]], line])
    body = rope(diameter=thickness, centre_line=line, points=points)
    return body, Gripper.still(-0.5 * back * along, radius=0.5 * back)


def clamped_strip(thickness: float, width: float, points: tuple[int, int]) -> tuple[Body, Gripper]:
    """A level cloth of which ``LENGTH`` is free, from x = 0 on."""
    back = LENGTH / (points[0] - 2)
    body = cloth(
        width=LENGTH + back, height=width, thickness=thickness, dx=LENGTH, points=points,
        corner=(-back, -0.5 * width, 0.0),
    )  # fmt: skip
    return body, Gripper.still((-100.0, 0.0, 0.0), radius=100.0)


def _sag_checks(settings: Settings, of: str, points: int, most: float) -> list[Check]:
    loads = np.geomspace(0.1, most, 3 if settings.quick else 9)
    found = sags(settings, of, loads, points) / sag(loads)
    return [
        Check.within_share(
            f"sag of {of} over theory, Gamma 0.1 to {most:g}, worst of {len(loads)}, "
            f"{points} points",
            "-", 1.0, _worst(found), 0.03, SAG,
        )
    ]  # fmt: skip


def _falls(
    settings: Settings, body: Body, hand: Gripper, material: Material, thickness: float,
    load: float, points: int,
) -> float:  # fmt: skip
    """Weight along y, over ``load`` [E I / L^3], under which a level strip falls over."""
    shares = np.array([0.95, 1.0, 1.05])
    k = thickness / math.sqrt(12.0)
    omega = _frequency(k, material)
    g = load * shares * _unit_gravity(k, material)
    s = settings.simulator(
        body, [material] * len(shares), engine="thin", grippers=[hand], air_density=0.0,
        gravity=np.outer(g, (0.0, -1.0, 0.0)), velocity_damping=2.0 * omega,
    )  # fmt: skip
    # in the plane it is stiff, and soon at rest
    s.run([3.0 / omega])
    bent = np.clip(body.points[:, 0] / LENGTH, 0.0, None) ** 2
    s.set_velocities(np.outer(bent, (0.0, 0.0, 1e-5)))
    t = (3.0 + np.linspace(6.0, 9.0, 7)) / omega
    return _critical(shares, _squared_rates(t, s.run(t)[:, :, points - 1, 2], 2.0 * omega))


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


# ---- readings ------------------------------------------------------------------------------------


def _squared_rates(
    t: NDArray[np.floating], y: NDArray[np.floating], damping: float
) -> NDArray[np.float64]:
    """[W] squared rates at which modes would grow without damping, of sizes y [T, W].

    All velocities decay at one rate c: of y ~ exp(r t) it is r (r + c).
    """
    rate = np.polyfit(t, np.log(np.abs(y.astype(float))), 1)[0]
    return rate * (rate + damping)


def _critical(shares: NDArray[np.floating], squared: NDArray[np.floating]) -> float:
    """Where a parabola through squared rates is 0, the nearest to 1.

    Raises:
        SimulationError: If it is not.
    """
    if not np.isfinite(squared).all():
        raise SimulationError("a kick came to nothing", where="growth")
    zeros = np.roots(np.polyfit(shares, squared, 2))
    zeros = zeros[np.isreal(zeros)].real
    if not len(zeros):
        raise SimulationError("no critical load", where="growth")
    return float(zeros[np.abs(zeros - 1.0).argmin()])


def _worst(ratios: NDArray[np.floating]) -> float:
    return float(ratios[np.abs(ratios - 1.0).argmax()])


def _frequency(k: float, material: Material) -> float:
    """First angular frequency of a cantilever of ``LENGTH`` [rad/s], k its radius of gyration."""
    return 3.516 * math.sqrt(material.specific_modulus) * k / LENGTH**2


def _unit_gravity(k: float, material: Material) -> float:
    """Gravity at which Gamma is 1 [m/s^2]."""
    return material.specific_modulus * k**2 / LENGTH**3
