"""`gendom act`: the action that reaches a goal with a given object."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import tyro

from gendom.arguments import require
from gendom.cli.arguments import TaskName
from gendom.cli.known_object import KnownObject, executed
from gendom.cli.outputs import tell_written
from gendom.errors import PolicyError, RobotError, printable
from gendom.files import check_file, to_json, write_json
from gendom.materials import KINDS, LARGEST, PARAMETERS, Item, thickness_of, to_columns
from gendom.robot import XARM7, TcpPath, follow
from gendom.tasks import Task

if TYPE_CHECKING:
    from gendom.materials.estimate import Estimate
    from gendom.policies.policy import Action, Policy
    from gendom.tasks.task import World

_ACTION = "gendom-action/3"

_log = logging.getLogger(__name__)

DRAWS = 64
"""Objects drawn from an estimate's posterior to say what will be reached."""

POLISHED_FOR = 8
"""Objects drawn to polish an action for."""


@dataclass(frozen=True, kw_only=True)
class Command(KnownObject):
    """Print the action that reaches a goal with a given object, and the robot's motion.

    The object comes from --params, or from --E, --nu, --density and its sizes; each of these flags
    also replaces what --params says. With an estimate, the predicted result has an
    interval.

    For example: gendom act rope-casting --goal 0.35 0.07 --params estimate.json
    """

    task: tyro.conf.Positional[TaskName]
    """The task."""
    goal: tuple[float, ...] = ()
    """The goal in SI units and the task's frame: rope-reaching x, rope-casting x and z [m]; none
    for cloth-spreading."""
    origin: tuple[float, float, float] | None = None
    """Where the task's frame has its origin in the robot's base frame [m] (default: the task's)."""
    policy: Path | None = None
    """Policy file; by default the shipped one."""
    no_parameters: bool = False
    """Use the shipped policy that does not see the object's parameters."""
    polish: bool = False
    """Improve the action through the simulator, for objects drawn from the estimate and with what
    earlier executions have shown (gendom adapt)."""
    seconds: float = 10.0
    """Time limit of --polish [s]."""
    engine: Literal["thin", "mpm"] = "thin"
    """Of the simulator that polishes and predicts: ropes as rods and cloths as shells, or particles
    on a grid."""
    no_prediction: bool = False
    """Do not simulate the predicted result."""
    seed: int = 0
    """Seed of the objects drawn from an estimate."""
    out: Path | None = None
    """Also write the result, with the robot's motion, to this JSON file."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        from gendom.policies.belief import believed, for_task
        from gendom.tasks.world import Simulation

        if self.out is not None:
            check_file(self.out, ".json")
        policy = self._policy()
        task = policy.task()
        held = self.held(task, needs=policy.description.conditioned_on)
        item = for_task(held, task).item
        if not self.force and (outside := policy.outside(self.goal, item)):
            raise PolicyError(
                ", ".join(found.what for found in outside),
                where=policy.where,
                fix=f"{', '.join(dict.fromkeys(o.fix for o in outside))}, or add --force",
            )
        action = policy.act(self.goal, item, force=self.force)
        values, polished = np.array(action.values), None
        world = Simulation(engine=self.engine)
        if self.polish:
            values, polished = self._polished(task, held, values, world)
        names = [q.name for q in task.actions]
        result = {
            "format": _ACTION,
            "task": self.task,
            "goal": action.goal,
            "action": dict(zip(names, map(float, values), strict=True)),
            "units": units_of(task),
            "object": {"kind": item.kind, **to_columns(item)},
            "assumed": held.assumed,
            **_about(policy, action),
        }
        T, path = placed(task, item, values, self.origin)
        result |= self._followed(path, item, result["warnings"])
        result["trajectory"] = {"T_base_task": T.tolist(), **path.to_dict()}
        if polished is not None:
            result["polished"] = polished
        if not self.no_prediction and held.value("E_over_rho") is not None:
            others = believed(held, task).draws(DRAWS, self.seed) if held.names else []
            result["predicted"] = predicted(task, item, values, others, self.seed, world)
        print(to_json(result) if self.json else result_text(result, motion=self.out is None))
        if self.out is not None:
            write_json(self.out, result)
            tell_written(self.out, json=self.json)
        return 0

    def _policy(self) -> Policy:
        """The policy of the flags, for the task.

        Raises:
            GendomError: There is none, or it is for another task.
        """
        from gendom.policies import Policy

        if self.policy is None:
            policy = Policy.pretrained(self.task, parameters=not self.no_parameters)
        else:
            what, fix = "cannot be given together with --policy", "leave one of them out"
            require(not self.no_parameters, what, where="--no-parameters", fix=fix)
            policy = Policy.read(self.policy)
        own = policy.task().name
        fix = f"use a policy for {self.task}, or give {own} as the task"
        require(own == self.task, f"is for {own}", where=policy.where, fix=fix)
        return policy

    def _followed(self, path: TcpPath, item: Item, warnings: list[str]) -> dict[str, Any]:
        """How the arm follows a path, ready for JSON; with --force a warning where it cannot.

        Raises:
            RobotError: It cannot.
        """
        try:
            motion = follow(XARM7, path, slow_down=True, opening=thickness_of(item))
        except RobotError as error:
            if not self.force:
                fix = "choose another --origin, or add --force"
                raise RobotError(error.what, where=error.where, fix=fix) from None
            warnings.append(str(error))
            _log.warning("%s", error)
            return {}
        return {"arm": {"name": XARM7.name, "slowed_by": motion.slowed_by}}

    def _polished(
        self, task: Task, held: Estimate, start: np.ndarray, world: World
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """A better action, and what is expected of it, ready for JSON."""
        from gendom.policies.adaptation import adapt
        from gendom.policies.belief import believed
        from gendom.policies.polishing import polish

        belief = believed(held, task)
        discrepancy = None
        if seen := executed(held, task):
            discrepancy = adapt(task, belief, seen, refine=False, world=world).discrepancy
        items = belief.draws(POLISHED_FOR, self.seed) if belief.names else [belief.item]
        found = polish(
            task,
            np.array(self.goal),
            items,
            start,
            seconds=self.seconds,
            seed=self.seed,
            discrepancy=discrepancy,
            world=world,
        )
        about = {"expected": found.expected, "before": found.before,
                 "rollouts": found.rollouts, "seconds": found.seconds}  # fmt: skip
        return found.action, about


def _about(policy: Policy, action: Action) -> dict[str, Any]:
    """Which policy chose an action, from what, with which warnings."""
    inputs = action.network_input
    return {
        "policy": {
            "path": policy.where,
            "method": policy.description.method,
            "conditioned_on": policy.description.conditioned_on,
            "seed": policy.description.training.get("seed"),
        },
        "network_input": inputs,
        "network_input_meaning": {n: f"{PARAMETERS[n].meaning}, dimensionless" for n in inputs},
        "warnings": list(action.warnings),
    }


def placed(
    task: Task, item: Item, action: np.ndarray, origin: tuple[float, float, float] | None
) -> tuple[np.ndarray, TcpPath]:
    """T_base_task [4, 4], by which a task is placed [m], and the tool's path in the robot's base
    frame."""
    T = task.T_world_task(item)
    if origin is not None:
        finite = all(map(math.isfinite, origin))
        require(finite, "must be three finite numbers [m]", where="--origin")
        what = f"is {' '.join(f'{x:g}' for x in origin)} m"
        require(max(map(abs, origin)) <= LARGEST, what, where="--origin", fix="give metres")
        T[:3, 3] = origin
    return T, task.tool_path(item, action).moved(T)


def predicted(
    task: Task,
    item: Item,
    action: np.ndarray,
    others: Sequence[Item],
    seed: int,
    world: World,
) -> dict[str, Any]:
    """What the action will reach, simulated: with the object as it is, and the 90 % interval over
    others that are plausible and over the simulator's error.

    Args:
        task: What is done.
        item: The object.
        action: [A].
        others: Plausible ones; none: the object is taken as known.
        seed: Of the simulator's error, as `gendom.policies.adaptation` expects it.
        world: Where it is simulated.
    """
    from gendom.policies.adaptation import DISCREPANCY

    items = [item, *others]
    outcomes = world.carry_out(task, items, np.tile(action, (len(items), 1)))
    if outcomes[0].fault is not None:
        return {"fault": outcomes[0].fault}
    found: dict[str, Any] = {"reached": outcomes[0].values}
    values = [o.values for o in outcomes[1:] if o.fault is None]
    if values:
        names = [q.name for q in task.goals] or list(values[0])
        some = np.array([[v[name] for name in names] for v in values])
        if task.goals:
            error = np.random.default_rng(seed).normal(size=some.shape)
            some += DISCREPANCY * task.goal_units(item) * error
        ends = np.quantile(some, [0.05, 0.95], axis=0).T
        found["interval_90"] = dict(zip(names, ends.tolist(), strict=True))
    return found


def units_of(task: Task) -> dict[str, str]:
    """SI units of actions, goals, outcomes and the risk by name; ``1``: dimensionless, ``bool``: 1
    is yes, 0 is no."""
    risk = [] if task.risk is None else [task.risk]
    named = (*task.actions, *task.goals, *task.outcomes, *risk)
    return {quantity.name: quantity.unit for quantity in named}


def _with_unit(name: str, value: float, units: Mapping[str, str], form: str = ".4g") -> str:
    unit = units.get(name)  # outcomes of other authors' tasks may have none
    if unit == "bool":
        return f"{name} {'yes' if value else 'no'}"
    return f"{name} {value:{form}} {'[-]' if unit == '1' else unit or ''}".rstrip()


def result_text(result: dict[str, Any], *, motion: bool) -> str:
    """The same for people, with or without the robot's motion."""
    path, held = result["trajectory"], result["object"]
    goal, action, units = result["goal"].items(), result["action"].items(), result["units"]
    large, small = KINDS[held["kind"]].sizes
    size = f"{large} {held[large]:.4g} m, {small} {held[small]:.4g} m"
    inputs = result["network_input"]
    rows = [
        (held["kind"], size),
        ("inputs", "of the policy, dimensionless" if inputs else "no parameters"),
        *[("", f"{n:<8} {v:<8.4g} {PARAMETERS[n].meaning}") for n, v in inputs.items()],
        ("goal", ", ".join(_with_unit(n, v, units) for n, v in goal) or "none"),
        ("action", ", ".join(_with_unit(n, v, units, ".4f") for n, v in action)),
    ]
    for event in path["events"]:
        rows.append(
            ("hand", f"{'closes' if event['closed'] else 'opens'} at {event['time']:.4f} s")
        )
    if "polished" in result:
        p = result["polished"]
        unit = next((u for n in result["goal"] if (u := units[n]) != "1"), "[-]")
        rows.append(
            ("polished", f"expected miss {p['expected']:.2g} {unit} (before {p['before']:.2g}), "
             f"{p['rollouts']} rollouts in {p['seconds']:.1f} s")
        )  # fmt: skip
    if "arm" in result:
        name, slower = result["arm"]["name"], result["arm"]["slowed_by"]
        late = f", but takes {slower:.3g} times as long" if slower > 1.0 else ""
        rows.append(("arm", f"{name} follows the motion{late}"))
    if "predicted" in result:
        rows.append(("predicts", predicted_text(result["predicted"], units)))
    for name in inputs:
        p = PARAMETERS[name]
        if p.column in result["assumed"]:
            unit = "[-]" if p.unit == "1" else p.unit
            rows.append(("assumed", f"{name} {result['assumed'][p.column]:g} {unit}"))
    rows.append(("policy", printable(result["policy"]["path"])))
    lines = [result["task"], *(f"  {name:<8} {text}" for name, text in rows)]
    if motion:
        lines += [f"  time [s]   position [m] in the frame: {path['frame']}"]
        lines += [
            f"  {t:<9.4f}  " + "  ".join(f"{c:9.5f}" for c in position)
            for t, position in zip(path["time"], path["position"], strict=True)
        ]
    return "\n".join(lines)


def predicted_text(predicted: Mapping[str, Any], units: Mapping[str, str]) -> str:
    """What will be reached, in one line, with units."""
    if "fault" in predicted:
        return f"cannot be simulated: {predicted['fault']}"
    text = []
    for name, value in predicted["reached"].items():
        ends = predicted.get("interval_90", {}).get(name)
        interval = f" (90 %: {ends[0]:.4g} to {ends[1]:.4g})" if ends else ""
        text.append(_with_unit(name, value, units) + interval)
    return ", ".join(text)
