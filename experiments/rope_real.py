"""The paper's table of real ropes, in the MuJoCo test scene: each rope is lifted once, then goals
are reached with it. True parameters serve only for the score, and for two rows that are labelled
so.

Baselines: pi_RD is trained on demonstrations of the three ropes in the second reality, R2S2R on
simulations with parameters from twenty of them; the inverse one is the paper's method.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.r2s2r import identify
from experiments.runs import (
    Chart,
    Misses,
    Result,
    Runs,
    Table,
    TrainingJob,
    adapted,
    misses,
    polished,
    stated,
)
from gendom.materials import (
    PARAMETERS,
    Item,
    dimensionless_parameters,
    with_dimensionless,
)
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.adaptation import Execution
from gendom.policies.belief import believed
from gendom.policies.demonstrations import SMALLEST, Demonstrations, joined
from gendom.policies.evaluation import choose, judge
from gendom.tasks import Task, find_task
from gendom.tasks.cases import Cases, draw_cases
from gendom.tasks.demonstrator import Demonstrator
from gendom.tasks.task import World
from gendom.tasks.world import Simulation

Array = NDArray[np.float64]

ROPES = ("rope-cotton", "rope-polyester", "rope-polyethylene")
"""Of the second reality, as the paper's."""

PAPER = {
    "inverse": (0.148, 0.106, 0.588),
    "sim+real": (0.112, 0.076, 0.193),
    "pi_RD, inverse": (0.426, 0.273, 0.297),
    "R2S2R, inverse": (0.318, 0.343, 0.364),
}
"""Sums over seven goals in the paper, of its cotton, polyester and polyethylene rope [m]."""

IDENTIFIED_FROM = 20
"""Executions that R2S2R finds its parameters from."""

FEW = 10
"""One in so many real demonstrations is in the smaller set for fine-tuning, if they are enough."""

WITHOUT_LIFT = 3.0 * math.log(0.7 / 0.25) / math.sqrt(12.0)
"""Standard deviation of ln E before a lift: bending lengths of 0.25 to 0.7 sizes."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Numbers of simulations, trainings and trials."""

    task: str = "rope-reaching"
    goals: int = 7
    """Of each rope: evenly over its reach, or drawn where they have two numbers."""
    demonstrations: int
    real: int
    """Demonstrations of each rope in the second reality."""
    epochs: int
    steps: int = 3000
    """Of the optimiser in each training, at least, in each round of refining and in fine-tuning."""
    refine: int
    """Rounds in the simulator of policies that are trained on simulations by our method."""
    executions: int
    """That are learnt from, one after the other, for each goal."""


SCALES = {
    "small": Settings(goals=2, demonstrations=4_000, real=20, epochs=60, executions=1, refine=1),
    "full": Settings(demonstrations=40_000, real=100, epochs=100, executions=1, refine=3),
}


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """Estimates, misses of goals, their sums by rope, components of the errors, and errors by the
    number of executions."""
    figures = rope_real(runs, replace(SCALES[flags.scale], task=flags.task))
    return Result(
        name=f"rope-real-{flags.task}",
        figures={"task": flags.task, **figures},
        shown=shown_of(figures),
    )


def rope_real(runs: Runs, settings: Settings) -> dict[str, Any]:
    """Measure all rows.

    Returns:
        JSON: estimates, goals, rows with errors over them by the arm and, of policies, in our
        simulator, and what the error is made of. Errors [m]; null where an action failed.

    Raises:
        DeviceError: The second reality cannot be simulated or rendered here.
        ModuleNotFoundError: Torch is missing.
    """
    from gendom.reality import RealWorld, find_object

    task = find_task(settings.task)()
    ropes = [find_object(name) for name in ROPES]
    beliefs = list(runs.each(partial(runs.lifted, task=task), ROPES, "lifts"))
    chosen = runs.kept(
        f"{task.name}-chosen", partial(_chosen, runs, settings, task, ropes, beliefs)
    )
    goal, actions = np.array(chosen["goals"]), chosen.pop("actions")
    items = tuple(ropes[k % len(ropes)] for k in range(len(goal)))
    cases = Cases(task=task, items=items, goal=goal)
    rows = Measured(
        runs=runs,
        title=f"{task.name}-row",
        settings=settings,
        cases=cases,
        world=RealWorld(jobs=runs.jobs),
    )
    return {
        "estimates": {n: stated(b) for n, b in zip(ROPES, beliefs, strict=True)},
        **chosen,
        "ropes": [ROPES[k % len(ROPES)] for k in range(len(cases))],
        **_measured(rows, [beliefs[k % len(beliefs)] for k in range(len(cases))], actions),
    }


def _chosen(
    runs: Runs, settings: Settings, task: Task, ropes: Sequence[Item], beliefs: Sequence[Estimate]
) -> dict[str, Any]:
    """Goals, what all policies do for them, and what was searched to train them."""
    simulated = runs.demonstrations(
        f"{task.name}-simulated", Demonstrator(task=task), settings.demonstrations
    )
    real = [
        _real(runs, settings, task, name, belief.most_likely)
        for name, belief in zip(ROPES, beliefs, strict=True)
    ]
    policies, searches = _policies(runs, settings, task, simulated, real)
    policies |= {f"shipped{end}": Policy.pretrained(task.name, parameters=not end)
                 for end in ("", ", no parameters")}  # fmt: skip
    cases = _cases(runs, settings, task, policies["ours"], ropes)
    known = [beliefs[k % len(beliefs)].most_likely for k in range(len(cases))]
    actions = {name: choose(policy, cases, known=known) for name, policy in policies.items()}
    actions["ours, true parameters"] = choose(policies["ours"], cases)
    found = {name: action.tolist() for name, action in actions.items()}
    return {"searches": searches, "goals": cases.goal.tolist(), "actions": found}


def _real(runs: Runs, settings: Settings, task: Task, name: str, known: Item) -> Demonstrations:
    """The second reality's demonstrations of a rope, with the parameters of its estimate in place
    of the true ones."""
    from gendom.reality import RealWorld, find_object

    source = Demonstrator(
        task=task, world=RealWorld(jobs=runs.jobs), items=(find_object(name),),
        acts=partial(choose, Policy.pretrained(task.name), known=[known]),
    )  # fmt: skip
    kept = runs.demonstrations(f"{task.name}-{name}", source, settings.real, device="cpu")
    alike = dimensionless_parameters(known)
    return replace(kept, parameters={n: np.full(len(kept), alike[n]) for n in PARAMETERS})


def _policies(
    runs: Runs,
    settings: Settings,
    task: Task,
    simulated: Demonstrations,
    real: Sequence[Demonstrations],
) -> tuple[dict[str, Policy], dict[str, Any]]:
    """Policies by row, and what was searched for the baselines' sake.

    Baselines see no parameters. They are trained on real demonstrations (pi_RD) or on simulations
    with R2S2R's parameters: by our method, and by the inverse one with the best of eight settings.
    """
    from gendom.policies.fitting import Training

    def job(data: Demonstrations, training: Training, **other: Any) -> TrainingJob:
        return TrainingJob.of_steps(data, training, settings.steps, **other)

    every_real = joined(joined(real[0], real[1]), real[2])
    each = min(FEW, len(every_real) // SMALLEST)
    few_real = every_real.chosen(np.arange(0, len(every_real), each))
    identified = runs.kept(f"{task.name}-R2S2R", partial(_identified, runs, task, real))
    searches: dict[str, Any] = {"R2S2R": identified}
    only = replace(task, item=with_dimensionless(task.item, identified["parameters"]), ranges={})
    known = runs.demonstrations(
        f"{task.name}-R2S2R", Demonstrator(task=only), settings.demonstrations
    )
    sets = {"pi_RD": every_real, "R2S2R": known}

    plain = Training(epochs=settings.epochs, refine_steps=settings.steps, seed=runs.seed)
    refined = replace(plain, refine=settings.refine)
    inverse = replace(plain, method="inverse")
    tuned = replace(refined, finetune_steps=settings.steps)
    world = runs.training_world()
    jobs = {
        "ours": job(simulated, refined, world=world),
        "ours, no parameters": job(simulated, replace(refined, conditioned_on=()), world=world),
        "sim+real": job(simulated, tuned, finetune=every_real, world=world),
        "sim+real, few": job(simulated, tuned, finetune=few_real, world=world),
        # real demonstrations have no simulator to refine in
        "pi_RD": job(every_real, replace(plain, conditioned_on=())),
        "R2S2R": job(known, replace(refined, conditioned_on=()), world=world),
        "inverse": job(simulated, inverse, world=world),
        "inverse, no parameters": job(simulated, replace(inverse, conditioned_on=()), world=world),
    }
    found = {
        row: _inverse_search(data, settings, replace(inverse, conditioned_on=()))
        for row, data in sets.items()
    }
    # all at once: the longest first
    jobs |= {f"{row}, {which}": one for row, many in found.items() for which, one in many.items()}
    policies = runs.policies(jobs, prefix=f"{settings.task}-")
    for row, many in found.items():
        tried = {which: policies.pop(f"{row}, {which}") for which in many}
        errors = {
            which: float(policy.description.training["errors"]["action_rms"])
            for which, policy in tried.items()
        }
        name = f"{row}, inverse"
        policies[name], searches[name] = tried[min(errors, key=errors.__getitem__)], errors
    return policies, searches


def _inverse_search(
    data: Demonstrations, settings: Settings, inverse: Any
) -> dict[str, TrainingJob]:
    """Eight settings of a baseline's training; that policy is taken whose action is nearest to that
    of demonstrations it has not seen."""
    return {
        f"inverse-{architecture}-{share:g}-{decay:g}": TrainingJob.of_steps(
            data,
            replace(
                inverse,
                architecture=architecture,
                epochs=max(round(share * settings.epochs), 1),
                weight_decay=decay,
            ),
            round(share * settings.steps),
        )
        for architecture in ("paper", "smooth")
        for share in (0.33, 1.0)
        for decay in (1e-4, 1e-2)
    }


def _identified(runs: Runs, task: Task, real: Sequence[Demonstrations]) -> dict[str, Any]:
    """R2S2R's parameters, from the first real demonstrations of some ropes."""
    seen = []
    for k, demonstrations in enumerate(real):
        # an object of the task's size with the parameters that these demonstrations have
        own = {name: float(values[0]) for name, values in demonstrations.parameters.items()}
        item = with_dimensionless(task.item, own)
        count = len(range(k, IDENTIFIED_FROM, len(real)))
        actions = demonstrations.action[:count] * task.action_units(item)
        reached = demonstrations.goal[:count] * task.goal_units(item)
        seen += [
            (item, Execution(action=a, reached=g)) for a, g in zip(actions, reached, strict=True)
        ]
    found = identify(task, seen, world=Simulation(device=runs.device))
    return {"parameters": found.parameters, "misfit": found.misfit,
            "executions": found.executions, "rollouts": found.rollouts}  # fmt: skip


def _cases(
    runs: Runs, settings: Settings, task: Task, policy: Policy, ropes: Sequence[Item]
) -> Cases:
    """Goals of all ropes in turns: evenly over the reach of each, as the paper's, or drawn."""
    count = len(ropes) * settings.goals
    if len(task.goals) > 1:
        world = Simulation(device=runs.device)
        return draw_cases(task, count, seed=runs.seed, items=ropes, simulation=world)
    items = [ropes[k % len(ropes)] for k in range(count)]
    shares = 0.1 + 0.8 * (np.arange(count) // len(ropes)) / max(settings.goals - 1, 1)
    low, high = np.array([policy.goal_range(item)[0] for item in items]).T
    return Cases(task=task, items=tuple(items), goal=(low + shares * (high - low))[:, None])


@dataclass(frozen=True, kw_only=True)
class Measured(Misses):
    """Rows of the goals."""

    settings: Settings
    cases: Cases
    world: World
    """Where actions are carried out."""

    def acted(self, name: str, act: Callable[[], Array]) -> tuple[Array, Array]:
        """[W, A] actions and [W, G] what they reached."""
        return self.row(name, self.cases, self.world, act)


def _measured(
    rows: Measured, beliefs: Sequence[Estimate], actions: Mapping[str, Sequence[Sequence[float]]]
) -> dict[str, Any]:
    """Errors [W] of every row, and the components of our own.

    Args:
        rows: The goals.
        beliefs: [W] of each one's rope.
        actions: [W, A] of policies, by row.
    """
    cases, sim = rows.cases, Simulation(device=rows.runs.device)

    def acted(name: str) -> tuple[Array, Array]:
        return rows.acted(name, lambda: np.array(actions[name]))

    done = {name: acted(name) for name in actions}
    ours, reached = done["ours"]
    action, there = rows.acted("polished", partial(polished, cases, beliefs, ours, sim))
    seen: list[list[Execution]] = [[] for _ in cases.items]
    for k in range(1, rows.settings.executions + 1):
        for w, (a, y) in enumerate(zip(action, there, strict=True)):
            if np.isfinite(y).all():
                seen[w].append(Execution(action=a, reached=y))
        name = f"polished, {k} execution{'s' * (k > 1)}"
        act = partial(adapted, cases, beliefs, seen, action, sim)
        action, there = rows.acted(name, act)
    assumed = [
        believed(Estimate.of(_middling(rope)), cases.task).with_uncertain(
            "E_over_rho", WITHOUT_LIFT
        )
        for rope in cases.items
    ]
    blind, _ = done["ours, no parameters"]
    without = partial(polished, cases, assumed, blind, sim)
    rows.acted("polished, no lift", without)
    true, _ = done["ours, true parameters"]
    here = replace(rows, title=f"{rows.title}-simulated", errors={})
    for name, (found, _) in done.items():
        here.row(name, cases, sim, partial(np.array, found))
    made_of = _components(rows, ours, reached, true)
    return {"errors": rows.errors, "simulated": here.errors, "made_of": made_of}


def _components(rows: Measured, ours: Array, reached: Array, true: Array) -> dict[str, float]:
    """Of our error, root mean squares [m], one change at a time.

    Args:
        rows: The set of goals.
        ours: [W, A] our actions.
        reached: [W, G] what the arm reached with them.
        true: [W, A] our actions for the true parameters.
    """
    from gendom.reality import RealWorld

    free = RealWorld(robot=False, jobs=rows.runs.jobs)
    _, by_hand = rows.row("ours, by a free hand", rows.cases, free, lambda: ours)
    del rows.errors["ours, by a free hand"]
    sim = Simulation(device=rows.runs.device)
    simulated = judge(rows.cases, ours, world=sim)
    exact = judge(rows.cases, true, world=sim)
    return {
        "arm": _rms(reached - by_hand),
        "simulator": _rms(by_hand - simulated.reached),
        "estimate": _rms(simulated.error - exact.error),
        "policy": _rms(exact.error),
    }


def _middling(rope: Item) -> Item:
    """A rope with these sizes and this mass; all else is unknown."""
    return with_dimensionless(rope, {"bending_ratio": 0.45, "damping": 0.02, "nu": 0.3})


def _rms(values: Array) -> float:
    flat = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(flat**2))) if len(flat) else math.nan


def shown_of(result: Mapping[str, Any]) -> list[Table | Chart]:
    """Tables of `rope_real`, and errors by the number of executions."""
    names, ropes = list(next(iter(result["estimates"].values()))), result["ropes"]
    sums = {
        row: (
            *(f"{_sum(errors, ropes, rope):.3f}" for rope in ROPES),
            *(f"{x:.3f}" for x in PAPER.get(row, ())),
            *[""] * (0 if row in PAPER else len(ROPES)),
        )
        for row, errors in result["errors"].items()
    }
    short = [rope.removeprefix("rope-") for rope in ROPES]
    shown: list[Table | Chart] = [
        Table(
            title="Estimates (E over density; SI)",
            head=tuple(names),
            rows={
                rope: tuple(f"{estimate[n]['mean']:.4g}" for n in names)
                for rope, estimate in result["estimates"].items()
            },
        ),
        misses(f"{len(ropes)} goals", result["errors"]),
        misses("In GenDOM's simulator", result["simulated"]),
        Table(
            title="Made of [mm]",
            head=tuple(result["made_of"]),
            rows={"ours": tuple(f"{1e3 * value:.1f}" for value in result["made_of"].values())},
        ),
        Table(
            title="Sums over each rope's goals [m]",
            head=(*short, *(f"paper, {rope}" for rope in short)),
            rows=sums,
        ),
    ]
    after = [
        e for row, e in result["errors"].items() if row.startswith("polished") and "lift" not in row
    ]
    lines = {
        name: (list(range(len(after))), [1e3 * float(of(np.array(e, dtype=float))) for e in after])
        for name, of in (("mean", np.nanmean), ("median", np.nanmedian))
    }
    title = "Polished, after executions"
    return [*shown, Chart(title=title, x="executions", y="missed by [mm]", lines=lines)]


def _sum(errors: Sequence[float | None], ropes: Sequence[str], rope: str) -> float:
    """Over one rope's goals; NaN if one failed."""
    own = [e for e, name in zip(errors, ropes, strict=True) if name == rope]
    return float(np.sum(np.array(own, dtype=float)))
