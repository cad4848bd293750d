"""Equal problems: a batch and its worlds, single and double precision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim import Gripper, Table, rope
from gendom.validation.check import Check, Settings

WORLDS = tuple(
    Material(E=E, nu=nu) for E, nu in ((1e5, 0.3), (3e5, 0.2), (1e6, 0.4), (2e5, 0.1), (5e4, 0.0))
)
"""Their substeps differ, so that they take turns at being the slowest."""

LIFT = 0.1
"""[m]."""


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
            "equal inputs, equal operations; on CUDA sums are added in no fixed order",
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
            "round-off: 2^-24 a number (IEEE 754)",
        )
    ]


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
