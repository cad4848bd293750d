"""`gendom adapt`: learn an object's parameters from what actions have reached."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np
import tyro

from gendom.cli.arguments import TaskName, read_params
from gendom.cli.known_object import KnownObject
from gendom.cli.outputs import tell_written
from gendom.errors import ParameterError
from gendom.files import check_file, read_json, to_json, write_json
from gendom.materials import PARAMETERS, to_columns
from gendom.tasks import find_task

if TYPE_CHECKING:
    from gendom.policies.adapt import Adapted, Execution
    from gendom.policies.belief import Belief

LEVEL = 0.9
"""Of intervals where the estimate names none."""


@dataclass(frozen=True, kw_only=True)
class Command(KnownObject):
    """Update an estimate by executed actions and what they reached.

    Damping and Young's modulus change as far as they explain what was reached; the rest of the miss
    is expected to repeat for similar actions. gendom act --polish --params uses both. To add a
    further execution, pass the written file as --params.

    For example: gendom adapt rope-casting --params estimate.json --action 0.17 --reached 0.35 0.08
    --out adapted.json
    """

    task: tyro.conf.Positional[TaskName]
    """The task."""
    action: tuple[float, ...] = ()
    """The executed action, as gendom act printed it [SI]."""
    reached: tuple[float, ...] = ()
    """What it reached, in the form of a goal [SI]."""
    executions: Path | None = None
    """JSON file with a list of executions: {"action": [...], "reached": [...]} each."""
    out: Path | None = None
    """JSON file to write: the updated estimate, with all executions."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        from gendom.policies.adapt import adapt

        if self.params is None:
            raise ParameterError("is missing", where="--params", fix="give an estimate's file")
        if self.out is not None:
            check_file(self.out, ".json")
        task = find_task(self.task)()
        record = read_params(self.params, force=self.force)
        held = self.held(task)
        executions = [*held.executed(task), *self._new()]
        if not executions:
            raise ParameterError(
                "no execution to learn from", fix="give --action and --reached, or --executions"
            )
        before = record.get("before_executions")
        belief = held.belief(task)
        if before is not None:  # all executions are learnt from at once, from where it began
            belief = _belief_of(belief, before)
        adapted = adapt(task, belief, executions)
        result = updated(record, task.name, belief, adapted, executions)
        print(to_json(result) if self.json else _text(belief, adapted))
        if self.out is not None:
            write_json(self.out, result)
            tell_written(self.out, json=self.json)
        return 0

    def _new(self) -> list[Execution]:
        from gendom.policies.adapt import executions_from

        found = []
        if self.executions is not None:
            rows = read_json(self.executions).get("executions")
            if not isinstance(rows, list):
                raise ParameterError(
                    "holds no list of executions",
                    where=str(self.executions),
                    fix='write {"executions": [{"action": [...], "reached": [...]}]}',
                )
            found += executions_from(rows, str(self.executions))
        if bool(self.action) != bool(self.reached):
            missing = "--reached" if self.action else "--action"
            raise ParameterError("is missing", where=missing, fix="give both")
        if self.action:
            found += executions_from([{"action": self.action, "reached": self.reached}], "flags")
        return found


def _belief_of(belief: Belief, before: Mapping[str, Any]) -> Belief:
    from gendom.policies.belief import Belief

    mean, covariance = np.array(before["mean"]), np.array(before["covariance"])
    return Belief(item=belief.item, names=tuple(before["names"]), mean=mean, covariance=covariance)


def updated(
    record: Mapping[str, Any],
    task: str,
    before: Belief,
    adapted: Adapted,
    executions: Sequence[Execution],
) -> dict[str, Any]:
    """An estimate's record with what executions have taught.

    Args:
        record: The estimate's.
        task: Name of what was done.
        before: What was known before any execution.
        adapted: What is known now.
        executions: All of them.
    """
    belief = adapted.belief
    columns = to_columns(belief.most_likely)
    ratio = columns["specific_modulus"] / record["specific_modulus"]
    level = (record.get("intervals") or {}).get("level", LEVEL)
    deviations = NormalDist().inv_cdf(0.5 + level / 2.0)
    intervals = dict(record.get("intervals") or {"level": level})
    for name in belief.names:
        low, high = belief.interval(name, deviations)
        intervals[PARAMETERS[name].column] = [low, high]
        if name != "E":
            continue
        own, density = columns["specific_modulus"], columns["density"]
        intervals["youngs_modulus"] = [low * density, high * density]
        for key, power in (("bending_length", 1.0 / 3.0), ("bending_stiffness", 1.0)):
            if record.get(key) is not None:
                now = record[key] * ratio**power
                intervals[key] = [now * (end / own) ** power for end in (low, high)]
    changed = {key: columns[key] for key in ("youngs_modulus", "specific_modulus")}
    changed |= {
        PARAMETERS[n].column: columns[PARAMETERS[n].column] for n in belief.names if n != "E"
    }
    for key, power in (("bending_length", 1.0 / 3.0), ("bending_stiffness", 1.0)):
        if record.get(key) is not None:
            changed[key] = record[key] * ratio**power
    everything = {**(record.get("executions") or {}), task: [e.to_dict() for e in executions]}
    return {
        **record,
        **changed,
        "intervals": intervals,
        "posterior": _posterior(record.get("posterior"), belief),
        "executions": everything,
        "before_executions": record.get("before_executions")
        or {
            "names": list(before.names),
            "mean": before.mean.tolist(),
            "covariance": before.covariance.tolist(),
        },
    }


def _posterior(old: Mapping[str, Any] | None, belief: Belief) -> dict[str, Any]:
    """The estimate's posterior with the belief in place of its parameters, which are then
    independent of the others (how the object is held)."""
    from gendom.policies.belief import LIMITS, OF_POSTERIOR

    names = {own: theirs for theirs, own in OF_POSTERIOR.items()}
    mine = [names[n] for n in belief.names]
    old = old or {"names": [], "covariance": []}
    others = [k for k, name in enumerate(old["names"]) if name not in mine]
    count = len(mine)
    covariance = np.zeros((count + len(others), count + len(others)))
    covariance[:count, :count] = belief.covariance
    if others:
        covariance[count:, count:] = np.array(old["covariance"])[np.ix_(others, others)]
    found: dict[str, Any] = {
        "names": [*mine, *(old["names"][k] for k in others)],
        "covariance": covariance.tolist(),
    }

    def end(name: str, side: int) -> float:
        value = LIMITS[name][side]
        return math.log(value) if PARAMETERS[name].log else value

    own = {
        "mean": belief.mean.tolist(),
        "prior_mean": belief.mean.tolist(),
        "prior_sd": belief.sd.tolist(),
        "low": [end(n, 0) for n in belief.names],
        "high": [end(n, 1) for n in belief.names],
        "log": [PARAMETERS[n].log for n in belief.names],
    }
    for key, values in own.items():
        there = dict(zip(old["names"], old.get(key) or [], strict=False))
        kept = [there[old["names"][k]] for k in others]
        # the prior stays that of the recording
        first = [
            there.get(name, value) if key.startswith("prior") else value
            for name, value in zip(mine, values, strict=True)
        ]
        found[key] = [*first, *kept]
    return found


def _text(before: Belief, adapted: Adapted) -> str:
    """For people."""
    rows = []
    for name in adapted.belief.names:
        column = PARAMETERS[name].column
        unit = "" if PARAMETERS[name].unit == "1" else f" {PARAMETERS[name].unit}"
        said = []
        for b in (before, adapted.belief):
            low, high = b.interval(name)
            said.append(f"{to_columns(b.most_likely)[column]:.4g} [{low:.4g}, {high:.4g}]")
        rows.append(f"  {column:<18} {said[0]}  ->  {said[1]}{unit}")
    left = ", ".join(f"{1e3 * np.linalg.norm(r):.1f}" for r in adapted.residuals)
    title = "parameters, with 90 % intervals, before and after"
    return "\n".join([title, *rows, f"  not explained [mm]: {left}"])
