"""`gendom replay`: with which parameters a recording is simulated."""

import json

import numpy as np
import pytest

from gendom import cli
from gendom.estimation import UNKNOWNS, EstimateSettings, estimate
from gendom.estimation.replayed import replay_setup
from gendom.files import write_json
from gendom.materials.estimate_file import checksum
from gendom.reading import read_json
from viz.made_up import record_of

MATERIAL = [name for name, u in UNKNOWNS.items() if u.material]


@pytest.fixture(scope="module")
def lifted(rope_lift):
    return rope_lift.seen(frames=16, grip_height=0.004)


@pytest.fixture(scope="module")
def params(rope_lift, lifted):
    """The estimate from the first frames of a lift."""
    settings = EstimateSettings(starts=1, scene=rope_lift.settings)
    return estimate(lifted.head(12), settings).record


@pytest.fixture
def words(lifted, params, tmp_path, monkeypatch):
    """A command with files of both."""
    monkeypatch.chdir(tmp_path)
    lifted.write("lift.npz")
    write_json("estimate.json", params)
    return ["replay", "lift.npz", "--params", "estimate.json"]


def test_a_longer_recording_is_foretold(words, lifted, params, tmp_path, capsys):
    """Every frame is compared; those that were not fitted are as near as the others."""
    assert cli.main([*words, "--out", "replay.json", "--gif", "lift.gif", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record == read_json("replay.json")
    assert record["format"] == "gendom-replay/1"
    assert record["frame"] == list(range(16)) and len(record["chamfer_surface"]) == 16
    assert record["time"] == pytest.approx(lifted.time.tolist())
    assert record["notes"] == []
    assert max(record["chamfer"]) < 2.0 * params["chamfer_mean"]
    assert (tmp_path / "lift.gif").stat().st_size > 10_000
    assert cli.main(words) == 0
    assert capsys.readouterr().out.startswith("Chamfer distance: mean ")


def test_in_its_own_recording_all_of_an_estimate_is_taken(lifted, params):
    scene, theta = replay_setup(lifted, params, "here", "cpu")
    assert dict(theta) == params["theta"] and theta.grip_height > 0.002
    assert scene.recording is lifted and len(scene.frames) == 16
    assert scene.settings.points == 15 and scene.clock == params["simulation"]["clock"]
    # the estimate's engine is taken or another
    assert scene.thin
    scene, _ = replay_setup(lifted, params, "here", "cpu", "mpm")
    assert not scene.thin and scene.settings.points is None


def test_in_another_recording_the_material_is_taken(rope_lift, params):
    """How that one is held is found, and said; the height of the first grip is not carried over."""
    other = rope_lift.seen(seed=5, grip_height=-0.003)
    scene, theta = replay_setup(other, params, "here", "cpu")
    for name in MATERIAL:
        assert getattr(theta, name) == params["theta"][name], name
    assert theta.grip_height == pytest.approx(-0.003, abs=0.0015)
    assert "found anew in this recording: grip height, grip along, delay, grip turn" in scene.notes


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"verdict": {"usable": False, "reasons": ["it rests"]}}, "is not usable: it rests; "),
        ({"object": {"kind": "cloth"}}, "the recording: shows a rope, estimate.json a cloth; "),
        ({"object": {"length": 0.26}}, "the recording: length is 0.25, in estimate.json 0.26; "),
        ({"object": {"diameter": 0.02}}, "recording: diameter is 0.012, in estimate.json 0.02; "),
        ({"object": {"mass": None}}, "mass is 0.0282743, in estimate.json not stated; "),
        ({"recordings": []}, "is of no recording, or of an earlier version; run gendom estimate"),
        ({"posterior": None}, "posterior: expected"),
        ({"format": "other/1"}, "has format 'other/1', not 'gendom-estimate/1'"),
    ],
)
def test_what_cannot_be_replayed_is_refused(words, params, refused, changes, said):
    """One that is not usable unless it is insisted on."""
    changed = params | changes | {"object": params["object"] | changes.get("object", {})}
    write_json("estimate.json", changed | {"sha256": checksum(changed)})
    assert said in refused(*words)
    if "verdict" in changes:
        assert cli.main([*words, "--force"]) == 0


def test_a_cloth_lies_as_the_estimate_took_it_to_lie(cloth_lift):
    """Where it lies is guessed from the frames that were fitted, not from those that follow."""
    seen = cloth_lift.at_rest(8)
    aside = [x + np.array([0.0, 0.05 * (t > 4), 0.0]) for t, x in enumerate(seen.frames())]
    longer = cloth_lift.recording(aside)
    params = record_of(cloth_lift.truth, longer, 9, [0, 2, 4])
    scene, theta = replay_setup(longer, params, "here", "cpu")
    alone, _ = replay_setup(longer.head(5), params, "here", "cpu")
    assert dict(theta) == pytest.approx(dict(cloth_lift.truth))
    assert len(scene.frames) == 8
    np.testing.assert_allclose(scene.inwards, alone.inwards, atol=1e-9)
