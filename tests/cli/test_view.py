"""`gendom view`: what is made of recordings and estimates, and its errors."""

import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gendom import cli
from gendom.datasets.lerobot import export_recording
from gendom.errors import GendomError
from gendom.estimation import LiftScene, SceneSettings, Theta, chamfers, replay
from gendom.estimation.replayed import find_recording, of_all_frames
from gendom.files import write_json
from gendom.reading import read_json
from gendom.viz.viewer import recording_model, unknown_object
from viz.made_up import record_of


def layers(scene):
    return {layer.name: layer for layer in scene.layers}


def sliders(model):
    return {s.unknown.name: s for s in model.sliders}


def shown(model: Any, **changes) -> list[Any]:
    """All scenes."""
    first = {name: slider.value for name, slider in sliders(model).items()}
    return list(model.simulate({**first, **changes}, lambda: None))


@pytest.fixture(scope="module")
def lifted(rope_lift):
    return rope_lift.seen(frames=12)


@pytest.fixture(scope="module")
def scene(rope_lift, lifted):
    return of_all_frames(LiftScene.of(lifted, rope_lift.settings), lifted)


# ---- recordings ----------------------------------------------------------------------------------


def test_a_recording_is_shown_beside_its_simulation(lifted, scene, rope_lift):
    body, truth = scene.body, rope_lift.truth
    lift_model = recording_model(scene, truth, "a lift")
    found = layers(lift_model.initial)
    assert list(found) == ["recorded", "gripper"] and lift_model.initial.table_height == 0.0
    np.testing.assert_array_equal(found["recorded"].points[3], lifted.frame(3))
    np.testing.assert_array_equal(lift_model.initial.times, lifted.time)
    before, after = shown(lift_model)
    x, rope = replay(scene, [truth])[:, 0], layers(before)["simulated"]
    assert {*body.surface(x)[5].ravel()} >= {*rope.points[5].ravel()}
    assert before.distance is None
    np.testing.assert_allclose(after.distance[1], chamfers(scene, x, truth)[0])
    assert dict(after.facts)["bending length"].endswith(" mm")
    # sliders change the motion
    soft = shown(lift_model, E_over_rho=20.0)[-1]
    heights = [layers(s)["simulated"].points[-1][:, 2].mean() for s in (after, soft)]
    assert heights[1] < heights[0] - 0.005
    assert soft.distance[1].mean() > 1.5 * after.distance[1].mean()


def test_unknown_objects_particles_and_cloths_are_shown(lifted, cloth_lift):
    """Particles as a chain, a cloth as a lattice."""
    scene, theta = unknown_object(lifted)
    middle = sliders(recording_model(scene, theta, ""))["E_over_rho"]
    assert middle.value == pytest.approx(np.sqrt(np.prod(middle.ends)))
    scene = LiftScene.of(lifted.head(2), SceneSettings(engine="mpm"))
    rope = layers(shown(recording_model(scene, Theta(E_over_rho=700.0), ""))[0])["simulated"]
    assert rope.kind == "dots" and len(rope.points) == 2
    scene = LiftScene.of(cloth_lift.at_rest(4), cloth_lift.settings)
    model = recording_model(scene, cloth_lift.truth, "")
    rows, columns = scene.body.shape
    assert len(layers(shown(model)[0])["simulated"].faces) == 2 * (rows - 1) * (columns - 1)
    assert "yaw" in sliders(model)


# ---- estimates -----------------------------------------------------------------------------------


@pytest.fixture
def params(rope_lift, lifted, tmp_path):
    """A recording, and in a folder beside it its estimate."""
    lifted.write(tmp_path / "lift.npz")
    record = record_of(rope_lift.truth, lifted, 15, [0, 11])
    write_json(tmp_path / "lift" / "estimate.json", record)
    return tmp_path / "lift" / "estimate.json"


def test_an_estimate_finds_its_recording(params, lifted, rope_lift, refused):
    """A file or folder; others are passed over, and cut or changed copies, too, but named."""
    lift, folder = params.parents[1] / "lift.npz", params.parent
    rope_lift.seen(frames=4, seed=9).write(folder / "another.npz")
    np.savez(folder / "other.npz", x=np.zeros(3))
    lifted.head(6).write(folder / "cut.npz")
    heavier = replace(lifted.object, mass=2.0 * (lifted.object.mass or 0.02))
    replace(lifted, object=heavier).write(folder / "heavier.npz")
    assert find_recording(read_json(params), params) == lift
    several = {"recordings": [{"digest": "of another"}, *read_json(params)["recordings"]]}
    assert find_recording(several, params) == lift
    export_recording(lifted, folder / "mine")
    lift.unlink()
    assert find_recording(read_json(params), params) == folder / "mine"
    shutil.rmtree(folder / "mine")
    with pytest.raises(GendomError, match=r"cut\.npz begins like it, but is cut or changed"):
        find_recording(read_json(params), params)
    (folder / "cut.npz").unlink()
    (folder / "heavier.npz").unlink()
    said = "neither beside it nor in the folder above; name it: gendom view RECORDING"
    assert said in refused("view", params)


# ---- the command ---------------------------------------------------------------------------------


def test_it_prints_its_address_and_ends_with_ctrl_c(params, tmp_path, capsys):
    """Or a page is written instead."""
    page = tmp_path / "lift.html"
    assert cli.main(["view", str(params), "--html", str(page)]) == 0
    assert capsys.readouterr().out == f"written: {page}\n" and page.stat().st_size > 30_000
    words = [sys.executable, "-m", "gendom", "view", str(params), "--port", "0"]
    pipes: dict = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process: Any = subprocess.Popen(words, cwd=Path(__file__).parent, **pipes)
    line = process.stdout.readline()
    assert re.fullmatch(r"lift.npz: http://127\.0\.0\.1:\d+/ \(Ctrl-C ends it\)\n", line), line
    process.send_signal(signal.SIGINT)
    # a first simulation, which may have to be compiled, ends before
    rest, said = process.communicate(timeout=180.0)
    assert (process.returncode, rest, said) == (0, "", "")
