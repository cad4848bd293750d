"""What cloths are made of: threads with a stiffness of their own, curvature free of stress."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim import GRAVITY, Body, Gripper, Weave, cloth
from gendom.validation.beams import BEAM
from gendom.validation.check import Check, Settings

LENGTH, WIDTH, THICKNESS = 0.2, 0.03, 0.002
"""Of strips [m]."""

WEAVE = Weave(warp=2.0, weft=0.5, shear=0.1, bending=0.4)

OWN_WEIGHT = "rho g L^2 / (2 E) (Gere and Timoshenko, Mechanics of Materials), E times the weave's"
OFF_AXIS = (
    "1 / E_a = cos^4 a / E_1 + sin^4 a / E_2 + sin^2 a cos^2 a / G, nu 0 (Jones, Mechanics of "
    "Composite Materials, chapter 2)"
)
ARC = "a strip is free of stress where it has its natural curvature: an arc of radius 1 / kappa"


def weave(settings: Settings) -> list[Check]:
    """Strips of one weave that hang from a hand, or are clamped level.

    They are cut along its threads, or hanging at 45 degrees to them.
    """
    return [*_hung(settings), _bias(settings), *_level(settings)]


def curls(settings: Settings) -> list[Check]:
    """Flat strips, held at one end, that curl to half a circle; nothing pulls at them.

    The sheet that is held stays flat, up to where the gripper ends. The joint there takes its whole
    natural turn, whatever part of it is free: a strip leaves its gripper turned by up to
    kappa times a spacing.
    """
    turn = math.pi
    checks = []
    for axis, name in ((0, "first"), (1, "second")):
        kappa = np.zeros((2, 2))
        kappa[axis, axis] = turn / LENGTH
        body, hand = strip(axis, 41, natural_curvature=kappa)
        material = Material(E=2.0e7, nu=0.3, density=1000.0)
        omega = 3.516 * math.sqrt(material.E_over_rho / 12.0) * THICKNESS / LENGTH**2
        s = settings.simulator(
            body, [material], engine="thin", grippers=[hand], gravity=(0, 0, 0), air_density=0.0,
            velocity_damping=2.0 * omega,
        )  # fmt: skip
        x = s.run([16.0 / omega])[0, 0].astype(float)[:, [axis, 2]]
        free = body.points[:, axis] > -1e-9
        along = body.points[free, axis]
        centre, radius = _circle(x[free])
        # of the strip, from its gripper on, beside that of an arc that begins level
        leaves = math.atan2(-float(centre[0]), radius)
        spacing = float(along[along > 1e-9].min())
        checks += [
            Check.within_share(
                f"radius of a curled strip along the {name} axis", "m", LENGTH / turn, radius, 0.01,
                ARC,
            ),
            Check.within(
                f"largest distance of a strip along the {name} axis from that circle / radius",
                "-", 0.0,
                float(np.abs(np.linalg.norm(x[free] - centre, axis=1) / radius - 1.0).max()), 0.01,
                ARC,
            ),
            Check.within(
                f"turn at its gripper over kappa times a spacing, {name} axis (for information)",
                "-", 0.0, leaves / (turn / LENGTH * spacing), 1.0, ARC,
            ),
        ]  # fmt: skip
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


def _hung(settings: Settings) -> list[Check]:
    """Strips along both axes that stretch by 0.1 % under their weight."""
    checks = []
    for axis, name, times in ((0, "warp", WEAVE.warp), (1, "weft", WEAVE.weft)):
        body, hand = strip(axis, 22, weave=WEAVE)
        stretch = _stretch(settings, body, hand, axis, times)
        end = body.points[:, axis] > LENGTH - 1e-9
        checks.append(
            Check.within_share(
                f"stretch over theory of a hanging strip along the {name}", "-", 1.0,
                float(stretch[end].mean()) / (0.5 * LENGTH**2), 0.01, OWN_WEIGHT,
            )
        )  # fmt: skip
    return checks


def _bias(settings: Settings) -> Check:
    """A strip cut at 45 degrees: how it stretches away from its clamp and its free end, which
    hinder or free it from contracting across."""
    a, width, back = math.radians(45.0), 0.04, 0.02
    outline = np.array([(-back, -0.5), (LENGTH, -0.5), (LENGTH, 0.5), (-back, 0.5)])
    turn = np.array([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]])
    body = cloth(
        outline=(outline * [1.0, width]) @ turn, thickness=THICKNESS, dx=0.02, yaw=-a,
        points=(28, 28), weave=WEAVE,
    )  # fmt: skip
    # G is E / 2 times the weave's
    times = 4.0 / (1.0 / WEAVE.warp + 1.0 / WEAVE.weft + 2.0 / WEAVE.shear)
    hand = Gripper.still((-100.0, 0.0, 0.0), radius=100.0)
    stretch = _stretch(settings, body, hand, 0, times)
    s, across = body.points[:, 0], body.points[:, 1]
    inside = (s > 1.5 * width) & (s < LENGTH - 0.5 * width) & (np.abs(across) < 0.5 * width)
    # s L - s^2 / 2 of theory, and a shift and a turn of the whole
    terms = np.stack([s * LENGTH - 0.5 * s**2, 0.0 * s + 1.0, across], axis=1)[inside]
    share = float(np.linalg.lstsq(terms, stretch[inside], rcond=None)[0][0])
    return Check.within_share(
        "stretch over theory of a hanging strip at 45 degrees", "-", 1.0, share, 0.02, OFF_AXIS
    )


def _stretch(
    settings: Settings, body: Body, hand: Gripper, axis: int, times: float
) -> NDArray[np.float64]:
    """[n] how far points go along a hanging strip over rho g / E; ``times`` the material's E is the
    strip's, and its end goes down by 0.1 % of the length."""
    E = 1000.0 * -GRAVITY[2] * LENGTH / (2e-3 * times)
    omega = 0.5 * math.pi * math.sqrt(E * times / 1000.0) / LENGTH
    pull = np.zeros(3)
    pull[axis] = -GRAVITY[2]
    s = settings.simulator(
        body, [Material(E=E, nu=0.0, density=1000.0)], engine="thin", grippers=[hand],
        gravity=pull, air_density=0.0, velocity_damping=2.0 * omega,
    )  # fmt: skip
    moved = s.run([24.0 / omega])[0, 0].astype(float) - body.points
    return moved[:, axis] * E * times / (1000.0 * -GRAVITY[2])


def _level(settings: Settings) -> list[Check]:
    """Strips along both axes that sag by 2 % of their length."""
    material = Material(E=2.0e7, nu=0.0, density=1000.0)
    bending = WEAVE.bending * material.E_over_rho * THICKNESS**2 / 12.0
    omega = 3.516 * math.sqrt(bending) / LENGTH**2
    checks = []
    for axis, name in ((0, "warp"), (1, "weft")):
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


def _circle(x: NDArray[np.floating]) -> tuple[NDArray[np.float64], float]:
    """Centre [2] and radius of the circle through points [k, 2], by least squares."""
    terms = np.concatenate([2.0 * x, np.ones((len(x), 1))], axis=1)
    a, b, c = np.linalg.lstsq(terms, np.sum(x**2, axis=1), rcond=None)[0]
    return np.array([a, b]), math.sqrt(c + a**2 + b**2)
