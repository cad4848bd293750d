"""`gendom act`: the action that reaches a goal with a given object."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import check_choice, require
from gendom.arrays import placed
from gendom.cli.arguments import Engine, Json, Seed, TaskName, policy_for
from gendom.cli.known_object import KnownObject, executed
from gendom.cli.outputs import check_places, tell_written, write_result
from gendom.datasets.folder import READERS
from gendom.errors import RobotError, printable
from gendom.files import to_json
from gendom.hardware.cell import BARE, Cell
from gendom.hardware.execution import ACTION_FORMAT, write_trajectory
from gendom.materials import KINDS, LARGEST, PARAMETERS, size_of, thickness_of, to_columns
from gendom.materials.estimate import Estimate
from gendom.policies import Action, Policy
from gendom.policies.adaptation import adapt
from gendom.policies.belief import believed, for_task, weighed
from gendom.policies.polishing import polish
from gendom.policies.prediction import doubts, predict
from gendom.robot import TcpPath
from gendom.tasks import Task
from gendom.tasks.world import Simulation

_log = logging.getLogger(__name__)

DRAWS = 64
"""Objects drawn from an estimate's posterior to choose an action for, and to say what will be
reached."""


@dataclass(frozen=True, kw_only=True)
class Command(KnownObject):
    """Print the action that reaches a goal with a given object, and the robot's motion.

    The object comes from --params, or from --E, --nu, --density and its sizes; each of these flags
    also replaces what --params says. With an estimate, the predicted result has an
    interval.

    For example: gendom act rope-casting --goal 0.35 0.07 --params estimate.json
    """

    task: TaskName
    goal: tuple[float, ...] = ()
    """The goal in SI units and the task's frame: rope-reaching x, rope-casting x and z [m]; none
    for cloths."""
    cell: Path | None = None
    """cell.toml (gendom cell) in which the arm will act: table, obstacles, distances and speeds.
    Without it the arm is planned beside its table alone, for simulation only."""
    origin: tuple[float, float, float] | None = None
    """Where the task's frame has its origin in the robot's base frame [m] (default: the task's)."""
    lying: tuple[Path, ...] = ()
    """Of cloth-dragging, clouds (.ply, .pcd or .npz) of the cloth in the base frame [m], as it lay
    after each drag so far: the motion is then the next one."""
    arm: str = "xarm7"
    """The robot without --cell: xarm7, fr3, another package's, or a URDF or MJCF file
    (docs/robot.md)."""
    policy: Path | None = None
    """Policy file; by default the shipped one."""
    polish: bool = False
    """Improve the action through the simulator, with what earlier executions have shown (gendom
    adapt); before the first one casts become better, and pulls hardly."""
    seconds: float = 5.0
    """Time limit of polishing [s]."""
    engine: Engine = "thin"
    no_prediction: bool = False
    """Do not simulate the predicted result."""
    seed: Seed = 0
    out: Path | None = None
    """Also write the result, with the robot's motion, to this JSON file, which gendom execute
    takes."""
    joints: Path | None = None
    """CSV file for the joint angles of the motion at 100 Hz (joints.csv of gendom perceive)."""
    trajectory: Path | None = None
    """File for the motion as a ROS JointTrajectory: .json, which YAML readers take, too."""
    json: Json = False

    def run(self) -> int:
        check_places((self.out, ".json"), (self.joints, ".csv"), (self.trajectory, ".json"))
        cell = replace(BARE, arm=self.arm) if self.cell is None else Cell.read(self.cell)
        policy = policy_for(self.task, self.policy)
        task = policy.task()
        held = self.held(task, needs=policy.description.conditioned_on)
        item = for_task(held, task).item
        others = believed(held, task).draws(DRAWS, self.seed) if held.names else []
        others = weighed(others, executed(held, task), policy, self.seed)
        action = policy.act(self.goal, item, likely=others, force=self.force)
        warnings, values = list(action.warnings), np.array(action.values)
        world = Simulation(engine=self.engine)
        simulated = not (self.no_prediction or self.lying) and held.value("E_over_rho") is not None
        polished = {}
        if self.polish:
            values, polished = self._polished(task, held, values, world)
        T = task.T_world_task(item)
        if self.origin is not None:
            near = all(abs(x) <= LARGEST for x in self.origin)
            what, fix = f"is {' '.join(f'{x:g}' for x in self.origin)} m", "give metres, finite"
            require(near, what, where="--origin", fix=fix)
            T[:3, 3] = self.origin
        path = task.tool_path(item, values).moved(T)
        for cloud in self.lying:
            check_choice("suffix", cloud.suffix, READERS, where=f"--lying {cloud}")
            require(len(x := READERS[cloud.suffix](cloud)), "has no points", where=str(cloud))
            x, hand = (placed(np.linalg.inv(T), of) for of in (x, path.position[-1]))
            path = task.next_path(item, x, hand).moved(T)
        result = {
            "format": ACTION_FORMAT,
            "task": self.task,
            "goal": action.goal,
            "action": dict(zip((q.name for q in task.actions), map(float, values), strict=True)),
            "units": {q.name: q.unit for q in (*task.actions, *task.goals, *task.outcomes)},
            "object": {"kind": item.kind, **to_columns(item)},
            "assumed": held.assumed,
            **_origin(policy, action),
            "warnings": warnings,
            "trajectory": {"T_base_task": T.tolist(), **path.to_dict()},
        }
        hangs = 0.0 if task.scene(item).stand else size_of(item)
        result |= self._followed(path, thickness_of(item), hangs, warnings, cell) | polished
        if simulated:
            predicted = predict(task, item, values, others, self.seed, world)
            result["predicted"] = predicted
            warnings += _told(doubts(task, item, action.goal, predicted, force=self.force))
        print(to_json(result) if self.json else result_text(result, motion=self.out is None))
        write_result(self.out, result, json=self.json)
        return 0

    def _followed(
        self, path: TcpPath, opening: float, hangs: float, warnings: list[str], cell: Cell
    ) -> dict[str, Any]:
        """How the arm follows a path, ready for JSON; with --force a warning where it cannot. Files
        of the motion are written.

        Raises:
            RobotError: It cannot.
        """
        try:
            planned = cell.plan(path, opening=opening, hangs=hangs)
        except RobotError as error:
            if not self.force:
                fix = "choose another --origin, or add --force"
                raise RobotError(error.what, where=error.where, fix=fix) from None
            warnings += _told([str(error)])
            return {}
        motion, pace = planned.motion, "what is predicted is for the task's own pace"
        if (slower := motion.slowed_by) > 1.02:
            said = f"the arm takes {slower:.3g} times as long as the task asks for, and {pace}"
            warnings.append(said)
        if self.joints is not None:
            widest = cell.model.gripper.max_opening
            motion.write_joints(self.joints, opening=(planned.opening, widest))
            tell_written(self.joints, json=self.json)
        if self.trajectory is not None:
            write_trajectory(self.trajectory, motion)
            tell_written(self.trajectory, json=self.json)
        return {"arm": {"name": planned.arm, "slowed_by": motion.slowed_by}, "plan": planned}

    def _polished(
        self, task: Task, held: Estimate, start: np.ndarray, world: Simulation
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """A better action, and what is expected of it, ready for JSON."""
        belief, wrong = believed(held, task), None
        if seen := executed(held, task):
            wrong = adapt(task, belief, seen, refine=False, world=world).discrepancy
        found = polish(
            task, np.array(self.goal), belief, start, seconds=self.seconds,
            discrepancy=wrong, world=world,
        )  # fmt: skip
        names = ("expected", "before", "rollouts", "seconds")
        return found.action, {"polished": {n: getattr(found, n) for n in names}}


def _told(notes: list[str]) -> list[str]:
    """Notes, which are logged as warnings."""
    for note in notes:
        _log.warning("%s", note)
    return notes


def _origin(policy: Policy, action: Action) -> dict[str, Any]:
    """Which policy chose an action, and what it saw, ready for JSON."""
    about, inputs = policy.description, action.network_input
    meanings = {name: f"{PARAMETERS[name].meaning}, dimensionless" for name in inputs}
    return {
        "policy": {
            "path": policy.where,
            "method": about.method,
            "conditioned_on": about.conditioned_on,
            "chance": action.chance,
            "seed": about.training.get("seed"),
        },
        "network_input": inputs,
        "network_input_meaning": meanings,
    }


def _with_unit(name: str, value: float, units: Mapping[str, str], form: str = ".4g") -> str:
    unit = units.get(name)  # outcomes of other authors' tasks may have none
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
        *[("", f"{n:<15}  {v:<8.4g} {PARAMETERS[n].meaning}") for n, v in inputs.items()],
        ("goal", ", ".join(_with_unit(n, v, units) for n, v in goal) or "none"),
        ("action", ", ".join(_with_unit(n, v, units, ".4f") for n, v in action)),
    ]
    for event in path["events"]:
        does = "closes" if event["closed"] else "opens"
        rows.append(("hand", f"{does} at {event['time']:.4f} s"))
    if (chance := result["policy"]["chance"]) is not None:
        rows.append(("chance", f"{chance:.2f} to be enough, by the policy"))
    if "polished" in result:
        p = result["polished"]
        unit = next((u for n in result["goal"] if (u := units[n]) != "1"), "[-]")
        said = f"expected miss {p['expected']:.2g} {unit} (before {p['before']:.2g}), "
        rows.append(("polished", f"{said}{p['rollouts']} rollouts in {p['seconds']:.1f} s"))
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
