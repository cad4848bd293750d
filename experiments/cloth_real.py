"""The paper's table of real cloths, in the MuJoCo test scene: each cloth is lifted once, then
spread, or dragged until it lies spread (`--task cloth-dragging`). Its true parameters serve only
for the score, and for the row that is labelled so. Trials of a cloth differ in where the hand
closes.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from experiments.runs import Result, Runs, Table, stated
from gendom.errors import GendomError
from gendom.materials import dimensionless_parameters
from gendom.policies import Policy
from gendom.tasks import ClothSpreading, Task, find_task
from gendom.tasks.cloth_dragging import ClothDragging
from gendom.tasks.cloth_spreading import OFF_CENTRE, SPREAD

if TYPE_CHECKING:
    from gendom.reality import RealCloth

Array = NDArray[np.float64]

ASSETS = Path(__file__).parent / "assets"
"""Where cloths lie as files that the second reality does not name."""

CLOTHS = (
    "cloth-cotton-200mm", "cloth-denim", "cloth-rubber-200mm", "cloth-canvas", "paper-cotton",
    "paper-rubber",
)  # fmt: skip
"""The second reality's, named after the paper's two; between and beyond them a denim and a canvas
(`gendom.materials.catalogue`); and sheets that bend as the paper's own estimates say, over 0.19 and
0.43 of their sides."""

PAPER = {
    "ours": {"cloth-cotton-200mm": 0.78, "cloth-rubber-200mm": 0.98},
    "ours, no parameters": {"cloth-cotton-200mm": 0.52, "cloth-rubber-200mm": 0.97},
}
"""Extended ratios in the paper, of its cotton and its rubber cloth."""

COLOUR = (40, 70, 190)
"""Of drawn cloths, by which cameras find them (sRGB)."""

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
    """What is done with which cloths."""

    trials: int
    """Of each cloth and row."""
    task: Task = field(default_factory=ClothSpreading)
    cloths: Sequence[str] = CLOTHS
    drawn: int = 0
    """Cloths of the task's ranges in place of these."""

    @property
    def names(self) -> list[str]:
        return [f"drawn-{k}" for k in range(self.drawn)] or list(self.cloths)


SCALES = {"small": 1, "full": 5}
"""Trials of each cloth and row."""


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """Measure all rows, and show a table for each cloth, or for each quarter of drawn ones."""
    settings = Settings(
        trials=SCALES[flags.scale], task=find_task(flags.task)(), drawn=flags.drawn,
        cloths=flags.objects or CLOTHS,
    )  # fmt: skip
    figures = cloth_real(runs, settings)
    shown = quarters_of(figures) if settings.drawn else tables_of(figures)
    return Result(name="cloth-real", figures=figures, shown=shown)


def cloth_real(runs: Runs, settings: Settings) -> dict[str, Any]:
    """Measure all rows; each estimate and trial is kept by itself.

    Returns:
        JSON: estimates; where the hand closed in each trial [sides]; for each cloth its true
        bending length [sides] and its rows with the action, in units of similarity, and, by trial,
        `MEASURED`, null where the arm or the simulation failed, and how often it was tried. A cloth
        whose estimate is not usable has the reason, and no rows that need one.

    Raises:
        DeviceError: The second reality cannot be simulated or rendered here.
    """
    names = settings.names
    told = runs.each(partial(_acted, runs, settings), names, "cloths")
    found = dict(zip(names, told, strict=True))
    hands = _hands(runs.seed, settings.trials)
    every = {(n, tuple(action)) for n, of in found.items() for action in of["actions"].values()}
    trials = [(*of, k) for of in sorted(every) for k in range(settings.trials)]
    made = runs.each(partial(_trial, runs, settings, hands), trials, "trials")
    seen = dict(zip(trials, made, strict=True))
    rows = {}
    for name, of in found.items():
        rows[name] = {}
        for row, action in of["actions"].items():
            own = [seen[name, tuple(action), k] for k in range(settings.trials)]
            measured = {m: [o[m] for o in own] for m in (*MEASURED, "tries")}
            rows[name][row] = {"action": action} | measured
    return {
        "task": settings.task.name,
        "hands": hands.tolist(),
        "estimates": {name: of["estimate"] for name, of in found.items()},
        "bending_lengths": {name: of["bending_length"] for name, of in found.items()},
        "cloths": rows,
    }


def _hands(seed: int, trials: int) -> Array:
    """[trials, 2] where the hand closes beside the centre [sides]; first where the task says."""
    away = HAND * np.random.default_rng([seed, _STREAM]).standard_normal((trials, 2))
    away[0] = 0.0
    return np.array(OFF_CENTRE) + away


def _item(runs: Runs, settings: Settings, name: str) -> RealCloth:
    """A cloth of the MuJoCo test scene: a named one, one of `ASSETS`, or one that is drawn."""
    from gendom.reality import find_object
    from gendom.reality.objects import as_real

    if settings.drawn:
        rng = np.random.default_rng([runs.seed, int(name.rpartition("-")[2])])
        item = replace(as_real(settings.task.draw_items([rng])[0]), name=name, colour=COLOUR)
    else:
        own = ASSETS / f"{name}.toml"
        item = find_object(str(own) if own.is_file() else name)
    return cast("RealCloth", item)


def _acted(runs: Runs, settings: Settings, name: str) -> dict[str, Any]:
    """What is estimated of a cloth, and the policy's actions by row."""
    item, task = _item(runs, settings, name), settings.task
    policy, rng = Policy.pretrained(task.name), np.random.default_rng([runs.seed, _STREAM])
    likely = {
        "ours, no parameters": [task.draw_items([rng])[0] for _ in range(DRAWN)],
        "ours, true parameters": [item],
    }
    found: dict[str, Any] = {"bending_length": dimensionless_parameters(item)["bending_ratio"]}
    try:
        belief = runs.lifted(name, task, item)
    except GendomError as error:
        found["estimate"] = {"refused": str(error).splitlines()[0]}
    else:
        found["estimate"], likely["ours"] = stated(belief), belief.draws(DRAWN, runs.seed)
    acts = {row: policy.act((), own[0], likely=own, force=True) for row, own in likely.items()}
    units = task.action_units(item)
    return found | {"actions": {r: (np.array(a.values) / units).tolist() for r, a in acts.items()}}


def _trial(
    runs: Runs, settings: Settings, hands: Array, trial: tuple[str, tuple[float, ...], int]
) -> dict[str, float | str | None]:
    """`MEASURED` of a trial: a cloth's name, an action [units of similarity] and the number of the
    hand's place."""
    from gendom.reality import RealWorld

    name, action, k = trial
    item = _item(runs, settings, name)

    def make() -> dict[str, Any]:
        task = replace(settings.task, off_centre=tuple(hands[k].tolist()))
        wanted = task.nearest(item, np.array(action) * task.action_units(item))
        (outcome,) = RealWorld().carry_out(task, [item], [wanted])
        measured = {key: outcome.values.get(key) for key in MEASURED}
        return measured | {"tries": outcome.tries, "fault": outcome.fault}

    said = hashlib.sha256(repr(action).encode()).hexdigest()[:8]
    return runs.kept(f"{settings.task.name}, {name}, {said}, trial {k}, seed {runs.seed}", make)


def tables_of(result: Mapping[str, Any]) -> list[Table]:
    """A table for each cloth."""
    head = ("action", "extended ratio", "std", "paper", "share spread", "std", "failed")
    found = []
    for name, rows in result["cloths"].items():
        refused = result["estimates"][name].get("refused")
        title = f"{name}, bends over {result['bending_lengths'][name]:.3f} sides"
        title += f", estimate refused: {refused}" if refused else ""
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
        _named(figures["action"]),
        *texts["covered"],
        "" if paper is None else f"{paper:.2f}",
        *texts["share"],
        str(sum(value is None for value in figures["covered"])),
    )


def _named(action: Sequence[float]) -> str:
    """An A, or a motion by its number among those that ship, from 1."""
    if len(action) == 1:
        return f"{action[0]:.2f}"
    same = np.isclose(ClothDragging.candidates, action, atol=1e-3).all(axis=1)
    return str(1 + int(same.argmax())) if same.any() else "new"


def quarters_of(result: Mapping[str, Any]) -> list[Table]:
    """Share of drawn cloths that lie spread to `SPREAD` after some tries, of all and by quarters of
    the bending length; what failed, or has no estimate, does not."""
    bends = np.array(list(result["bending_lengths"].values()))
    quarter = np.searchsorted(np.quantile(bends, [0.25, 0.5, 0.75]), bends)
    cloths, rows = list(result["cloths"].values()), {}
    most = max(max(own["tries"]) for of in cloths for own in of.values())
    for row in dict.fromkeys(row for of in cloths for row in of):
        some = [of.get(row, {"share": [0.0], "tries": [1]}) for of in cloths]
        for n in range(1, most + 1):
            within = [np.array(of["tries"]) <= n for of in some]
            shares = [np.array(of["share"], dtype=float) for of in some]
            enough = np.array(
                [((s >= SPREAD) & w).mean() for s, w in zip(shares, within, strict=True)]
            )
            by = [enough, *(enough[quarter == k] for k in range(4))]
            name = row + f", tries: {n}" * (most > 1)
            rows[name] = tuple(f"{some.mean():.2f}" if len(some) else "" for some in by)
    title = f"{len(cloths)} cloths, {result['task']}: share spread to {SPREAD}"
    head = ("all", "limpest quarter", "second", "third", "stiffest")
    return [Table(title=title, head=head, rows=rows)]
