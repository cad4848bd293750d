"""Equal problems: a batch and its worlds, single and double precision."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim import Gripper, Simulator, Table, cloth, rope
from gendom.validation.check import Check, Settings

WORLDS = tuple(
    Material(E=E, nu=nu) for E, nu in ((1e5, 0.3), (3e5, 0.2), (1e6, 0.4), (2e5, 0.1), (5e4, 0.0))
)
"""Their substeps differ, so that they take turns at being the slowest."""

LIFT = 0.1
"""[m]."""

SHEET = 0.2
"""Size of a cloth, and how high its corner is lifted [m]."""

EQUAL = "equal inputs, equal operations; on CUDA sums are added in no fixed order"
ROUND_OFF = "round-off: 2^-24 a number (IEEE 754)"


def batch(settings: Settings) -> list[Check]:
    """Five worlds at once and each alone: bit for bit on the CPU, to round-off on CUDA."""
    together = _lift(settings, WORLDS)
    alone = np.stack([_lift(settings, [m])[:, 0] for m in WORLDS], axis=1)
    exact = settings.device == "cpu"
    return [
        Check.within(
            "largest difference of a batch of 5 from single worlds",
            "m",
            0.0,
            float(np.abs(together - alone).max()),
            0.0 if exact else settings.round_off(1e-9, 1e-4),
            EQUAL,
        )
    ]


def precision(settings: Settings) -> list[Check]:
    """The same five worlds in float32 and float64."""
    single = _lift(replace(settings, dtype="float32"), WORLDS)
    double = _lift(replace(settings, dtype="float64"), WORLDS)
    return [
        Check.within(
            "largest difference of float32 from float64, over the lift",
            "-",
            0.0,
            float(np.abs(single - double).max() / LIFT),
            1e-5,
            ROUND_OFF,
        )
    ]


def rods_together(settings: Settings) -> list[Check]:
    """Five ropes at once and each alone: lifted off the table at one end, with self-contact."""
    return _together(settings, "rope")


def shells_together(settings: Settings) -> list[Check]:
    """Five cloths at once and each alone: lifted off the table at a corner, with self-contact."""
    return _together(settings, "cloth")


def shells_precision(settings: Settings) -> list[Check]:
    """A cloth lifted by a corner, in float32 and float64.

    Limp cloths fold, and at a fold's edge round-off grows: there it may be ten times the mean.
    """
    worlds = [Material(E=E, nu=0.3, density=400.0, damping=0.01) for E in (1e6, 3e6)]
    body = cloth(
        width=SHEET, height=SHEET, thickness=0.001, dx=0.02, points=(14, 14),
        corner=(0.0, 0.0, 0.0005),
    )  # fmt: skip
    path = [(0, 0, 0.0005), (0, 0, 0.0005 + SHEET)]
    hand = Gripper(time=[0.0, 2.0], position=path, radius=0.03)
    single, double = (
        replace(settings, dtype=dtype)
        .simulator(body, worlds, engine="thin", grippers=[hand], table=Table(height=0.0))
        .run([1.0, 2.0])
        .astype(float)
        for dtype in ("float32", "float64")
    )
    far = np.linalg.norm(single - double, axis=-1) / SHEET
    return [
        Check.within(
            f"{name} difference of float32 from float64 over the size", "-", 0.0, float(value),
            allowed, ROUND_OFF,
        )
        for name, value, allowed in (
            ("root mean square", np.sqrt(np.mean(far**2, axis=2)).max(), 1e-5),
            ("largest", far.max(), 1e-4),
        )
    ]  # fmt: skip


def _together(settings: Settings, kind: str) -> list[Check]:
    every = range(len(WORLDS))
    together = _thin_lift(settings, kind, every).run([0.1, 0.4])
    alone = np.concatenate([_thin_lift(settings, kind, [w]).run([0.1, 0.4]) for w in every], axis=1)
    exact = settings.device == "cpu"
    return [
        Check.within(
            f"largest difference of a batch of {len(WORLDS)} {kind}s from single worlds", "m", 0.0,
            float(np.abs(together - alone).max()),
            0.0 if exact else settings.round_off(1e-9, 1e-4), EQUAL,
        )
    ]  # fmt: skip


def _thin_lift(settings: Settings, kind: str, which: Sequence[int]) -> Simulator:
    """Worlds of ``WORLDS`` that differ in all that worlds may differ in."""
    if kind == "rope":
        body = rope(diameter=0.01, length=0.3, start=(0.0, 0.0, 0.005))
    else:
        body = cloth(
            width=SHEET, height=SHEET, thickness=0.001, dx=0.02, points=(14, 14),
            corner=(0.0, 0.0, 0.0005),
        )  # fmt: skip
    low = np.array([0.0, 0.0, body.thickness / 2.0])
    number = np.array(which, dtype=float)
    hands = [
        [
            Gripper(
                time=[0.0, 0.3 + 0.02 * w],
                position=[low, low + np.array([0.1 * LIFT * w, 0.0, LIFT])],
                radius=0.02 + 0.001 * w,
                hold_until=0.35,
            )
        ]
        for w in which
    ]
    return settings.simulator(
        body, [replace(WORLDS[w], damping=0.001 * w) for w in which], engine="thin",
        grippers=hands, table=Table(height=0.0, friction=0.1 + 0.1 * number), self_contact=True,
        self_friction=0.2 + 0.1 * number, velocity_damping=number, air_density=0.3 * number,
        stiffness=1.0 + 0.1 * np.outer(number, np.linspace(0.0, 1.0, len(body.points))),
    )  # fmt: skip


def _lift(settings: Settings, materials) -> NDArray[np.floating]:
    """[T, W, N, 3] a rope just above a table, one end lifted by 10 cm in 0.3 s [m].

    It starts 0.1 mm above: in which substep it first touches would otherwise be left to the last
    bit of its height, and a substep's fall (25 um in the softest world) is no round-off.
    """
    z = 0.0101
    body = rope(diameter=0.02, length=0.2, start=(0.0, 0.0, z), cells_across=1.5)
    hand = Gripper(time=[0.0, 0.3], position=[(0, 0, z), (0, 0, z + LIFT)], radius=0.02)
    s = settings.simulator(
        body, materials, grippers=[hand], table=Table(height=0.0), velocity_damping=2.0
    )
    return s.run([0.1, 0.3]).astype(float)
