"""Cloths with an outline: discs, and strips that are cut at an angle to the lattice."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim import AIR_DENSITY, GRAVITY, Body, Gripper, cloth
from gendom.sim.thin.shells import Shells
from gendom.validation.air import HOERNER
from gendom.validation.check import Check, Settings
from gendom.validation.elastica import sag
from gendom.validation.master_curves import SAG
from gendom.validation.specimens import swing

THICKNESS, RADIUS = 0.002, 0.1
"""[m]."""

MATERIAL = Material(E=2.0e7, nu=0.3, density=1000.0)

RIGIDITY = MATERIAL.E * THICKNESS**3 / (12.0 * (1.0 - MATERIAL.nu**2))
"""[N m]."""

POINTS = {15: 0.10, 28: 0.03, 45: 0.03}
"""Along a lattice's longer side, and the share of theory that errors may have."""

FREE_DISC = 5.3583
"""omega R^2 sqrt(rho h / D) of a free disc's first mode, two diameters at rest, nu 0.3."""

LEISSA = "5.358 sqrt(D / (rho h)) / R^2, nu 0.3 (Leissa 1969, Vibration of Plates, table 2.5)"
ANNULUS = (
    "plate clamped within, free outside: q r^4 / (64 D) + c1 + c2 r^2 + c3 ln r + c4 r^2 ln r "
    "(Timoshenko, Theory of Plates and Shells, chapter 3)"
)


def discs(settings: Settings) -> list[Check]:
    """Mass and its centre, terminal speed, and vibration of discs."""
    return [*_masses(), *_fall(settings), *_vibrations(settings)]


def held_discs(settings: Settings) -> list[Check]:
    """Discs that are held in their middle, and hang down at the rim by 1 % of their thickness."""
    inner = 0.25 * RADIUS
    unit = _rim_sag(1.0, inner, RADIUS)
    g = 0.01 * THICKNESS / (unit * MATERIAL.density * THICKNESS)
    checks = []
    for points, allowed in _sizes(settings):
        body = disc(points)
        s = settings.simulator(
            body, [MATERIAL], engine="thin", gravity=(0, 0, -g), air_density=0.0,
            grippers=[Gripper.still((0, 0, 0), radius=inner)],
        )  # fmt: skip
        x = body.surface(s.run([1.0])[0, 0])
        rim = np.linalg.norm(body.surface(body.points), axis=1) > 0.999 * RADIUS
        checks.append(
            Check.within_share(
                f"sag of a disc's rim over theory, {points} points across", "-", 1.0,
                -float(x[rim, 2].mean()) / (0.01 * THICKNESS), allowed, ANNULUS,
            )
        )  # fmt: skip
    return checks


def cut_strips(settings: Settings) -> list[Check]:
    """Clamped strips, cut at 20 and 45 degrees to the lattice, under weights over two decades."""
    L, back, width = 0.2, 0.025, 0.06
    material = Material(E=2.0e7, nu=0.0, density=1000.0)
    loads = np.array([0.3, 30.0])
    g = loads * material.E_over_rho * THICKNESS**2 / (12.0 * L**3)
    strip = np.array([(-back, -0.5), (L, -0.5), (L, 0.5), (-back, 0.5)]) * [1.0, width]
    checks = []
    for degrees in (20.0, 45.0):
        a = math.radians(degrees)
        turn = np.array([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]])
        size = np.ptp(strip @ turn, axis=0)
        for points, allowed in _sizes(settings):
            count = np.rint(1 + size / size.max() * (points - 1)).astype(int)
            body = cloth(
                outline=strip @ turn, thickness=THICKNESS, dx=0.02, yaw=-a,
                points=(int(count[0]), int(count[1])),
            )  # fmt: skip
            s = settings.simulator(
                body, [material] * len(loads), engine="thin", air_density=0.0,
                grippers=[Gripper.still((-100.0, 0.0, 0.0), radius=100.0)],
                gravity=np.outer(g, (0.0, 0.0, -1.0)),
            )  # fmt: skip
            x = body.surface(s.run([1.0])[0])
            end = x[:, np.abs(body.surface(body.points)[:, 0] - L) < 1e-9].mean(axis=1)
            ratios = -end[:, 2] / end[:, 0] / sag(loads)
            worst = float(ratios[np.abs(ratios - 1.0).argmax()])
            checks.append(
                Check.within_share(
                    f"sag of a strip cut at {degrees:g} degrees over theory, worst of "
                    f"{len(loads)}, {points} points",
                    "-", 1.0, worst, allowed, SAG,
                )
            )  # fmt: skip
    return checks


# ---- discs ---------------------------------------------------------------------------------------


def _masses() -> list[Check]:
    """Of discs with a hole beside their middle: those of their area."""
    area, centre, hole = math.pi * RADIUS**2, [], 0.3 * RADIUS
    errors = []
    at = np.array([0.4 * RADIUS, 0.2 * RADIUS])
    for points in POINTS:
        body = cloth(
            outline=[circle(RADIUS), circle(hole) + at], thickness=THICKNESS, dx=0.02,
            points=(points, points),
        )  # fmt: skip
        assert body.cut is not None
        left = area - math.pi * hole**2
        errors.append(abs(body.cut.area.sum() / left - 1.0))
        found = body.cut.area @ body.points[:, :2] / left
        centre.append(float(np.abs(found + math.pi * hole**2 / left * at).max()) / RADIUS)
    return [
        Check.within(
            "mass of discs with a hole over that of their area, less 1", "-", 0.0, max(errors),
            1e-12, "pi (R^2 - r^2) h rho",
        ),
        Check.within(
            "error of the centre of mass over R", "-", 0.0, max(centre), 1e-12,
            "-r^2 d / (R^2 - r^2)",
        ),
    ]  # fmt: skip


def _fall(settings: Settings) -> list[Check]:
    light = Material(E=2.0e6, nu=0.3, density=200.0)
    speed = math.sqrt(2.0 * light.density * -GRAVITY[2] * THICKNESS / (1.2 * AIR_DENSITY))
    s = settings.simulator(disc(15), [light], engine="thin", air_density=AIR_DENSITY)
    s.run([4.0 * speed / -GRAVITY[2]])
    assert isinstance(s.engine, Shells)
    mass = s.engine.mass[0]
    found = -float(mass @ s.velocities()[0, :, 2] / mass.sum())
    return [
        Check.within_share(
            "a disc's terminal speed", "m/s", speed, found, 0.03,
            "sqrt(2 m g / (rho c pi R^2)) " + HOERNER,
        )
    ]  # fmt: skip


def _vibrations(settings: Settings) -> list[Check]:
    """A disc in space that swings between two saddles."""
    omega = FREE_DISC * math.sqrt(RIGIDITY / (MATERIAL.density * THICKNESS)) / RADIUS**2
    checks = []
    for points, allowed in _sizes(settings):
        body = disc(points)
        s = settings.simulator(body, [MATERIAL], engine="thin", gravity=(0, 0, 0), air_density=0.0)
        assert isinstance(s.engine, Shells)
        saddle = (body.points[:, 0] ** 2 - body.points[:, 1] ** 2) / RADIUS**2
        s.set_velocities(np.outer(0.01 * THICKNESS * omega * saddle, (0.0, 0.0, 1.0)))
        t = np.linspace(0.2, 2.2, 61) * 2.0 * math.pi / omega
        z = s.run(t)[:, 0, :, 2] @ (s.engine.mass[0] * saddle)
        found, _ = swing(t, z / np.abs(z).max(), omega)
        checks.append(
            Check.within_share(
                f"frequency of a free disc, {points} points across", "Hz",
                omega / (2.0 * math.pi), found / (2.0 * math.pi), allowed, LEISSA,
            )
        )  # fmt: skip
    return checks


def _rim_sag(q: float, a: float, b: float) -> float:
    """How far the rim r = b of a plate clamped at r = a hangs down under q [N/m^2], see
    ``ANNULUS`` [m]."""

    def rows(r: float) -> NDArray[np.float64]:
        """Deflection, slope, second derivative and d/dr of the Laplacian of the four terms and of
        the load's."""
        log = math.log(r)
        return np.array(
            [
                [1.0, r**2, log, r**2 * log, q * r**4 / (64.0 * RIGIDITY)],
                [0.0, 2.0 * r, 1.0 / r, 2.0 * r * log + r, q * r**3 / (16.0 * RIGIDITY)],
                [0.0, 2.0, -1.0 / r**2, 2.0 * log + 3.0, 3.0 * q * r**2 / (16.0 * RIGIDITY)],
                [0.0, 0.0, 0.0, 4.0 / r, q * r / (2.0 * RIGIDITY)],
            ]
        )

    inner, outer = rows(a), rows(b)
    moment = outer[2] + MATERIAL.nu / b * outer[1]
    all_zero = np.stack([inner[0], inner[1], moment, outer[3]])
    c = np.linalg.solve(all_zero[:, :4], -all_zero[:, 4])
    return float(outer[0, :4] @ c + outer[0, 4])


# ---- specimens -----------------------------------------------------------------------------------


def circle(radius: float, sides: int = 256) -> NDArray[np.float64]:
    """[sides, 2] a regular polygon with a circle's area [m]."""
    angle = 2.0 * math.pi * np.arange(sides) / sides
    area = 0.5 * sides * math.sin(2.0 * math.pi / sides)
    return radius * math.sqrt(math.pi / area) * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def disc(points: int) -> Body:
    """Of ``RADIUS``, with so many points across."""
    return cloth(outline=circle(RADIUS), thickness=THICKNESS, dx=0.02, points=(points, points))


def _sizes(settings: Settings) -> list[tuple[int, float]]:
    return [(n, share) for n, share in POINTS.items() if n < 40 or not settings.quick]
