"""A new unknown is one entry of the registry, from outside of the package."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gendom import cli
from gendom.errors import ParameterError
from gendom.estimation import LiftScene
from gendom.materials.estimate import Estimate
from gendom.materials.unknowns import UNKNOWNS, Unknown, register
from gendom.policies.belief import believed
from gendom.tasks import RopeReaching
from gendom.viz.viewer.models import _parameters


def stiffened(inputs, value):
    inputs.E_over_rho *= value


MATERIAL = Unknown(
    name="humidity", symbol="h", unit="1", meaning="E over that of the dry rope",
    log=True, low=0.5, high=2.0, mean=1.0, sd=0.05, step=0.02, widest=0.1, material=True,
    kinds=("rope",), on_replay=stiffened,
    on_object=lambda item, h: replace(item, material=replace(item.material, E=h * item.material.E)),
)  # fmt: skip


@pytest.fixture
def unknown():
    register(MATERIAL)
    yield MATERIAL
    del UNKNOWNS[MATERIAL.name]


def test_a_new_unknown_is_found_everywhere(unknown, rope_lift, tmp_path, capsys):
    path, out, report = tmp_path / "lift.npz", tmp_path / "out", tmp_path / "report.html"
    rope_lift.seen().write(path)
    words = ["estimate", str(path), "--unknowns", "E_over_rho", unknown.name, "--starts", "1"]
    words += ["--points", "15", "--out", str(out), "--report", str(report), "--json"]
    assert cli.main(words) == 0
    record = json.loads(capsys.readouterr().out)
    found = Estimate.load(out / "estimate.json")

    # the file and the estimate
    assert unknown.name in record["posterior"]["names"] and unknown.name in record["theta"]
    low, high = found.posterior.interval(unknown.name, 0.9)
    assert low < found.theta[unknown.name] < high
    assert found.theta[unknown.name] == getattr(found.theta, unknown.name)
    assert record["intervals"][unknown.name] == [low, high]
    assert unknown.title in "\n".join(name for name, *_ in found.rows())

    # the report and the viewer
    page = report.read_text(encoding="utf-8").lower()
    assert f'class="name" data-label="quantity">{unknown.title}</td>' in page
    assert unknown.title in page.split("usable.", 1)[1].split("</p>", 1)[0]  # the verdict
    scene = LiftScene.of(rope_lift.seen(), rope_lift.settings)
    assert unknown.name in [p.name for p in _parameters(scene, found.theta)]

    # the policies' belief
    belief = believed(found, RopeReaching())
    E = [item.material.E for item in belief.draws(50, seed=0)]
    # the lift shows the product of both alone, so E varies less than each of them
    assert 0.0 < np.std(np.log(E)) < 0.5 * belief.sd[belief.names.index(unknown.name)]


def test_a_name_is_registered_once(unknown):
    with pytest.raises(ParameterError, match="already"):
        register(unknown)
