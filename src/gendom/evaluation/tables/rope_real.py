"""The paper's table of real ropes, in the MuJoCo test scene: each rope is lifted once, then goals
are reached with it. True parameters serve only for the score, and for two rows that are labelled
so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.evaluation.protocol import Cases, choose, draw_cases, judge
from gendom.evaluation.tables.lifted import lifted, stated
from gendom.evaluation.tables.workbench import Wanted, Workbench
from gendom.materials import (
    PARAMETERS,
    Item,
    dimensionless_parameters,
    to_columns,
    with_dimensionless,
)
from gendom.policies import Policy
from gendom.policies.adaptation import Execution, adapting
from gendom.policies.belief import Belief
from gendom.policies.demonstrations import Demonstrations, joined
from gendom.policies.identify import Identified, identify
from gendom.policies.polishing import PolishSettings, polishing
from gendom.policies.rollouts import side_by_side
from gendom.tasks import Task, find_task
from gendom.tasks.demonstrator import Demonstrator
from gendom.tasks.task import World
from gendom.tasks.world import Simulation

Array = NDArray[np.float64]

ROPES = ("rope-cotton", "rope-polyester", "rope-polyethylene")
"""Of the second reality, as the paper's; baselines of one rope see the first."""

IDENTIFIED_FROM = 20
"""Executions that R2S2R finds its parameters from."""

CANDIDATES = 16
"""Number of candidates for an action that is not sensitive to disturbances."""

WITHOUT_LIFT = 3.0 * math.log(0.7 / 0.25) / math.sqrt(12.0)
"""Standard deviation of ln E before a lift: bending lengths of 0.25 to 0.7 sizes."""


@dataclass(frozen=True, kw_only=True)
class RopeRealSettings:
    """Numbers of simulations, trainings and trials."""

    task: str = "rope-reaching"
    goals: int = 24
    """Of each rope, drawn."""
    demonstrations: int = 40_000
    real: int = 100
    """Demonstrations of each rope in the second reality."""
    epochs: int = 150
    steps: int = 3000
    """Of the optimiser in each training, at least, and in each round of refining."""
    refine: int = 4
    """Rounds in the simulator of policies that are trained on simulations by our method."""
    finetune_epochs: int = 300
    """Of fine-tuning on the second reality's demonstrations."""
    executions: int = 3
    """That are learnt from, one after the other, for each goal."""
    draws: int = 8
    """Objects that an action is polished for."""


def rope_real(bench: Workbench, settings: RopeRealSettings) -> dict[str, Any]:
    """Measure all rows.

    Args:
        bench: Where everything is kept.
        settings: How much.

    Returns:
        JSON: estimates, rows with errors over the drawn goals, rows with sums over seven goals, and
        what the error is made of. Errors [m]; null where the arm or the simulation failed.

    Raises:
        DeviceError: The second reality cannot be simulated or rendered here.
        ModuleNotFoundError: Torch is missing.
    """
    from gendom.reality import RealWorld, find_object

    task = find_task(settings.task)()
    ropes = [find_object(name) for name in ROPES]
    beliefs = [lifted(bench, name, task) for name in ROPES]
    simulated = bench.demonstrations(
        f"{task.name}-simulated", Demonstrator(task=task), settings.demonstrations
    )
    real = [
        _real(bench, settings, task, name, belief.most_likely)
        for name, belief in zip(ROPES, beliefs, strict=True)
    ]
    policies = _ours(bench, settings, simulated, joined(joined(real[0], real[1]), real[2]))
    baselines, searches = _baselines(bench, settings, task, real)
    policies |= baselines

    cases = draw_cases(task, len(ropes) * settings.goals, seed=bench.seed, items=ropes,
                       simulation=Simulation(device=bench.device))  # fmt: skip
    seven = _seven(task, policies["ours"], ropes) if len(task.goals) == 1 else None
    world = RealWorld(jobs=bench.jobs)
    sets = {"drawn": cases} | ({"seven": seven} if seven is not None else {})
    result: dict[str, Any] = {
        "estimates": {n: stated(b) for n, b in zip(ROPES, beliefs, strict=True)},
        "searches": searches,
    }
    for name, some in sets.items():
        result[name] = {
            "ropes": [ROPES[k % len(ROPES)] for k in range(len(some))],
            "goals": some.goal.tolist(),
            **_measured(bench, settings, name, some, beliefs, policies, world),
        }
    return result


@dataclass(frozen=True, kw_only=True)
class Steady(Demonstrator):
    """Draws actions whose simulated risk, with the estimated object, is within its limit: outcomes
    beyond it are not reproducible and no use for training."""

    known: Item
    """The object with its estimated parameters."""
    foresight: World = field(default_factory=Simulation)
    """Where it is simulated."""

    def about(self) -> dict[str, Any]:
        return {**super().about(), "steady_for": to_columns(self.known)}

    def draw(self, rngs: Sequence[np.random.Generator]) -> dict[str, NDArray[np.float64]]:
        rows = [self._steady(rng) for rng in rngs]
        return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}

    def _steady(self, rng: np.random.Generator) -> dict[str, NDArray[np.float64]]:
        """Columns [1] of one demonstration."""
        drawn = [super(Steady, self).draw([rng]) for _ in range(CANDIDATES)]
        actions = np.array([[d[q.name][0] for q in self.task.actions] for d in drawn])
        outcomes = self.foresight.carry_out(self.task, [self.known] * CANDIDATES, actions)
        steady = (
            d
            for d, o in zip(drawn, outcomes, strict=True)
            if o.fault is None and self.task.within_risk(self.known, o.values)
        )
        return next(steady, drawn[0])


def _real(
    bench: Workbench, settings: RopeRealSettings, task: Task, name: str, known: Item
) -> Demonstrations:
    """The second reality's demonstrations of a rope, with the parameters of its estimate in place
    of the true ones."""
    from gendom.reality import RealWorld, find_object

    source = Steady(
        task=task, world=RealWorld(jobs=bench.jobs), items=(find_object(name),), known=known
    )
    kept = bench.demonstrations(f"{task.name}-{name}", source, settings.real, device="cpu")
    alike = dimensionless_parameters(known)
    return replace(kept, parameters={n: np.full(len(kept), alike[n]) for n in PARAMETERS})


def _ours(
    bench: Workbench,
    settings: RopeRealSettings,
    simulated: Demonstrations,
    real: Demonstrations,
) -> dict[str, Policy]:
    """Policies trained on simulations of all ropes, by row."""
    from gendom.policies.training import Training

    plain = Training(epochs=settings.epochs, refine_steps=settings.steps, seed=bench.seed)
    refined = replace(plain, refine=settings.refine)
    inverse = replace(plain, method="inverse")
    tuned = replace(plain, finetune_epochs=settings.finetune_epochs)
    trainings = {
        "ours": refined,
        "ours, no parameters": replace(refined, conditioned_on=()),
        "inverse": inverse,
        "inverse, no parameters": replace(inverse, conditioned_on=()),
    }
    world = bench.beside_training()
    wanted = {
        n: Wanted.suited(simulated, t, settings.steps, world=world) for n, t in trainings.items()
    }
    wanted["sim+real"] = Wanted.suited(simulated, tuned, settings.steps, finetune=real)
    return _named(bench, settings, wanted)


def _baselines(
    bench: Workbench, settings: RopeRealSettings, task: Task, real: Sequence[Demonstrations]
) -> tuple[dict[str, Policy], dict[str, Any]]:
    """Policies that see no parameters, trained on real demonstrations or on simulations with
    R2S2R's parameters: by our method, and by the inverse one with the best of eight settings; and
    what was searched."""
    from gendom.policies.training import Training

    everything = joined(joined(real[0], real[1]), real[2])
    sets = {"pi_RD, ropes": everything, "pi_RD, rope": real[0]}
    searches: dict[str, Any] = {}
    for row, group in (("R2S2R, ropes", real), ("R2S2R, rope", real[:1])):
        found = _identified(bench, task, row, group)
        searches[row] = {"parameters": found.parameters, "misfit": found.misfit}
        only = replace(task, item=with_dimensionless(task.item, found.parameters), ranges={})
        sets[row] = bench.demonstrations(
            f"{task.name}-{row}", Demonstrator(task=only), settings.demonstrations
        )

    plain = Training(
        epochs=settings.epochs, refine_steps=settings.steps, seed=bench.seed, conditioned_on=()
    )

    own = {
        row: Wanted.suited(
            some,
            # real demonstrations have no simulator to refine in
            replace(plain, refine=settings.refine if row.startswith("R2S2R") else 0),
            settings.steps,
            world=bench.beside_training(),
        )
        for row, some in sets.items()
    }
    policies = _named(bench, settings, own)
    tried = [
        (
            f"{architecture}-{share:g}-{decay:g}",
            replace(
                plain,
                method="inverse",
                architecture=architecture,
                epochs=max(round(share * settings.epochs), 1),
                weight_decay=decay,
            ),
            round(share * settings.steps),
        )
        for architecture in ("paper", "smooth")
        for share in (0.33, 1.0)
        for decay in (1e-4, 1e-2)
    ]
    for row, some in sets.items():
        name = f"{row}, inverse"
        search = {which: Wanted.suited(some, t, steps) for which, t, steps in tried}
        policies[name], searches[name] = bench.best(f"{task.name}-{name}", search)
    return policies, searches


def _named(
    bench: Workbench, settings: RopeRealSettings, wanted: dict[str, Wanted]
) -> dict[str, Policy]:
    """Policies by row, trained side by side; the task is part of their files' names."""
    made = bench.policies({f"{settings.task}-{row}": one for row, one in wanted.items()})
    return {row: made[f"{settings.task}-{row}"] for row in wanted}


def _identified(
    bench: Workbench, task: Task, label: str, real: Sequence[Demonstrations]
) -> Identified:
    """R2S2R's parameters, from the first real demonstrations of some ropes."""

    def make() -> dict[str, Any]:
        seen = []
        for k, demonstrations in enumerate(real):
            item = _like_stated(demonstrations, task)
            count = len(range(k, IDENTIFIED_FROM, len(real)))
            units = task.action_units(item), task.goal_units(item)
            seen += [
                (item, Execution(action=a * units[0], reached=g * units[1]))
                for a, g in zip(
                    demonstrations.action[:count], demonstrations.goal[:count], strict=True
                )
            ]
        found = identify(task, seen, world=Simulation(device=bench.device))
        return {"parameters": found.parameters, "misfit": found.misfit,
                "executions": found.executions, "rollouts": found.rollouts}  # fmt: skip

    return Identified(**bench.kept(f"{task.name}-{label}", make))


def _like_stated(demonstrations: Demonstrations, task: Task) -> Item:
    """An object of the task's size with the parameters that demonstrations have."""
    own = {name: float(values[0]) for name, values in demonstrations.parameters.items()}
    return with_dimensionless(task.item, own)


def _seven(task: Task, policy: Policy, ropes: Sequence[Item]) -> Cases:
    """The paper's seven goals: evenly over the reach of each rope."""
    items, goals = [], []
    for k in range(7):
        for rope in ropes:
            low, high = policy.goal_range(rope)[0]
            items.append(rope)
            goals.append([low + (0.1 + 0.8 * k / 6.0) * (high - low)])
    return Cases(task=task, items=tuple(items), goal=np.array(goals))


def _measured(
    bench: Workbench,
    settings: RopeRealSettings,
    title: str,
    cases: Cases,
    beliefs: Sequence[Belief],
    policies: dict[str, Policy],
    world: World,
) -> dict[str, Any]:
    """Errors [W] of every row, and the components of our own; each row is kept."""
    from gendom.reality import RealWorld

    held = [beliefs[k % len(beliefs)] for k in range(len(cases))]
    known = [belief.most_likely for belief in held]
    rows: dict[str, list[float | None]] = {}

    def measure(name: str, act: Callable[[], Array], where: World = world) -> tuple[Array, Array]:
        """[W, A] actions and [W, G] what they reached."""

        def make() -> dict[str, Any]:
            action = act()
            found = judge(cases, action, world=where)
            return {"action": action.tolist(), "reached": _plain(found.reached),
                    "error": _plain(found.error)}  # fmt: skip

        row = bench.kept(f"{cases.task.name}-{title}-{name}", make)
        rows[name] = row["error"]
        return np.array(row["action"], dtype=float), np.array(row["reached"], dtype=float)

    done = {
        name: measure(name, lambda policy=policy: choose(policy, cases, known=known))
        for name, policy in policies.items()
    }
    true, _ = measure("ours, true parameters", lambda: choose(policies["ours"], cases))
    assumed = [
        Belief.for_task(cases.task, _middling(rope)).doubting("E", WITHOUT_LIFT)
        for rope in cases.items
    ]
    blind, _ = done["ours, no parameters"]
    measure("polished, no lift", lambda: _polished(bench, settings, cases, assumed, blind))
    ours, reached = done["ours"]
    action, there = measure("polished", lambda: _polished(bench, settings, cases, held, ours))
    seen: list[list[Execution]] = [[] for _ in cases.items]
    for k in range(1, settings.executions + 1):
        for w, (a, y) in enumerate(zip(action, there, strict=True)):
            if np.isfinite(y).all():
                seen[w].append(Execution(action=a, reached=y))
        action, there = measure(
            f"polished, {k} execution{'s' * (k > 1)}",
            lambda start=action: _after(bench, settings, cases, held, seen, start),
        )

    # components of our error, one change at a time
    free = RealWorld(robot=False, jobs=bench.jobs)
    _, by_hand = measure("ours, by a free hand", lambda: ours, free)
    sim = Simulation(device=bench.device)
    simulated = judge(cases, ours, world=sim)
    exact = judge(cases, true, world=sim)
    del rows["ours, by a free hand"]
    made_of = {
        "arm": _rms(reached - by_hand),
        "simulator": _rms(by_hand - simulated.reached),
        "estimate": _rms(simulated.error - exact.error),
        "policy": _rms(exact.error),
    }
    return {"errors": rows, "made_of": made_of}


def _after(
    bench: Workbench,
    settings: RopeRealSettings,
    cases: Cases,
    beliefs: Sequence[Belief],
    seen: Sequence[Sequence[Execution]],
    start: Array,
) -> Array:
    """[W, A] actions polished with the result of earlier executions."""
    searches = [adapting(cases.task, b, list(e)) for b, e in zip(beliefs, seen, strict=True)]
    learnt = side_by_side(cases.task, Simulation(device=bench.device), searches)
    return _polished(
        bench,
        settings,
        cases,
        [a.belief for a in learnt],
        start,
        [a.discrepancy for a in learnt],
    )


def _polished(
    bench: Workbench,
    settings: RopeRealSettings,
    cases: Cases,
    beliefs: Sequence[Belief],
    start: Array,
    discrepancies: Sequence[Any] | None = None,
) -> Array:
    """[W, A] actions polished for the posterior of each object."""
    task = cases.task
    patient = PolishSettings(seconds=math.inf, seed=bench.seed)
    searches = [
        polishing(
            task,
            goal,
            belief.draws(settings.draws, bench.seed),
            task.nearest(belief.item, a),
            settings=patient,
            discrepancy=None if discrepancies is None else discrepancies[w],
        )
        for w, (goal, belief, a) in enumerate(zip(cases.goal, beliefs, start, strict=True))
    ]
    found = side_by_side(task, Simulation(device=bench.device), searches)
    return np.array([polished.action for polished in found])


def _middling(rope: Item) -> Item:
    """A rope with these sizes and this mass; all else is unknown."""
    return with_dimensionless(rope, {"E": 0.45, "damping": 0.02, "nu": 0.3})


def _plain(values: Array) -> list[Any]:
    """For JSON, null where a number is not finite."""
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [float(x) if np.isfinite(x) else None for x in values]


def _rms(values: Array) -> float:
    flat = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(flat**2))) if len(flat) else math.nan
