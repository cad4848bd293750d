"""`gendom train`, `gendom act` and `gendom evaluate`."""

import json
import math
import re

import numpy as np
import pytest

from gendom import cli
from gendom.cli.act import result_text
from gendom.datasets.demonstrations import generate
from gendom.errors import PolicyError
from gendom.files import write_json
from gendom.hardware.cell import Cell, PlannedMotion
from gendom.hardware.execution import read_action
from gendom.materials import size_of
from gendom.materials.estimate import Estimate
from gendom.materials.estimate_file import checksum
from gendom.materials.posterior import Posterior, prior_of
from gendom.policies import Policy
from gendom.policies.prediction import doubts, predict
from gendom.reading import read_json
from gendom.reality import OBJECTS
from gendom.robot import XARM7, read_joints
from gendom.tasks import RopeReaching
from gendom.tasks.demonstrator import Demonstrator
from gendom.tasks.task import Outcome
from gendom.tasks.world import Simulation
from simulated_cell import write_cell


def estimated(sd=0.068, **known):
    """Record of an estimate of E over density, which is 1,000 m^2/s^2."""
    numbers = {"mean": np.log([1000.0]), "covariance": np.array([[sd**2]])}
    posterior = Posterior(prior=prior_of(["E_over_rho"]), bases=(), **numbers)
    known = {"length": 0.25, "diameter": 0.014, "nu": 0.3, "density": 900.0} | known
    return Estimate(kind="rope", known=known, posterior=posterior).record


ESTIMATE = estimated()


PLANS: dict[str, PlannedMotion] = {}


def plan_once(cell, path, *, plan=Cell.plan, **how):
    """As `Cell.plan`, which takes a second, once for each path: most tests act alike."""
    key = repr((cell.path, cell.arm, path.to_dict(), how))
    return PLANS.get(key) or PLANS.setdefault(key, plan(cell, path, **how))


@pytest.fixture
def act(make_policy, monkeypatch, tmp_path, capsys):
    """Run `gendom act` with the stand-in policy; returns exit code, stdout and stderr."""
    policies = {True: make_policy()[0], False: make_policy(conditioned_on=())[0]}
    monkeypatch.setattr(Policy, "pretrained", lambda task, *, parameters: policies[parameters])
    monkeypatch.setattr("gendom.policies.prediction.UNSTEADY", 0.04)  # the stand-in's move by 0.03
    monkeypatch.setattr("gendom.cli.act.DRAWS", 24)
    monkeypatch.setattr(Cell, "plan", plan_once)

    def run(*flags, estimate=ESTIMATE, goal="0.35"):
        words = ["act", "rope-reaching", "--goal", goal, *flags]
        if estimate is not None:
            sealed = estimate | {"sha256": checksum(estimate)}
            write_json(tmp_path / "estimate.json", sealed)
            words += ["--params", str(tmp_path / "estimate.json")]
        code = cli.main(words)
        return code, *capsys.readouterr()

    return run


def test_act_prints_action_and_motion_in_the_robot_s_frame(act, tmp_path):
    """What is dimensionless or assumed is said so; by file or by flags, here or elsewhere."""
    code, out, err = act("--json", "--out", str(tmp_path / "action.json"))
    assert code == 0 and err.endswith(f"written: {tmp_path / 'action.json'}\n")
    result = json.loads(out)
    assert result == read_json(tmp_path / "action.json")
    assert result["format"] == "gendom-action/5"
    x, z = result["action"]["release_x"], result["action"]["release_z"]
    assert (x, z) == pytest.approx((0.15, 0.1), abs=0.005)
    motion = result["trajectory"]
    T = np.array(motion["T_base_task"])
    assert T[:3, 3] == pytest.approx([0.48, 0.30, 0.12])
    assert motion["position"][-1] == pytest.approx((T @ [x, 0.0, z, 1.0])[:3].tolist())
    assert [e["closed"] for e in motion["events"]] == [True, False]
    assert result["arm"] == {"name": "xarm7", "slowed_by": 1.0}
    assert result["policy"]["seed"] == 3
    assert result["assumed"] == {"damping": 0.004, "friction": 0.3}
    meaning = result["network_input_meaning"]
    assert result["network_input"].keys() == meaning.keys() == {"bending_ratio", "nu"}
    assert meaning["bending_ratio"] == "bending length over size, dimensionless"
    assert {result["units"][name] for name in ("release_x", "x", "sideways")} == {"m"}

    code, out, _ = act()
    assert code == 0 and re.search(r"release_x 0\.15\d* m, release_z ", out)
    assert re.search(r"predicts x 0\.\d+ m \(90", out)
    assert re.search(r"\n           bending_ratio +0\.\d+ +bending length over size\n", out)
    assert "xarm7 follows the motion" in out and out.count("\n") > len(motion["time"])

    flags = ["--E=9e5", "--nu=0.3", "--density=900", "--length=0.25", "--diameter=0.014"]
    moved = ["--origin", "0.5", "0.2", "0.1", "--no-prediction", "--json"]
    elsewhere = json.loads(act(*flags, *moved, estimate=None)[1])
    assert elsewhere["network_input"] == pytest.approx(result["network_input"])
    shift = np.subtract(elsewhere["trajectory"]["position"], motion["position"])
    assert shift == pytest.approx(np.tile([0.02, -0.1, -0.02], (len(shift), 1)))


def test_an_unsteady_release_is_not_offered():
    """The shipped policy's for the cotton rope at 0.485 m: 7.7 mm by 100 ms."""
    task, item, world = RopeReaching(), OBJECTS["rope-cotton"], Simulation()
    release = size_of(item) * np.array([0.49461472, 0.35117316])
    predicted = predict(task, item, release, [], 0, world)
    with pytest.raises(PolicyError, match=r"by 7\.7 mm; choose another goal, or add --force"):
        doubts(task, item, {"x": 0.485}, predicted, force=False)
    (note,) = doubts(task, item, {"x": 0.485}, predicted, force=True)
    assert "by 7.7 mm" in note
    steady = predict(task, item, np.array([0.175, 0.084]), [], 0, world)
    assert not doubts(task, item, {"x": 0.45}, steady, force=False)


@pytest.mark.parametrize("cell", [False, True])
def test_nothing_below_the_table_is_planned(act, tmp_path, cell):
    """An origin 0.2 m lower: the release point lies 30 mm below the table, in a cell or none."""
    flags = ["--cell", str(write_cell(tmp_path, cameras=False))] if cell else []
    code, _, err = act(*flags, "--no-prediction", "--origin", "0.48", "0.30", "-0.13")
    assert code == 2 and re.search("table.*; choose another --origin, or add --force", err)


def test_act_plans_what_execute_reads(act, tmp_path):
    cell, out = write_cell(tmp_path, cameras=False), tmp_path / "action.json"
    joints, points = tmp_path / "joints.csv", tmp_path / "ros.json"
    flags = ["--cell", cell, "--out", out, "--joints", joints, "--trajectory", points]
    code, text, err = act(*map(str, flags), "--no-prediction")
    assert code == 0, err
    action = read_action(out)
    motion = action.plan.motion
    assert action.plan.cell == str(cell) and [e.closed for e in motion.events] == [True, False]
    states = read_joints(joints, XARM7)
    assert states.q == pytest.approx(motion.at(states.time), abs=1e-6)
    assert read_json(points)["points"][-1]["positions"] == pytest.approx(motion.q[-1])
    said = read_json(out)
    assert said["plan"]["surroundings"]["table_height"] == 0.0
    assert said["plan"]["motion"]["deviation"] < 0.02
    assert ("takes" in text) == any("times as long" in w for w in said["warnings"])


def test_act_predicts_what_will_be_reached(act):
    """By the estimate's deviation, and by what its simulator errs, which counts also where the
    object is known all but exactly."""

    def spread(sd):
        flags = ("--json", "--damping", "0.004")
        found = json.loads(act(*flags, estimate=estimated(sd))[1])["predicted"]
        low, high = found["interval_90"]["x"]
        assert 0.25 < low < high < 0.5 and low - 0.01 < found["reached"]["x"] < high + 0.01
        return high - low

    own = 0.008 * ESTIMATE["object"]["length"]  # deviation of the simulator
    usual, wide = (math.sqrt(spread(sd) ** 2 - (3.29 * own) ** 2) for sd in (0.068, 0.165))
    assert wide > 1.5 * usual
    assert 2.4 * own < spread(1e-4) < 4.2 * own
    assert "predicted" not in json.loads(act("--json", "--no-prediction")[1])


def test_act_polishes_and_warns_of_a_goal_outside_of_its_own_interval(act):
    """The stand-in's release reaches farther, as it says itself; a polished one does not."""
    flags = ("--json", "--damping", "0.004", "--seconds", "60")
    made = {}
    for polish in ((), ("--polish",)):
        _, out, err = act(*flags, *polish)
        made[polish] = said = json.loads(out)
        low, high = said["predicted"]["interval_90"]["x"]
        assert (low <= 0.35 <= high) == bool(polish)
        what = f"the goal x 0.35 m lies outside of what is predicted, 90 % in {low:.4g} to"
        assert any(what in w for w in said["warnings"]) == (not polish) == (what in err)
    plain, polished = made.values()
    assert "polished" not in plain
    assert polished["polished"]["expected"] < 0.5 * polished["polished"]["before"]
    assert polished["trajectory"]["position"][-1] != plain["trajectory"]["position"][-1]
    assert "polished expected miss" in result_text(polished, motion=True)


@pytest.fixture
def adapt(tmp_path, capsys):
    """Run `gendom adapt` of an estimate's file; returns exit code, stdout and stderr."""
    write_json(tmp_path / "estimate.json", ESTIMATE)

    def run(*flags, name="estimate.json"):
        words = ["adapt", "rope-reaching", "--params", str(tmp_path / name), *flags]
        return cli.main(words), *capsys.readouterr()

    return run


EXECUTION = ("--action", "0.15", "0.1", "--reached", "0.36")


@pytest.mark.slow
def test_adapt_learns_from_executions_one_after_the_other(adapt, act, tmp_path):
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    code, out, err = adapt(*EXECUTION, "--out", str(first))
    assert (code, err) == (0, "") and f"written: {first}" in out
    assert "damping" in out and "not explained" in out
    learnt, row = read_json(first), {"action": [0.15, 0.1], "reached": [0.36]}
    assert learnt["executions"] == {"rope-reaching": [row]}
    assert learnt["damping"] != pytest.approx(0.004, rel=0.01)
    share = learnt["E"] / ESTIMATE["E"]
    assert learnt["bending_length"] == pytest.approx(0.1077 * share ** (1 / 3), rel=1e-3)
    # a second one goes on from there
    more = ("--action", "0.16", "0.1", "--reached", "0.355")
    assert adapt(*more, "--out", str(second), name="first.json")[0] == 0
    by_turns, more_row = read_json(second), {"action": [0.16, 0.1], "reached": [0.355]}
    assert by_turns["executions"]["rope-reaching"] == [row, more_row]
    # and what is not explained by parameters moves the polished action
    flags = ("--json", "--polish", "--seconds", "60")
    with_it, without = (
        json.loads(act(*flags, estimate=of)[1]) for of in (by_turns, by_turns | {"executions": {}})
    )
    assert with_it["action"] != without["action"]


@pytest.mark.parametrize(
    ("flags", "text"),
    [
        ((), "--action: is missing; give both"),
        (("--action", "0.15", "0.1"), "--reached: is missing"),
        (("--action", "0.15", "--reached", "0.36"), "1 numbers of an action"),
        (("--action", "0.15", "0.1", "--reached", "nan"), "finite"),
        ((*EXECUTION, "--out", "adapted.txt"), "does not end in .json"),
    ],
)
def test_adapt_refuses(adapt, flags, text):
    code, out, err = adapt(*flags)
    assert (code, out) == (2, "")
    assert text in err and err.count("\n") == 1


def test_act_takes_the_estimate_s_numbers_and_flags_before_them(act):
    changed = estimated(damping=0.007, friction=0.0)
    result = json.loads(act("--json", "--no-prediction", estimate=changed)[1])
    assert (result["object"]["damping"], result["object"]["friction"]) == (0.007, 0.0)
    softer = json.loads(act("--E", "4.5e5", "--json")[1])
    assert softer["object"]["E_over_rho"] == pytest.approx(500.0)
    assert "interval_90" not in softer["predicted"]  # that was of another E


UNUSABLE = ESTIMATE | {"verdict": {"usable": False, "reasons": ["it rests", "points stray"]}}


@pytest.mark.parametrize(
    ("flags", "estimate", "text"),
    [
        ((), UNUSABLE, "is not usable: it rests, points stray; record the object again"),
        (("--origin", "1.5", "0.2", "0.1"), ESTIMATE, "xarm7: (1.500"),
    ],
)
def test_what_is_refused_can_be_forced(act, flags, estimate, text):
    """An estimate that is not usable, and a motion that the arm cannot do: another robot may."""
    code, out, err = act(*flags, "--no-prediction", estimate=estimate)
    assert (code, out, err.count("\n")) == (2, "", 1) and text in err and "--force" in err
    code, _, err = act(*flags, "--force", "--no-prediction", "--json", estimate=estimate)
    assert code == 0 and ("is out of reach" in err) == bool(flags)


def test_act_refuses_what_its_policy_never_saw_unless_forced(act):
    """All of it is named in one line; what is as good as in the range is taken."""
    said = ["goal x 0.9 lies outside", "bending_ratio (bending length over size)",
            "nu (Poisson's ratio) 0.45 is 12.5 % above the range 0.2 to 0.4"]  # fmt: skip
    flags = ("--nu", "0.45", "--E", "1e4", "--no-prediction")
    code, out, err = act(*flags, goal="0.9")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1 and all(text in err for text in said) and "--force" in err
    code, out, err = act(*flags, "--force", "--json", goal="0.9")
    result = json.loads(out)
    assert code == 0 and result["goal"] == {"x": 0.9}
    for text, warning in zip(said, result["warnings"], strict=False):
        assert text in warning and "it uses" in warning and text in err
    code, _, err = act("--nu", "0.403", "--no-prediction")
    assert code == 0 and "0.75 % above" in err


CLOTH = ESTIMATE | {"object": {"kind": "cloth"}}
FEW = ("--E", "1e5", "--length", "0.2")
UNITS = [
    ((), "35", "goal x is 35 m"),
    (("--diameter", "14"), "0.35", "diameter is 14 m; give metres: 14 mm are 0.014 m"),
    (("--origin", "480", "300", "120"), "0.35", "--origin: is 480 300 120 m"),
    (("--nu", "0.5"), "0.35", "nu must lie in (-1, 0.5), got 0.5"),
]
"""Other units than metres, and an impossible Poisson's ratio: flags, goal and what is said, also
where it is forced."""


@pytest.mark.parametrize(
    ("flags", "goal", "text", "estimate"),
    [
        *((("--force", *flags), *row, ESTIMATE) for flags, *row in UNITS),
        ((), "0.9", "choose one between", ESTIMATE),
        (FEW, "0.3", "give --diameter [m], --density [kg/m^3]", None),
        ((), "0.35", "not 'gendom-estimate/1'", ESTIMATE | {"format": "other/1"}),
        ((), "0.35", "could not convert string to float", ESTIMATE | {"nu": "x"}),
        ((), "0.35", "describes a cloth", CLOTH),
        (("--policy", "x.onnx"), "0.35", "x.onnx: no such file", ESTIMATE),
        (("--origin", "nan", "0", "0"), "0.35", "--origin: is nan 0 0 m; give metres", ESTIMATE),
    ],
)
def test_act_tells_faults_in_one_line(act, flags, estimate, goal, text):
    code, out, err = act(*flags, estimate=estimate, goal=goal)
    assert (code, out, err.count("\n")) == (2, "", 1) and text in err


@pytest.fixture
def quick(monkeypatch):
    """A world without a simulation: whoever releases farther back reaches farther."""

    def carry_out(self, task, items, actions, **_):
        return [
            Outcome(values={"x": 2.0 * size_of(item) - action[0], "sideways": 0.0})
            for item, action in zip(items, np.asarray(actions), strict=True)
        ]

    monkeypatch.setattr(Simulation, "carry_out", carry_out)


def test_train_then_evaluate(quick, tmp_path, capsys):
    pytest.importorskip("torch", reason="needs the extra `train`")
    pytest.importorskip("onnx", reason="needs the extra `train`")
    generate(Demonstrator(task=RopeReaching()), 200, tmp_path / "set", seed=0)
    paths = {}
    for condition, method in (("all", "distal"), ("none", "inverse")):
        paths[condition] = str(tmp_path / f"{condition}.onnx")
        words = ["train", "rope-reaching", "--data", str(tmp_path / "set"), "--epochs", "25"]
        words += ["--cases", "40", "--out", paths[condition]]
        words += ["--condition", condition, "--method", method]
        assert cli.main([*words, "--seed", "5", "--json"]) == 0
        summary = json.loads(capsys.readouterr().out)
        assert summary["training"]["seed"] == 5
        assert summary["training"]["demonstrations"] == 200
        assert summary["acted"]["cases"] == 40 and summary["acted"]["error"]["mean"] < 0.02
    assert cli.main(words) == 0
    assert "conditioned on no parameters" in capsys.readouterr().out

    words = ["evaluate", "rope-reaching", "--policy", *paths.values(), "--cases", "30"]
    assert cli.main([*words, "--seed", "7", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["seed"], result["cases"]) == (7, 30)
    assert [p["path"] for p in result["policies"]] == list(paths.values())
    # the second was trained again just now, with the default seed
    assert [p["training_seed"] for p in result["policies"]] == [5, 0]
    for entry in result["policies"]:
        assert 0.0 < entry["error"]["mean"] < 0.02


def test_policies_that_ship_are_listed(capsys):
    assert cli.main(["policies", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["policies"]
    assert {"rope-reaching", "rope-casting", "cloth-spreading"} <= {r["task"] for r in rows}
    for row in rows:
        assert row["acted"]["cases"] > 0 and row["demonstrations"] > 0
    assert cli.main(["policies"]) == 0
    out = capsys.readouterr().out
    assert "no parameters" in out and "misses by" in out and "bending length over size" in out
