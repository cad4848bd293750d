"""A rope twisted by a gripper that turns."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from gendom.materials import Material
from gendom.sim import Gripper, rope
from gendom.validation.check import Check, Settings
from gendom.validation.specimens import across, clamp_beyond, energies

DIAMETER = 0.01
"""[m]."""

ANGLE = 0.1
"""[rad]."""

SAINT_VENANT = (
    "U = G J angle^2 / (2 L), J = pi d^4 / 32, of a round bar (Coulomb 1784; Gere and Timoshenko, "
    "Mechanics of Materials)"
)


def torsion(settings: Settings) -> list[Check]:
    """A rope six diameters long, one end clamped, the other turned by 0.1 rad about its axis.

    Its elastic energy gives the stiffness: that of the twist alone, as both ends stay in place.
    """
    L = 6.0 * DIAMETER
    material = Material(E=1.0e6, nu=0.3)
    G = material.lame[0]
    J = math.pi * DIAMETER**4 / 32.0
    omega = math.pi * math.sqrt(G / material.density) / L
    checks = []
    for cells in (1.0, 2.0) if settings.quick else (0.6, 1.0, 1.5, 2.0, 3.0):
        back = 3.0 * DIAMETER / cells
        body = rope(
            diameter=DIAMETER,
            length=L + 2.0 * back,
            start=(-back, 0.0, 0.0),
            cells_across=cells,
        )
        far = clamp_beyond((L, 0.0, 0.0), (1.0, 0.0, 0.0), DIAMETER)
        turns = [0.0, 40.0 / omega]
        hand = Gripper(
            time=turns,
            position=np.repeat(far.position_at([0.0]), 2, axis=0),
            quat_xyzw=Rotation.from_rotvec([(0.0, 0.0, 0.0), (ANGLE, 0.0, 0.0)]).as_quat(),
            radius=far.radius,
        )
        s = settings.simulator(
            body,
            [material],
            grippers=[clamp_beyond((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), DIAMETER), hand],
            gravity=(0.0, 0.0, 0.0),
            air_density=0.0,
            velocity_damping=omega,
        )
        s.run([turns[-1] + 20.0 / omega])
        found = 2.0 * energies(s, (0.0, 0.0, 0.0))[1] / ANGLE**2
        checks.append(
            Check.within_share(
                f"torsional stiffness, {across(cells)}",
                "N m/rad",
                G * J / L,
                found,
                0.05,
                SAINT_VENANT,
            )
        )
    return checks
