"""What is believed before a recording is seen."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import ParameterError, RecordingError
from gendom.estimation import LiftScene
from gendom.materials import catalogue


def test_a_material_narrows_what_is_believed(rope_lift):
    def of(material, *wanted):
        settings = replace(rope_lift.settings, material=material)
        return LiftScene.of(rope_lift.at_rest(), settings).prior(wanted)

    known, (wide, _), (narrow, base) = catalogue.get("cotton-rope"), of(None), of("cotton-rope")
    assert narrow.names == wide.names
    assert (narrow.low == wide.low).all() and (narrow.high == wide.high).all()
    sd, mean = (dict(zip(narrow.names, x, strict=True)) for x in (narrow.sd, narrow.mean))
    assert mean["E_over_rho"] == pytest.approx(math.log(known.E.typical / known.density.typical))
    spread = math.hypot(math.log(20.0), math.log(1000.0 / 650.0))
    assert sd["E_over_rho"] == pytest.approx(spread / 2.0 / 1.645, rel=1e-3)
    for name in ("nu", "friction"):
        expected = getattr(known, name)
        assert mean[name] == expected.typical
        assert sd[name] == pytest.approx((expected.high - expected.low) / 3.29, rel=1e-3)
    assert sd["grip_height"] == wide.sd[wide.names.index("grip_height")]
    assert base.damping == pytest.approx(known.damping.typical)
    prior, base = of("rubber-cord", "delay")
    assert prior.names == ("delay",)
    assert base.friction == catalogue.get("rubber-cord").friction.typical
    assert base.nu == 0.45  # the stiffest that is looked for


def test_its_density_stands_for_an_unknown_mass(rope_lift):
    light = replace(rope_lift.object, mass=None)
    settings = replace(rope_lift.settings, material="cotton-rope")
    scene = LiftScene.of(rope_lift.at_rest(object=light), settings)
    assert scene.density == 800.0
    assert any("a density of cotton-rope of 800 kg/m^3 assumed" in note for note in scene.notes)
    stated = LiftScene.of(rope_lift.at_rest(), settings)
    assert stated.density != 800.0
    assert any(note.startswith("material cotton-rope: E of 2e+05") for note in stated.notes)


@pytest.mark.parametrize(
    ("material", "said"),
    [
        ("denim", "denim is a cloth, and a rope was recorded"),
        ("network-cable", "made of network-cable, would be a stick"),
    ],
)
def test_a_material_that_cannot_be(rope_lift, material, said):
    tiny = replace(rope_lift.object, length=0.05) if "stick" in said else rope_lift.object
    scene = LiftScene.of(rope_lift.at_rest(), replace(rope_lift.settings, material=material))
    scene = replace(scene, recording=replace(scene.recording, object=tiny))
    with pytest.raises(ParameterError, match=said):
        scene.prior()


def test_what_is_stated_of_a_held_corner_narrows_what_is_believed(cloth_lift):
    """How far inside the corner it is held, and the axis as which it turns."""
    inside = replace(cloth_lift.object, grasp_inset=0.01)
    axes = np.tile([1.0, 0.0, 0.0], (3, 1))
    stated = cloth_lift.at_rest(object=inside, gripper_axis=axes)
    found = []
    for recording in (stated, cloth_lift.at_rest()):
        scene = LiftScene.of(recording, cloth_lift.settings)
        prior, _ = scene.prior()
        named = dict(zip(prior.names, zip(prior.mean, prior.sd, strict=True), strict=True))
        found.append((named["grip_along"][1], *named["grip_tilt"], len(scene.guesses)))
    assert found[0] == (0.002, 0.0, 0.1, 1)
    assert found[1] == (0.01, 0.8, 0.6, 3)


def test_the_delay_of_slow_frames_is_less_sure(rope_lift):
    """Of a quasi-static recording the times may be those of the nearest frame."""
    seen = rope_lift.at_rest(quasi_static=True)
    slow = replace(seen, time=100.0 * seen.time)
    sd = [float(LiftScene.of(r).prior(("delay",))[0].sd[0]) for r in (seen, slow)]
    assert sd[1] == pytest.approx(np.median(np.diff(slow.time)) / np.sqrt(12.0))
    assert sd[0] < 0.02 * sd[1]


@pytest.mark.parametrize(
    ("stated", "share"),
    [
        ({}, 0.05),
        ({"diameter_sd": 1e-4}, 1 / 120),
        ({"diameter_sd": 2.4e-3}, 0.2),
        ({"diameter": None}, 0.8),
    ],
)
def test_a_diameter_is_as_sure_as_is_stated(rope_lift, stated, share):
    """One that is not stated may be a third to three times what is assumed; none is exact."""
    described = replace(rope_lift.object, **stated)
    lifted = replace(rope_lift.at_rest(), object=described)
    assert LiftScene.of(lifted).prior(("thickness",))[0].sd == pytest.approx([share])
    assert "thickness" not in LiftScene.of(lifted).prior()[0].names
    wrong = replace(lifted, object=replace(described, diameter=0.01, diameter_sd=0.0))
    with pytest.raises(RecordingError, match=r"object.diameter_sd: is 0.0; give metres above 0"):
        wrong.require_valid("lift", on_warning=print)
