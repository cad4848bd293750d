"""How well policies reach their goals, measured in the simulator on equal cases.

A case is an object and a goal that this object can reach: its parameters and an action are
drawn as for a demonstration and simulated, and what came of it is the goal (hindsight). The
policy, told the true parameters, chooses its own action; that is simulated with the same object,
and the error is |goal - reached|.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.errors import ParameterError, PolicyError, SimulationError
from gendom.policies import Policy
from gendom.tasks import RopeReaching

_ROUNDS = 5
"""How often a case whose simulation fails is drawn anew."""

_STREAM = 1
"""Keeps these draws apart from those of demonstrations with the same seed."""


@dataclass(frozen=True, kw_only=True)
class Cases:
    """W objects, each with a goal that it can reach."""

    task: RopeReaching
    draws: tuple[Mapping[str, float], ...]
    """What the task drew for each: parameters, sizes, and the action that reached the goal."""
    goal: NDArray[np.float64]
    """[W] [m]."""
    seed: int
    device: str
    dtype: str

    def __len__(self) -> int:
        return len(self.draws)


@dataclass(frozen=True, kw_only=True)
class Score:
    """What a policy did in each of W cases."""

    action: NDArray[np.float64]
    """[W, A] [m]."""
    goal: NDArray[np.float64]
    """[W] [m]."""
    reached: NDArray[np.float64]
    """[W] [m]; NaN where the simulation failed."""
    length: NDArray[np.float64]
    """[W] the ropes' lengths [m]."""
    outside: NDArray[np.bool_]
    """[W] whether `Policy.act` would refuse the goal as outside the training range."""

    @property
    def error(self) -> NDArray[np.float64]:
        """[W] |goal - reached| [m]; NaN where the simulation failed."""
        return np.abs(self.goal - self.reached)

    def summary(self) -> dict[str, Any]:
        """Figures ready for JSON: errors in metres and as shares of the length.

        Cases whose simulation failed are counted in `failed` and in no other figure; if all
        failed, the errors are None. Goals outside the policy's range count like all others.
        """
        done = np.isfinite(self.reached)
        return {
            "cases": len(self.goal),
            "failed": int((~done).sum()),
            "outside_range": int(self.outside.sum()),
            "error": _figures(self.error[done]),
            "error_over_length": _figures(self.error[done] / self.length[done]),
        }


def draw_cases(
    task: RopeReaching,
    count: int,
    *,
    seed: int,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    device: str = "cpu",
    dtype: str = "float32",
) -> Cases:
    """Draw objects and goals.

    Case i depends on the seed and i alone. A draw whose simulation fails is replaced.

    Args:
        task: What is done.
        count: Number of cases.
        seed: Seed of all draws, 0 or more.
        ranges: Other ranges than the task's own for `specific_modulus` [m^2/s^2] (drawn
            log-uniformly) and `poissons_ratio` (uniformly).
        device: ``cpu``, ``cuda`` or ``cuda:0`` and so on.
        dtype: ``float32`` or ``float64``.

    Raises:
        ParameterError: A number or range is out of bounds.
        SimulationError: Draws keep failing.
    """
    if count < 1 or seed < 0:
        raise ParameterError(
            f"{count} cases with seed {seed}", fix="give 1 case or more and a seed of 0 or more"
        )
    kept: list[dict[str, float]] = [{} for _ in range(count)]
    goal = np.full(count, np.nan)
    column = f"goal_{task.goal_names[0]}"
    for attempt in range(_ROUNDS):
        waiting = np.flatnonzero(np.isnan(goal))
        if not len(waiting):
            break
        for i in waiting:
            rng = np.random.default_rng([seed, int(i), attempt, _STREAM])
            kept[i] = _draw(task, rng, ranges or {})
        outcomes = task.demonstrate([kept[i] for i in waiting], device=device, dtype=dtype)
        goal[waiting] = outcomes.columns[column]
    failed = int(np.isnan(goal).sum())
    if failed:
        raise SimulationError(
            f"{failed} of {count} cases failed {_ROUNDS} times", fix="choose other ranges"
        )
    return Cases(task=task, draws=tuple(kept), goal=goal, seed=seed, device=device, dtype=dtype)


def score(policy: Policy, cases: Cases) -> Score:
    """Let a policy act in all cases, and simulate what comes of it.

    Raises:
        PolicyError: The policy is for another task.
    """
    task, own = cases.task, policy.task()
    if own.name != task.name:
        raise PolicyError(
            f"is for {own.name}, the cases are for {task.name}",
            where=policy.where,
            fix=f"use a policy for {task.name}",
        )
    length = np.array([draw["length"] for draw in cases.draws])
    # as the policy sees them: its own rope's specific modulus at the same bending
    modulus = np.array(
        [
            own.conditioned_on(
                draw["specific_modulus"],
                length=draw["length"],
                diameter=draw["diameter"],
                gravity=task.gravity,
            )
            for draw in cases.draws
        ]
    )
    nu = np.array([draw["poissons_ratio"] for draw in cases.draws])
    reach = cases.goal / length
    action = policy.into_limits(policy.actions(reach, modulus, nu)) * length[:, None]
    ends = np.array([policy.goal_range(s) for s in modulus])
    acted = [
        {**draw, **dict(zip(task.action_names, map(float, values), strict=True))}
        for draw, values in zip(cases.draws, action, strict=True)
    ]
    outcomes = task.demonstrate(acted, device=cases.device, dtype=cases.dtype)
    return Score(
        action=action,
        goal=cases.goal,
        reached=outcomes.columns[f"goal_{task.goal_names[0]}"],
        length=length,
        outside=(reach < ends[:, 0]) | (reach > ends[:, 1]),
    )


def _draw(
    task: RopeReaching, rng: np.random.Generator, ranges: Mapping[str, tuple[float, float]]
) -> dict[str, float]:
    drawn = task.draw(rng)
    for name, (low, high) in ranges.items():
        if not 0.0 < low <= high:
            raise ParameterError(
                f"is {low} to {high}", where=name, fix="give a positive range, smaller end first"
            )
        if name == "specific_modulus":
            drawn[name] = math.exp(rng.uniform(math.log(low), math.log(high)))
            drawn["youngs_modulus"] = drawn[name] * drawn["density"]
        elif name == "poissons_ratio":
            drawn[name] = rng.uniform(low, high)
        else:
            raise ParameterError(
                f"no range of {name!r} can be set", fix="set specific_modulus or poissons_ratio"
            )
    return drawn


def _figures(error: NDArray[np.float64]) -> dict[str, float | None]:
    if not len(error):
        return dict.fromkeys(("mean", "std", "median", "p95"))
    return {
        "mean": float(error.mean()),
        "std": float(error.std()),
        "median": float(np.median(error)),
        "p95": float(np.quantile(error, 0.95)),
    }
