"""Plates that bend in two directions at once: strips bent to an arc, squares held at corners."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gendom.materials import Material
from gendom.sim import Gripper, cloth
from gendom.validation.check import Check, Settings

THICKNESS = 0.002
"""[m]."""

MATERIAL = Material(E=2.0e7, nu=0.3, density=1000.0)

ANTICLASTIC = (
    "kappa_y = -nu kappa_x of a narrow strip under end moments (Timoshenko, Theory of Plates and "
    "Shells, chapter 2)"
)
CORNERS = (
    "0.02551 and 0.01775 q a^4 / D in the middle and halfway along a side, nu 0.3, by Ritz's "
    "method with polynomials of degree 16 (plates supported at corners: Timoshenko, Theory of "
    "Plates and Shells)"
)


def plates(settings: Settings) -> list[Check]:
    """Strips bent by turned ends, and squares that sag under their weight between four corners."""
    return [*_bent_strips(settings), *_squares(settings)]


def _bent_strips(settings: Settings) -> list[Check]:
    """Strips ten times as long as wide, bent to an arc: how they curve across in their middle."""
    L, width, points, R = 0.4, 0.04, (41, 9), 10.0
    back = 0.02
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
    materials = [replace(MATERIAL, nu=nu) for nu in (0.1, 0.4)]
    omega = 22.4 * math.sqrt(MATERIAL.E_over_rho / 12.0) * THICKNESS / L**2
    s = settings.simulator(
        body, materials, engine="thin", grippers=hands, gravity=(0, 0, 0), air_density=0.0,
        velocity_damping=2.0 * omega,
    )  # fmt: skip
    x = s.run([1.0 + 16.0 / omega])[0].reshape(-1, *points[::-1], 3).astype(float)
    z, i = x[..., 2], points[0] // 2
    along = np.diff(z[..., i - 1 : i + 2], 2, axis=-1).mean(axis=(1, 2))
    across = np.diff(z[..., i], 2, axis=-1).mean(axis=-1)
    spacings = ((L + 2.0 * back) / (points[0] - 1), width / (points[1] - 1))
    ratio = -across / along * (spacings[0] / spacings[1]) ** 2
    return [
        Check.within_share(
            f"curvature across over that along a bent strip, with the other sign, nu {m.nu:g}", "-",
            m.nu, float(found), 0.02, ANTICLASTIC,
        )
        for m, found in zip(materials, ratio, strict=True)
    ]  # fmt: skip


def _squares(settings: Settings) -> list[Check]:
    """Squares that sag by 1 % of their thickness."""
    a, sag = 0.2, 0.01 * THICKNESS
    D = MATERIAL.E * THICKNESS**3 / (12.0 * (1.0 - MATERIAL.nu**2))
    middle, side = corner_sags(MATERIAL.nu)
    g = sag / middle * D / (MATERIAL.density * THICKNESS * a**4)
    hands = [
        Gripper.still((0.5 * i * a, 0.5 * j * a, 0.0), radius=1e-4)
        for i in (-1, 1)
        for j in (-1, 1)
    ]
    # of the first mode (Leissa 1969, Vibration of Plates)
    omega = 7.1 * math.sqrt(D / (MATERIAL.density * THICKNESS)) / a**2
    checks = []
    for n in (11,) if settings.quick else (11, 21):
        body = cloth(
            width=a, height=a, thickness=THICKNESS, dx=0.02, points=(n, n),
            corner=(-0.5 * a, -0.5 * a, 0.0),
        )  # fmt: skip
        s = settings.simulator(
            body, [MATERIAL], engine="thin", grippers=hands, gravity=(0, 0, -g), air_density=0.0,
            velocity_damping=2.0 * omega,
        )  # fmt: skip
        z = -s.run([16.0 / omega])[0, 0, :, 2].reshape(n, n).astype(float) / sag
        for name, found in (
            ("in the middle", z[n // 2, n // 2]),
            ("halfway along a side", z[0, n // 2] * middle / side),
        ):
            checks.append(
                Check.within_share(
                    f"sag over theory of a square held at its corners, {name}, {n} points", "-",
                    1.0, float(found), 0.01, CORNERS,
                )
            )  # fmt: skip
    return checks


def corner_sags(nu: float, degree: int = 16) -> tuple[float, float]:
    """Sags of a square plate held at its four corners, in its middle and halfway along a side, in
    units of q a^4 / D.

    Ritz's method: of the even polynomials that are 0 at the corners, the one of least energy
    D / 2 integral of (w_xx + w_yy)^2 - 2 (1 - nu) (w_xx w_yy - w_xy^2), minus the load's work.

    Args:
        nu: Poisson's ratio.
        degree: Of the polynomials along each axis.
    """
    at, weight = legendre.leggauss(degree + 2)
    even = np.eye(degree + 1)[::2]

    def values(s: NDArray[np.floating], m: int = 0) -> NDArray[np.float64]:
        """[terms, s] m-th derivatives."""
        return np.array([legendre.legval(s, legendre.legder(c, m)) for c in even])

    d = [values(at, m) for m in range(3)]
    times = {(i, j): (d[i] * weight) @ d[j].T for i in range(3) for j in range(3)}
    K = np.kron(times[2, 2], times[0, 0]) + np.kron(times[0, 0], times[2, 2])
    K += nu * (np.kron(times[2, 0], times[0, 2]) + np.kron(times[0, 2], times[2, 0]))
    K += 2.0 * (1.0 - nu) * np.kron(times[1, 1], times[1, 1])
    terms = len(even)
    work = np.kron(d[0] @ weight, d[0] @ weight)
    # all terms are 1 at the corners: their sum is 0 there
    held = np.ones((1, terms**2))
    system = np.block([[K, held.T], [held, np.zeros((1, 1))]])
    shape = np.linalg.solve(system, np.append(work, 0.0))[:-1].reshape(terms, terms)
    centre = values(np.zeros(1))[:, 0]
    # the square from -1 to 1 is two units wide
    return float(centre @ shape @ centre) / 16.0, float(centre @ shape.sum(axis=1)) / 16.0
