"""`gendom record`: a lift, recorded by depth cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from gendom.arguments import require
from gendom.cli.arguments import settings_of
from gendom.errors import ParameterError
from gendom.files import check_folder
from gendom.materials import AIR_DENSITY
from gendom.progress import bar

MAX_RISE = 2.0
"""In lengths of a rope or sides of a cloth; more was not given in metres."""

MAX_ENCODER_NOISE = 0.1
"""Far more than any robot's [rad]."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """Record the predefined lift of an object in the MuJoCo test scene (the second reality).

    A robot arm lifts it under two depth cameras like a D435i, with their noise, their
    calibration's errors and a clock that is ahead. Writes what `gendom perceive` reads; the truth
    goes into DIR/truth, for evaluation only. See docs/reality.md.

    For example: gendom record --reality rope-cotton --out lift
    """

    reality: str
    """The object: rope-cotton, rope-polyester, rope-polyethylene, cloth-cotton, cloth-rubber..., or
    a TOML file that describes your own (docs/own-object.md)."""
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
    format: Literal["png", "db3"] = "png"
    """png: folders of pictures. db3: RealSense recordings; needs the extra camera."""
    seed: int = 0
    """Seed of all noise and errors."""

    def run(self) -> int:
        from gendom.reality import (
            RealRope,
            RecordSettings,
            RigErrors,
            TrialRun,
            find_object,
            lift,
            lift_cameras,
            lifted_by,
            record,
        )
        from gendom.robot import LiftMotion

        rate, noise = self.frame_rate, self.encoder_noise
        fix = "give 90 or less, above 0"
        require(0.0 < rate <= 90.0, f"is {rate}", where="--frame-rate", fix=fix)
        fix = f"give 0 to {MAX_ENCODER_NOISE:g}"
        if MAX_ENCODER_NOISE < noise < math.inf:
            fix += f": {noise:g} mrad are {1e-3 * noise:g}"
        what = f"is {noise:g} radians"
        require(0.0 <= noise <= MAX_ENCODER_NOISE, what, where="--encoder-noise", fix=fix)
        check_folder(self.out)
        item = find_object(self.reality)
        if isinstance(item, RealRope):
            self._check_rise(item.length, f"the rope {item.length:g} m long")
        else:
            self._check_rise(item.side, f"the cloth {item.side:g} m wide")
        if self.motion is None:
            trial = lift(item, rise=self.rise, end=self.end or "hold")
        else:
            what, fix = "says how high and with which end", "leave out --rise and --end"
            require(self.rise is None and self.end is None, what, where="--motion", fix=fix)
            trial = lifted_by(item, LiftMotion.read(self.motion))
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
                settings_of(RecordSettings, self, notes=notes, noisy=not self.no_noise),
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
