"""`gendom execute`: carry out a planned action on a robot."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from gendom.arguments import require
from gendom.arrays import placed
from gendom.cli.outputs import check_places, write_picture
from gendom.errors import DeviceError, printable
from gendom.files import write_json
from gendom.hardware.cell import Cell, PlannedMotion
from gendom.hardware.contracts import Robot
from gendom.hardware.execution import (
    ExecutionLog,
    PlannedAction,
    careful,
    execute,
    last_time,
    preview,
    read_action,
    read_log,
)
from gendom.hardware.picture import draw_cell
from gendom.hardware.recording import record_motion
from gendom.hardware.simulated import SimulatedRobot
from gendom.materials import Item, from_columns
from gendom.reading import read_json, record_of
from gendom.reality import as_real, task_trial
from gendom.reality.objects import description
from gendom.reality.recording import object_file
from gendom.reality.world import FINGER_WIDTH
from gendom.robot import JointMotion, tcp_pose
from gendom.tasks import find_task

_log = logging.getLogger(__name__)

LIFTED = {"at", "log", "started", "plan"}
"""Keys of the first line of a lift's log."""

WORD = "move"
"""What a person types before the arm moves."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """Show what an action of `gendom act` would do in a cell; with --move do it.

    Nothing moves without --move. It prints times and distances, then asks for a typed word; with
    --yes it does not ask, and goes at a tenth of the arm's speeds at most. All states, commands and
    faults are written to a log as they happen, beside the cell's file (executions/). A log in place
    of the action shows what was measured, and with --move does the same again.

    For example: gendom execute action.json --cell cell.toml --picture action.png
    """

    action: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="ACTION")]
    """File of gendom act --cell CELL --out, or the log of an execution."""
    cell: Path
    """cell.toml, see gendom cell."""
    move: bool = False
    """Move, after a typed confirmation."""
    yes: bool = False
    """Do not ask, and move slowly."""
    picture: Path | None = None
    """PNG file: the cell, with the tool's path."""
    record: Path | None = None
    """Folder for what the cell's cameras see of it."""

    def run(self) -> int:
        check_places((self.picture, ".png"))
        fix = "add --move"
        require(self.move or not self.yes, "goes with --move", where="--yes", fix=fix)
        require(self.move or self.record is None, "goes with --move", where="--record", fix=fix)
        cell = Cell.read(self.cell)
        log = read_log(self.action) if self.action.suffix == ".jsonl" else None
        if log is not None and log.header.keys() == LIFTED:
            again, fix = not self.move, "lift again with gendom record --cell"
            require(again, "is the log of a lift", where=str(self.action), fix=fix)
            plan = log.header["plan"]
            action, plan = None, record_of(PlannedMotion, plan, where=str(self.action), fix=fix)
        else:
            action = read_action(self.action, cell.model)
            plan = action.plan
        if killed := last_time(self.cell.parent / "executions"):
            _log.warning("%s", killed)
        if log is not None:
            print(_measured(self.action))
        if self.picture is not None:
            write_picture(self.picture, self._drawn(cell, plan))
        if not self.move or action is None:
            print("\n".join(preview(plan, cell)))
            print("nothing moved: this was a dry run (--move)")
            return 0
        what, logs = "the execution of an action", self.cell.parent / "executions"
        record = self.record and (self.record, described(cell, held(action), what, action.task))
        move(cell, action, what, read_plan(self.action), logs, record=record, yes=self.yes)
        return 0

    def _drawn(self, cell: Cell, planned: PlannedMotion) -> Any:
        arm = cell.model
        moves = {"approach": planned.approach, "motion": planned.motion}
        paths = {name: m.at(m.sampled(50.0)) for name, m in moves.items()}
        if self.action.suffix == ".jsonl" and len(measured := read_log(self.action).measured):
            paths["measured"] = measured
        ends = [planned.approach.q[0], planned.motion.q[0], planned.motion.q[-1]]
        points = {name: tcp_pose(arm, q)[:, :3, 3] for name, q in paths.items()}
        return draw_cell(cell, np.array(ends), points)


def _measured(path: Path) -> str:
    """What a log tells, in some lines."""
    seen = read_log(path)
    lines = [f"{'log':<9} {seen.header.get('started')}, {len(seen.time)} ticks; "
             f"end: {printable(seen.end or 'none: it was killed')}"]  # fmt: skip
    if len(seen.time):
        off = np.abs(seen.command - seen.measured).max()
        lines.append(f"{'':<9} joints at most {np.degrees(off):.3f} degrees from the commanded, "
                     f"reports at most {1e3 * seen.age.max():.0f} ms old")  # fmt: skip
    lines += [f"{'':<9} fault in {e.get('call')}: {printable(e['fault'])}"
              for e in seen.events if "fault" in e]  # fmt: skip
    return "\n".join(lines)


def confirm(question: str) -> None:
    """Let a person type a word.

    Raises:
        DeviceError: Something else was typed, or nothing can be.
    """
    try:
        typed = input(f"{question} Type {WORD} to go on: ")
    except EOFError:
        typed = ""
    fix = "nothing moved"
    require(typed.strip() == WORD, "was not confirmed", fix=fix, error=DeviceError)


def read_plan(path: Path) -> dict[str, Any]:
    """All of an action's file, or of that in a log, for the log to hold."""
    own = ("log", "started", "at")
    said = read_log(path).header if path.suffix == ".jsonl" else read_json(path)
    return {key: value for key, value in said.items() if key not in own}


def held(action: PlannedAction) -> Item:
    """The object that an action is for."""
    return from_columns(find_task(action.task)().kind, action.object)


def move(
    cell: Cell,
    action: PlannedAction | PlannedMotion,
    what: str,
    said: Mapping[str, Any],
    logs: Path,
    *,
    record: tuple[Path, str] | None = None,
    yes: bool,
) -> None:
    """Show a motion, ask, and carry it out, logged, under the cell's cameras where asked for.

    Args:
        cell: Where.
        action: A task's, or the motion of a lift.
        what: What it is called.
        said: The action's file; the log begins with it, and pictures have it beside them as
            action.json, with the plan as it is carried out.
        logs: Folder of logs.
        record: Folder for pictures, and the content of its object.toml; None: none are taken.
        yes: Nobody is asked, and it moves slowly.
    """
    task = action if isinstance(action, PlannedAction) else None
    planned = action.plan if isinstance(action, PlannedAction) else action
    planned = careful(planned, cell) if yes else planned
    said = {**said, "plan": planned}
    print("\n".join([what, *preview(planned, cell)]))
    if not yes:
        confirm("Is the cell empty and the emergency stop at hand?")
    robot, cameras = cell.devices()
    name = datetime.now().strftime("%Y-%m-%dT%H-%M-%S-%f")
    log = ExecutionLog(logs / f"{name}.jsonl", said)

    def play(robot: Robot, motion: JointMotion) -> None:
        if record is None:
            return robot.play(motion)
        write_json(record[0] / "action.json", said)
        record_motion(robot, cameras, motion, record[0], description=record[1])

    cameras = cameras if record else []
    try:
        for camera in cameras:
            camera.connect()
        execute(planned, cell, robot, log, ready=lambda: bring(robot, task, ask=not yes), play=play)
    finally:
        for camera in cameras:
            camera.disconnect()


def described(
    cell: Cell, item: Item, source: str, task: str | None = None, *, quasi_static: bool = False
) -> str:
    """Content of object.toml for a recording in a cell.

    Args:
        cell: Its table and arm.
        item: The object, held by its end or corner.
        source: Of the recording, in words.
        task: What is done; None: a lift.
        quasi_static: Whether inertia plays no part.
    """
    about = {} if cell.table_height is None else {"table_height": cell.table_height}
    about |= {"gripper_source": "measured", "robot": cell.model.name}
    about |= {"quasi_static": quasi_static, "source": source}
    about |= {} if task is None else {"task": task}
    half = 0.5 * FINGER_WIDTH
    grasp = {"grasp": "end" if item.kind == "rope" else "corner"}
    grasp |= {"grasp_radius": half, "grasp_inset": half}
    return object_file(about, grasp | description(item))


def bring(robot: Any, action: PlannedAction | None, *, ask: bool) -> None:
    """Ask a person to bring the object; in simulation it is brought.

    Args:
        robot: At the motion's first pose, its fingers open.
        action: What will be done; None: a lift.
        ask: Whether a person is there; else the object is.
    """
    simulated = isinstance(robot, SimulatedRobot)
    if not simulated and not ask:
        return
    if action is None:
        if simulated:
            return robot.arrange()
        return confirm("Lay the object down, its end between the fingers, and step back.")
    task, item = find_task(action.task)(), held(action)
    if simulated:
        real = robot.item if task.kind == robot.item.kind else as_real(item)
        return robot.arrange(task_trial(task, real, list(action.action.values())))
    scene = task.scene(item)
    at = ", ".join(f"{x:.3f}" for x in placed(action.trajectory.T_base_task, scene.origin))
    hung = f"Fix the object's first end in the stand at ({at}) m. " if scene.stand else ""
    confirm(f"{hung}Put what is to be held between the fingers: they close when you have typed.")
