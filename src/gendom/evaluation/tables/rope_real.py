"""The paper's table of real ropes, in the second reality: each rope lifted once, then reached for.

Nothing of the second reality's truth is used but the score, and two rows that say so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.datasets import Recording
from gendom.errors import GendomError
from gendom.evaluation.protocol import Cases, choose, draw_cases, judge
from gendom.evaluation.tables.workbench import Wanted, Workbench
from gendom.materials import PARAMETERS, Item, Material, Rope, likeness, to_columns
from gendom.policies import Policy
from gendom.policies.adapt import Execution, adapting, uncertain
from gendom.policies.belief import Belief
from gendom.policies.demonstrations import Demonstrations, joined
from gendom.policies.identify import Identified, identify, with_likeness
from gendom.policies.polish import PolishSettings, polishing
from gendom.policies.rollouts import side_by_side
from gendom.tasks import Task, find_task
from gendom.tasks.demonstrator import Demonstrator
from gendom.tasks.world import Simulation, World

Array = NDArray[np.float64]

ROPES = ("rope-cotton", "rope-polyester", "rope-polyethylene")
"""Of the second reality, as the paper's; baselines of one rope see the first."""

IDENTIFIED_FROM = 20
"""Executions that R2S2R finds its parameters from."""

FEW = 1000
"""Sets below this are trained on in smaller batches."""

FRAME_RATE = 30.0
"""Of the lift's cameras [1/s]."""


@dataclass(frozen=True, kw_only=True)
class RopeRealSettings:
    """How much is simulated, trained and tried."""

    task: str = "rope-reaching"
    goals: int = 24
    """Of each rope, drawn."""
    demonstrations: int = 40_000
    real: int = 100
    """Demonstrations of each rope in the second reality."""
    epochs: int = 150
    real_epochs: int = 300
    """Of what is trained on the second reality's demonstrations."""
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
    estimates = [belief.most_likely for belief in beliefs]
    policies, searches = _policies(bench, settings, task, estimates)

    cases = draw_cases(task, len(ropes) * settings.goals, seed=bench.seed, items=ropes,
                       simulation=Simulation(device=bench.device))  # fmt: skip
    seven = _seven(task, policies["ours"], ropes) if len(task.goals) == 1 else None
    world = RealWorld(jobs=bench.jobs)
    sets = {"drawn": cases} | ({"seven": seven} if seven is not None else {})
    result: dict[str, Any] = {
        "estimates": {n: _stated(b) for n, b in zip(ROPES, beliefs, strict=True)},
        "searches": searches,
    }
    for name, some in sets.items():
        result[name] = {
            "ropes": [ROPES[k % len(ROPES)] for k in range(len(some))],
            "goals": some.goal.tolist(),
            **_measured(bench, settings, name, some, beliefs, policies, world),
        }
    return result


def lifted(bench: Workbench, name: str, task: Task) -> Belief:
    """What one lift that ends in a swing tells of a rope of the second reality.

    Raises:
        GendomError: The estimate is not usable.
    """
    from gendom.estimation import EstimateSettings, estimate
    from gendom.reality import find_object
    from gendom.reality.chain import record_and_perceive

    rope = find_object(name)

    def make() -> dict[str, Any]:
        bench.folder.mkdir(parents=True, exist_ok=True)
        path = bench.folder / f"lift-{name}.npz"
        if not path.exists():
            with TemporaryDirectory(dir=bench.folder) as pictures:
                recording, _ = record_and_perceive(
                    rope, pictures, frame_rate=FRAME_RATE, seed=bench.seed, end="swing"
                )
            recording.write(path)
        found = estimate(Recording.read(path), EstimateSettings(starts=3, seed=bench.seed))
        return found.record

    record = bench.kept(f"estimate-{name}", make)
    if not record["verdict"]["usable"]:
        raise GendomError(", ".join(record["verdict"]["reasons"]), where=f"the lift of {name}")
    described, density = record["object"], record["density"]
    known = [n for n in PARAMETERS if n not in uncertain(task, rope)]
    return Belief.of(
        Rope(
            length=described["length"],
            diameter=described["diameter"],
            material=Material(E=record["youngs_modulus"], nu=record["poissons_ratio"],
                              density=density, damping=record["damping"]),
        ),
        record["posterior"],
        known=known,
    )  # fmt: skip


def _policies(
    bench: Workbench, settings: RopeRealSettings, task: Task, estimates: Sequence[Item]
) -> tuple[dict[str, Policy], dict[str, Any]]:
    """Ours and the baselines', by name; and what was searched for them."""
    from gendom.policies.train import Training
    from gendom.reality import RealWorld, find_object

    seed, epochs = bench.seed, settings.epochs
    simulated = bench.demonstrations(
        f"{task.name}-simulated", Demonstrator(task=task), settings.demonstrations
    )
    real = []
    for name, item in zip(ROPES, estimates, strict=True):
        source = Demonstrator(task=task, world=RealWorld(jobs=bench.jobs),
                              items=(find_object(name),))  # fmt: skip
        kept = bench.demonstrations(f"{task.name}-{name}", source, settings.real, device="cpu")
        real.append(_as_estimated(kept, item))
    everything = joined(joined(real[0], real[1]), real[2])
    ours = {
        "ours": Wanted(demonstrations=simulated, training=Training(epochs=epochs, seed=seed)),
        "ours, no parameters": Wanted(
            demonstrations=simulated, training=Training(epochs=epochs, seed=seed, conditioned_on=())
        ),
        "inverse": Wanted(
            demonstrations=simulated,
            training=Training(method="inverse", epochs=epochs, seed=seed),
        ),
        "inverse, no parameters": Wanted(
            demonstrations=simulated,
            training=Training(method="inverse", epochs=epochs, seed=seed, conditioned_on=()),
        ),
        "sim+real": Wanted(
            demonstrations=simulated,
            training=Training(epochs=epochs, seed=seed, finetune_epochs=settings.real_epochs),
            finetune=everything,
        ),
    }
    searches: dict[str, Any] = {}
    blind: dict[str, Demonstrations] = {"pi_RD, ropes": everything, "pi_RD, rope": real[0]}
    for label, group in (("R2S2R, ropes", real), ("R2S2R, rope", real[:1])):
        found = _identified(bench, task, label, group)
        searches[label] = {"parameters": found.parameters, "misfit": found.misfit}
        only = replace(task, item=with_likeness(task.item, found.parameters), ranges={})
        name = f"{task.name}-{_slug(label)}"
        blind[label] = bench.demonstrations(name, Demonstrator(task=only), settings.demonstrations)
    for label, demonstrations in blind.items():
        small = len(demonstrations) < FEW
        ours[label] = Wanted(
            demonstrations=demonstrations,
            training=Training(
                epochs=settings.real_epochs if small else epochs,
                batch_size=32 if small else 256,
                seed=seed,
                conditioned_on=(),
            ),
        )
    made = bench.policies({f"{task.name}-{_slug(n)}": w for n, w in ours.items()})
    policies = {n: made[f"{task.name}-{_slug(n)}"] for n in ours}
    for label, demonstrations in blind.items():
        policies[f"{label}, inverse"], searches[f"{label}, inverse"] = bench.best(
            f"{task.name}-{_slug(label)}-inverse",
            _inverse_search(
                demonstrations, settings.real_epochs if len(demonstrations) < FEW else epochs, seed
            ),
        )
    return policies, searches


def _inverse_search(demonstrations: Demonstrations, epochs: int, seed: int) -> dict[str, Wanted]:
    """What a baseline's settings are chosen from."""
    from gendom.policies.train import Training

    small = len(demonstrations) < FEW
    return {
        f"{architecture}-{passes}-{decay:g}": Wanted(
            demonstrations=demonstrations,
            training=Training(
                method="inverse",
                conditioned_on=(),
                architecture=architecture,
                epochs=passes,
                batch_size=32 if small else 256,
                weight_decay=decay,
                seed=seed,
            ),
        )
        for architecture in ("paper", "smooth")
        for passes in (max(epochs // 3, 1), epochs)
        for decay in (1e-4, 1e-2)
    }


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

    return Identified(**bench.kept(f"{task.name}-{_slug(label)}", make))


def _like_stated(demonstrations: Demonstrations, task: Task) -> Item:
    """An object of the task's size with the parameters that demonstrations have."""
    own = {name: float(values[0]) for name, values in demonstrations.parameters.items()}
    return with_likeness(task.item, own)


def _as_estimated(demonstrations: Demonstrations, item: Item) -> Demonstrations:
    """With an object's parameters in place of the true ones."""
    alike = likeness(item)
    count = len(demonstrations)
    return replace(
        demonstrations, parameters={name: np.full(count, alike[name]) for name in PARAMETERS}
    )


def _seven(task: Task, policy: Policy, ropes: Sequence[Item]) -> Cases:
    """The paper's seven goals: evenly over what each rope reaches."""
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
    """Errors [W] of every row, and what those of ours are made of; each row is kept."""
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

        row = bench.kept(f"{cases.task.name}-{title}-{_slug(name)}", make)
        rows[name] = row["error"]
        return np.array(row["action"], dtype=float), np.array(row["reached"], dtype=float)

    done = {
        name: measure(name, lambda policy=policy: choose(policy, cases, known=known))
        for name, policy in policies.items()
    }
    true, _ = measure("ours, true parameters", lambda: choose(policies["ours"], cases))
    assumed = [Belief.of(_middling(rope), known=_certain(cases.task, rope)) for rope in cases.items]
    blind, _ = done["ours, no parameters"]
    measure("polished, no lift", lambda: _polished(bench, settings, cases, _wide(assumed), blind))
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

    # what the error of ours is made of, one change at a time
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
    """[W, A] actions polished for what executions have taught."""
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
    """[W, A] actions polished for what is believed of each object."""
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


def _certain(task: Task, item: Item) -> list[str]:
    return [n for n in PARAMETERS if n not in uncertain(task, item)]


def _middling(rope: Item) -> Item:
    """A rope of these sizes and this mass of which nothing else is known."""
    return with_likeness(rope, {"E": 0.45, "damping": 0.02, "nu": 0.3})


def _wide(beliefs: Sequence[Belief]) -> list[Belief]:
    """With E as doubtful as it is before a lift: bending lengths of 0.25 to 0.7 sizes."""
    found = []
    for belief in beliefs:
        names = ("E", *belief.names)
        m = belief.item.material
        mean = np.concatenate([[math.log(m.specific_modulus)], belief.mean])
        sd = np.concatenate([[3.0 * math.log(0.7 / 0.25) / math.sqrt(12.0)], belief.sd])
        found.append(replace(belief, names=names, mean=mean, covariance=np.diag(sd**2)))
    return found


def _stated(belief: Belief) -> dict[str, Any]:
    columns = to_columns(belief.most_likely)
    return {
        name: {"mean": columns[PARAMETERS[name].column], "interval_90": belief.interval(name)}
        for name in belief.names
    }


def _slug(name: str) -> str:
    return name.lower().replace(", ", "-").replace(" ", "-").replace("+", "-and-")


def _plain(values: Array) -> list[Any]:
    """For JSON, null where a number is not finite."""
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [float(x) if np.isfinite(x) else None for x in values]


def _rms(values: Array) -> float:
    flat = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(flat**2))) if len(flat) else math.nan
