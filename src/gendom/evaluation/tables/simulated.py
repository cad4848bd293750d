"""The paper's two tables in simulation: the effect of parameters as an input, and generalisation of
policies.

Errors are in the paper's unit, in which a rope is 0.5 long.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.evaluation.protocol import Cases, choose, draw_cases, judge
from gendom.evaluation.tables.workbench import Wanted, Workbench
from gendom.materials import Item, Material, Rope, with_dimensionless
from gendom.policies import Policy
from gendom.policies.adaptation import Execution
from gendom.policies.demonstrations import Demonstrations
from gendom.policies.identify import IdentifySettings, identify
from gendom.policies.polishing import PolishSettings, polishing
from gendom.policies.rollouts import side_by_side
from gendom.tasks import Task, find_task
from gendom.tasks.demonstrator import Demonstrator
from gendom.tasks.task import ROPE
from gendom.tasks.world import Simulation

Array = NDArray[np.float64]

LENGTH = 0.5
"""Of a rope in the paper's unit."""

METRIC = 9.81 * ROPE.length / (12.0 * LENGTH)
"""E / density of our rope [m^2/s^2] by the paper's E, see `gendom.tasks.rope_reaching`."""

ABLATION_RANGES = {"E_over_rho": (500.0, 10500.0), "nu": (0.2, 0.4)}

IN_DOMAIN = {"E_over_rho": (1500.0, 8200.0), "nu": (0.34, 0.36)}

OUTSIDE = {"E_over_rho": (500.0, 1500.0), "nu": (0.3, 0.33)}

ROPES = ((1779.38, 0.35), (3276.12, 0.346), (8000.31, 0.36))
"""E and nu of the paper's three ropes, the cotton one first."""

IDENTIFIED_FROM = 20
"""Executions that R2S2R finds its parameters from."""

ARCHITECTURES = {"inverse": "paper", "distal": "smooth", "refined": "smooth"}
"""Of networks by row: the paper's for its method, ours for ours. ``refined``: distal, then refined
in the simulator."""

SEES: dict[str, tuple[str, ...]] = {
    "both": ("bending_ratio", "nu"),
    "E": ("bending_ratio",),
    "nu": ("nu",),
    "none": (),
}


@dataclass(frozen=True, kw_only=True)
class SimulatedSettings:
    """Numbers of simulations and trainings."""

    task: str = "rope-reaching"
    engine: str = "thin"
    """``thin``: rods. ``mpm``: the paper's engine."""
    demonstrations: int = 40_000
    epochs: int = 150
    goals: tuple[int, ...] = (30, 200)
    """Means are taken over the first so many."""
    seeds: int = 3
    """Trainings of each row."""
    curve: tuple[int, ...] = (100, 300, 1000, 3000, 10_000)
    """Demonstrations, fewer than all, that `ablation` also trains on."""
    steps: int = 3000
    """Of the optimiser in each training, at least, and in each round of refining."""
    refine: int = 4
    """Rounds in the simulator, of rows that are refined."""
    damping: float = 0.001
    """Of all ropes [s]; of the MPM none, whose grid damps about as much."""


def ablation(bench: Workbench, settings: SimulatedSettings) -> dict[str, Any]:
    """Policies that see both parameters, one or none: their errors for goals of random ropes.

    Args:
        bench: Where everything is kept.
        settings: How much.

    Returns:
        JSON: rows with mean and standard deviation of the error for each number of goals, and
        the same of policies that see both, by the number of demonstrations.
    """
    task, world = _task(settings, ABLATION_RANGES), _world(bench, settings)
    name = f"ablation-{task.name}-{settings.engine}"
    data = bench.demonstrations(name, Demonstrator(task=task, world=world), settings.demonstrations)
    wanted = {
        f"{method}, {sees}": _wanted(bench, data, settings, method, SEES[sees])
        for method in ARCHITECTURES
        for sees in SEES
    }
    policies = _trained(bench, name, settings, wanted)
    cases = draw_cases(task, max(settings.goals), seed=bench.seed, simulation=world)
    rows = _rows(bench, settings, policies, cases, world)
    polished = _polished(cases, policies["refined, both"][0], world)
    rows["polished, both"] = _figures(settings, [polished])
    return {
        "rows": rows,
        "by_demonstrations": _curve(bench, settings, name, data, cases, world),
        "demonstrations": len(data),
    }


def _curve(
    bench: Workbench,
    settings: SimulatedSettings,
    name: str,
    data: Demonstrations,
    cases: Cases,
    world: Simulation,
) -> dict[str, Any]:
    """Rows of policies that see both parameters, trained on the first demonstrations only."""
    wanted = {
        f"{method}, {count}": _wanted(bench, data.first(count), settings, method, SEES["both"])
        for method in ("inverse", "distal")
        for count in settings.curve
        if count < len(data)
    }
    return _rows(bench, settings, _trained(bench, name, settings, wanted), cases, world)


def generalization(bench: Workbench, settings: SimulatedSettings) -> dict[str, Any]:
    """Ours beside R2S2R, with the paper's three ropes and with softer ones than any in training.

    Args:
        bench: Where everything is kept.
        settings: How much.

    Returns:
        JSON: rows by domain, and the parameters that R2S2R found.
    """
    task, world = _task(settings, IN_DOMAIN), _world(bench, settings)
    name = f"generalization-{task.name}-{settings.engine}"
    data = bench.demonstrations(name, Demonstrator(task=task, world=world), settings.demonstrations)
    both = SEES["both"]
    wanted = {
        "ours, inverse": _wanted(
            bench, data, settings, "inverse", ("bending_ratio", "nu"), "smooth"
        ),
        "ours": _wanted(bench, data, settings, "refined", both),
        "ours, no parameters": _wanted(bench, data, settings, "refined", ()),
    }
    found: dict[str, Any] = {}
    ropes = [_rope(task.item, E, nu) for E, nu in ROPES]
    for label, group in (("R2S2R, three ropes", ropes), ("R2S2R, cotton rope", ropes[:1])):
        kept = bench.kept(
            f"{name}-{label}",
            lambda group=group: _identified(bench, task, group, world),
        )
        found[label] = kept
        only = replace(task, item=with_dimensionless(task.item, kept["parameters"]), ranges={})
        own = bench.demonstrations(
            f"{name}-{label}-demonstrations",
            Demonstrator(task=only, world=world),
            settings.demonstrations,
        )
        for method in ("inverse", "refined"):
            wanted[f"{label}, {method}"] = _wanted(bench, own, settings, method, (), "smooth")
    policies = _trained(bench, name, settings, wanted)
    count = max(settings.goals)
    sets = {
        "in domain": draw_cases(task, count, seed=bench.seed, items=ropes, simulation=world),
        "outside": draw_cases(
            replace(task, ranges=_metric(OUTSIDE)), count, seed=bench.seed, simulation=world
        ),
    }
    rows: dict[str, Any] = {}
    for domain, cases in sets.items():
        rows[domain] = _rows(bench, settings, policies, cases, world)
        rows[domain]["ours, polished"] = _figures(
            settings, [_polished(cases, policies["ours"][0], world)]
        )
    return {"rows": rows, "identified": found, "demonstrations": len(data)}


def _task(settings: SimulatedSettings, ranges: Mapping[str, tuple[float, float]]) -> Task:
    material = replace(
        ROPE.material, damping=settings.damping if settings.engine == "thin" else 0.0
    )
    kind = find_task(settings.task)
    # the paper's ropes are straight
    straight = {"bow": 0.0} if settings.task == "rope-reaching" else {}
    return kind(item=replace(ROPE, material=material), ranges=_metric(ranges), **straight)


def _metric(ranges: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    low, high = ranges["E_over_rho"]
    return {**ranges, "E_over_rho": (METRIC * low, METRIC * high)}


def _rope(like: Item, E: float, nu: float) -> Rope:
    assert isinstance(like, Rope)
    m = like.material
    material = Material(E=METRIC * E * m.density, nu=nu, density=m.density, damping=m.damping)
    return replace(like, material=material)


def _world(bench: Workbench, settings: SimulatedSettings) -> Simulation:
    return Simulation(engine=settings.engine, device=bench.device)


def _wanted(
    bench: Workbench,
    data: Demonstrations,
    settings: SimulatedSettings,
    row: str,
    sees: tuple[str, ...],
    architecture: str | None = None,
) -> Wanted:
    """A policy of a row, one of `ARCHITECTURES`."""
    from gendom.policies.training import Training

    training = Training(
        method="distal" if row == "refined" else row,
        conditioned_on=sees,
        architecture=architecture or ARCHITECTURES[row],
        epochs=settings.epochs,
        refine=settings.refine if row == "refined" else 0,
        refine_steps=settings.steps,
    )
    world = bench.beside_training(settings.engine)
    return Wanted.suited(data, training, settings.steps, world=world)


def _trained(
    bench: Workbench, name: str, settings: SimulatedSettings, wanted: Mapping[str, Wanted]
) -> dict[str, list[Policy]]:
    """Of each row, one policy a seed."""
    every = {
        f"{name}-{row}-{seed}": replace(one, training=replace(one.training, seed=seed))
        for row, one in wanted.items()
        for seed in range(bench.seed, bench.seed + settings.seeds)
    }
    made = iter(bench.policies(every).values())
    return {row: [next(made) for _ in range(settings.seeds)] for row in wanted}


def _identified(
    bench: Workbench, task: Task, ropes: Sequence[Item], world: Simulation
) -> dict[str, Any]:
    """R2S2R's parameters from executions with some ropes."""
    rng = np.random.default_rng([bench.seed, len(ropes)])
    items = [ropes[k % len(ropes)] for k in range(IDENTIFIED_FROM)]
    actions = np.array([task.sample_actions(item, rng, 1)[0] for item in items])
    seen = [
        (item, Execution(action=a, reached=np.array([o.values[q.name] for q in task.goals])))
        for item, a, o in zip(items, actions, world.carry_out(task, items, actions), strict=True)
        if o.fault is None
    ]
    ranges = IdentifySettings(
        ranges={"bending_ratio": (0.2, 0.8), "nu": (0.2, 0.4)}, seed=bench.seed
    )
    found = identify(task, seen, world=world, settings=ranges)
    return {"parameters": found.parameters, "misfit": found.misfit}


def _rows(
    bench: Workbench,
    settings: SimulatedSettings,
    policies: Mapping[str, Sequence[Policy]],
    cases: Cases,
    world: Simulation,
) -> dict[str, Any]:
    rows = {}
    for row, seeds in policies.items():
        bench.on_stage(f"{len(cases)} goals: {row}")
        rows[row] = _figures(
            settings, [_errors(cases, choose(policy, cases), world) for policy in seeds]
        )
    return rows


def _errors(cases: Cases, action: Array, world: Simulation) -> Array:
    """[W] in the paper's unit."""
    found = judge(cases, action, world=world)
    return LENGTH * found.error / found.size


def _polished(cases: Cases, policy: Policy, world: Simulation) -> Array:
    start = choose(policy, cases)
    patient = PolishSettings(seconds=math.inf)
    searches = [
        polishing(cases.task, goal, [item], a, settings=patient)
        for item, goal, a in zip(cases.items, cases.goal, start, strict=True)
    ]
    found = side_by_side(cases.task, world, searches)
    return _errors(cases, np.array([p.action for p in found]), world)


def _figures(settings: SimulatedSettings, errors: Sequence[Array]) -> dict[str, Any]:
    """Over the first goals, all trainings together: mean, standard deviation, the mean's 95 %
    interval (normal, goals independent), and the means of the trainings."""
    found = {}
    for count in settings.goals:
        some = np.array([e[:count] for e in errors])
        flat = some[np.isfinite(some)]
        half = 1.96 * float(flat.std()) / math.sqrt(max(count, 1))
        mean = float(flat.mean())
        found[str(count)] = {
            "mean": mean,
            "std": float(flat.std()),
            "median": float(np.median(flat)),
            "interval_95": [mean - half, mean + half],
            "by_seed": [float(np.nanmean(e)) for e in some],
            "failed": int((~np.isfinite(some)).sum()),
        }
    return found
