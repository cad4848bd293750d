"""Ropes as rods: held, bent, twisted, buckled, swinging, damped."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from gendom.materials import Material
from gendom.sim import GRAVITY, Gripper, Simulator, Table, rope
from gendom.sim.thin.rod_model import joint_strains
from gendom.sim.thin.rods import Q, Rods
from gendom.sim.thin.rotation import conjugate, turned
from gendom.validation.beams import ELASTICA, heavy_elastica
from gendom.validation.chain import STIFF, lowest_frequency
from gendom.validation.check import Check, Settings
from gendom.validation.damping import (
    LINEAR_SOLID,
    damped_frequency,
    elastic_frequency,
    first_mode,
    gravity_for,
)
from gendom.validation.friction import thin_on_slopes
from gendom.validation.grip import BEAM
from gendom.validation.specimens import swing
from gendom.validation.torsion import SAINT_VENANT

DIAMETER = 0.01
"""[m]."""

LENGTH = 0.2
"""[m]."""

MATERIAL = Material(E=1.0e6, nu=0.3, density=1000.0)

EULER = "P = 4 pi^2 E I / L^2 of a column clamped at both ends (Euler 1744)"
GREENHILL = "M = 8.987 E I / L, tan(u) = u, of a rod clamped at both ends (Greenhill 1883)"
GRADED = (
    "integral of w (L - s)^3 / (2 E(s) I) by quadrature (Gere and Timoshenko, Mechanics of "
    "Materials), E(s) = E0 exp(a s)"
)
CATENARY = "z = a cosh(x / a) (J. Bernoulli, Huygens, Leibniz 1691)"


def held(settings: Settings) -> list[Check]:
    """A rope held by spheres that end anywhere between two points."""
    checks = []
    for points in (13, 25) if settings.quick else (13, 25, 49):
        radius = np.linspace(0.02, 0.05, 13)
        hands = [[Gripper.still((0, 0, 0), radius=r)] for r in radius]
        free = LENGTH - radius
        g = [gravity_for(0.02 * L, MATERIAL, DIAMETER / 4.0, L) for L in free]
        omega = elastic_frequency(MATERIAL, DIAMETER / 4.0, free.max())
        s = _simulator(
            settings, points, [MATERIAL] * len(free), hands, g, velocity_damping=2.0 * omega
        )
        sag = -s.run([30.0 / omega])[0, :, -1, 2] / (0.02 * free)
        for name, value in (("least", sag.min()), ("largest", sag.max())):
            checks.append(
                Check.within_share(
                    f"{name} of 13 sags over theory, {points} points", "-", 1.0, float(value),
                    0.02 if points < 25 else 0.01, BEAM,
                )
            )  # fmt: skip
    return checks


def elastica(settings: Settings) -> list[Check]:
    """A rope of 1, 2 and 3 bending lengths, clamped level; the error falls with points squared."""
    ratios = np.array([1.0, 2.0, 3.0])
    material, d = Material(E=2.0e7, nu=0.3, density=1000.0), 0.004
    k, back, L = d / 4.0, 0.02, 0.3
    omega = 3.516 * math.sqrt(material.E_over_rho) * k / L**2
    g = material.E_over_rho * k**2 * ratios**3 / L**3
    counts = (17, 33) if settings.quick else (17, 33, 65)
    errors = []
    for points in counts:
        body = rope(
            diameter=d, length=L + back, start=(-back, 0, 0), points=points
        )  # the clamp ends on a point: (points - 1) / 16 edges are held
        hand = Gripper.still((-back, 0, 0), radius=back)
        s = settings.simulator(
            body, [material] * 3, engine="thin", grippers=[hand], air_density=0.0,
            gravity=np.stack([0 * g, 0 * g, -g], axis=1), velocity_damping=2.0 * omega,
        )  # fmt: skip
        tip = s.run([16.0 / omega])[0][:, -1, [0, 2]] / L
        expected = np.array([heavy_elastica(r)([1.0])[0] for r in ratios])
        errors.append(np.linalg.norm(tip - expected, axis=1))
    return [
        Check.within(
            f"tip's distance from the elastica / L, {ratio:g} bending lengths, {counts[-1]} points",
            "-", 0.0, float(errors[-1][w]), 0.003, ELASTICA,
        )
        for w, ratio in enumerate(ratios)
    ]  # fmt: skip


def graded(settings: Settings) -> list[Check]:
    """Level ropes that get ten times as stiff, or as soft, from the clamp to the tip."""
    material, rates = replace(MATERIAL, E=2.0e7), np.array([1.0, -1.0]) * math.log(10.0)
    d, points, back = LENGTH / 100.0, 41, LENGTH / 39.0
    k = d / 4.0
    body = rope(diameter=d, length=LENGTH + back, start=(-back, 0, 0), points=points)
    hand = Gripper.still((-0.5 * back, 0, 0), radius=0.5 * back)
    # sags over w L^4 / (E0 I), and loads under which they are 0.5 % of the length
    theory = [quad(lambda s, a=a: 0.5 * (1 - s) ** 3 * math.exp(-a * s), 0, 1)[0] for a in rates]
    sag = 5e-3 * LENGTH
    g = sag / np.array(theory) * material.E_over_rho * k**2 / LENGTH**4
    along = np.clip(body.points[:, 0] / LENGTH, 0.0, None)
    omega = 1.24 * np.sqrt(g / sag)
    s = settings.simulator(
        body, [material] * 2, engine="thin", grippers=[hand], air_density=0.0,
        gravity=np.outer(g, (0.0, 0.0, -1.0)), stiffness=np.exp(np.outer(rates, along)),
        velocity_damping=2.0 * omega,
    )  # fmt: skip
    found = -s.run([24.0 / omega.min()], particles=[points - 1])[0, :, 0, 2] / sag
    return [
        Check.within_share(
            f"sag over theory of a rope ten times as {name} at its tip", "-", 1.0, float(value),
            0.01, GRADED,
        )
        for name, value in zip(("stiff", "soft"), found, strict=True)
    ]  # fmt: skip


def ring_down(settings: Settings) -> list[Check]:
    """A clamped rope pushed in its first mode, with damping of 1, 3 and 10 ms and without."""
    times = (0.0, 0.001, 0.003, 0.01)
    material, L = replace(MATERIAL, E=4.0e6), 0.1
    omega = elastic_frequency(material, DIAMETER / 4.0, L)
    body = rope(diameter=DIAMETER, length=2.0 * L, start=(-L, 0, 0), points=33)
    s = settings.simulator(
        body, [replace(material, damping=t) for t in times], engine="thin",
        grippers=[Gripper.still((-L, 0, 0), radius=L)], gravity=(0, 0, 0), air_density=0.0,
    )  # fmt: skip
    speed = 0.01 * L * omega
    y, _, _ = first_mode(body.points[:, 0], L)
    s.set_velocities(np.stack([0 * y, 0 * y, speed * y], axis=1))
    t = np.linspace(0.5, 2.5, 81) * 2.0 * math.pi / omega
    tips = s.run(t)[:, :, -1, 2]
    checks = []
    for w, tau in enumerate(times):
        frequency, rate = swing(t, tips[:, w], omega)
        size = f"damping {1e3 * tau:g} ms"
        if tau == 0.0:
            own = 1e3 * 2.0 * rate / frequency**2
            checks.append(
                Check.within(
                    "what the integrator itself damps",
                    "ms",
                    0.0,
                    own,
                    0.002,
                    "a leapfrog has no damping",
                )
            )  # fmt: skip
            continue
        expected, decay = damped_frequency(omega, tau)
        checks += [
            Check.within_share(f"decay rate, {size}", "1/s", decay, rate, 0.05, LINEAR_SOLID),
            Check.within_share(
                f"frequency, {size}", "Hz", expected / (2 * math.pi), frequency / (2 * math.pi),
                0.02, LINEAR_SOLID,
            ),
        ]  # fmt: skip
    return checks


def hanging(settings: Settings) -> list[Check]:
    """A soft rope 100 diameters long that swings in its first mode."""
    d = 0.005
    L, k, g = 100 * d, d / 4.0, -GRAVITY[2]
    specific = 50.0 * g * L
    points = 33 if settings.quick else 65
    body = rope(diameter=d, length=1.05 * L, direction=(0, 0, -1), points=points)
    hand = Gripper.still((0, 0, 0), radius=0.05 * L)
    along = -body.points[:, 2]
    below = np.clip(1.05 * L - along, 0.0, L)
    x = body.points.copy()
    x[:, 2] -= g * (L**2 - below**2) / (2.0 * specific)
    material = Material(E=1000.0 * specific, nu=0.3, density=1000.0)
    s = settings.simulator(
        body, [material], engine="thin", grippers=[hand], positions=x, air_density=0.0
    )
    stiff = lowest_frequency(specific, k, L, g)
    s.set_velocities(np.outer((1.0 - below / L) ** 2 * 0.02 * L * stiff, (1.0, 0.0, 0.0)))
    t = np.linspace(0.0, 3.0 * 2.0 * math.pi / stiff, 181)
    found, _ = swing(t, _smooth(s.run(t)[:, 0, -1, 0]), stiff)
    return [
        Check.within_share(
            f"period with bending stiffness and stretch, {points} points",
            "s", 2 * math.pi / stiff, 2 * math.pi / found, 0.01, STIFF,
        )
    ]  # fmt: skip


def twist(settings: Settings) -> list[Check]:
    """A straight rope, one end clamped, the other turned by 0.3 rad: its moment everywhere."""
    L, angle = LENGTH, 0.3
    body = rope(diameter=DIAMETER, length=1.5 * L, start=(-0.25 * L, 0, 0), points=49)
    s = settings.simulator(
        body, [replace(MATERIAL, damping=0.02)], engine="thin", air_density=0.0,
        grippers=_clamps(L, 0.0, angle), gravity=(0, 0, 0),
    )  # fmt: skip
    s.run([3.0])
    assert isinstance(s.engine, Rods)
    k = s.engine.model.stiffness[0, 5, 1:-1] * s.engine.stiffer[0, :, 0].prod(axis=0)[1:-1]
    free = np.abs(body.points[1:-1, 0] - 0.5 * L) < 0.49 * L
    moment = (k * joint_strains(s.engine.component(Q)[:, :-1])[0, :, 2])[free]
    expected = MATERIAL.lame[0] * math.pi * DIAMETER**4 / 32.0 / L * angle
    return [
        Check.within_share(
            "moment of a twisted rope", "N m", expected, float(moment.mean()), 0.01, SAINT_VENANT
        ),
        Check.within(
            "spread of the moment along it", "-", 0.0, float(np.ptp(moment) / expected), 1e-3,
            "equilibrium",
        ),
    ]  # fmt: skip


def buckling(settings: Settings) -> list[Check]:
    """Clamped ropes that are pushed together, or twisted.

    Each is given a small kick. The rate at which it grows, squared (or minus the squared frequency
    at which it swings), is linear in the load near the critical one: its zero is read off a line.
    """
    shares, L = np.array([0.9, 0.95, 1.05, 1.1]), LENGTH
    strain = 4.0 * math.pi**2 * (DIAMETER / 4.0) ** 2 / L**2
    pushed = [_clamps(L, share * strain * L, 0.0) for share in shares]
    # G J = E I / (1 + nu)
    twisted = [_clamps(L, 0.0, share * 8.9868 * (1.0 + MATERIAL.nu)) for share in shares]
    return [
        Check.within_share(
            f"critical {name}", "-", 1.0, _zero(shares, _growth(settings, hands)), 0.03, source
        )
        for name, hands, source in (
            ("shortening, P L / (E A)", pushed, EULER),
            ("twist, M L / (G J)", twisted, GREENHILL),
        )
    ]


def catenary(settings: Settings) -> list[Check]:
    """A thin soft rope that hangs from two points as far apart as 0.7 of its length."""
    d, L = 0.002, 0.6
    material = Material(E=5.0e6, nu=0.3, density=1000.0)
    span = 0.7 * L
    points = 65
    body = rope(diameter=d, length=L, start=(-L / 2, 0, 0), points=points)
    # the middle is let down while the ends come together
    knots = [0.0, 1.0]
    hands = [
        Gripper(time=knots, position=[(side * L / 2, 0, 0), (side * span / 2, 0, 0)], radius=0.001)
        for side in (-1.0, 1.0)
    ]
    s = settings.simulator(
        body, [material], engine="thin", grippers=hands, velocity_damping=4.0, air_density=0.0
    )
    x = s.run([4.0])[0, 0]
    middle = -x[points // 2, 2]
    a = brentq(lambda a: 2.0 * a * math.sinh(span / (2.0 * a)) - L, 0.05, 10.0)
    assert isinstance(a, float)
    sag = a * (math.cosh(span / (2.0 * a)) - 1.0)
    return [
        Check.within_share(
            "sag of a hanging rope", "m", sag, float(middle), 0.02,
            CATENARY + "; its ends are clamped level, which takes some of it",
        )
    ]  # fmt: skip


def on_the_table(settings: Settings) -> list[Check]:
    """A rope dropped on the table; ropes on slopes below and above the angle of friction."""
    body = rope(diameter=DIAMETER, length=LENGTH, start=(0, 0, 0.02), direction=(1, 0.2, 0))
    s = settings.simulator(body, [MATERIAL], engine="thin", table=Table(height=0.0))
    z = s.run([1.0])[0, 0][:, 2]
    checks = [
        Check.within(
            "height of a resting rope over its radius", "-", 0.0,
            float(np.abs(z / (DIAMETER / 2) - 1.0).max()), 1e-6,
            "a body at rest touches the table with its surface",
        )
    ]  # fmt: skip
    return checks + thin_on_slopes(settings, body.moved((0, 0, DIAMETER / 2 - 0.02)), MATERIAL)


def free_flight(settings: Settings) -> list[Check]:
    """A bent and spinning rope in space: momentum, angular momentum and energy."""
    body = rope(diameter=DIAMETER, length=LENGTH, start=(-LENGTH / 2, 0, 0))
    u = body.points[:, 0] / (LENGTH / 2)
    s = settings.simulator(
        body, [replace(MATERIAL, E=1.0e5)], engine="thin", air_density=0.0, gravity=(0, 0, 0)
    )
    s.set_velocities(np.stack([0.1 * u, 0.8 * u, 1.5 - 2.0 * u**2], axis=1))
    readings = [momenta_and_energy(s)]
    for t in np.linspace(0.0, 1.0, 101)[1:]:
        s.run([t])
        readings.append(momenta_and_energy(s))
    P = np.array([r[0] for r in readings])
    Lz = np.array([r[1] for r in readings])
    E = np.array([sum(r[2]) for r in readings])
    scale = readings[0][2][0]
    return [
        Check.within(
            "drift of momentum", "-", 0.0,
            float(np.abs(P - P[0]).max() / np.abs(P[0]).max()), settings.round_off(1e-10, 1e-4),
            "nothing pushes it",
        ),
        Check.within(
            "drift of angular momentum about the centre", "-", 0.0,
            float(np.abs(Lz - Lz[0]).max() / np.abs(Lz[0]).max()), settings.round_off(1e-10, 1e-3),
            "nothing turns it",
        ),
        Check.within(
            "largest change of energy over the kinetic energy at first", "-", 0.0,
            float(np.ptp(E) / scale), 0.02,
            "a leapfrog keeps energy but for an oscillation (Hairer, Lubich, Wanner 2006); "
            "velocities are read half a step before positions",
        ),
    ]  # fmt: skip


def precision(settings: Settings) -> list[Check]:
    """A lift off the table in float32 and float64."""
    worlds = [Material(E=E, damping=0.003) for E in (1e5, 1e6, 1e7)]
    body = rope(diameter=0.01, length=0.3, start=(0, 0, 0.005))
    hand = Gripper(time=[0, 1], position=[(0, 0, 0.005), (0, 0, 0.305)], radius=0.0075)
    single, double = (
        replace(settings, dtype=dtype)
        .simulator(body, worlds, engine="thin", grippers=[hand], table=Table(height=0.0))
        .run([0.5, 1.0])
        for dtype in ("float32", "float64")
    )
    return [
        Check.within(
            "largest difference of float32 from float64, over a lift by 0.3 m", "-", 0.0,
            float(np.abs(single - double).max() / 0.3), 1e-3,
            "round-off: 2^-24 a number (IEEE 754)",
        )
    ]  # fmt: skip


# ---- specimens -----------------------------------------------------------------------------------


def momenta_and_energy(
    s: Simulator,
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[float, float]]:
    """Momentum [3], angular momentum about the centre of mass [3], and kinetic and elastic energy
    [J] of a rod, world 0."""
    e = s.engine
    assert isinstance(e, Rods)
    m, J = e.model.mass[0], e.model.inertia[0, :-1]
    x, v = s.positions()[0].astype(float), s.velocities()[0].astype(float)
    q, spin = e.component(Q)[0][:-1], e.component(slice(10, 13))[0][:-1]
    out = x - m @ x / m.sum()
    P, turn = m @ v, np.cross(out, m[:, None] * v).sum(axis=0) + J @ spin
    k, rest = e.model.stiffness[0], e.model.rest
    strain = turned(conjugate(q), np.diff(x, axis=0)) * rest[0, :-1, None] - rest[1:4, :-1].T
    bend = joint_strains(q) - rest[4:, 1:-1].T
    at_grips = e.stiffer[0, :, 0].prod(axis=0)[1:-1]
    elastic = 0.5 * np.sum(k[:3, :-1].T * strain**2 / rest[0, :-1, None])
    elastic += 0.5 * np.sum(k[3:, 1:-1].T * at_grips[:, None] * bend**2)
    kinetic = 0.5 * np.sum(m[:, None] * v**2) + 0.5 * np.sum(J[:, None] * spin**2)
    return P, turn, (float(kinetic), float(elastic))


def _simulator(settings, points, materials, hands, gravity, **options) -> Simulator:
    body = rope(diameter=DIAMETER, length=LENGTH, points=points)
    down = np.outer(gravity, (0.0, 0.0, -1.0))
    return settings.simulator(
        body, materials, engine="thin", grippers=hands, gravity=down, air_density=0.0, **options
    )


def _smooth(y: NDArray[np.floating]) -> NDArray[np.floating]:
    """Without what is faster than five samples: higher modes of a soft rope."""
    return np.convolve(np.pad(y, 2, mode="edge"), np.full(5, 0.2), mode="valid")


def _clamps(L: float, shortening: float, angle: float) -> list[Gripper]:
    """Clamps at both ends of the free length from 0 to L, the far one pushed in and turned."""
    share = np.linspace(0.0, 1.0, 13)  # no segment turns by half a turn
    far = 1.25 * L
    return [
        Gripper.still((-0.25 * L, 0, 0), radius=0.25 * L),
        Gripper(
            time=2.0 * share,
            position=np.outer(far - shortening * share, (1.0, 0.0, 0.0)),
            quat_xyzw=Rotation.from_rotvec(np.outer(angle * share, (1.0, 0.0, 0.0))).as_quat(),
            radius=0.25 * L,
        ),
    ]


def _growth(settings: Settings, hands: list[list[Gripper]]) -> NDArray[np.float64]:
    """[W] squared rates [1/s^2] at which small kicks grow; negative: squared frequencies."""
    body = rope(diameter=DIAMETER, length=1.5 * LENGTH, start=(-0.25 * LENGTH, 0, 0), points=49)
    s = settings.simulator(
        body, [MATERIAL] * len(hands), engine="thin", grippers=hands, gravity=(0, 0, 0),
        air_density=0.0,
    )  # fmt: skip
    s.run([2.5])  # nothing bends it
    place = np.clip(2.0 * body.points[:, 0] / LENGTH - 1.0, -1.0, 1.0)
    kick = 1e-4 * np.outer(1.0 + np.cos(math.pi * place), (0.0, 0.0, 1.0))
    s.set_velocities(kick)
    t = np.linspace(0.01, 0.15, 29)
    bent = np.linalg.norm(s.run(2.5 + t)[..., 1:], axis=-1).max(axis=-1)
    return np.array([_rate(t, y) for y in bent.T])


def _rate(t: NDArray[np.floating], y: NDArray[np.floating]) -> float:
    """r^2 of y = c sinh(r t) / r, or of sin where it is negative, by least squares."""

    def misfit(square: float) -> float:
        r = math.sqrt(abs(square)) + 1e-9
        f = np.sinh(r * t) / r if square > 0 else np.sin(r * t) / r
        return float(np.sum((y - f * (f @ y) / (f @ f)) ** 2))

    squares = np.linspace(-2000.0, 2000.0, 4001)
    return float(squares[int(np.argmin([misfit(square) for square in squares]))])


def _zero(shares: NDArray[np.floating], squared: NDArray[np.floating]) -> float:
    slope, offset = np.polyfit(shares, squared, 1)
    return float(-offset / slope)
