"""Cloths as shells: bent along any direction, stretched, damped, dropped."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gendom.materials import Material
from gendom.sim import AIR_DENSITY, GRAVITY, Gripper, Simulator, Table, cloth
from gendom.sim.thin.shells import Shells
from gendom.validation.air import HOERNER
from gendom.validation.beams import BEAM
from gendom.validation.check import Check, Settings
from gendom.validation.damping import LINEAR_SOLID, damped_frequency, first_mode
from gendom.validation.friction import thin_on_slopes
from gendom.validation.specimens import swing

THICKNESS = 0.002
"""[m]."""

MATERIAL = Material(E=2.0e7, nu=0.0, density=1000.0)

PLATE = "U = D / 2 kappa^2 A, D = E h^3 / (12 (1 - nu^2)) (Timoshenko, Theory of Plates and Shells)"
HOOKE = "plane stress (Hooke; Timoshenko, Theory of Elasticity)"


def strips(settings: Settings) -> list[Check]:
    """Clamped strips along both axes that sag by 2 % of their length; the clamp ends anywhere."""
    L, width = 0.2, 0.03
    k = THICKNESS / math.sqrt(12.0)
    omega = 3.516 * math.sqrt(MATERIAL.E_over_rho) * k / L**2
    g = 8.0 * MATERIAL.E_over_rho * k**2 * 0.02 / L**3
    checks = []
    for axis, name in ((0, "first"), (1, "second")):
        sags = []
        for back in np.linspace(0.02, 0.04, 2 if settings.quick else 5):
            size = {"width": L + back, "height": width, "points": (23, 4)}
            corner = (-back, -width / 2.0, 0.0)
            if axis == 1:
                size = {"width": width, "height": L + back, "points": (4, 23)}
                corner = (-width / 2.0, -back, 0.0)
            body = cloth(thickness=THICKNESS, dx=0.02, corner=corner, **size)
            hand = _beyond(axis)
            s = settings.simulator(
                body, [MATERIAL], engine="thin", grippers=[hand], gravity=(0, 0, -g),
                velocity_damping=2.0 * omega, air_density=0.0,
            )  # fmt: skip
            x = s.run([16.0 / omega])[0, 0]
            end = body.points[:, axis] > L - 1e-9
            sags.append(-float(x[end, 2].mean()) / (0.02 * L))
        for which, value in (("least", min(sags)), ("largest", max(sags))):
            checks.append(
                Check.within_share(
                    f"{which} sag over theory, strip along the {name} axis", "-", 1.0, value,
                    0.02, BEAM,
                )
            )  # fmt: skip
    return checks


def cylinders(settings: Settings) -> list[Check]:
    """A square rolled to a cylinder along its sides, its diagonal and between."""
    checks = []
    R, size = 0.5, 0.2
    for nu in (0.0, 0.3):
        material = replace(MATERIAL, nu=nu)
        # free ends carry no moment: of n points in a row n - 2 do
        body = cloth(width=size, height=size, thickness=THICKNESS, dx=0.02, points=(121, 121))
        D = material.E * THICKNESS**3 / (12.0 * (1.0 - nu**2))
        for degrees in (0.0, 22.5, 45.0, 90.0):
            a = math.radians(degrees)
            along = body.points[:, :2] @ [math.cos(a), math.sin(a)]
            across = body.points[:, :2] @ [-math.sin(a), math.cos(a)]
            u, v, w = R * np.sin(along / R), across, R * (1.0 - np.cos(along / R))
            x = np.stack(
                [u * math.cos(a) - v * math.sin(a), u * math.sin(a) + v * math.cos(a), w], axis=1
            )
            s = settings.simulator(body, [material], engine="thin", positions=x)
            energy = bending_energy(s)
            checks.append(
                Check.within_share(
                    f"energy of a sheet rolled at {degrees:g} degrees, nu {nu:g}", "J",
                    0.5 * D * size**2 / R**2, energy, 0.01, PLATE,
                )
            )  # fmt: skip
    return checks


def stretched(settings: Settings) -> list[Check]:
    """Forces that hold a sheet in a plane deformation: uniaxial, both ways, and sheared."""
    nu, strain = 0.3, 1e-4
    material = replace(MATERIAL, nu=nu)
    body = cloth(width=0.2, height=0.15, thickness=THICKNESS, dx=0.02, points=(12, 9))
    E, area = material.E, 0.2 * 0.15 * THICKNESS
    plane = E / (1.0 - nu**2)
    ways = {
        "uniaxial": (np.diag([strain, -nu * strain]), E * strain**2),
        "biaxial": (np.diag([strain, strain]), 2.0 * plane * (1.0 + nu) * strain**2),
        "sheared": (np.array([[0, strain], [0, 0]]), E / (2.0 * (1.0 + nu)) * strain**2),
    }
    checks = []
    for name, (gradient, density) in ways.items():
        x = body.points.copy()
        x[:, :2] += body.points[:, :2] @ gradient.T
        s = settings.simulator(body, [material], engine="thin", positions=x)
        checks.append(
            Check.within_share(
                f"{name} energy", "J", 0.5 * density * area, membrane_energy(s), 2e-3, HOOKE
            )
        )
    return checks


def ring_down(settings: Settings) -> list[Check]:
    """A clamped strip pushed in its first mode, with damping of 1, 3 and 10 ms and without."""
    times, L = (0.0, 0.001, 0.003, 0.01), 0.15
    omega = 1.8751040687**2 * math.sqrt(MATERIAL.E_over_rho / 12.0) * THICKNESS / L**2
    body = cloth(
        width=2.0 * L, height=0.02, thickness=THICKNESS, dx=0.02, corner=(-L, 0, 0), points=(49, 3)
    )
    s = settings.simulator(
        body, [replace(MATERIAL, damping=t) for t in times], engine="thin",
        grippers=[_beyond(0)], gravity=(0, 0, 0), air_density=0.0,
    )  # fmt: skip
    y, _, _ = first_mode(body.points[:, 0], L)
    s.set_velocities(np.outer(0.01 * L * omega * y, (0.0, 0.0, 1.0)))
    t = np.linspace(0.5, 2.5, 81) * 2.0 * math.pi / omega
    tips = s.run(t)[:, :, -1, 2]
    checks = []
    for w, tau in enumerate(times):
        frequency, rate = swing(t, tips[:, w], omega)
        if tau == 0.0:
            own = 1e3 * 2.0 * rate / frequency**2
            checks.append(
                Check.within(
                    "what the integrator itself damps", "ms", 0.0, own, 0.002,
                    "a leapfrog has no damping",
                )
            )  # fmt: skip
            continue
        expected, decay = damped_frequency(omega, tau)
        size = f"damping {1e3 * tau:g} ms"
        checks += [
            Check.within_share(f"decay rate, {size}", "1/s", decay, rate, 0.05, LINEAR_SOLID),
            Check.within_share(
                f"frequency, {size}", "Hz", expected / (2 * math.pi), frequency / (2 * math.pi),
                0.02, LINEAR_SOLID,
            ),
        ]  # fmt: skip
    return checks


def falls(settings: Settings) -> list[Check]:
    """A sheet that falls flat through air, and one that comes to rest on the table; on slopes."""
    light = Material(E=2.0e6, nu=0.3, density=200.0)
    body = cloth(width=0.1, height=0.1, thickness=0.001, dx=0.02, points=(9, 9))
    speed = math.sqrt(2.0 * light.density * -GRAVITY[2] * 0.001 / (1.2 * AIR_DENSITY))
    s = settings.simulator(body, [light], engine="thin", air_density=AIR_DENSITY)
    s.run([4.0 * speed / -GRAVITY[2]])
    found = -float(s.velocities()[0, :, 2].mean())
    checks = [
        Check.within_share(
            "a sheet's terminal speed", "m/s", speed, found, 0.03,
            "sqrt(2 m g / (rho c A)) " + HOERNER,
        )
    ]  # fmt: skip
    s = settings.simulator(body.moved((0, 0, 0.02)), [light], engine="thin", table=Table(height=0))
    z = s.run([1.0])[0, 0][:, 2]
    checks.append(
        Check.within(
            "height of a resting sheet over half its thickness", "-", 0.0,
            float(np.abs(z / 0.0005 - 1.0).max()), 1e-6,
            "a body at rest touches the table with its surface",
        )
    )  # fmt: skip
    return checks + thin_on_slopes(settings, body.moved((0, 0, 0.0005)), light)


def free_flight(settings: Settings) -> list[Check]:
    """A crumpling and spinning sheet in space: momentum, angular momentum and energy."""
    material = Material(E=1.0e5, nu=0.3, density=500.0)
    body = cloth(
        width=0.2, height=0.15, thickness=0.001, dx=0.02, corner=(-0.1, -0.075, 0), points=(15, 11)
    )
    s = settings.simulator(
        body, [material], engine="thin", air_density=0.0, gravity=(0, 0, 0), cfl=0.2
    )
    u, w = body.points[:, 0] / 0.1, body.points[:, 1] / 0.075
    s.set_velocities(np.stack([-0.3 * w, 0.4 * u, 1.0 - 2.0 * u**2 + u * w], axis=1))
    assert isinstance(s.engine, Shells)
    mass = s.engine.mass[0]
    readings = []
    for t in np.linspace(0.0, 0.5, 51):
        s.run([t])
        x, v = s.positions()[0].astype(float), s.velocities()[0].astype(float)
        out = x - mass @ x / mass.sum()
        kinetic = 0.5 * float(mass @ np.sum(v**2, axis=1))
        energy = kinetic + membrane_energy(s) + bending_energy(s)
        readings.append((mass @ v, np.cross(out, mass[:, None] * v).sum(axis=0), energy, kinetic))
    P, turn, E, K = (np.array(of) for of in zip(*readings, strict=True))
    return [
        Check.within(
            f"drift of {name}", "-", 0.0, float(np.abs(a - a[0]).max() / np.abs(a[0]).max()),
            settings.round_off(1e-10, 1e-3), "nothing pushes or turns it",
        )
        for name, a in (("momentum", P), ("angular momentum", turn))
    ] + [
        Check.within(
            "largest change of energy over the kinetic energy at first", "-", 0.0,
            float(np.ptp(E) / K[0]), 0.02,
            "a leapfrog keeps energy but for an oscillation (Hairer, Lubich, Wanner 2006); "
            "velocities are read half a step before positions",
        )
    ]  # fmt: skip


# ---- specimens -----------------------------------------------------------------------------------


def membrane_energy(s: Simulator) -> float:
    """Of world 0 [J], from the lattice's edges as ``native/shell.h`` says."""
    e = s.engine
    assert isinstance(e, Shells)
    ny, nx = e.model.shape
    x = e.model.on_lattice(s.positions()[:1].astype(float))[0]
    lx, ly = e.model.spacing
    u, v = np.diff(x, axis=1), np.diff(x, axis=0)
    rows, columns = (np.sum(u**2, 2) / lx**2 - 1) / 2, (np.sum(v**2, 2) / ly**2 - 1) / 2
    k = e.model.on_lattice((e.modulus * e.share[:, None])[0])[:, :-1, :-1]
    F = np.sum((u[1:] + u[:-1]) * (v[:, 1:] + v[:, :-1]), axis=2) / 4
    free = np.sum((u[1:] - u[:-1]) ** 2, axis=2) / 4
    total = 0.5 * np.sum(k[3] * ((F - np.clip(F, -free, free)) / (2 * lx * ly)) ** 2)
    for j, i in ((0, 0), (0, 1), (1, 0), (1, 1)):
        a, b = rows[j : ny - 1 + j], columns[:, i : nx - 1 + i]
        total += 0.5 * np.sum(k[0] * a**2 + k[1] * b**2 + 2 * k[2] * a * b)
    return float(total)


def bending_energy(s: Simulator) -> float:
    """Of world 0 [J]."""
    e = s.engine
    assert isinstance(e, Shells)
    x = e.model.on_lattice(s.positions()[:1].astype(float))[0]
    k = e.model.on_lattice((e.modulus * e.share[:, None])[0])
    xx, yy = np.zeros_like(x), np.zeros_like(x)
    xx[:, 1:-1], yy[1:-1] = np.diff(x, 2, axis=1), np.diff(x, 2, axis=0)
    xy = np.diff(np.diff(x, axis=0), axis=1)
    at_grips = e.model.on_lattice(e.stiffer[0].prod(axis=0))
    total = np.sum(at_grips[0] * k[4] * np.sum(xx**2, 2) + at_grips[1] * k[5] * np.sum(yy**2, 2))
    total += np.sum(2 * k[6] * np.sum(xx * yy, 2)) + np.sum(k[7, :-1, :-1] * np.sum(xy**2, 2))
    return 0.5 * float(total)


def _beyond(axis: int) -> Gripper:
    """A gripper that holds all that is beyond 0 along an axis."""
    centre = np.zeros(3)
    centre[axis] = -100.0
    return Gripper.still(centre, radius=100.0)
