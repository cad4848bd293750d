"""Parameters from executed actions, as the baseline R2S2R finds its own.

After Lim et al. (2022), "Planar robot casting with real2sim2real self-supervised learning": about
twenty actions are executed, and differential evolution (Storn and Price 1997) looks for the one set
of parameters with which the simulator reaches what was reached. The policy is then trained on
simulations with these parameters alone. Objects of several kinds share one set.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from gendom.errors import ParameterError, SimulationError
from gendom.materials import PARAMETERS, Item, with_dimensionless
from gendom.policies.adaptation import Execution
from gendom.tasks import Task
from gendom.tasks.task import World
from gendom.tasks.world import Simulation

Array = NDArray[np.float64]


RANGES = {"bending_ratio": (0.2, 0.8), "damping": (0.005, 0.15)}
"""Lowest and highest value of each parameter, as `dimensionless_parameters` has them."""

POPULATION, GENERATIONS, TOLERANCE = 15, 20, 0.01
"""Members for each parameter, generations, and the share by which misfits deviate in the end:
scipy's `popsize`, `maxiter` and `tol`."""


@dataclass(frozen=True, kw_only=True)
class Identified:
    """One set of parameters for all objects."""

    parameters: dict[str, float]
    """By names of `PARAMETERS`, as `dimensionless_parameters` has them."""
    misfit: float
    """Root mean square of the residuals [units of similarity]."""
    executions: int
    rollouts: int

    def item(self, like: Item) -> Item:
        """An object of the sizes of another, with these parameters."""
        return with_dimensionless(like, self.parameters)


def identify(
    task: Task,
    seen: Sequence[tuple[Item, Execution]],
    *,
    world: World | None = None,
    ranges: Mapping[str, tuple[float, float]] = RANGES,
    generations: int = GENERATIONS,
    seed: int = 0,
) -> Identified:
    """Look for the parameters that explain executions best.

    Args:
        task: What was done.
        seen: Objects, of which only sizes and density count, and what was done with them.
        world: Where it is simulated (default: our simulator).
        ranges: Parameters, and where to look for them.
        generations: At most.
        seed: Of the search.

    Raises:
        ParameterError: Nothing was executed, or a parameter is unknown.
        SimulationError: Nothing could be simulated.
    """
    world = world or Simulation()
    if not seen:
        raise ParameterError("no executions to identify parameters from", fix="give about 20")
    bounds = [tuple(np.log(ends)) if PARAMETERS[n].log else ends for n, ends in ranges.items()]
    units = np.array([task.goal_units(item) for item, _ in seen])
    reached = np.array([e.reached for _, e in seen]) / units
    rollouts = 0

    def values(vector: Array) -> dict[str, float]:
        return {
            n: float(np.exp(x) if PARAMETERS[n].log else x)
            for n, x in zip(ranges, vector, strict=True)
        }

    def misfits(population: Array) -> Array:
        """[S] mean squares for S sets of parameters, in columns."""
        nonlocal rollouts
        sets = np.atleast_2d(population.T)
        items = [with_dimensionless(item, values(v)) for v in sets for item, _ in seen]
        actions = np.array([e.action for _ in sets for _, e in seen])
        outcomes = world.carry_out(task, items, actions)
        rollouts += len(items)
        found = np.full((len(items), len(task.goals)), np.nan)
        for row, outcome in zip(found, outcomes, strict=True):
            if outcome.fault is None:
                row[:] = [outcome.values[q.name] for q in task.goals]
        off = found.reshape(len(sets), len(seen), -1) / units - reached
        cost = (off**2).sum(axis=2).mean(axis=1)
        return np.where(np.isfinite(cost), cost, np.inf)

    result = optimize.differential_evolution(
        misfits,
        bounds,
        popsize=POPULATION,
        maxiter=generations,
        tol=TOLERANCE,
        rng=seed,
        vectorized=True,
        updating="deferred",
        polish=False,
    )
    if not np.isfinite(result.fun):
        raise SimulationError("no parameters could be simulated", fix="choose other ranges")
    return Identified(
        parameters=values(result.x),
        misfit=float(np.sqrt(result.fun)),
        executions=len(seen),
        rollouts=rollouts,
    )
