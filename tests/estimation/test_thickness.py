"""Objects that are not as thick as stated."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.estimation import EstimateSettings, LiftScene, NoiseModel, Problem, estimate, replay

RATIO = 1.1
"""True over stated diameter."""

UNKNOWNS = ("E_over_rho", "thickness", "grip_height", "grip_along", "delay")

EXACT = NoiseModel(sensor=1e-4, least_sensor=1e-5, shift=1e-5, turn=1e-5, skin=1e-6)
"""Of clouds without noise, of cameras without errors."""


def bending_stiffness(scene, theta):
    """E I of a rope's section [N m^2]."""
    h = theta.thickness * scene.body.thickness
    return theta.E_over_rho * scene.density_of(theta) * math.pi * h**4 / 64.0


def stated(recording, share=1.0, **changes):
    """With this share of its diameter, and where it is held."""
    diameter = share * recording.object.diameter
    held = {"grasp_radius": 0.01, "grasp_inset": 0.006}
    return replace(
        recording, object=replace(recording.object, diameter=diameter, **held, **changes)
    )


@pytest.fixture(scope="module")
def thin_stated(rope_lift):
    """Maker of lifts of a rope that is thicker than stated, by default by a tenth."""
    held = replace(rope_lift, object=stated(rope_lift.at_rest()).object)
    return lambda ratio=RATIO, **how: stated(held.seen(**how), 1.0 / ratio)


@pytest.fixture(scope="module")
def settings(rope_lift):
    return EstimateSettings(starts=1, unknowns=UNKNOWNS, scene=rope_lift.settings)


@pytest.mark.parametrize("weighed", [True, False])
def test_a_thicker_object_moves_as_one_of_that_thickness(rope_lift, weighed):
    """Bending, height on the table and weight are those of the rope that has it."""
    recording = rope_lift.at_rest(8)
    mass: dict[str, Any] = {} if weighed else {"mass": None}
    right = LiftScene.of(stated(recording, **mass), rope_lift.settings)
    wrong = LiftScene.of(stated(recording, 1.0 / RATIO, **mass), rope_lift.settings)
    theta = rope_lift.truth
    x = replay(right, [theta])[:, 0]
    y = replay(wrong, [theta.with_values({"thickness": RATIO}), theta])
    assert np.abs(y[:, 0] - x).max() < 2e-4
    assert np.abs(y[:, 1] - x).max() > 2e-3
    as_thick = theta.with_values({"thickness": RATIO})
    assert wrong.density_of(as_thick) == pytest.approx(right.density)
    EI = bending_stiffness(right, theta)
    assert bending_stiffness(wrong, as_thick) == pytest.approx(EI)
    skins = right.body_of(theta).surface(x[0]), wrong.body_of(as_thick).surface(x[0])
    assert [np.ptp(skin[:, 1]) for skin in skins] == pytest.approx([0.012, 0.012], rel=0.01)


def test_exact_clouds_bring_the_diameter_back(rope_lift, thin_stated, settings):
    """And with it E, which otherwise is a fifth too large."""
    exact = thin_stated(noise=0.0)
    found = estimate(exact, replace(settings, noise=EXACT))
    assert found.theta.thickness == pytest.approx(RATIO, rel=0.02)
    assert found.posterior.determined("thickness") and found.record["identifiable"]["thickness"]
    modulus = rope_lift.truth.E_over_rho
    assert found.theta.E_over_rho == pytest.approx(modulus, rel=0.06)
    record = found.record
    assert record["thickness"] == record["object"]["diameter"] == pytest.approx(0.012, rel=0.02)
    low, high = found.record["intervals"]["thickness"]
    assert low < record["thickness"] < high
    assert record["density"] == pytest.approx(1000.0, rel=0.05)
    assert record["E"] == pytest.approx(record["density"] * record["E_over_rho"])
    rigid = replace(settings, unknowns=tuple(n for n in UNKNOWNS if n != "thickness"))
    without = estimate(exact, rigid)
    assert without.theta.E_over_rho > 1.12 * modulus
    assert without.record["thickness"] == exact.object.diameter
    assert not without.record["identifiable"]["thickness"]


def test_where_clouds_cannot_tell_the_interval_says_so(rope_lift, thin_stated, settings):
    """Cameras and skins as they are hide a twentieth of a diameter: it stays the prior's, and E is
    known to no more than its fourth power; what bends, E I, is known better."""
    lifted = thin_stated(ratio=1.05)
    found = estimate(lifted, settings)
    assert found.usable, found.verdict.reasons
    assert not found.record["identifiable"]["thickness"]
    assert found.posterior.sd("thickness") > 0.85 * 0.05
    believed = replace(lifted, object=replace(lifted.object, diameter_sd=1e-6))
    without = estimate(
        believed, replace(settings, unknowns=tuple(n for n in UNKNOWNS if n != "thickness"))
    )

    def width(estimated, key):
        low, high = estimated.record["intervals"][key]
        return math.log(high / low)

    assert width(found, "E_over_rho") > 1.3 * width(without, "E_over_rho")
    assert width(found, "bending_stiffness") < 0.8 * width(found, "E_over_rho")
    truth = rope_lift.truth.E_over_rho * 1000.0 * math.pi * 0.012**4 / 64.0
    low, high = found.record["intervals"]["bending_stiffness"]
    assert low < truth < high
    low, high = found.record["intervals"]["E"]
    assert low < rope_lift.truth.E_over_rho * 1000.0 < high
    assert low < found.record["E"] < high
    # who believes the ruler is wrong, and sure of it
    assert without.record["intervals"]["E"][0] > rope_lift.truth.E_over_rho * 1000.0
    assert width(found, "E") > 1.3 * width(found, "E_over_rho")


def test_what_stiffness_makes_up_for_says_nothing_of_thickness(rope_lift):
    """A rope that is thicker, and as much softer, swings alike: what is left is how it lies."""
    scene = LiftScene.of(stated(rope_lift.at_rest(30, swing=0.1)), rope_lift.settings)
    names = ("E_over_rho", "thickness")
    problem = Problem([scene], EstimateSettings(unknowns=names))
    (compared,) = problem.compare([problem.prior.vector(rope_lift.truth)])
    assert compared is not None
    J = compared.parts[0].J
    fast = np.abs(J[..., 0]).max()
    assert np.abs(J[..., 1] - 2.0 * J[..., 0]).max() < 0.0065 < 0.05 * fast
    assert compared.parts[0].widens == pytest.approx([0.0, 0.006], rel=0.02)


def test_what_is_not_stated_may_be_anything(rope_lift):
    """A third to three times what is assumed."""
    seen = rope_lift.at_rest()
    unsaid = replace(seen, object=replace(seen.object, diameter=None))
    sd = [LiftScene.of(r).prior(("thickness",))[0].sd[0] for r in (seen, unsaid)]
    assert sd == [0.05, 0.8]
    assert "thickness" not in LiftScene.of(seen).prior()[0].names


def test_adam_compares_what_is_as_thick_as_stated(rope_lift, settings):
    with pytest.raises(ParameterError, match="compares objects as thick as stated"):
        estimate(rope_lift.seen(), replace(settings, method="adam"))
