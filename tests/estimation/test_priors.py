"""What is believed beforehand of an object whose material is stated."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.estimation import EstimateSettings, LiftScene, SceneSettings, estimate
from gendom.materials import catalogue


def test_a_material_narrows_what_is_believed(rope_lift):
    known = catalogue.get("cotton-rope")
    wide, _ = LiftScene.of(rope_lift.at_rest(), rope_lift.settings).prior()
    settings = replace(rope_lift.settings, material="cotton-rope")
    narrow, base = LiftScene.of(rope_lift.at_rest(), settings).prior()
    assert narrow.names == wide.names
    np.testing.assert_array_equal(narrow.low, wide.low)
    np.testing.assert_array_equal(narrow.high, wide.high)
    k = narrow.names.index("E_over_rho")
    assert narrow.mean[k] == pytest.approx(math.log(known.E.typical / known.density.typical))
    spread = math.hypot(math.log(20.0), math.log(1000.0 / 650.0))
    assert narrow.sd[k] == pytest.approx(spread / 2.0 / 1.645, rel=1e-3)
    for name in ("nu", "friction"):
        k, expected = narrow.names.index(name), getattr(known, name)
        assert narrow.mean[k] == expected.typical
        assert narrow.sd[k] == pytest.approx((expected.high - expected.low) / 3.29, rel=1e-3)
    k = narrow.names.index("grip_height")
    assert narrow.sd[k] == wide.sd[k]
    assert base.damping == pytest.approx(known.damping.typical)


def test_what_is_not_looked_for_is_typical(rope_lift):
    settings = replace(rope_lift.settings, material="rubber-cord")
    prior, base = LiftScene.of(rope_lift.at_rest(), settings).prior(("delay",))
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


def test_an_unknown_material():
    with pytest.raises(ParameterError, match="no material 'denin'; did you mean 'denim'"):
        SceneSettings(material="denin")


def test_the_record_tells_of_it(rope_lift):
    seen = rope_lift.seen(frames=5, points=60)
    settings = replace(rope_lift.settings, material="cotton-rope")
    fewer = EstimateSettings(starts=1, max_iterations=2, scene=settings)
    record = estimate(seen, fewer).record
    assert record["simulation"]["material"] == "cotton-rope"
    k = record["posterior"]["names"].index("E_over_rho")
    assert record["posterior"]["prior_mean"][k] == pytest.approx(math.log(1e6 / 800.0))
    assert record["notes"][0].startswith("material cotton-rope")


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
