"""Bars and sheets that are stretched or bent two ways: how stiff a material is in each."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gendom.materials import Material
from gendom.sim import Gripper, Simulator, cloth
from validation.bench import WEIGHTLESS, Bench, Row, case, over_theory, relative
from validation.readings import bending_energy, membrane_energy
from validation.references import BEAM, beam_frequency, corner_sags, unit_gravity
from validation.specimens import (
    across,
    block,
    clamp_beyond,
    clamped_strip,
    sections,
    stations,
)

BAR_SIDE = 0.01
"""Edge of the bar's square section [m]."""

THICKNESS = 0.002
"""Of sheets [m]."""

MATERIAL = Material(E=2.0e7, nu=0.0, density=1000.0)
"""Of sheets."""

BAR = "uniaxial tension: sigma = rho g (L - x) = E strain, contraction nu strain (Hooke)"
PLATE = "U = D / 2 kappa^2 A, D = E h^3 / (12 (1 - nu^2)) (Timoshenko, Theory of Plates and Shells)"
HOOKE = "plane stress (Hooke; Timoshenko, Theory of Elasticity)"
ANTICLASTIC = (
    "kappa_y = -nu kappa_x of a narrow strip under end moments (Timoshenko, Theory of Plates and "
    "Shells, chapter 2)"
)
CORNERS = (
    "0.02551 and 0.01775 q a^4 / D in the middle and halfway along a side, nu 0.3, by Ritz's "
    "method with polynomials of degree 16 (plates supported at corners: Timoshenko, Theory of "
    "Plates and Shells)"
)

# ---- bars ----------------------------------------------------------------------------------------


@case("tension", "a bar under its own weight", "mpm")
def tension(bench: Bench) -> list[Row]:
    """A clamped bar that hangs along its axis, strain 0.2 % at the clamp.

    Its weight is the known load. E is the slope of load over mean strain of the sections, away
    from clamp and end by 1.5 sides; nu compares their contraction. The last row repeats the
    measurement under strong damping, which must not carry weight.
    """
    cells = 2 if bench.quick else 4
    L = 8.0 * BAR_SIDE
    strain, g = 2.0e-3, 9.81
    material = Material(E=1000.0 * g * L / strain, nu=0.3, density=1000.0)
    omega = math.pi * math.sqrt(material.E_over_rho) / (2.0 * L)

    def read(damping: float, time: float) -> tuple[float, float, float]:
        """E [Pa], nu [-] and damping times substep [-] of a bar at rest."""
        s = clamped_bar(bench, cells, L, material, pull=g, damping=damping)
        x, body = s.run([time])[0, 0].astype(float), s.body
        at = stations(body) - 3.0 * body.dx
        part = (at > 1.5 * BAR_SIDE) & (at < L - 1.5 * BAR_SIDE)
        stretch = np.gradient(sections(x - body.x, body)[:, 0], at)[part]
        # lateral displacement per distance from the axis, by least squares over each section
        y0, y = (a[:, 1:].reshape(len(at), -1) for a in (body.x, x))
        narrow = ((y - y0) * y0).sum(axis=1)[part] / (y0**2).sum(axis=1)[part]
        load = material.density * g * (L - at[part])
        E = float(np.polyfit(stretch, load, 1)[0])
        return E, -float(np.polyfit(stretch, narrow, 1)[0]), damping * float(s.substep[0])

    E, nu, _ = read(0.2 * omega, 80.0 / omega)
    damped, _, ratio = read(2.0 * omega, 14.0 / omega)
    size, still = across(cells), BAR + "; at rest damping has no velocity to act on"
    strongly = f"E read back, damping x substep = {ratio:.2g}"
    return [
        relative(f"E read back, {size}", "Pa", material.E, E, 0.02, BAR),
        relative(f"nu read back, {size}", "-", material.nu, nu, 0.02, BAR),
        relative(strongly, "Pa", material.E, damped, 0.02, still),
    ]


def clamped_bar(
    bench: Bench, cells: int, L: float, material: Material, *, pull: float, damping: float
) -> Simulator:
    """A bar whose free part reaches from x = 0 over L; gravity ``pull`` along x [m/s^2]."""
    dx = BAR_SIDE / cells
    back = 3.0 * dx
    body = block((L + back, BAR_SIDE, BAR_SIDE), dx, centre=((L - back) / 2.0, 0.0, 0.0))
    return bench.simulate(
        body, [material], grippers=[clamp_beyond(reach=BAR_SIDE)], gravity=(pull, 0.0, 0.0),
        velocity_damping=damping,
    )  # fmt: skip


# ---- sheets of given shape -----------------------------------------------------------------------


@case("shell-cylinders", "rolled sheets", "thin")
def cylinders(bench: Bench) -> list[Row]:
    """A square rolled to a cylinder along its sides, its diagonal and between."""
    rows, R, size = [], 0.5, 0.2
    # free ends carry no moment: of n points in a row n - 2 do
    body = cloth(width=size, height=size, thickness=THICKNESS, dx=0.02, points=(121, 121))
    for nu in (0.0, 0.3):
        material = replace(MATERIAL, nu=nu)
        expected = 0.5 * rigidity(material) * size**2 / R**2
        for degrees in (0.0, 22.5, 45.0, 90.0):
            a = math.radians(degrees)
            along = body.points[:, :2] @ [math.cos(a), math.sin(a)]
            v = body.points[:, :2] @ [-math.sin(a), math.cos(a)]
            u, w = R * np.sin(along / R), R * (1.0 - np.cos(along / R))
            x = [u * math.cos(a) - v * math.sin(a), u * math.sin(a) + v * math.cos(a), w]
            s = bench.simulate(body, [material], positions=np.stack(x, axis=1))
            name = f"energy of a sheet rolled at {degrees:g} degrees, nu {nu:g}"
            rows.append(relative(name, "J", expected, bending_energy(s), 0.01, PLATE))
    return rows


@case("shell-stretched", "stretched and sheared sheets", "thin")
def stretched(bench: Bench) -> list[Row]:
    """Forces that hold a sheet in a plane deformation: uniaxial, both ways, and sheared."""
    nu, strain = 0.3, 1e-4
    material = replace(MATERIAL, nu=nu)
    body = cloth(width=0.2, height=0.15, thickness=THICKNESS, dx=0.02, points=(12, 9))
    E, volume = material.E, 0.2 * 0.15 * THICKNESS
    ways = {
        "uniaxial": (np.diag([strain, -nu * strain]), E * strain**2),
        "biaxial": (np.diag([strain, strain]), 2.0 * E / (1.0 - nu) * strain**2),
        "sheared": (np.array([[0, strain], [0, 0]]), E / (2.0 * (1.0 + nu)) * strain**2),
    }
    rows = []
    for name, (gradient, density) in ways.items():
        x = body.points.copy()
        x[:, :2] += body.points[:, :2] @ gradient.T
        found = membrane_energy(bench.simulate(body, [material], positions=x))
        rows.append(relative(f"{name} energy", "J", 0.5 * density * volume, found, 2e-3, HOOKE))
    return rows


def rigidity(material: Material) -> float:
    """Bending stiffness D of a sheet [N m]."""
    return material.E * THICKNESS**3 / (12.0 * (1.0 - material.nu**2))


# ---- plates --------------------------------------------------------------------------------------


@case("shell-plates", "strips and squares that bend two ways", "thin")
def plates(bench: Bench) -> list[Row]:
    """Strips bent by turned ends, and squares that sag under their weight between four corners."""
    return [*_bent_strips(bench), *_squares(bench)]


def _bent_strips(bench: Bench) -> list[Row]:
    """Strips ten times as long as wide, bent to an arc: how they curve across in their middle."""
    L, width, points, R, back = 0.4, 0.04, (41, 9), 10.0, 0.02
    body = cloth(
        width=L + 2.0 * back, height=width, thickness=THICKNESS, dx=0.02, points=points,
        corner=(-0.5 * L - back, -0.5 * width, 0.0),
    )  # fmt: skip
    turned = np.linspace(0.0, 0.5 * L / R, 13)[1:]
    end = 0.5 * L / turned[:, None] * np.stack([np.sin(turned), np.cos(turned) - 1.0], axis=1)
    end = np.concatenate([[[0.5 * L, 0.0]], end])
    turned = np.append(0.0, turned)
    # spheres so wide that they look flat
    centre = end + 100.0 * np.stack([np.cos(turned), -np.sin(turned)], axis=1)
    hands = [
        Gripper(
            time=np.linspace(0.0, 1.0, len(turned)),
            position=np.stack([side * centre[:, 0], 0.0 * turned, centre[:, 1]], axis=1),
            quat_xyzw=Rotation.from_rotvec(np.outer(side * turned, (0.0, 1.0, 0.0))).as_quat(),
            radius=100.0,
        )
        for side in (-1.0, 1.0)
    ]
    worlds = [replace(MATERIAL, nu=nu) for nu in (0.1, 0.4)]
    omega = 22.4 * math.sqrt(MATERIAL.E_over_rho / 12.0) * THICKNESS / L**2
    options = {"grippers": hands, "gravity": WEIGHTLESS}
    x = bench.settle(body, worlds, omega, periods=16.0 + omega, **options)
    z, i = x.reshape(-1, *points[::-1], 3)[..., 2], points[0] // 2
    along = np.diff(z[..., i - 1 : i + 2], 2, axis=-1).mean(axis=(1, 2))
    over = np.diff(z[..., i], 2, axis=-1).mean(axis=-1)
    spacings = ((L + 2.0 * back) / (points[0] - 1), width / (points[1] - 1))
    ratios = -over / along * (spacings[0] / spacings[1]) ** 2
    name = "curvature across over that along a bent strip, with the other sign, nu"
    return [
        relative(f"{name} {m.nu:g}", "-", m.nu, float(ratio), 0.02, ANTICLASTIC)
        for m, ratio in zip(worlds, ratios, strict=True)
    ]


def _squares(bench: Bench) -> list[Row]:
    """Squares that sag by 1 % of their thickness."""
    a, sag, material = 0.2, 0.01 * THICKNESS, replace(MATERIAL, nu=0.3)
    D, areal = rigidity(material), material.density * THICKNESS
    middle, side = corner_sags(material.nu)
    corners = [(0.5 * i * a, 0.5 * j * a, 0.0) for i in (-1, 1) for j in (-1, 1)]
    # of the first mode (Leissa 1969, Vibration of Plates)
    omega = 7.1 * math.sqrt(D / areal) / a**2
    rows = []
    for n in (11,) if bench.quick else (11, 21):
        corner = (-0.5 * a, -0.5 * a, 0.0)
        x = bench.settle(
            cloth(width=a, height=a, thickness=THICKNESS, dx=0.02, points=(n, n), corner=corner),
            [material], omega, grippers=[Gripper.still(at, radius=1e-4) for at in corners],
            gravity=(0, 0, -sag / middle * D / (areal * a**4)),
        )  # fmt: skip
        z = -x[0, :, 2].reshape(n, n) / sag
        name = "sag over theory of a square held at its corners"
        for place, found in (
            ("in the middle", z[n // 2, n // 2]),
            ("halfway along a side", z[0, n // 2] * middle / side),
        ):
            rows.append(over_theory(f"{name}, {place}, {n} points", float(found), 0.01, CORNERS))
    return rows


@case("shell-weave", "strips of a weave", "thin")
def weave(bench: Bench) -> list[Row]:
    """Level strips of one weave, cut along its threads, that sag by 2 % of their length."""
    woven, L, k, rows = replace(MATERIAL, warp=2.0, weft=0.5), 0.2, THICKNESS / math.sqrt(12.0), []
    for axis, name, times in ((0, "warp", woven.warp), (1, "weft", woven.weft)):
        body, hand = clamped_strip(L, 0.03, THICKNESS, (22, 4), axis=axis)
        alike = replace(MATERIAL, E=times * MATERIAL.E)  # bends as the weave does
        omega, g = beam_frequency(alike, k, L), 8.0 * 0.02 * unit_gravity(alike, k, L)
        x = bench.settle(body, [woven], omega, grippers=[hand], gravity=(0, 0, -g))
        share = -x[0, body.points[:, axis] > L - 1e-9, 2].mean() / (0.02 * L)
        name = f"sag over theory of a level strip along the {name}"
        rows.append(over_theory(name, share, 0.01, BEAM))
    return rows
