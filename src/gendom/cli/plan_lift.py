"""`gendom plan-lift`: which lift shows an object's parameters best."""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gendom.arguments import require
from gendom.cli.arguments import Json, refuse_sizes
from gendom.cli.outputs import check_places, columns, tell_written, write_result
from gendom.cli.parsing import NotFlags
from gendom.estimation.lift_plan import LiftPlan, LiftPlanSettings, ObjectClass, plan_lift, rolls
from gendom.files import to_json
from gendom.materials import KINDS, thickness_of, to_columns
from gendom.progress import bar
from gendom.reality import arm_motion, as_real, lift, lift_cameras
from gendom.robot import MOTION_FORMAT

OPEN = 0.08
"""Of the gripper, as joints.csv states it where it holds nothing [m]."""

ROLLS = (
    "* the rope moves fast on the table, where a round one rolls and the simulator's slides: "
    "expect wrong values in narrow intervals; not chosen where there is another"
)


@dataclass(frozen=True, kw_only=True)
class Command:
    """Compare predefined lifts by the intervals that an estimate is expected to report after them.

    Objects are drawn from the priors of gendom estimate for a rope or cloth; each lift of
    each is simulated, as the arm carries it out and noisy cameras show it. Nothing is recorded.
    --out gets plan.json, the best motion as motion.json for gendom record --motion, and joints.csv.

    For example: gendom plan-lift rope --length 0.3 --diameter 0.016 --for damping --out plan
    """

    kind: tyro.conf.Positional[Literal["rope", "cloth"]]
    """What is lifted."""
    length: tuple[float, ...] = ()
    """Of a rope in metres: one number, or from and to."""
    diameter: tuple[float, ...] = ()
    """Of a rope in metres."""
    side: tuple[float, ...] = ()
    """Of a cloth in metres."""
    thickness: tuple[float, ...] = ()
    """Of a cloth in metres."""
    mass: tuple[float, ...] = ()
    """In kg; by default that of 1,000 kg/m^3, or of the material."""
    material: str | None = None
    """Its material, by a name of gendom materials: narrows the priors."""
    for_: Annotated[Literal["E", "damping", "friction", "all"], tyro.conf.arg(name="for")] = "all"
    """What the motion is chosen for."""
    settings: Annotated[LiftPlanSettings, NotFlags("aim")] = field(default_factory=LiftPlanSettings)
    out: Path | None = None
    """Folder for plan.json, motion.json and joints.csv."""
    json: Json = False

    def run(self) -> int:
        check_places((self.out, ""))
        objects = self._objects()
        settings = replace(self.settings, aim=self.for_)
        with bar("planning", 1, "lift", even=True) as show:
            plan = plan_lift(objects, settings, on_done=show)
        print(to_json(plan.to_dict()) if self.json else plan_text(plan))
        if self.out is not None:
            self._write(plan, self.out)
        return 0

    def _objects(self) -> ObjectClass:
        large, small = KINDS[self.kind].sizes
        refuse_sizes(self.kind, [name for name, given in vars(self).items() if given])
        size, thickness, mass = (self._range(name) for name in (large, small, "mass"))
        missing = [n for n, ends in ((large, size), (small, thickness)) if ends is None]
        fix = f"give {' and '.join(f'--{name}' for name in missing)} in metres"
        require(not missing, f"lacks the {self.kind}'s {' and '.join(missing)}", fix=fix)
        assert size is not None and thickness is not None
        return ObjectClass(
            kind=self.kind, size=size, thickness=thickness, mass=mass, material=self.material
        )

    def _range(self, name: str) -> tuple[float, float] | None:
        given = getattr(self, name)
        what, fix = f"has {len(given)} numbers", "give one, or from and to"
        require(len(given) <= 2, what, where=f"--{name}", fix=fix)
        return (given[0], given[-1]) if given else None

    def _write(self, plan: LiftPlan, folder: Path) -> None:
        write_result(folder / "plan.json", plan.to_dict(), json=self.json)
        middle = plan.objects.at(0.5)
        item = as_real(middle)
        trial = lift(item, plan.chosen.motion)
        about = {"object": {name: to_columns(middle)[name] for name in item.sizes}}
        about |= {"trajectory": trial.path.to_dict()}
        motion = {"format": MOTION_FORMAT, "lift": plan.chosen.motion, **about}
        write_result(folder / "motion.json", motion, json=self.json)
        arm = arm_motion(trial, lift_cameras(item))
        arm.write_joints(folder / "joints.csv", opening=(thickness_of(item), OPEN))
        tell_written(folder / "joints.csv", json=self.json)


def plan_text(plan: LiftPlan) -> str:
    """A plan for people."""
    level, drawn, rows = plan.settings.level, plan.settings.draws, []
    for row in plan.rows:
        half = {name: row.half_width(name, level) for name in plan.prior_sd}
        widths = [f"{100.0 * math.expm1(half[n]):.3g}" if math.isfinite(half[n]) else ""
                  for n in ("E", "damping")]  # fmt: skip
        friction = f"{half['friction']:.3f}" if math.isfinite(half["friction"]) else ""
        carried, gain = f"{len(row.sd)} of {drawn}", f"{plan.gain(row):.2f}"
        star = "*" if rolls(row.motion) else ""
        rows.append((str(row.motion), *widths, friction, carried, gain, star))
    head = ("E [%]", "damping [%]", "friction", "carried out", "gain", "")
    lines = [columns((f"Half width of {100.0 * level:g} % intervals", *head), rows)]
    lines += [ROLLS] * any(rolls(row.motion) for row in plan.rows)
    for fault in dict.fromkeys(fault for row in plan.rows for fault in row.faults):
        count = sum(fault in row.faults for row in plan.rows)
        lines.append(f"{count} of {len(plan.rows)} motions: {fault}")
    best, aims = plan.chosen, " and ".join(plan.settings.aims)
    gain, said = f"{plan.gain(best):.2f}", "whose intervals are narrower than the plain hold's by a"
    better = f"best for {aims}: {best.motion}, {said} factor of {gain} (geometric mean)"
    none = f"for {aims} none of these motions shows more than the plain hold"
    return "\n".join([*lines, better if float(gain) > 1.0 else none])
