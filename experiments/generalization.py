"""The default policy and R2S2R on the paper's three ropes, and on softer ones than any in training.

Errors are in the paper's unit, as those of `ablation`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from experiments.ablation import METRIC, SCALES, Settings, Simulated, metric, table_of
from experiments.r2s2r import identify
from experiments.runs import Result, Runs
from gendom.materials import Item, Material, with_dimensionless
from gendom.policies.adaptation import Execution

DEMONSTRATIONS = 2_271
"""The paper's number."""

GOALS = (40, 200)
"""Means are taken over the first so many."""

IN_DOMAIN = {"E_over_rho": (1500.0, 8200.0), "nu": (0.34, 0.36)}

OUTSIDE = {"E_over_rho": (500.0, 1500.0), "nu": (0.3, 0.33)}

ROPES = ((1779.38, 0.35), (3276.12, 0.346), (8000.31, 0.36))
"""E and nu of the paper's three ropes, the cotton one first."""

IDENTIFIED_FROM = 20
"""Executions that R2S2R finds its parameters from."""

IDENTIFIED_IN = {"bending_ratio": (0.2, 0.8), "nu": (0.2, 0.4)}
"""Ranges in which it looks, as `gendom.materials.dimensionless_parameters` has them."""

PAPER = {
    "in domain": {"ours": 0.031, "R2S2R, three ropes": 0.082, "R2S2R, cotton rope": 0.047},
    "outside": {"ours": 0.039, "R2S2R, three ropes": 0.096, "R2S2R, cotton rope": 0.046},
}
"""Mean errors in the paper, over 40 goals."""


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """A table for each domain."""
    settings = replace(
        SCALES[flags.scale],
        task=flags.task,
        engine=flags.engine,
        demonstrations=DEMONSTRATIONS,
        goals=GOALS,
    )
    figures = generalization(runs, settings)
    shown = [
        table_of(domain.capitalize(), rows, PAPER[domain])
        for domain, rows in figures["rows"].items()
    ]
    about = {"task": flags.task, "engine": flags.engine}
    return Result(name=f"generalization-{flags.task}", figures={**about, **figures}, shown=shown)


def generalization(runs: Runs, settings: Settings) -> dict[str, Any]:
    """Ours beside R2S2R, with the paper's three ropes and with softer ones than any in training.

    Returns:
        JSON: rows by domain, and the parameters that R2S2R found.
    """
    made = Simulated("generalization", runs, settings, IN_DOMAIN)
    data = made.demonstrations()
    jobs = {
        "ours, inverse": made.job(data, "inverse", ("bending_ratio", "nu"), "smooth"),
        "ours": made.job(data, "refined", ("bending_ratio", "nu")),
        "ours, no parameters": made.job(data, "refined", ()),
    }
    found: dict[str, Any] = {}
    ropes = [_rope(made.task.item, E, nu) for E, nu in ROPES]
    for label, group in (("R2S2R, three ropes", ropes), ("R2S2R, cotton rope", ropes[:1])):
        kept = runs.kept(f"{made.name}-{label}", partial(_identified, made, group))
        found[label] = kept
        item = with_dimensionless(made.task.item, kept["parameters"])
        only = replace(made.task, item=item, ranges={})
        own = made.demonstrations(f"-{label}-demonstrations", only)
        for method in ("inverse", "refined"):
            jobs[f"{label}, {method}"] = made.job(own, method, (), "smooth")
    policies = made.policies(jobs)
    softer = replace(made.task, ranges=metric(OUTSIDE))
    rows: dict[str, Any] = {}
    for domain, cases in (
        ("in domain", made.cases(seed=runs.seed, items=ropes)),
        ("outside", made.cases(seed=runs.seed, task=softer)),
    ):
        rows[domain] = made.rows(policies, cases)
        rows[domain]["ours, polished"] = made.polished_row(cases, policies["ours"][0])
    return {"rows": rows, "identified": found, "demonstrations": len(data)}


def _rope(like: Item, E: float, nu: float) -> Item:
    """A rope with E in the paper's unit and nu."""
    m = like.material
    material = Material(E=METRIC * E * m.density, nu=nu, density=m.density, damping=m.damping)
    return replace(like, material=material)


def _identified(made: Simulated, ropes: Sequence[Item]) -> dict[str, Any]:
    """R2S2R's parameters from executions with some ropes."""
    task, world, seed = made.task, made.world, made.runs.seed
    rng = np.random.default_rng([seed, len(ropes)])
    items = [ropes[k % len(ropes)] for k in range(IDENTIFIED_FROM)]
    actions = np.array([task.sample_actions(item, rng, 1)[0] for item in items])
    seen = [
        (item, Execution(action=a, reached=np.array([o.values[q.name] for q in task.goals])))
        for item, a, o in zip(items, actions, world.carry_out(task, items, actions), strict=True)
        if o.fault is None
    ]
    found = identify(task, seen, world=world, ranges=IDENTIFIED_IN, seed=seed)
    return {"parameters": found.parameters, "misfit": found.misfit}
