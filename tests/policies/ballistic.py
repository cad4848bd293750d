"""A task solved in closed form: a thrown stone whose reach depends on E and damping."""

from dataclasses import dataclass

import numpy as np

from gendom.materials import Material, Rope, dimensionless_parameters, size_of
from gendom.tasks import RopeReaching
from gendom.tasks.task import Outcome
from gendom.tasks.world import Simulation

TASK = RopeReaching().of_one_size()
ROPE = Rope(
    length=0.3, diameter=0.016, material=Material(E=8e5, nu=0.3, density=900.0, damping=0.004)
)


def reach_of(x, z, E, damping):
    """In rope lengths: grows with x and z, and the more with E and the less with damping."""
    return 1.1 + 0.5 * x + (0.6 * np.log(E / 0.4) - 6.0 * (damping - 0.02)) * z


@dataclass(frozen=True, kw_only=True)
class Throws(Simulation):
    """`reach_of` in place of a simulation."""

    off: float = 0.0
    """Added to each reach [lengths]."""
    risky_above: float = 9.0
    """Releases higher than this leave their plane [lengths]."""
    fails: bool = False

    def carry_out(self, task, items, actions, **_):
        outcomes = []
        for item, (x, z) in zip(items, np.asarray(actions), strict=True):
            L, alike = size_of(item), dimensionless_parameters(item)
            reached = reach_of(x / L, z / L, alike["bending_ratio"], alike["damping"]) + self.off
            values = {"x": L * reached, "sideways": 0.0 if z < self.risky_above * L else 0.1 * L}
            outcomes.append(
                Outcome(values={}, fault="it burst") if self.fails else Outcome(values=values)
            )
        return outcomes
