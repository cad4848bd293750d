"""Twins for other simulators: written by the command, run as their users run them."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from gendom import cli
from gendom.errors import GendomError
from gendom.materials import catalogue
from gendom.materials.estimate import Estimate
from gendom.reality import OBJECTS
from gendom.twins import write_twin
from gendom.twins.lift import Lift

COTTON = ["cotton-rope", "--length", "0.3"]
CLOTH = ["denim", "--side", "0.2"]


def written(tmp_path, *words):
    assert cli.main(["twin", *words, "--out", str(tmp_path / "twin")]) == 0
    return tmp_path / "twin"


def lifted(folder):
    """Mean distance from our simulator over the lift, and in the worst frame [mm]."""
    done = subprocess.run(
        [sys.executable, str(folder / "lift.py")], capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr
    found = re.search(r"mean distance ([\d.]+) mm, worst frame's ([\d.]+)", done.stdout)
    assert found, done.stdout
    return float(found[1]), float(found[2])


@pytest.fixture
def estimate(tmp_path):
    """Function (an object of the second reality) -> its estimate's file."""

    def saved(item, doubt=0.1):
        found = Estimate.of(item).with_uncertain("E_over_rho", doubt)
        found.save(tmp_path / "estimate.json")
        return str(tmp_path / "estimate.json")

    return saved


def test_a_rope_lifted_in_mujoco_moves_as_ours(tmp_path, estimate):
    pytest.importorskip("mujoco")
    short = replace(OBJECTS["rope-polyester"], length=0.1)
    folder = written(tmp_path, estimate(short), "--to", "mjcf")
    mean, worst = lifted(folder)
    assert mean < 2.0 and worst < 6.0
    about = json.loads((folder / "twin.json").read_text())
    assert about["object"]["E"] == pytest.approx(short.material.E)
    assert np.load(folder / "positions.npy").shape == np.load(folder / "lift.npz")["gendom"].shape


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cloth-cotton", "cloth-rubber"])
def test_a_cloth_lifted_in_mujoco_moves_as_ours(tmp_path, estimate, name):
    pytest.importorskip("mujoco")
    folder = written(tmp_path, estimate(OBJECTS[name]), "--to", "mjcf")
    assert lifted(folder)[0] < 4.0


def test_usd_holds_the_lift_and_the_parameters(tmp_path):
    folder = written(tmp_path, *COTTON, "--to", "usd")
    text = (folder / "object.usda").read_text()
    assert f"custom double gendom:E = {catalogue.get('cotton-rope').E.typical!r} " in text
    frames = re.findall(r"^ +(\d+): \[(.*)\],$", text, re.MULTILINE)
    assert [int(k) for k, _ in frames] == list(range(len(frames))) and len(frames) > 15
    first, last = (max(map(float, re.findall(r", (-?[\d.]+)\)", frames[k][1]))) for k in (0, -1))
    assert first < 0.02 < 0.1 < last


@pytest.fixture
def still(monkeypatch):
    """Our simulator's lift is not simulated."""
    at_rest = lambda lift: np.repeat(lift.body.points[None], len(lift.frames), axis=0)  # noqa: E731
    monkeypatch.setattr(Lift, "simulated", at_rest)


def scripted(tmp_path, words, target):
    """The twin's arrays; its script compiles and reads nothing else."""
    folder = written(tmp_path, *words, "--to", target)
    arrays, script = dict(np.load(folder / "lift.npz")), (folder / "lift.py").read_text()
    compile(script, "lift.py", "exec")
    sheet = {"held", "triangles", "mass_per_area", "mu", "lam", "side_hinge", "spacing",
             "diagonal_hinge", "stretch_compliance", "bending_compliance"}  # fmt: skip
    read = set(re.findall(r'about\["(\w+)"', script))
    assert read - (sheet if arrays["kind"] == "rope" else set()) <= set(arrays)
    return folder, arrays


@pytest.mark.usefixtures("still")
def test_rods_are_as_heavy_and_as_stiff_as_the_rope(tmp_path):
    """Newton's, and Genesis' chain."""
    m, d = catalogue.get("cotton-rope").material(), catalogue.get("cotton-rope").across.typical
    EI, mass = m.E * np.pi * d**4 / 64.0, m.density * np.pi * d**2 / 4.0 * 0.3
    arrays = scripted(tmp_path / "newton", COTTON, "newton")[1]
    whole = float(arrays["mass"]) * (len(arrays["nodes"]) - 1)
    assert (float(arrays["EI"]), whole) == pytest.approx((EI, mass))
    folder, arrays = scripted(tmp_path, COTTON, "genesis")
    chain = ElementTree.parse(folder / "rope.xml")
    weights = [float(of.attrib["mass"]) for of in chain.iter("inertial")]
    assert len(weights) == len(arrays["rest"]) == 20
    assert sum(weights) == pytest.approx(mass)
    hinges = [j.attrib for j in chain.iter("joint") if j.attrib["type"] == "hinge"]
    np.testing.assert_allclose([float(of["stiffness"]) for of in hinges], EI / 0.015)
    assert len(hinges) == 2 * (20 - int(np.sum(arrays["rest"][:, 0] < 0.025)))


@pytest.mark.usefixtures("still")
def test_genesis_sheet_is_flat_and_held_by_its_corner(tmp_path):
    folder, arrays = scripted(tmp_path, CLOTH, "genesis")
    rows = (folder / "sheet.obj").read_text().splitlines()
    x = np.array([row.split()[1:] for row in rows if row.startswith("v")], dtype=float)
    np.testing.assert_allclose(x, arrays["rest"], atol=1e-12)
    assert np.linalg.norm(x[1] - x[0]) == pytest.approx(float(arrays["spacing"]))
    faces = np.array([row.split()[1:] for row in rows if row.startswith("f")], dtype=int) - 1
    a, b, c = (x[faces[:, k]] for k in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(0.04)
    assert np.linalg.norm(x[arrays["held"], :2], axis=1).max() <= 0.025 + 1e-9


def test_draws_are_variants_for_randomisation(tmp_path, estimate):
    path = estimate(OBJECTS["rope-cotton"], 0.2)
    folder = written(tmp_path, path, "--to", "usd", "--draws", "3", "--seed", "5")
    E = [json.loads((p / "twin.json").read_text())["object"]["E"] for p in sorted(folder.iterdir())]
    drawn = Estimate.load(path).draws(3, 5)
    assert E == pytest.approx([d.material.E for d in drawn]) and len(set(E)) == 3


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["cotton-rop", "--to", "usd"], "cotton-rop: is no file and no material; did you mean"),
        (["cotton-rope", "--to", "usd"], "a material has no length; give --length in metres"),
        ([*COTTON, "--side", "0.3", "--to", "usd"], "--side: a rope has no side; give --length"),
        ([*COTTON, "--to", "usd", "--draws", "2"], "--draws: needs an estimate"),
    ],
)
def test_what_cannot_become_a_twin(tmp_path, capsys, words, said):
    assert cli.main(["twin", *words, "--out", str(tmp_path / "twin")]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "twin" / "twin.json").exists()


def test_a_twin_is_never_overwritten_and_has_a_known_target(tmp_path, capsys):
    folder = written(tmp_path, *COTTON, "--to", "usd")
    before = (folder / "object.usda").read_bytes()
    words = ["twin", "cotton-rope", "--length", "0.5", "--to", "usd", "--out", str(folder)]
    assert cli.main(words) == 2
    assert "holds a twin already; name another folder" in capsys.readouterr().err
    assert (folder / "object.usda").read_bytes() == before
    with pytest.raises(GendomError, match="no target 'sdf'; choose mjcf, newton, genesis, usd"):
        write_twin(OBJECTS["rope-cotton"], "sdf", tmp_path / "other", about={})
    assert not (tmp_path / "other").exists()
