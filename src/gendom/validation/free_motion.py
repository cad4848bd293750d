"""Free fall, free flight, and answers that turn with the problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gendom.materials import Material
from gendom.sim import GRAVITY, Gripper, rope
from gendom.validation.check import Check, Settings
from gendom.validation.specimens import across, block, momenta

SUBSTEPS = 1000

EULER = "symplectic Euler: x = x0 + v0 n h + g h^2 n (n + 1) / 2 (Hairer, Lubich, Wanner 2006)"
NEWTON = "momentum balance: P = P0 + M g t, L about the centre of mass constant"
OBJECTIVITY = "objectivity: Q x(problem) = x(Q problem) (Truesdell and Noll 1965, section 19)"


def free_fall(settings: Settings) -> list[Check]:
    """A thrown block of 4 x 3 x 2 cells, 1,000 substeps: all particles on one parabola."""
    dx = 0.01
    body = block((4 * dx, 3 * dx, 2 * dx), dx, centre=(0.003, 0.001, 0.002))
    s = settings.simulator(body, [Material(E=1.0e5)])
    start, v = body.x, np.array([0.3, -0.2, 1.0])
    s.set_velocities(v)
    h = float(s.substep[0])
    s.run([SUBSTEPS * h])
    path = v * SUBSTEPS * h + np.array(GRAVITY) * h**2 * SUBSTEPS * (SUBSTEPS + 1) / 2.0
    # particles must also keep their distances, so the worst one is compared
    off = s.positions()[0].astype(float) - start - path
    speed = s.velocities()[0].astype(float) - v - np.array(GRAVITY) * SUBSTEPS * h
    exact = settings.round_off(1e-10, 1e-4)
    return [
        Check.within(
            "worst particle's distance from its path, over the path",
            "-",
            0.0,
            np.linalg.norm(off, axis=1).max() / np.linalg.norm(path),
            exact,
            EULER,
        ),
        Check.within(
            "worst particle's velocity beside v0 + g t, over |g| t",
            "-",
            0.0,
            np.linalg.norm(speed, axis=1).max() / (np.linalg.norm(GRAVITY) * SUBSTEPS * h),
            exact,
            NEWTON,
        ),
    ]


def free_flight(settings: Settings) -> list[Check]:
    """A block set spinning at 20 rad/s by a gripper that lets go; then 1,000 substeps alone."""
    dx, rate, held = 0.01, 20.0, 0.02
    body = block((4 * dx, 3 * dx, 2 * dx), dx, centre=(0.003, 0.001, 0.002))
    material = Material(E=1.0e6)
    axis = np.array([0.0, 0.0, 1.0])
    centre = body.x.mean(axis=0)
    hand = Gripper(
        time=[0.0, held],
        position=[centre, centre + held * np.array([0.5, 0.0, 0.3])],
        quat_xyzw=Rotation.from_rotvec([0.0 * axis, rate * held * axis]).as_quat(),
        radius=0.2,
        hold_until=held,
    )
    s = settings.simulator(body, [material], grippers=[hand])
    s.run([held])
    mass = material.density * body.volume * body.num_particles
    gravity = np.array(GRAVITY)

    def state() -> tuple[NDArray[np.floating], ...]:
        P, L = momenta(s)
        x = s.positions()[0].astype(float)
        c = x.mean(axis=0)
        return x - c, c, P, L - np.cross(c, P)

    x0, c0, P0, L0 = state()
    h = float(s.substep[0])
    time = SUBSTEPS * h
    s.run([held + time])
    x1, c1, P1, L1 = state()
    path = P0 / mass * time + gravity * h**2 * SUBSTEPS * (SUBSTEPS + 1) / 2.0
    P = P0 + mass * gravity * time
    turn = Rotation.align_vectors(x1, x0)[0].as_rotvec() @ axis
    # the fit knows the angle up to whole turns
    turn += 2.0 * np.pi * np.round((rate * time - turn) / (2.0 * np.pi))
    exact = settings.round_off(1e-10, 1e-4)
    return [
        Check.within(
            "centre's distance from its path, over the path",
            "-",
            0.0,
            float(np.linalg.norm(c1 - c0 - path) / np.linalg.norm(path)),
            exact,
            EULER,
        ),
        Check.within(
            "linear momentum beside P0 + M g t, relative",
            "-",
            0.0,
            float(np.linalg.norm(P1 - P) / np.linalg.norm(P)),
            exact,
            NEWTON,
        ),
        Check.within(
            "change of angular momentum, relative",
            "-",
            0.0,
            float(np.linalg.norm(L1 - L0) / np.linalg.norm(L0)),
            exact,
            NEWTON + "; a particle's moment of C included (Jiang et al. 2015)",
        ),
        Check.within_share(
            "angle turned about a principal axis",
            "rad",
            rate * time,
            float(turn),
            0.01,
            "Euler's equations: about a principal axis the rate of turn is constant",
        ),
    ]


def objectivity(settings: Settings) -> list[Check]:
    """A rope lifted by one end under oblique gravity, as is and turned."""
    cells = 1.5 if settings.quick else 2.0
    body = rope(diameter=0.02, length=0.2, start=(-0.05, 0.0, 0.0), cells_across=cells)
    path = np.array([(-0.05, 0.0, 0.0), (-0.05, 0.02, 0.03)])
    pull = np.array([2.0, 1.0, -9.0])

    def answer(Q: NDArray[np.floating]) -> NDArray[np.floating]:
        grip = Gripper(time=[0.0, 0.2], position=path @ Q.T, radius=0.04)
        turned = replace(body, x=body.x @ Q.T)
        s = settings.simulator(
            turned, [Material(E=3.0e5)], grippers=[grip], gravity=Q @ pull, air_density=0.0
        )
        return s.run([0.2])[0, 0].astype(float) @ Q

    plain = answer(np.eye(3))
    moved = np.linalg.norm(plain - body.x, axis=1).max()

    def difference(degrees: ArrayLike) -> float:
        Q = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
        if not np.any(np.asarray(degrees) % 90.0):
            Q = np.round(Q)
        return float(np.linalg.norm(answer(Q) - plain, axis=1).max() / moved)

    exact = settings.round_off(1e-10, 1e-3)
    checks = [
        Check.within(
            f"largest difference after 90 degrees about {name}, over the largest displacement",
            "-",
            0.0,
            difference(degrees),
            exact,
            OBJECTIVITY,
        )
        for name, degrees in (("x", (90, 0, 0)), ("y", (0, 90, 0)), ("z", (0, 0, 90)))
    ]
    # the grid stays where it is: away from its own symmetries the error is one of resolution
    for name, degrees in (
        ("30 degrees about y", (0, 30, 0)),
        ("45 degrees about z", (0, 0, 45)),
        ("20, 30 and 40 degrees about x, y and z", (20, 30, 40)),
    ):
        checks.append(
            Check.within(
                f"largest difference after {name}, {across(cells)}",
                "-",
                0.0,
                difference(degrees),
                0.10 if settings.quick else 0.05,
                OBJECTIVITY,
            )
        )
    return checks
