"""Lifts that are compared before any is recorded."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from gendom.cli import main
from gendom.cli.plan_lift import plan_text
from gendom.errors import RobotError
from gendom.estimation import EstimateSettings, SceneSettings, estimate, lift_plan
from gendom.estimation.lift_plan import (
    SHOWN,
    LiftPlan,
    LiftPlanSettings,
    MotionForecast,
    ObjectClass,
    plan_lift,
    rolls,
)
from gendom.reality import as_real, lift
from gendom.robot import XARM7, LiftMotion, follow, predefined_lift

ROPES = ObjectClass(kind="rope", size=(0.25, 0.25), thickness=(0.012, 0.012))
FIXED = ["rope", "--length", "0.25", "--diameter", "0.012"]


@pytest.mark.slow
def test_what_is_expected_is_what_the_estimator_reports(monkeypatch):
    """In the median of five objects of known diameter: steps along a curved valley differ."""
    clouds, imagined, ratios = [], lift_plan.imagined, []
    monkeypatch.setattr(lift_plan, "imagined", lambda *a: clouds.extend(imagined(*a)) or clouds)
    trial = lift(as_real(ROPES.at(0.5)), LiftMotion(kind="rope", rise=1.0, speed=0.1, end="swing"))
    lying = lift_plan.recorded_lift(trial, follow(XARM7, trial.path), 30.0)
    for seed in range(3, 8):
        clouds.clear()
        _, sd = lift_plan.forecast(lying, None, [seed])
        measured = replace(clouds[0], object=replace(clouds[0].object, diameter_sd=1e-5))
        found = estimate(measured, EstimateSettings(starts=1, scene=SceneSettings(threads=1)))
        assert found.usable
        ratios.append([found.posterior.sd(unknown) / sd[name] for name, unknown in SHOWN.items()])
    np.testing.assert_allclose(np.median(ratios, axis=0), 1.0, rtol=0.25)


def predicted(end, *sds):
    return MotionForecast(
        motion=predefined_lift("rope", end), sd=tuple({name: s for name in SHOWN} for s in sds)
    )


def planned(*rows, **changes):
    return LiftPlan(
        objects=ROPES,
        settings=LiftPlanSettings(draws=len(rows[0].sd), **changes),
        prior_sd=dict.fromkeys(SHOWN, 1.0),
        rows=rows,
    )


def test_a_motion_that_the_arm_refuses_tells_nothing():
    """One that halves deviations of all objects is better than one that cuts those of half of them
    to a third; it is as if nothing had been seen of the others."""
    plain = predicted("hold", 1.0, 1.0)
    half, third = predicted("swing", 0.5, 0.5), predicted("drop", 1 / 3)
    plan = planned(plain, half, third)
    assert plan.chosen is half
    assert plan.gain(half) == pytest.approx(2.0) and plan.gain(third) == pytest.approx(3**0.5)
    assert third.half_width("E", 0.9) == pytest.approx(1.645 / 3.0, rel=1e-3)
    _, _, of_half, of_third, _, best = plan_text(plan).splitlines()
    percent = f"{100.0 * math.expm1(1.645 / 2.0):.3g}"
    assert of_half.split()[-7:] == [percent, percent, "0.822", "2", "of", "2", "2.00"]
    assert of_third.split()[-5:] == ["1", "of", "2", "1.73", "*"]
    assert "swing, 1 lengths" in best and "by a factor of 2.00" in best


def test_where_ropes_roll_no_motion_is_chosen_unless_asked_for():
    """A drop tells most, and wrongly; a swing with its tail on the table alike."""
    rows = predicted("hold", 1.0), predicted("swing", 0.5), predicted("drop", 0.1)
    low = replace(rows[1], motion=replace(rows[1].motion, rise=0.75), sd=rows[2].sd)
    cloth = replace(rows[2].motion, kind="cloth")
    assert not any(map(rolls, (rows[0].motion, rows[1].motion, cloth)))
    assert rolls(rows[2].motion) and rolls(low.motion)
    assert planned(*rows, low).chosen is rows[1]
    assert planned(*rows, low, ends=("drop",)).chosen is rows[2]


@pytest.mark.slow
def test_nothing_that_the_arm_can_do():
    long = replace(ROPES, size=(1.5, 1.5), thickness=(0.05, 0.05))
    with pytest.raises(RobotError, match="no object can be lifted by any of 2 motions: "):
        plan_lift(long, LiftPlanSettings(ends=("hold",), rises=(1.0,), speeds=(0.1,), draws=1))


# ---- the commands --------------------------------------------------------------------------------


def test_the_command_writes_what_record_reads(tmp_path, capsys):
    out = tmp_path / "plan"
    words = ["--ends", "drop", "--rises", "0.4", "--speeds", "0.1", "--draws", "1"]
    assert main(["plan-lift", *FIXED, *words, "--for", "damping", "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "drop, 0.4 lengths at 0.1 m/s" in told and "best for damping" in told
    plan = json.loads((out / "plan.json").read_text())
    chosen = plan["rows"][plan["chosen"]]
    hold, only = (row["sd"][0]["damping"] for row in plan["rows"])
    assert chosen["gain"] == pytest.approx(hold / only) and f"{chosen['gain']:.2f}" in told
    assert vars(LiftMotion.read(out / "motion.json")) == chosen["lift"]
    path = json.loads((out / "motion.json").read_text())["trajectory"]
    rise = chosen["lift"]["rise"] * 0.25
    assert path["position"][-1][2] - path["position"][0][2] == pytest.approx(rise)
    header, *rows = (out / "joints.csv").read_text().splitlines()
    assert header.startswith("time,q0") and header.endswith("gripper") and len(rows) > 100
