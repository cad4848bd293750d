"""What cloths are made of: threads with a bending stiffness of their own."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gendom.materials import Material
from gendom.sim import Body, Gripper, Weave, cloth
from gendom.validation.beams import BEAM
from gendom.validation.check import Check, Settings

LENGTH, WIDTH, THICKNESS = 0.2, 0.03, 0.002
"""Of strips [m]."""

WEAVE = Weave(warp=2.0, weft=0.5)


def weave(settings: Settings) -> list[Check]:
    """Level strips of one weave, cut along its threads, that sag by 2 % of their length."""
    material = Material(E=2.0e7, nu=0.0, density=1000.0)
    checks = []
    for axis, name, times in ((0, "warp", WEAVE.warp), (1, "weft", WEAVE.weft)):
        bending = times * material.specific_modulus * THICKNESS**2 / 12.0
        omega = 3.516 * math.sqrt(bending) / LENGTH**2
        body, hand = strip(axis, 22, weave=WEAVE)
        s = settings.simulator(
            body, [material], engine="thin", grippers=[hand], air_density=0.0,
            gravity=(0, 0, -8.0 * bending * 0.02 / LENGTH**3), velocity_damping=2.0 * omega,
        )  # fmt: skip
        x = s.run([16.0 / omega])[0, 0]
        end = body.points[:, axis] > LENGTH - 1e-9
        checks.append(
            Check.within_share(
                f"sag over theory of a level strip along the {name}", "-", 1.0,
                -float(x[end, 2].mean()) / (0.02 * LENGTH), 0.01, BEAM,
            )
        )  # fmt: skip
    return checks


def strip(axis: int, points: int, **options: Any) -> tuple[Body, Gripper]:
    """A level strip along an axis, of which ``LENGTH`` is free from 0 on, and what holds the rest.

    Args:
        axis: 0 or 1.
        points: Along it.
        options: Of ``cloth``.
    """
    back = LENGTH / (points - 2)
    size, number, corner = [LENGTH + back, WIDTH], [points, 4], [-back, -0.5 * WIDTH]
    if axis == 1:
        size, number, corner = size[::-1], number[::-1], corner[::-1]
    body = cloth(
        width=size[0], height=size[1], thickness=THICKNESS, dx=0.02, corner=(*corner, 0.0),
        points=(number[0], number[1]), **options,
    )  # fmt: skip
    centre = np.zeros(3)
    centre[axis] = -100.0
    return body, Gripper.still(centre, radius=100.0)
