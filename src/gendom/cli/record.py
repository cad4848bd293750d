"""`gendom record`: a lift, recorded by depth cameras."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from gendom.errors import ParameterError
from gendom.files import check_folder
from gendom.progress import bar


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
    ms with --end swing or drop: those are joined by a cable)."""
    format: Literal["png", "db3"] = "png"
    """png: folders of pictures. db3: RealSense recordings; needs the extra camera."""
    seed: int = 0
    """Seed of all noise and errors."""

    def run(self) -> int:
        from gendom.reality import (
            DepthSensor,
            Performance,
            RecordSettings,
            RigErrors,
            find_object,
            lift,
            lift_cameras,
            lifted_by,
            record,
        )
        from gendom.robot import LiftMotion

        if not 0.0 < self.frame_rate <= 90.0:
            raise ParameterError(
                f"is {self.frame_rate}", where="--frame-rate", fix="give 90 or less, above 0"
            )
        check_folder(self.out)
        item = find_object(self.reality)
        if self.motion is None:
            trial = lift(item, rise=self.rise, end=self.end or "hold")
        elif self.rise is None and self.end is None:
            trial = lifted_by(item, LiftMotion.read(self.motion))
        else:
            raise ParameterError(
                "says how high and with which end",
                where="--motion",
                fix="leave out --rise and --end",
            )
        performance = Performance(trial, cameras=lift_cameras(item))
        performance.step_to(performance.closes)
        seconds = performance.end - performance.closes
        with performance.world, bar("recording", round(seconds, 1), "second") as show:
            record(
                performance,
                self.out,
                RecordSettings(
                    frame_rate=self.frame_rate,
                    seed=self.seed,
                    format=self.format,
                    notes=f"The predefined lift of {item.name}, seed {self.seed}.",
                ),
                sensor=DepthSensor.exact() if self.no_noise else DepthSensor(),
                errors=RigErrors.none() if self.no_errors else None,
                on_frame=lambda moment: show(round(moment, 1)),
            )
        r, g, b = item.colour
        print(f"written: {self.out}")
        print(f"next: gendom perceive {self.out} --colour {r} {g} {b} --out {item.name}.npz")
        return 0
