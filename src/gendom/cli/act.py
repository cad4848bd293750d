"""`gendom act`: the action that reaches a goal with a given object."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np
import tyro

from gendom.cli.arguments import TaskName, read_params
from gendom.cli.outputs import tell_written
from gendom.errors import GendomError, PolicyError
from gendom.files import check_file, to_json, write_json
from gendom.materials import ASSUMED, KINDS, LARGEST, PARAMETERS, Item, from_columns, to_columns

if TYPE_CHECKING:
    from gendom.policies import Policy
    from gendom.tasks import Task

_ACTION = "gendom-action/2"

DRAWS = 64
"""Objects drawn from an estimate's interval to say what will be reached."""

# What is missing -> the flags that give it.
_FLAGS = {
    "E": "--E and --density",
    "nu": "--nu",
    "density": "--density",
    "damping": "--damping",
    "friction": "--friction",
    "length": "--length",
    "diameter": "--diameter",
    "side": "--side",
    "thickness": "--thickness",
}


@dataclass(frozen=True, kw_only=True)
class Command:
    """Print the action that reaches a goal with a given object, and the robot's motion.

    The object comes from --params, or from --E, --nu, --density and its sizes; each of these flags
    also replaces what --params says. With an estimate, the range of what will be reached is
    printed too.

    For example: gendom act rope-casting --goal 0.35 0.07 --params estimate.json
    """

    task: tyro.conf.Positional[TaskName]
    """What is done."""
    goal: tuple[float, ...] = ()
    """In SI units and the task's frame: rope-reaching x, rope-casting x and z [m]; none for
    cloth-spreading."""
    params: Path | None = None
    """File written by gendom estimate."""
    E: float | None = None
    """Young's modulus [Pa]."""
    nu: float | None = None
    """Poisson's ratio [-]."""
    density: float | None = None
    """Mass density [kg/m^3]."""
    damping: float | None = None
    """Viscous over elastic stress [s]."""
    friction: float | None = None
    """Coefficient of friction [-]."""
    length: float | None = None
    """A rope's length [m]."""
    diameter: float | None = None
    """A rope's diameter [m]."""
    side: float | None = None
    """A cloth's side [m]."""
    thickness: float | None = None
    """A cloth's thickness [m]."""
    origin: tuple[float, float, float] | None = None
    """Where the task's frame has its origin in the robot's base frame [m] (default: the task's)."""
    policy: Path | None = None
    """Policy file; by default the one that comes with the package."""
    no_parameters: bool = False
    """Use the policy of the package that does not see the object's parameters."""
    force: bool = False
    """Act for a goal or an object outside of what the policy was trained on, too, with the nearest
    numbers that it was and a warning; and with an estimate that is not usable."""
    no_foretell: bool = False
    """Do not simulate what will be reached."""
    seed: int = 0
    """Seed of the objects drawn from an estimate's interval."""
    out: Path | None = None
    """Also write the result, with the robot's motion, to this JSON file."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        from gendom.policies import Policy

        if self.out is not None:
            check_file(self.out, ".json")
        if self.policy is None:
            policy = Policy.pretrained(self.task, parameters=not self.no_parameters)
        elif not self.no_parameters:
            policy = Policy.read(self.policy)
        else:
            raise GendomError(
                "cannot be given together with --policy",
                where="--no-parameters",
                fix="leave one of them out",
            )
        task = policy.task()
        if task.name != self.task:
            raise GendomError(
                f"is for {task.name}",
                where=policy.where,
                fix=f"use a policy for {self.task}, or give {task.name} as the task",
            )
        held, spread = self._held(task.kind)
        item, assumed = self._object(task, policy, held)
        if not self.force and (outside := policy.outside(self.goal, item)):
            raise PolicyError(
                ", ".join(found.what for found in outside),
                where=policy.where,
                fix=f"{', '.join(dict.fromkeys(o.fix for o in outside))}, or add --force",
            )
        action = policy.act(self.goal, item, force=self.force)
        values = np.array(action.values)
        result = {
            "format": _ACTION,
            "task": self.task,
            "goal": action.goal,
            "action": action.action,
            "object": {"kind": item.kind, **to_columns(item)},
            "assumed": assumed,
            "policy": {
                "path": policy.where,
                "method": policy.description.method,
                "conditioned_on": policy.description.conditioned_on,
                "seed": policy.description.training.get("seed"),
            },
            "network_input": action.saw,
            "warnings": action.warnings,
            "trajectory": trajectory(task, item, values, self.origin),
        }
        if not self.no_foretell and "specific_modulus" in held:
            result["foretold"] = foretold(task, item, values, spread, self.seed)
        print(to_json(result) if self.json else result_text(result, motion=self.out is None))
        if self.out is not None:
            write_json(self.out, result)
            tell_written(self.out, json=self.json)
        return 0

    def _held(self, kind: str) -> tuple[dict[str, float], tuple[float, float] | None]:
        """What is known of the object, in SI units by column name, and `read_estimate`'s spread."""
        held, spread = {}, None
        if self.params is not None:
            params = read_params(self.params, force=self.force)
            held, spread = read_estimate(params, str(self.params), kind)
        flags = {
            "youngs_modulus": self.E,
            "poissons_ratio": self.nu,
            "density": self.density,
            "damping": self.damping,
            "friction": self.friction,
            "length": self.length,
            "diameter": self.diameter,
            "side": self.side,
            "thickness": self.thickness,
        }
        given = {name: value for name, value in flags.items() if value is not None}
        held |= given
        if given.keys() & {"youngs_modulus", "density"}:
            held.pop("specific_modulus", None)  # the file's own, of other numbers
            spread = None
        if "specific_modulus" not in held and {"youngs_modulus", "density"} <= held.keys():
            held["specific_modulus"] = held["youngs_modulus"] / held["density"]
        return held, spread

    def _object(
        self, task: Task, policy: Policy, held: Mapping[str, float]
    ) -> tuple[Item, dict[str, float]]:
        """The object, and what had to be assumed of it.

        Raises:
            GendomError: Something that the policy sees is missing.
        """
        sees = policy.description.conditioned_on
        missing = [name for name in KINDS[task.kind].sizes if name not in held]
        # not every recording tells damping and friction
        missing += [
            name
            for name in sees
            if name not in ("damping", "friction") and PARAMETERS[name].column not in held
        ]
        if missing:
            raise GendomError(
                "the object is not fully described",
                where=None if self.params is None else str(self.params),
                fix=f"give {', '.join(dict.fromkeys(_FLAGS[name] for name in missing))}"
                + (", or --params with an estimate" if self.params is None else ""),
            )
        assumed = {name: value for name, value in ASSUMED.items() if name not in held}
        known = {**assumed, **held}
        modulus = known.get("specific_modulus", task.item.material.specific_modulus)
        known["youngs_modulus"] = modulus * known["density"]
        return from_columns(task.kind, known), assumed


def trajectory(
    task: Task, item: Item, action: np.ndarray, origin: tuple[float, float, float] | None
) -> dict[str, Any]:
    """The tool's motion in the robot's base frame, ready for JSON.

    Returns:
        time [K] [s]; position [K][3] [m] and quat_xyzw [4] or [K][4] of the tool; events, when the
        hand closes and opens; frame, and T_base_task [4][4], by which the task was placed.
    """
    T = task.T_world_task(item)
    if origin is not None:
        if not all(map(math.isfinite, origin)):
            raise GendomError("must be three finite numbers [m]", where="--origin")
        if max(map(abs, origin)) > LARGEST:
            raise GendomError(
                f"is {' '.join(f'{x:g}' for x in origin)} m", where="--origin", fix="give metres"
            )
        T[:3, 3] = origin
    path = task.tool_path(item, action).moved(T)
    times, position = path.sampled()
    return {
        "frame": "robot base, z up",
        "T_base_task": T.tolist(),
        "time": times.tolist(),
        "position": position.tolist(),
        "quat_xyzw": path.quat_xyzw.tolist(),
        "events": [{"time": e.time, "closed": e.closed} for e in path.events],
    }


def foretold(
    task: Task,
    item: Item,
    action: np.ndarray,
    spread: tuple[float, float] | None,
    seed: int,
) -> dict[str, Any]:
    """What the action will reach, simulated: with the object as it is, and over E's 90 % interval.

    Args:
        task: What is done.
        item: The object.
        action: [A].
        spread: Mean and standard deviation of ln(E / Pa); None: E is taken as known.
        seed: Of the draws.
    """
    from gendom.tasks.world import Simulation

    items = [item]
    if spread is not None:
        rng = np.random.default_rng(seed)
        logs = rng.normal(*spread, DRAWS)
        material = item.material
        items += [replace(item, material=replace(material, E=float(np.exp(x)))) for x in logs]
    outcomes = Simulation().carry_out(task, items, np.tile(action, (len(items), 1)))
    if outcomes[0].fault is not None:
        return {"fault": outcomes[0].fault}
    found: dict[str, Any] = {"reached": outcomes[0].values}
    others = [o.values for o in outcomes[1:] if o.fault is None]
    if others:
        names = [q.name for q in task.goals] or list(others[0])
        found["interval_90"] = {
            name: np.quantile([o[name] for o in others], [0.05, 0.95]).tolist() for name in names
        }
    return found


def read_estimate(
    params: Mapping[str, Any], where: str, kind: str
) -> tuple[dict[str, float], tuple[float, float] | None]:
    """The numbers of an estimate that a policy needs, as far as it has them, by column name; and
    mean and standard deviation of ln(E / Pa).

    Args:
        params: An estimate's JSON, perhaps of an older version.
        where: Its file, for complaints.
        kind: Of the task's object.

    Raises:
        GendomError: It is of another kind of object, or a number in it is none.
    """
    names = ("youngs_modulus", "poissons_ratio", "density", "specific_modulus")
    found = {name: params.get(name) for name in (*names, "damping", "friction")}
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
        may_be_zero = name in ("damping", "friction")
        if not (isinstance(value, (int, float)) and (value > 0.0 or (may_be_zero and value == 0))):
            raise GendomError(
                f"{name} must be a positive number, got {value!r}",
                where=where,
                fix="estimate again, or give the number by a flag",
            )
    known = {name: float(value) for name, value in found.items() if value is not None}
    intervals = params.get("intervals") or {}
    ends = intervals.get("youngs_modulus")
    if not ends:
        return known, None
    low, high = math.log(ends[0]), math.log(ends[1])
    half = NormalDist().inv_cdf(0.5 + intervals.get("level", 0.9) / 2.0)
    return known, (0.5 * (low + high), 0.5 * (high - low) / half)


def result_text(result: dict[str, Any], *, motion: bool) -> str:
    """The same for people, with or without the robot's motion."""
    path, held = result["trajectory"], result["object"]
    large, small = KINDS[held["kind"]].sizes
    size = f"{large} {held[large]:.4g} m, {small} {held[small]:.4g} m"
    seen = ", ".join(f"{name} {value:.4g}" for name, value in result["network_input"].items())
    rows = [
        (held["kind"], size),
        ("sees", seen or "no parameters"),
        ("goal", ", ".join(f"{n} {v:.4g}" for n, v in result["goal"].items()) or "none"),
        ("action", ", ".join(f"{n} {v:.4f}" for n, v in result["action"].items())),
    ]
    for event in path["events"]:
        rows.append(
            ("hand", f"{'closes' if event['closed'] else 'opens'} at {event['time']:.4f} s")
        )
    if "foretold" in result:
        rows.append(("foretold", _foretold_text(result["foretold"])))
    if assumed := [f"{n} {v:g}" for n, v in result["assumed"].items() if n in seen]:
        rows.append(("assumed", ", ".join(assumed)))
    rows.append(("policy", result["policy"]["path"]))
    lines = [result["task"], *(f"  {name:<8} {text}" for name, text in rows)]
    if motion:
        lines += [f"  time [s]   position [m] in the frame: {path['frame']}"]
        lines += [
            f"  {t:<9.4f}  " + "  ".join(f"{c:9.5f}" for c in position)
            for t, position in zip(path["time"], path["position"], strict=True)
        ]
    return "\n".join(lines)


def _foretold_text(foretold: Mapping[str, Any]) -> str:
    if "fault" in foretold:
        return f"cannot be simulated: {foretold['fault']}"
    text = []
    for name, value in foretold["reached"].items():
        ends = foretold.get("interval_90", {}).get(name)
        text.append(
            f"{name} {value:.4g}" + (f" (90 %: {ends[0]:.4g} to {ends[1]:.4g})" if ends else "")
        )
    return ", ".join(text)
