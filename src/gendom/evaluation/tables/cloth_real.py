"""The paper's table of real cloths, in the MuJoCo test scene: each cloth is lifted once, then
spread. Its true parameters serve only for the score, and for the row that is labelled so. Trials of
a cloth differ in where the hand closes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from gendom.errors import GendomError
from gendom.evaluation.protocol import Cases, choose
from gendom.evaluation.tables.lifted import lifted, stated
from gendom.evaluation.tables.workbench import Wanted, Workbench
from gendom.materials import Item
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.policy import QUANTILE
from gendom.tasks import ClothSpreading
from gendom.tasks.cloth_spreading import CLOTH, OFF_CENTRE, SEARCHED
from gendom.tasks.demonstrator import Demonstrator
from gendom.tasks.world import Simulation

Array = NDArray[np.float64]

CLOTHS = ("cloth-cotton-200mm", "cloth-rubber-200mm")
"""Of the second reality, as the paper's."""

HAND = 0.01
"""Standard deviation of where the hand closes, along each side [sides]."""

SEEN = ("covered", "share")
"""Results of a trial: the area covered, the paper's extended ratio, and the share of it that
lies spread."""

_STREAM = 7
"""Part of the seed: makes these draws independent of others with the same seed."""


@dataclass(frozen=True, kw_only=True)
class ClothRealSettings:
    """Numbers of simulations, trainings and trials."""

    cloths: tuple[str, ...] = CLOTHS
    trials: int = 5
    """Of each cloth and row."""
    demonstrations: int = 800
    """Simulated, of which those that spread are learnt from; 0: the policy that ships. The one
    without parameters gives the same quantile of what was learnt from."""
    epochs: int = 150
    steps: int = 3000
    """Of the optimiser in each training, at least."""
    draws: int = 8
    """Objects of the posterior for which an action is searched."""


def cloth_real(bench: Workbench, settings: ClothRealSettings) -> dict[str, Any]:
    """Measure all rows.

    Args:
        bench: Where everything is kept, each trial by itself.
        settings: How much.

    Returns:
        JSON: estimates; where the hand closed in each trial [sides]; for each cloth its rows with
        A and, by trial, `SEEN`, null where the arm or the simulation failed. A cloth whose estimate
        is not usable has the reason, and no rows that need one.

    Raises:
        DeviceError: The second reality cannot be simulated or rendered here.
        ModuleNotFoundError: Torch is missing, and policies are to be trained.
    """
    from gendom.reality import find_object

    policies = _policies(bench, settings)
    estimates, rows = {}, {}
    for name in settings.cloths:
        item = find_object(name)
        A = {"ours, no parameters": policies["no parameters"](item)}
        try:
            belief = lifted(bench, name, ClothSpreading())
        except GendomError as error:
            estimates[name] = {"refused": str(error).splitlines()[0]}
        else:
            estimates[name] = stated(belief)
            A["ours"] = policies["ours"](belief.most_likely)
            A["searched"] = _searched(bench, settings, name, belief)
        A["ours, true parameters"] = policies["ours"](item)
        rows[name] = {row: {"A": round(value, 4)} for row, value in A.items()}

    hands = _hands(bench.seed, settings.trials)
    wanted = sorted({(n, row["A"], k) for n, of in rows.items() for row in of.values()
                     for k in range(settings.trials)})  # fmt: skip
    bench.on_stage(f"{len(wanted)} trials")
    found = dict(zip(wanted, _carried_out(bench, wanted, hands), strict=True))
    for name, of in rows.items():
        for row in of.values():
            trials = [found[name, row["A"], k] for k in range(settings.trials)]
            row |= {key: [trial[key] for trial in trials] for key in SEEN}
    return {"estimates": estimates, "hands": hands.tolist(), "cloths": rows}


def _hands(seed: int, trials: int) -> Array:
    """[trials, 2] where the hand closes beside the centre [sides]; first where the task says."""
    away = HAND * np.random.default_rng([seed, _STREAM]).standard_normal((trials, 2))
    away[0] = 0.0
    return np.array(OFF_CENTRE) + away


def _policies(
    bench: Workbench, settings: ClothRealSettings
) -> Mapping[str, Callable[[Item], float]]:
    """The A [-] of each policy for an object."""
    policy, constant = _policy(bench, settings)
    return {"ours": partial(_acts, policy), "no parameters": lambda _: constant}


def _policy(bench: Workbench, settings: ClothRealSettings) -> tuple[Policy, float]:
    """The policy, and the A that is enough for as many cloths without seeing them [-]."""
    task = ClothSpreading()
    if settings.demonstrations == 0:
        policy = Policy.pretrained(task.name)
        A, (_, most) = policy.description.outputs[0], task.limits(CLOTH)[0]
        return policy, min(A.mean + float(norm.ppf(QUANTILE)) * A.scale, float(most))
    from gendom.policies.training import Training

    data = bench.demonstrations(
        f"{task.name}-simulated", Demonstrator(task=task), settings.demonstrations
    )
    training = Training(method="quantile", epochs=settings.epochs, seed=bench.seed)
    name = f"{task.name}-ours"
    policy = bench.policies({name: Wanted.suited(data, training, settings.steps)})[name]
    return policy, float(np.quantile(data.action[:, 0], QUANTILE))


def _acts(policy: Policy, item: Item) -> float:
    case = Cases(task=ClothSpreading(), items=(item,), goal=np.empty((1, 0)))
    return float(choose(policy, case)[0, 0])


def _searched(bench: Workbench, settings: ClothRealSettings, name: str, belief: Estimate) -> float:
    """The A that spreads most in our simulator, in the mean over the posterior of an estimate."""

    def make() -> dict[str, Any]:
        items = belief.draws(settings.draws, bench.seed)
        found = Simulation(device=bench.device).carry_out(
            ClothSpreading(),
            [item for item in items for _ in SEARCHED],
            np.tile(SEARCHED, len(items))[:, None],
        )
        # a failed trial spreads nothing
        share = np.array([o.values.get("share", 0.0) for o in found])
        mean = share.reshape(len(items), -1).mean(axis=0)
        return {"A": SEARCHED, "share": mean.tolist(), "best": SEARCHED[int(mean.argmax())]}

    kept = bench.kept(f"{name}, searched, {settings.draws} draws, seed {bench.seed}", make)
    return float(kept["best"])


def _carried_out(
    bench: Workbench, wanted: list[tuple[str, float, int]], hands: Array
) -> list[dict[str, float | None]]:
    """`SEEN` of trials, each a cloth's name, A and the number of the hand's place."""
    # the progress callback stays in this process
    work = partial(_trial, {"folder": bench.folder, "seed": bench.seed})
    places = [hands[k].tolist() for *_, k in wanted]
    if bench.jobs == 1 or len(wanted) == 1:
        return list(map(work, wanted, places))
    with get_context("spawn").Pool(min(bench.jobs, len(wanted))) as pool:
        return pool.starmap(work, zip(wanted, places, strict=True), chunksize=1)


def _trial(
    own: dict[str, Any], wanted: tuple[str, float, int], place: list[float]
) -> dict[str, float | None]:
    from gendom.reality import RealWorld, find_object

    name, A, k = wanted
    bench = Workbench(**own)

    def make() -> dict[str, Any]:
        task = ClothSpreading(off_centre=(place[0], place[1]))
        (outcome,) = RealWorld().carry_out(task, [find_object(name)], [[A]])
        return {key: outcome.values.get(key) for key in SEEN} | {"fault": outcome.fault}

    return bench.kept(f"{name}, A {A:.4f}, trial {k}, seed {bench.seed}", make)
