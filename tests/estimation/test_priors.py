"""What is believed before a recording is seen."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import ParameterError, RecordingError
from gendom.estimation import LiftScene
from gendom.materials import catalogue


def believed(lift, material=None, wanted=(), **changes):
    """A scene, its prior by name (mean and deviation), and what else it takes for known."""
    settings = replace(lift.settings, material=material)
    scene = LiftScene.of(lift.at_rest(**changes), settings)
    prior, base = scene.prior(wanted)
    return scene, dict(zip(prior.names, zip(prior.mean, prior.sd, strict=True), strict=True)), base


def test_a_material_narrows_what_is_believed(rope_lift):
    known, (_, wide, _) = catalogue.get("cotton-rope"), believed(rope_lift)
    scene, narrow, base = believed(rope_lift, "cotton-rope")
    assert narrow.keys() == wide.keys()
    mean, sd = narrow["E_over_rho"]
    assert mean == pytest.approx(math.log(known.E.typical / known.density.typical))
    spread = math.hypot(math.log(20.0), math.log(1000.0 / 650.0))
    assert sd == pytest.approx(spread / 2.0 / 1.645, rel=1e-3)
    for name in ("nu", "friction"):
        expected = getattr(known, name)
        sd = (expected.high - expected.low) / 3.29
        assert narrow[name] == pytest.approx((expected.typical, sd), rel=1e-3)
    assert narrow["grip_height"] == wide["grip_height"]
    assert base.damping == pytest.approx(known.damping.typical)
    assert any(note.startswith("material cotton-rope: E of 2e+05") for note in scene.notes)
    _, only, base = believed(rope_lift, "rubber-cord", ("delay",))
    assert list(only) == ["delay"]
    assert base.friction == catalogue.get("rubber-cord").friction.typical
    assert base.nu == 0.45  # the stiffest that is looked for


@pytest.mark.parametrize(
    ("material", "mass", "density", "said"),
    [
        (None, None, 1000.0, "mass not stated: a density of 1000 kg/m^3 assumed"),
        ("cotton-rope", None, 800.0, "a density of cotton-rope of 800 kg/m^3 assumed"),
        ("cotton-rope", 0.1, 0.1 / (math.pi / 4 * 0.012**2 * 0.25), None),
    ],
)
def test_a_density_is_assumed_where_no_mass_is_stated(rope_lift, material, mass, density, said):
    """And said to be."""
    described = replace(rope_lift.object, mass=mass)
    scene, _, _ = believed(rope_lift, material, object=described)
    assert scene.density == pytest.approx(density)
    notes = [note for note in scene.notes if "mass not stated" in note]
    assert len(notes) == (said is not None) and all(said in note for note in notes)


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


@pytest.mark.parametrize(
    ("stated", "inset", "tilt", "guesses"),
    [(True, 0.002, (0.0, 0.1), 1), (False, 0.01, (0.8, 0.6), 3)],
)
def test_what_a_recording_states_of_a_corner_is_believed(cloth_lift, stated, inset, tilt, guesses):
    told = {}
    if stated:
        told["object"] = replace(cloth_lift.object, grasp_inset=0.01)
        told["gripper_axis"] = np.tile([1.0, 0.0, 0.0], (3, 1))
    scene, own, _ = believed(cloth_lift, **told)
    assert (own["grip_along"][1], own["grip_tilt"]) == (inset, tilt)
    assert len(scene.guesses) == guesses


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
    scene, usual, _ = believed(rope_lift, object=described)
    assert scene.prior(("thickness",))[0].sd == pytest.approx([share])
    assert "thickness" not in usual
    wrong = replace(scene.recording, object=replace(described, diameter=0.01, diameter_sd=0.0))
    with pytest.raises(RecordingError, match=r"object.diameter_sd: is 0.0; give metres above 0"):
        wrong.require_valid("lift", on_warning=print)
