"""`gendom train`, `gendom act` and `gendom evaluate`."""

import json

import numpy as np
import pytest

from gendom import cli
from gendom.datasets.demonstrations import generate
from gendom.files import read_json, write_json
from gendom.policies import Policy
from gendom.tasks import Outcomes, RopeReaching

ESTIMATE = {
    "format": "gendom-estimate/1",
    "youngs_modulus": 9.0e5,
    "poissons_ratio": 0.3,
    "density": 900.0,
    "specific_modulus": 1000.0,
    "bending_length": 0.02,
    "object": {"kind": "rope", "length": 0.25, "diameter": 0.014},
}


@pytest.fixture
def act(make_policy, monkeypatch, tmp_path, capsys):
    """Run `gendom act` with the stand-in policy; returns exit code, stdout and stderr."""
    policies = {True: make_policy()[0], False: make_policy(conditioned_on=())[0]}
    monkeypatch.setattr(Policy, "pretrained", lambda task, *, parameters: policies[parameters])

    def run(*flags, estimate=ESTIMATE, goal="0.35"):
        words = ["act", "rope-reaching", "--goal", goal, *flags]
        if estimate is not None:
            write_json(tmp_path / "estimate.json", estimate)
            words += ["--params", str(tmp_path / "estimate.json")]
        code = cli.main(words)
        return code, *capsys.readouterr()

    return run


def test_act_prints_action_and_motion(act, tmp_path):
    code, out, err = act("--json", "--out", str(tmp_path / "action.json"))
    assert (code, err) == (0, "")
    result = json.loads(out)
    assert result == read_json(tmp_path / "action.json")
    assert result["format"] == "gendom-action/1"
    assert result["action"] == pytest.approx({"release_x": 0.15, "release_z": 0.125})
    motion = result["trajectory"]
    assert len(motion["time"]) == len(motion["position"])
    assert motion["position"][-1] == pytest.approx([0.15, 0.0, 0.125])
    assert result["policy"]["seed"] == 3

    code, out, _ = act()
    assert code == 0
    assert "release_x 0.1500 m, release_z 0.1250 m" in out
    assert out.count("\n") > len(motion["time"])


def test_act_takes_flags_instead_of_a_file_and_before_it(act):
    material = ["--E=9e5", "--nu=0.3", "--density=900"]
    sizes = ["--length=0.25", "--diameter=0.014"]
    by_flags = json.loads(act(*material, *sizes, "--json", estimate=None)[1])
    assert by_flags == json.loads(act("--json")[1])
    softer = json.loads(act("--E", "4.5e5", "--json")[1])
    assert softer["object"]["specific_modulus"] == pytest.approx(500.0)
    assert softer["network_input"]["specific_modulus"] == pytest.approx(500.0)


def test_act_without_parameters_needs_only_sizes(act):
    flags = ["--no-parameters", "--length", "0.25", "--diameter", "0.014", "--json"]
    code, out, _ = act(*flags, estimate=None)
    assert code == 0
    assert json.loads(out)["network_input"] == {"specific_modulus": None, "poissons_ratio": None}


def test_act_warns_on_stderr(act):
    code, out, err = act("--nu", "0.45", "--json")
    assert code == 0
    assert "poissons_ratio 0.45 is 12.5 % above" in err
    assert json.loads(out)["warnings"]


@pytest.mark.parametrize(
    ("flags", "estimate", "goal", "text"),
    [
        ((), ESTIMATE, "0.9", "choose one between"),
        (("--E", "1e5", "--length", "0.2"), None, "0.3", "give --diameter, --E and --density"),
        ((), ESTIMATE | {"format": "other/1"}, "0.35", "not 'gendom-estimate/1'"),
        ((), ESTIMATE | {"poissons_ratio": "0.3"}, "0.35", "must be a positive number, got '0.3'"),
        ((), ESTIMATE | {"object": {"kind": "cloth"}}, "0.35", "describes a cloth"),
        (("--E", "-1"), ESTIMATE, "0.35", "must be positive"),
        (("--no-parameters", "--policy", "x.onnx"), ESTIMATE, "0.35", "together with --policy"),
        (("--policy", "x.onnx"), ESTIMATE, "0.35", "x.onnx: no such file"),
    ],
)
def test_act_tells_faults_in_one_line(act, flags, estimate, goal, text):
    code, out, err = act(*flags, estimate=estimate, goal=goal)
    assert (code, out) == (2, "")
    assert text in err
    assert err.count("\n") == 1


@pytest.fixture
def quick(monkeypatch):
    """A task without a simulation: whoever releases farther back reaches farther."""

    def demonstrate(self, draws, *, device="cpu", dtype="float32", on_frame=None):
        goal = np.array([2.0 * self.length - d["release_x"] for d in draws])
        return Outcomes(columns={"goal_x": goal}, faults=(None,) * len(draws))

    monkeypatch.setattr(RopeReaching, "demonstrate", demonstrate)


def test_train_then_evaluate(quick, tmp_path, capsys):
    pytest.importorskip("torch", reason="needs the extra `train`")
    pytest.importorskip("onnx", reason="needs the extra `train`")
    generate(RopeReaching(), 400, tmp_path / "set", seed=0)
    paths = {}
    for condition, method in (("both", "distal"), ("none", "inverse")):
        paths[condition] = str(tmp_path / f"{condition}.onnx")
        words = ["train", "rope-reaching", "--data", str(tmp_path / "set"), "--epochs", "40"]
        words += ["--out", paths[condition], "--condition", condition, "--method", method]
        assert cli.main([*words, "--seed", "5", "--json"]) == 0
        out, err = capsys.readouterr()
        summary = json.loads(out)
        assert summary["training"]["seed"] == 5
        assert summary["training"]["demonstrations"] == 400
        assert "policy: 100%" in err
    assert cli.main(words) == 0
    assert "sees no parameters" in capsys.readouterr().out

    words = ["evaluate", "rope-reaching", "--policy", *paths.values(), "--cases", "30"]
    assert cli.main([*words, "--seed", "7", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["seed"], result["cases"]) == (7, 30)
    assert [p["path"] for p in result["policies"]] == list(paths.values())
    # the second was trained again just now, with the default seed
    assert [p["training_seed"] for p in result["policies"]] == [5, 0]
    for entry in result["policies"]:
        assert 0.0 < entry["error"]["mean"] < 0.01
    assert cli.main([*words, "--seed", "7"]) == 0
    assert "distal, sees specific_modulus, poissons_ratio" in capsys.readouterr().out


def test_train_refuses_a_missing_set(tmp_path, capsys):
    pytest.importorskip("torch", reason="needs the extra `train`")
    words = ["train", "rope-reaching", "--data", str(tmp_path / "x"), "--out", "p.onnx"]
    assert cli.main(words) == 2
    assert "no such folder" in capsys.readouterr().err
