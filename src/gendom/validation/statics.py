"""Cases at rest once more, by `Simulator.equilibria`, within the same bounds as in motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.sim import Simulator
from gendom.validation import master_curves
from gendom.validation.check import Check, Settings


class Resting(Simulator):
    """A simulator that goes from shape to shape at rest instead of moving."""

    def run(
        self, times: ArrayLike, *, particles: ArrayLike | None = None, **options: Any
    ) -> NDArray[np.floating]:
        """[T, W, P, 3] positions at rest at the given times [m]."""
        del options  # of a run in time
        x = self.equilibria(times).positions
        return x if particles is None else x[:, :, np.asarray(particles, dtype=int)]


def at_rest(case: Callable[[Settings], list[Check]]) -> Callable[[Settings], list[Check]]:
    """A case of shapes at rest, without motion."""

    def run(settings: Settings) -> list[Check]:
        return [
            replace(check, quantity=f"{check.quantity}, by equilibria")
            for check in case(replace(settings, make=Resting))
        ]

    return run


def tips_slip(settings: Settings) -> list[Check]:
    """In fewer frames: each is a search of its own."""
    return master_curves.tips_slip(settings, frames=200)
