"""The paper's table of real cloths, in the MuJoCo test scene: each cloth is lifted once, then
spread. Its true parameters serve only for the score, and for the row that is labelled so. Trials of
a cloth differ in where the hand closes.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.runs import Result, Runs, Table, TrainingJob, stated
from gendom.errors import GendomError
from gendom.materials import Item
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.tasks import ClothSpreading
from gendom.tasks.cloth_spreading import CHOICES, OFF_CENTRE
from gendom.tasks.demonstrator import Demonstrator
from gendom.tasks.world import Simulation

Array = NDArray[np.float64]

CLOTHS = ("cloth-cotton-200mm", "cloth-rubber-200mm")
"""Of the second reality, as the paper's."""

PAPER = {
    "ours": {"cloth-cotton-200mm": 0.78, "cloth-rubber-200mm": 0.98},
    "ours, no parameters": {"cloth-cotton-200mm": 0.52, "cloth-rubber-200mm": 0.97},
}
"""Extended ratios in the paper, of its cotton and its rubber cloth."""

HAND = 0.01
"""Standard deviation of where the hand closes, along each side [sides]."""

MEASURED = ("covered", "share")
"""Results of a trial: the area covered, the paper's extended ratio, and the share of it that
lies spread."""

DRAWN = 256
"""Cloths for which a policy acts that does not know which one it has."""

_STREAM = 7
"""Part of the seed: makes these draws independent of others with the same seed."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Numbers of simulations, trainings and trials."""

    trials: int
    """Of each cloth and row."""
    demonstrations: int
    """Simulated; 0: the policy that ships. Without parameters it acts for `DRAWN` cloths of the
    task's ranges."""
    draws: int
    """Objects of the posterior for which an action is searched."""
    epochs: int = 150
    steps: int = 3000
    """Of the optimiser in each training, at least."""


SCALES = {
    "small": Settings(trials=1, demonstrations=0, draws=2),
    "full": Settings(trials=5, demonstrations=6000, draws=8),
}


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """Measure all rows, and show a table for each cloth."""
    figures = cloth_real(runs, SCALES[flags.scale], flags.objects or CLOTHS)
    return Result(name="cloth-real", figures=figures, shown=tables_of(figures))


def cloth_real(runs: Runs, settings: Settings, cloths: Sequence[str] = CLOTHS) -> dict[str, Any]:
    """Measure all rows; each trial is kept by itself.

    Returns:
        JSON: estimates; where the hand closed in each trial [sides]; for each cloth its rows with
        A and, by trial, `MEASURED`, null where the arm or the simulation failed. A cloth whose
        estimate is not usable has the reason, and no rows that need one.

    Raises:
        DeviceError: The second reality cannot be simulated or rendered here.
        ModuleNotFoundError: Torch is missing, and policies are to be trained.
    """
    from gendom.reality import find_object

    policy = _policy(runs, settings)
    rng = np.random.default_rng([runs.seed, _STREAM])
    some = [ClothSpreading().draw_item(rng) for _ in range(DRAWN)]
    estimates, rows = {}, {}
    for name in cloths:
        item = find_object(name)
        A = {"ours, no parameters": _acts(policy, some)}
        try:
            belief = runs.lifted(name, ClothSpreading())
        except GendomError as error:
            estimates[name] = {"refused": str(error).splitlines()[0]}
        else:
            estimates[name] = stated(belief)
            A["ours"] = _acts(policy, belief.draws(DRAWN, runs.seed))
            A["searched"] = _searched(runs, settings, name, belief)
        A["ours, true parameters"] = _acts(policy, [item])
        rows[name] = {row: {"A": round(value, 4)} for row, value in A.items()}

    hands = _hands(runs.seed, settings.trials)
    trials = sorted({(n, row["A"], k) for n, of in rows.items() for row in of.values()
                     for k in range(settings.trials)})  # fmt: skip
    found = dict(
        zip(trials, runs.each(partial(_trial, runs, hands), trials, "trials"), strict=True)
    )
    for name, of in rows.items():
        for row in of.values():
            own = [found[name, row["A"], k] for k in range(settings.trials)]
            row |= {key: [trial[key] for trial in own] for key in MEASURED}
    return {"estimates": estimates, "hands": hands.tolist(), "cloths": rows}


def _hands(seed: int, trials: int) -> Array:
    """[trials, 2] where the hand closes beside the centre [sides]; first where the task says."""
    away = HAND * np.random.default_rng([seed, _STREAM]).standard_normal((trials, 2))
    away[0] = 0.0
    return np.array(OFF_CENTRE) + away


def _policy(runs: Runs, settings: Settings) -> Policy:
    task = ClothSpreading()
    if settings.demonstrations == 0:
        return Policy.pretrained(task.name)
    from gendom.policies.fitting import Training

    data = runs.demonstrations(
        f"{task.name}-tried", Demonstrator(task=task), settings.demonstrations
    )
    training = Training(method="chance", epochs=settings.epochs, seed=runs.seed)
    name = f"{task.name}-ours"
    job = TrainingJob.of_steps(data, training, settings.steps)
    return runs.policies({name: job})[name]


def _acts(policy: Policy, items: Sequence[Item]) -> float:
    """A for whichever of these it is."""
    return policy.act((), items[0], likely=items, force=True).action["A"]


def _searched(runs: Runs, settings: Settings, name: str, belief: Estimate) -> float:
    """The A that spreads most in our simulator, in the mean over the posterior of an estimate."""

    def make() -> dict[str, Any]:
        items = belief.draws(settings.draws, runs.seed)
        found = Simulation(device=runs.device).carry_out(
            ClothSpreading(),
            [item for item in items for _ in CHOICES],
            np.tile(CHOICES, len(items))[:, None],
        )
        # a failed trial spreads nothing
        share = np.array([o.values.get("share", 0.0) for o in found])
        mean = share.reshape(len(items), -1).mean(axis=0)
        return {"A": CHOICES, "share": mean.tolist(), "best": CHOICES[int(mean.argmax())]}

    kept = runs.kept(f"{name}, searched, {settings.draws} draws, seed {runs.seed}", make)
    return float(kept["best"])


def _trial(
    runs: Runs, hands: Array, trial: tuple[str, float, int]
) -> dict[str, float | str | None]:
    """`MEASURED` of a trial: a cloth's name, A and the number of the hand's place."""
    from gendom.reality import RealWorld, find_object

    name, A, k = trial

    def make() -> dict[str, Any]:
        task = ClothSpreading(off_centre=tuple(hands[k].tolist()))
        (outcome,) = RealWorld().carry_out(task, [find_object(name)], [[A]])
        return {key: outcome.values.get(key) for key in MEASURED} | {"fault": outcome.fault}

    return runs.kept(f"{name}, A {A:.4f}, trial {k}, seed {runs.seed}", make)


def tables_of(result: Mapping[str, Any]) -> list[Table]:
    """A table for each cloth."""
    head = ("A", "extended ratio", "std", "paper", "share spread", "std", "failed")
    found = []
    for name, rows in result["cloths"].items():
        refused = result["estimates"][name].get("refused")
        title = f"{name}, estimate refused: {refused}" if refused else name
        texts = {row: _texts(name, row, figures) for row, figures in rows.items()}
        found.append(Table(title=title, head=head, rows=texts))
    return found


def _texts(name: str, row: str, figures: Mapping[str, Any]) -> tuple[str, ...]:
    texts: dict[str, tuple[str, str]] = {}
    for key in MEASURED:
        values = np.array(figures[key], dtype=float)
        done = values[np.isfinite(values)]
        texts[key] = (f"{done.mean():.2f}", f"{done.std():.2f}") if len(done) else ("", "")
    paper = PAPER.get(row, {}).get(name)
    return (
        f"{figures['A']:.2f}",
        *texts["covered"],
        "" if paper is None else f"{paper:.2f}",
        *texts["share"],
        str(sum(value is None for value in figures["covered"])),
    )
