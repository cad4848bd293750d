"""`gendom record`: a lift, recorded by depth cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from gendom.arguments import require
from gendom.cli.execute import FINGER_WIDTH, bring, described, move
from gendom.errors import ParameterError
from gendom.files import check_folder
from gendom.materials import AIR_DENSITY, Item, size_of, thickness_of
from gendom.progress import bar

if TYPE_CHECKING:
    from gendom.hardware.cell import Cell
    from gendom.reality import RealObject
    from gendom.robot import LiftMotion

MAX_RISE = 2.0
"""In lengths of a rope or sides of a cloth; more was not given in metres."""

AHEAD = 0.32
"""How far in front of the base an object's near end lies, unless --grasp says so [m]."""

LEAST_HEIGHT, WAIT = 0.002, 0.5
"""Of the tool point above the table [m], and pauses of the lift [s]."""

MAX_ENCODER_NOISE = 0.1
"""Far more than any robot's [rad]."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """Record the predefined lift of an object: with --cell in a cell, by its robot and cameras,
    with --reality in the MuJoCo test scene (the second reality).

    Writes what `gendom perceive` reads. In a cell it shows what will move and asks first
    (docs/hardware.md). In MuJoCo a robot arm lifts the object under two depth cameras like a D435i,
    with their noise, their calibration's errors and a clock that is ahead; the truth goes into
    DIR/truth, for evaluation only (docs/reality.md).

    For example: gendom record --reality rope-cotton --out lift
    """

    reality: str | None = None
    """The object: rope-cotton, rope-polyester, rope-polyethylene, cloth-cotton, cloth-rubber..., or
    a TOML file that describes your own (docs/own-object.md)."""
    cell: Path | None = None
    """In place of it cell.toml, see gendom cell."""
    object: Path | None = None
    """In a cell: TOML file with the object's kind, sizes and mass; its stiffness is not looked at.
    Of a simulated robot by default what the cell names."""
    grasp: tuple[float, float, float] | None = None
    """In a cell: where the fingers take the lying object in metres; by default 0.33 m ahead, on the
    table."""
    yes: bool = False
    """In a cell: do not ask, and move slowly."""
    out: Path
    """DIR to write; must not hold a recording."""
    rise: float | None = None
    """How high to lift in metres; by default 0.75 of a rope's length or a cloth's side."""
    end: Literal["hold", "swing", "drop"] | None = None
    """At the top: hold it still (the default), swing it by one quick move, or let it drop."""
    motion: Path | None = None
    """A motion.json of gendom plan-lift, in place of --rise and --end."""
    frame_rate: float = 30.0
    """Frames a second."""
    no_noise: bool = False
    """Cameras without noise."""
    no_errors: bool = False
    """A rig without its errors: 2 mm and 0.3 degrees of calibration, 20 ms between the cameras (1
    ms with --end swing or drop: those are joined by a cable), and the two below."""
    robot_clock: float = 0.0
    """Seconds by which the robot's clock is ahead of the first camera's, -0.1 to 0.1."""
    encoder_noise: float = 0.0
    """Noise of the robot's measured joint angles in radians."""
    grip_force: float = math.inf
    """Newtons that the fingers hold at most: pulled harder, the object slips."""
    air_density: float = AIR_DENSITY
    """Of the still air in kg/m^3; 0: none."""
    seed: int = 0
    """Seed of all noise and errors."""

    def run(self) -> int:
        one = (self.reality is None) != (self.cell is None)
        require(one, "give either --reality or --cell", fix="see gendom record --help")
        return self._in_mujoco(str(self.reality)) if self.cell is None else self._in_cell(self.cell)

    def _in_cell(self, path: Path) -> int:
        from gendom.hardware.cell import Cell

        check_folder(self.out)
        cell = Cell.read(path)
        known = known_in(cell, self.object)
        self._check_rise(size_of(known), f"the {known.kind} {size_of(known):g} m long")
        lift_in(cell, known, self.out, motion=self._motion(known), grasp=self.grasp, yes=self.yes)
        print(f"written: {self.out}")
        print(f"next: gendom perceive {self.out} --out {self.out.name}.npz")
        return 0

    def _motion(self, item: Item) -> LiftMotion:
        """The lift that flags ask for."""
        from gendom.robot import LiftMotion, predefined_lift

        if self.motion is not None:
            what, fix = "says how high and with which end", "leave out --rise and --end"
            require(self.rise is None and self.end is None, what, where="--motion", fix=fix)
            return LiftMotion.read(self.motion)
        usual = predefined_lift(item.kind, self.end or "hold")
        return usual if self.rise is None else replace(usual, rise=self.rise / size_of(item))

    def _in_mujoco(self, reality: str) -> int:
        from gendom.reality import (
            RealRope,
            RigErrors,
            TrialRun,
            find_object,
            lift,
            lift_cameras,
            record,
        )

        rate, noise = self.frame_rate, self.encoder_noise
        fix = "give 90 or less, above 0"
        require(0.0 < rate <= 90.0, f"is {rate}", where="--frame-rate", fix=fix)
        fix = f"give 0 to {MAX_ENCODER_NOISE:g}"
        if MAX_ENCODER_NOISE < noise < math.inf:
            fix += f": {noise:g} mrad are {1e-3 * noise:g}"
        what = f"is {noise:g} radians"
        require(0.0 <= noise <= MAX_ENCODER_NOISE, what, where="--encoder-noise", fix=fix)
        check_folder(self.out)
        item = find_object(reality)
        if isinstance(item, RealRope):
            self._check_rise(item.length, f"the rope {item.length:g} m long")
        else:
            self._check_rise(item.side, f"the cloth {item.side:g} m wide")
        trial = lift(item, self._motion(item))
        trial_run = TrialRun(
            trial,
            cameras=lift_cameras(item),
            air_density=self.air_density,
            grip_force=self.grip_force,
        )
        usual = RigErrors.synchronised() if trial.quick else RigErrors()
        errors = replace(usual, robot_clock=self.robot_clock, encoders=self.encoder_noise)
        trial_run.step_to(trial_run.closes)
        seconds = trial_run.end - trial_run.closes
        notes = f"The predefined lift of {item.name}, seed {self.seed}."
        with trial_run.world, bar("recording", round(seconds, 1), "second") as show:
            record(
                trial_run,
                self.out,
                frame_rate=self.frame_rate,
                seed=self.seed,
                noisy=not self.no_noise,
                notes=notes,
                errors=RigErrors.none() if self.no_errors else errors,
                on_frame=lambda moment: show(round(moment, 1)),
            )
        r, g, b = item.colour
        print(f"written: {self.out}")
        print(f"next: gendom perceive {self.out} --colour {r} {g} {b} --out {item.name}.npz")
        return 0

    def _check_rise(self, size: float, called: str) -> None:
        """Refuse a rise in another unit than metres.

        Args:
            size: The object's length or side [m].
            called: What it is, with that size.
        """
        if self.rise is None or 0.0 < self.rise <= MAX_RISE * size:
            return
        fix = "give metres above 0"
        if 0.0 < self.rise < math.inf:
            unit, metres = ("cm", 1e-2) if self.rise <= 100.0 * MAX_RISE * size else ("mm", 1e-3)
            fix = f"give metres: {self.rise:g} {unit} are {metres * self.rise:g}"
        raise ParameterError(f"is {self.rise:g} m, and {called}", where="--rise", fix=fix)


def known_in(cell: Cell, path: Path | None) -> RealObject:
    """An object as it is described; its stiffness is not looked at.

    Args:
        cell: Where it is; that of a simulated robot names one.
        path: Its TOML file.

    Raises:
        GendomError: It is not described.
    """
    from gendom.reality import find_object

    fix = "give its kind, sizes, mass and colour in a TOML file"
    described = path is not None or cell.simulated
    require(described, "is missing", where="--object", fix=fix)
    return find_object(cell.address if path is None else str(path))


def lift_in(
    cell: Cell,
    known: RealObject,
    out: Path,
    *,
    motion: LiftMotion,
    grasp: tuple[float, float, float] | None,
    yes: bool,
    logs: Path | None = None,
) -> None:
    """Lift an object in a cell, and record it.

    Args:
        cell: Where.
        known: The object as it is described.
        out: Folder for the recording.
        motion: How it is lifted.
        grasp: Where the fingers take it [m]; None: ahead, on the table.
        yes: Do not ask, and move slowly.
        logs: Folder of logs; None: ``executions`` beside the cell's file.
    """
    from gendom.hardware.execution import plan_record
    from gendom.robot import motions

    size, thick = size_of(known), thickness_of(known)
    table = cell.surroundings.table_height or 0.0
    usual = (AHEAD + 0.5 * FINGER_WIDTH, 0.0, table + max(0.5 * thick, LEAST_HEIGHT))
    require(motion.kind == known.kind, f"is for a {motion.kind}, the object is a {known.kind}",
            where="motion", fix=f"plan one with gendom plan-lift {known.kind}")  # fmt: skip
    path = motions.lift(
        grasp or usual, height=motion.rise * size, speed=motion.speed, wait=WAIT, end=motion.end,
        after=WAIT if motion.end == "hold" else None,
    )  # fmt: skip
    planned = cell.plan(path, opening=thick, hangs=size)
    slow = known.kind == "rope" and motion.end == "hold" and motion.speed <= motions.ROPE_LIFT_SPEED
    move(
        cell,
        planned,
        "lift",
        logs=logs or Path(cell.path or ".").parent / "executions",
        said={"plan": plan_record(planned)},
        bring=lambda robot: bring(robot, None, ask=not yes),
        record=(out, described(cell, known, "a lift in a cell", quasi_static=slow)),
        yes=yes,
    )
