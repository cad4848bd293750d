"""A block on the table: stopping distance, sticking, sliding."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from gendom.materials import Material
from gendom.sim import GRAVITY, Body, Simulator, Table, cloth, rope
from gendom.validation.check import Check, Settings
from gendom.validation.specimens import block

SIDE = 0.04
MATERIAL = Material(E=1.0e6, nu=0.3, density=1000.0)

COULOMB = "Coulomb friction (Coulomb 1785)"


def sliding(settings: Settings) -> list[Check]:
    """A block pushed along the table, until it stops."""
    friction = np.array([0.2, 0.5])
    g, v = -GRAVITY[2], 1.0
    s = put_down(settings, standing_block(), friction, np.tile(GRAVITY, (2, 1)))
    before = s.positions().mean(axis=1)[:, 0]
    s.set_velocities((v, 0.0, 0.0))
    s.run([1.5 * v / (friction.min() * g)])
    way = s.positions().mean(axis=1)[:, 0] - before
    return [
        Check.within_share(
            f"stopping distance at mu = {mu:g}",
            "m",
            v**2 / (2.0 * mu * g),
            float(way[w]),
            0.03,
            "v^2 / (2 mu g), " + COULOMB,
        )
        for w, mu in enumerate(friction)
    ]


def sticking(settings: Settings) -> list[Check]:
    """A block, a rope and a cloth under tilted gravity, for 0.5 s below and above the angle of
    friction."""
    mu, g, time = 0.3, -GRAVITY[2], 0.5
    string = rope(diameter=SIDE / 2.0, length=5.0 * SIDE, start=(0.0, 0.0, SIDE / 4.0))
    sheet = cloth(width=0.1, height=0.1, thickness=0.002, dx=0.02, corner=(0.0, 0.0, 0.001))
    bulk = standing_block()
    checks = []
    for name, body in (("block", bulk), ("rope", string), ("cloth", sheet)):
        shares = np.array([0.8, 0.95, 1.1, 1.25] if body is bulk else [0.95, 1.1])
        angle = shares * math.atan(mu)
        pull = np.stack([g * np.sin(angle), 0.0 * angle, -g * np.cos(angle)], axis=1)
        s = put_down(settings, body, np.full(len(angle), mu), pull)
        s.run([0.1])
        x0, v0 = (a.mean(axis=1)[:, 0].astype(float) for a in (s.positions(), s.velocities()))
        s.run([0.1 + time])
        x1, v1 = (a.mean(axis=1)[:, 0].astype(float) for a in (s.positions(), s.velocities()))
        for w, share in enumerate(shares):
            if share < 1.0:
                checks.append(
                    Check.within(
                        f"way of a {name} in 0.5 s at {share:g} atan(mu)",
                        "m",
                        0.0,
                        x1[w] - x0[w],
                        1e-4,
                        "no slip below atan(mu), " + COULOMB,
                    )
                )
            else:
                checks.append(
                    Check.within_share(
                        f"acceleration of a {name} at {share:g} atan(mu)",
                        "m/s^2",
                        g * (math.sin(angle[w]) - mu * math.cos(angle[w])),
                        (v1[w] - v0[w]) / time,
                        0.05,
                        "g (sin a - mu cos a), " + COULOMB,
                    )
                )
    return checks


def thin_on_slopes(settings: Settings, body: Body, material: Material) -> list[Check]:
    """A rod or shell that lies on the table under tilted gravity, below and above the angle of
    friction."""
    mu, g, shares, time = 0.3, -GRAVITY[2], np.array([0.95, 1.05]), 0.5
    angle = shares * math.atan(mu)
    pull = g * np.stack([np.sin(angle), 0.0 * angle, -np.cos(angle)], axis=1)
    s = settings.simulator(
        body, [material] * 2, engine="thin", table=Table(height=0.0, friction=mu), gravity=pull,
        air_density=0.0,
    )  # fmt: skip
    x = s.run([0.0, time]).mean(axis=2)[..., 0]
    slides = g * (math.sin(angle[1]) - mu * math.cos(angle[1]))
    return [
        Check.within(
            f"acceleration at {share:g} atan(mu)", "m/s^2", expected,
            float(2.0 * (x[1, w] - x[0, w]) / time**2), 2e-3, "g (sin a - mu cos a), " + COULOMB,
        )
        for w, (share, expected) in enumerate(zip(shares, (0.0, slides), strict=True))
    ]  # fmt: skip


def standing_block() -> Body:
    """A block of three cells whose lowest particles are on a table at height 0.

    One of two cells would tremble, see docs/validation.md.
    """
    dx = SIDE / 3.0
    return block((2.0 * SIDE, SIDE, SIDE), dx, centre=(0.003, 0.001, SIDE / 2.0 - dx / 4.0))


def put_down(settings: Settings, body: Body, friction: ArrayLike, gravity: ArrayLike) -> Simulator:
    """A body at rest under its weight, one world for each friction and gravity, without air.

    A first simulator with damping lets it come to rest; a second, without, starts from there.
    Otherwise it bounces, and slides while the table hardly carries it.

    Args:
        settings: How to run.
        body: It begins where it touches the table, at height 0.
        friction: [W].
        gravity: [W, 3] [m/s^2].
    """
    mu = np.asarray(friction, dtype=float)
    pull = np.asarray(gravity, dtype=float)
    omega = math.pi * MATERIAL.wave_speed / (2.0 * SIDE)
    worlds = [MATERIAL] * len(mu)
    # friction that holds everything, so that nothing slides away before its time
    first = settings.simulator(
        body,
        worlds,
        table=Table(height=0.0, friction=10.0),
        gravity=pull,
        velocity_damping=omega,
        air_density=0.0,
    )
    first.run([20.0 / omega])
    return settings.simulator(
        body,
        worlds,
        table=Table(height=0.0, friction=mu),
        gravity=pull,
        positions=first.positions(),
        air_density=0.0,
    )
