"""How a rope is held, how its mass lies along it, and how thick it is."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gendom.estimation import LiftScene, estimate, replay

USUAL = {"damping": 0.004, "friction": 0.4}


def off(found, truth):
    """Difference of ln(E / density)."""
    return math.log(found.theta.E_over_rho / truth.E_over_rho)


def width(found, name):
    """Logarithm of the upper over the lower end of an interval."""
    low, high = found.interval(name)
    return math.log(high / low)


def holds(found, name, value):
    low, high = found.interval(name)
    return low < value < high


def test_soft_fingers_do_not_make_a_rope_soft(rope_lift, settings):
    lifted, truth = rope_lift.seen(grip_turn=0.3, **USUAL), rope_lift.truth
    found = estimate(lifted, settings)
    low, high = found.posterior.interval("grip_turn", 0.95)
    assert low < 0.3 < high and found.theta.grip_turn > 0.1
    bends = LiftScene.of(lifted).bending_length(truth.E_over_rho)
    assert holds(found, "bending_length", bends)
    names = tuple(n for n in found.names if n not in ("grip_turn", "thickness"))
    hard = estimate(lifted, replace(settings, unknowns=names))
    assert off(hard, truth) < -0.05 < -2.0 * abs(off(found, truth))
    # a turn does not follow the moment just so: what it explains is less sure
    assert found.posterior.sd("E_over_rho") > hard.posterior.sd("E_over_rho")


@pytest.fixture(scope="module")
def high_lift(rope_lift):
    """A lift that takes the free end off the table."""
    return replace(rope_lift, rise=0.28)


def test_a_heavy_tip_is_found_and_named(high_lift, settings):
    lifted, truth = high_lift.seen(tip_mass=0.12, **USUAL), high_lift.truth
    found = estimate(lifted, settings)
    assert found.usable and holds(found, "tip_mass", 0.12)
    (said,) = [n for n in found.record["notes"] if "free end weighs" in n]
    assert f"weighs {found.theta.tip_mass:.0%} of the mass more" in said
    assert holds(found, "bending_length", LiftScene.of(lifted).bending_length(truth.E_over_rho))
    uniform = replace(settings, unknowns=tuple(n for n in found.names if n != "tip_mass"))
    wrong = estimate(lifted, uniform)
    assert abs(off(found, truth)) < 0.5 * abs(off(wrong, truth))
    assert not [n for n in wrong.record["notes"] if "free end" in n]


def test_E_is_known_as_the_diameter_is_and_the_bending_length_leads(high_lift, settings):
    """With its fourth power, where the mass is known. A uniform rope has no heavy tip."""
    plain = estimate(high_lift.seen(**USUAL), settings)
    sd = {name: width(plain, name) / 2.0 / 1.645 for name in ("E", "bending_length")}
    assert sd["E"] == pytest.approx(math.hypot(3.0 * sd["bending_length"], 4.0 * 0.05), 0.02)
    assert plain.rows()[0][0] == "bending length" and sd["bending_length"] < 0.02
    assert not [n for n in plain.record["notes"] if "free end" in n]


RATIO = 1.1
"""True over stated diameter."""


def test_a_thicker_object_moves_as_one_of_that_thickness(rope_lift):
    """Bending, height on the table and weight are those of the rope that has it."""
    described = replace(rope_lift.object, grasp_radius=0.01, grasp_inset=0.006)
    thin = replace(described, diameter=0.012 / RATIO)
    lifts = [rope_lift.at_rest(8, object=of) for of in (described, thin)]
    right, wrong = (LiftScene.of(lift, rope_lift.settings) for lift in lifts)
    theta = rope_lift.truth
    as_thick = theta.with_values({"thickness": RATIO})
    x, y = replay(right, [theta])[:, 0], replay(wrong, [as_thick, theta])
    assert np.abs(y[:, 0] - x).max() < 2e-4
    assert np.abs(y[:, 1] - x).max() > 2e-3
    assert wrong.density_of(as_thick) == pytest.approx(right.density)
    assert RATIO * wrong.body.thickness == pytest.approx(right.body.thickness)
    skins = right.body_of(theta).surface(x[0]), wrong.body_of(as_thick).surface(x[0])
    assert [np.ptp(skin[:, 1]) for skin in skins] == pytest.approx([0.012, 0.012], rel=0.01)


@pytest.mark.parametrize("along", [-0.004, 0.008])
def test_a_rope_turns_at_the_fingers(high_lift, along):
    """Wherever between points they end; a turn relieves the moment that it is stated by."""
    scene = LiftScene.of(high_lift.at_rest(8), replace(high_lift.settings, points=31))
    held = high_lift.truth.with_values({"grip_along": along})
    x = replay(scene, [held.with_values({"grip_turn": t}) for t in (0.0, 0.1, 0.3)])
    step = np.diff(x, axis=2)
    down = np.arctan2(-step[..., 2], np.linalg.norm(step[..., :2], axis=3))
    bent = np.diff(down, axis=2)
    turn = (bent - bent[:, :1]).max(axis=2)
    assert np.abs(turn[0]).max() < 1e-3
    assert 0.05 < turn[-1, 1] < 0.12
    assert 2.0 * turn[-1, 1] < turn[-1, 2] < 3.0 * turn[-1, 1]
