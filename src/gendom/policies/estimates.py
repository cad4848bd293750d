"""An estimate's record, as `gendom.estimation` writes it: what acting takes from it, and what
executions write back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import Any

import numpy as np

from gendom.errors import GendomError
from gendom.materials import ASSUMED, KINDS, QUANTITIES, Item, from_columns, to_columns
from gendom.policies.adaptation import Adapted, Execution
from gendom.policies.belief import LIMITS, OF_POSTERIOR, Belief
from gendom.tasks import Task

LEVEL = 0.9
"""Of intervals where an estimate names none."""

BENDING = {"bending_length": 1.0 / 3.0, "bending_stiffness": 1.0}
"""What follows from E / density for an object of the same sizes, and its power of that."""


def read_estimate(
    params: Mapping[str, Any], where: str, kind: str
) -> tuple[dict[str, float], Mapping[str, Any] | None]:
    """The numbers of an estimate that a policy needs, as far as it has them, by column name; and
    its posterior, None if it says of nothing how sure it is.

    Args:
        params: An estimate's JSON, perhaps of an older version.
        where: Its file, for complaints.
        kind: Of the task's object.

    Raises:
        GendomError: It is of another kind of object, or a number in it is none.
    """
    names = ("E", "nu", "density", "E_over_rho")
    found = {name: params.get(name) for name in names}
    # what the recording does not tell is its prior's
    told = params.get("identifiable") or {}
    hidden = ("damping", "friction")
    found |= {name: params.get(name) for name in hidden if told.get(name, True)}
    described = params.get("object")
    if isinstance(described, dict):
        if described.get("kind", kind) != kind:
            raise GendomError(
                f"describes a {described['kind']}, the task needs a {kind}",
                where=where,
                fix=f"give the estimate of a {kind}",
            )
        # a recording's cloth has width and height
        sizes = {**described, "side": described.get("width")}
        found |= {name: sizes.get(name) for name in KINDS[kind].sizes}
    for name, value in found.items():
        if value is None:
            continue
        may_be_zero = name in hidden
        if not (isinstance(value, (int, float)) and (value > 0.0 or (may_be_zero and value == 0))):
            raise GendomError(
                f"{name} must be a positive number, got {value!r}",
                where=where,
                fix="estimate again, or give the number by a flag",
            )
    known = {name: float(value) for name, value in found.items() if value is not None}
    intervals = params.get("intervals") or {}
    ends = intervals.get("E")
    if not ends:
        return known, None
    if isinstance(params.get("posterior"), dict):
        return known, params["posterior"]
    # files of older versions have the interval alone
    low, high = (math.log(end / known["density"]) for end in ends)
    half = NormalDist().inv_cdf(0.5 + intervals.get("level", 0.9) / 2.0)
    variance = (0.5 * (high - low) / half) ** 2
    return known, {
        "names": ["E_over_rho"],
        "mean": [0.5 * (low + high)],
        "covariance": [[variance]],
    }


def item_of(columns: Mapping[str, float], task: Task) -> Item:
    """The object of an estimate's numbers, by column name; what is missing is `ASSUMED`, or, of E
    over density, the task's."""
    known = {**ASSUMED, **columns}
    modulus = known.get("E_over_rho", task.item.material.E_over_rho)
    known["E"] = modulus * known["density"]
    return from_columns(task.kind, known)


def believed(record: Mapping[str, Any], task: Task, where: str = "estimate") -> Belief:
    """What an estimate says of an object, as far as it counts for a task.

    Args:
        record: An estimate's.
        task: What is to be done.
        where: Its file, for complaints.

    Raises:
        GendomError: It is of another kind of object, or cannot be used.
    """
    columns, posterior = read_estimate(record, where, task.kind)
    return Belief.for_task(task, item_of(columns, task), posterior)


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
    own, density = columns["E_over_rho"], columns["density"]
    level = (record.get("intervals") or {}).get("level", LEVEL)
    deviations = NormalDist().inv_cdf(0.5 + level / 2.0)
    intervals = dict(record.get("intervals") or {"level": level})
    changed = {key: columns[key] for key in ("E", "E_over_rho")}
    for name in belief.names:
        column = QUANTITIES[name].column
        low, high = belief.interval(name, deviations)
        intervals[column], changed[column] = [low, high], columns[column]
        if name == "E_over_rho":
            intervals["E"] = [low * density, high * density]
    for key, power in BENDING.items():
        if record.get(key) is not None:
            changed[key] = record[key] * (own / record["E_over_rho"]) ** power
            if "E_over_rho" in belief.names:
                ends = intervals["E_over_rho"]
                intervals[key] = [changed[key] * (end / own) ** power for end in ends]
    everything = {**(record.get("executions") or {}), task: [e.to_dict() for e in executions]}
    return {
        **record,
        **changed,
        "intervals": intervals,
        "posterior": _posterior(record.get("posterior"), belief),
        "executions": everything,
        "before_executions": record.get("before_executions") or before.to_dict(),
    }


def _posterior(old: Mapping[str, Any] | None, belief: Belief) -> dict[str, Any]:
    """The estimate's posterior with the belief in place of its parameters, which are then
    independent of the others (how the object is held)."""
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
        return math.log(value) if QUANTITIES[name].log else value

    own = {
        "mean": belief.mean.tolist(),
        "prior_mean": belief.mean.tolist(),
        "prior_sd": belief.sd.tolist(),
        "low": [end(n, 0) for n in belief.names],
        "high": [end(n, 1) for n in belief.names],
        "log": [QUANTITIES[n].log for n in belief.names],
    }
    if "recordings" in old:
        own["recordings"] = [None] * count
    for key, values in own.items():
        # those of several recordings share names
        there = dict(zip(old["names"], old.get(key) or [], strict=False))
        kept = [old[key][k] for k in others]
        # the prior stays that of the recording
        first = [
            there.get(name, value) if key.startswith("prior") else value
            for name, value in zip(mine, values, strict=True)
        ]
        found[key] = [*first, *kept]
    return found
