"""Cases at rest once more, by `Simulator.equilibria`, within the same bounds as in motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.materials import Material
from gendom.sim import GRAVITY, Gripper, Simulator, rope
from gendom.validation import master_curves
from gendom.validation.check import Check, Settings

OWN_WEIGHT = "rho g (L^2 - s^2) / (2 E) (Gere and Timoshenko, Mechanics of Materials)"


class Resting(Simulator):
    """A simulator that goes from shape to shape at rest instead of moving."""

    def run(
        self, times: ArrayLike, *, particles: ArrayLike | None = None, **options: Any
    ) -> NDArray[np.floating]:
        """[T, W, P, 3] positions at rest at the given times [m]."""
        del options  # of a run in time
        x = self.equilibria(times).positions
        return x if particles is None else x[:, :, np.asarray(particles, dtype=int)]


class AtRest(Settings):
    """Settings with simulators that do so."""

    simulators = Resting


def at_rest(case: Callable[[Settings], list[Check]]) -> Callable[[Settings], list[Check]]:
    """A case of shapes at rest, without motion."""

    def run(settings: Settings) -> list[Check]:
        return [
            replace(check, quantity=f"{check.quantity}, by equilibria")
            for check in case(AtRest(**asdict(settings)))
        ]

    return run


def hanging(settings: Settings) -> list[Check]:
    """A soft rope that hangs from a hand, which ends on one of its points."""
    d = 0.005
    L, g = 100 * d, -GRAVITY[2]
    specific = 50.0 * g * L
    body = rope(diameter=d, length=1.05 * L, direction=(0, 0, -1), points=43)
    s = settings.simulator(
        body, [Material(E=1000.0 * specific, nu=0.3, density=1000.0)], engine="thin",
        grippers=[Gripper.still((0, 0, 0), radius=0.05 * L)],
    )  # fmt: skip
    below = np.clip(1.05 * L + body.points[:, 2], 0.0, L)
    longer = body.points[:, 2] - s.equilibria([1.0]).positions[0, 0, :, 2]
    expected = g * (L**2 - below**2) / (2.0 * specific)
    return [
        Check.within(
            "error of how far points of a hanging rope go down, over the most", "-", 0.0,
            float(np.abs(longer - expected).max() / expected.max()), 0.01, OWN_WEIGHT,
        )
    ]  # fmt: skip


def tips_slip(settings: Settings) -> list[Check]:
    """In fewer frames: each is a search of its own."""
    return master_curves.tips_slip(settings, frames=200)
