"""`gendom record`: a lift, recorded by depth cameras."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from gendom.arguments import require
from gendom.cli.arguments import Seed
from gendom.cli.execute import described, move
from gendom.errors import ParameterError
from gendom.files import check_folder
from gendom.hardware.cell import Cell
from gendom.hardware.clocks import check_clocks
from gendom.materials import Item, size_of, thickness_of
from gendom.progress import bar
from gendom.reality import RealObject, TrialRun, find_object, lift, lift_cameras, record
from gendom.reality.trials import lift_path
from gendom.robot import LiftMotion, predefined_lift

SPAN = {"rope": "long", "cloth": "wide"}

MAX_RISE = 2.0
"""In lengths of a rope or sides of a cloth; more was not given in metres."""


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
    no_errors: bool = False
    """Cameras without noise, and a rig without errors: 2 mm and 0.3 degrees of calibration, 20 ms
    between the cameras (1 ms with --end swing or drop: those are joined by a cable)."""
    seed: Seed = 0

    def run(self) -> int:
        one = (self.reality is None) != (self.cell is None)
        require(one, "give either --reality or --cell", fix="see gendom record --help")
        return self._in_mujoco(str(self.reality)) if self.cell is None else self._in_cell(self.cell)

    def _in_cell(self, path: Path) -> int:
        check_folder(self.out)
        cell = Cell.read(path)
        known = known_in(cell, self.object)
        self._check_rise(known)
        lift_in(cell, known, self.out, motion=self._motion(known), grasp=self.grasp, yes=self.yes)
        print(f"written: {self.out}")
        print(f"next: gendom perceive {self.out} --out {self.out.name}.npz")
        return 0

    def _motion(self, item: Item) -> LiftMotion:
        """The lift that flags ask for."""
        if self.motion is not None:
            what, fix = "says how high and with which end", "leave out --rise and --end"
            require(self.rise is None and self.end is None, what, where="--motion", fix=fix)
            return LiftMotion.read(self.motion)
        usual = predefined_lift(item.kind, self.end or "hold")
        return usual if self.rise is None else replace(usual, rise=self.rise / size_of(item))

    def _in_mujoco(self, reality: str) -> int:
        rate, fix = self.frame_rate, "give 90 or less, above 0"
        require(0.0 < rate <= 90.0, f"is {rate}", where="--frame-rate", fix=fix)
        check_folder(self.out)
        item = find_object(reality)
        self._check_rise(item)
        trial_run = TrialRun(lift(item, self._motion(item)), cameras=lift_cameras(item))
        trial_run.step_to(trial_run.closes)
        seconds = trial_run.end - trial_run.closes
        notes = f"The predefined lift of {item.name}, seed {self.seed}."
        with trial_run.world, bar("recording", round(seconds, 1), "second") as show:
            record(
                trial_run, self.out, frame_rate=self.frame_rate, seed=self.seed,
                exact=self.no_errors, notes=notes, on_frame=lambda at: show(round(at, 1)),
            )  # fmt: skip
        r, g, b = item.colour
        print(f"written: {self.out}")
        print(f"next: gendom perceive {self.out} --colour {r} {g} {b} --out {item.name}.npz")
        return 0

    def _check_rise(self, item: Item) -> None:
        """Refuse a rise in another unit than metres."""
        size = size_of(item)
        if self.rise is None or 0.0 < self.rise <= MAX_RISE * size:
            return
        fix = "give metres above 0"
        if 0.0 < self.rise < math.inf:
            unit, metres = ("cm", 1e-2) if self.rise <= 100.0 * MAX_RISE * size else ("mm", 1e-3)
            fix = f"give metres: {self.rise:g} {unit} are {metres * self.rise:g}"
        what = f"is {self.rise:g} m, and the {item.kind} {size:g} m {SPAN[item.kind]}"
        raise ParameterError(what, where="--rise", fix=fix)


def known_in(cell: Cell, path: Path | None) -> RealObject:
    """An object as its TOML file describes it, or as the cell of a simulated robot names it; its
    stiffness is not looked at.

    Raises:
        GendomError: It is not described.
    """
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
    """Lift an object in a cell, and record it into a folder.

    ``grasp`` is where the fingers take it [m] (None: ahead, on the table); with ``yes`` nobody is
    asked, and it moves slowly; ``logs`` is a folder (None: ``executions`` beside the cell's file).

    Raises:
        GendomError: It is refused, or fails; also where a camera's clock is far off the robot's.
    """
    fix = "add two: a lift is seen by them"
    require(cell.camera, "has no camera", where=str(cell.path), fix=fix)
    path = lift_path(known, motion, grasp, cell.table_height or 0.0)
    planned = cell.plan(path, opening=thickness_of(known), hangs=size_of(known))
    about = described(cell, known, "a lift in a cell", quasi_static=motion.quasi_static)
    logs = logs or Path(cell.path or ".").parent / "executions"
    move(cell, planned, "lift", {"plan": planned}, logs, record=(out, about), yes=yes)
    for name, (offset, sd) in check_clocks(out, cell.model).items():
        print(f"clock      camera {name} {1e3 * offset:+.0f} +- {1e3 * sd:.0f} ms off the robot's")
