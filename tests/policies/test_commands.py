"""`gendom train`, `gendom act` and `gendom evaluate`."""

import json
import math
import re
from functools import partial

import numpy as np
import pytest

from gendom import cli
from gendom.cli.act import result_text
from gendom.datasets.demonstrations import generate
from gendom.errors import PolicyError, RobotError
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
from gendom.tasks.world import Simulation
from policies.conftest import Throws
from simulated_cell import write_cell


def estimated(sd=0.068, **known):
    """Record of an estimate of E over density, which is 1,000 m^2/s^2."""
    numbers = {"mean": np.log([1000.0]), "covariance": np.array([[sd**2]])}
    posterior = Posterior(prior=prior_of(["E_over_rho"]), bases=(), **numbers)
    known = {"length": 0.25, "diameter": 0.014, "nu": 0.3, "density": 900.0} | known
    return Estimate(kind="rope", known=known, posterior=posterior).record


ESTIMATE = estimated()
PLANS: dict[str, PlannedMotion | RobotError] = {}


def plan_once(cell, path, *, plan=Cell.plan, **how):
    """As `Cell.plan`, which takes a second, once for each path: most tests act alike."""
    key = repr((cell.path, cell.arm, path.to_dict(), how))
    try:
        found = PLANS.get(key) or PLANS.setdefault(key, plan(cell, path, **how))
    except RobotError as error:
        found = PLANS[key] = error
    if isinstance(found, RobotError):
        raise found
    return found


def told(capsys, words, code):
    """What a command prints, read where it is JSON, and what it says beside that. With another
    exit code than 0: that alone, one line."""
    assert cli.main([str(word) for word in words]) == code
    out, err = capsys.readouterr()
    if code:
        assert (out, err.count("\n")) == ("", 1), err
        return err
    return (json.loads(out) if "--json" in words else out), err


@pytest.fixture
def act(make_policy, monkeypatch, tmp_path, capsys):
    """Run `gendom act` with the stand-in policy, see `told`."""
    policies = {True: make_policy()[0], False: make_policy(conditioned_on=())[0]}
    monkeypatch.setattr(Policy, "pretrained", lambda task, *, parameters: policies[parameters])
    monkeypatch.setattr("gendom.policies.prediction.UNSTEADY", 0.04)  # the stand-in's move by 0.03
    monkeypatch.setattr("gendom.cli.act.DRAWS", 24)
    monkeypatch.setattr(Cell, "plan", plan_once)

    def run(*flags, estimate: dict | None = ESTIMATE, goal="0.35", code=0):
        words = ["act", "rope-reaching", "--goal", goal, *flags]
        if estimate is not None:
            path = tmp_path / "estimate.json"
            write_json(path, estimate | {"sha256": checksum(estimate)})
            words += ["--params", path]
        return told(capsys, words, code)

    return run


def test_act_prints_action_and_motion_in_the_robot_s_frame(act, tmp_path):
    """What is dimensionless or assumed is said so; by file or by flags, here or elsewhere."""
    result, err = act("--json", "--out", tmp_path / "action.json")
    assert err.endswith(f"written: {tmp_path / 'action.json'}\n")
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

    out, _ = act()
    for line in (r"release_x 0\.15\d* m, release_z ", r"predicts x 0\.\d+ m \(90",
                 r"\n           bending_ratio +0\.\d+ +bending length over size\n",
                 "xarm7 follows the motion"):  # fmt: skip
        assert re.search(line, out)
    assert out.count("\n") > len(motion["time"])

    flags = ["--E=9e5", "--nu=0.3", "--density=900", "--length=0.25", "--diameter=0.014"]
    moved = ["--origin", "0.5", "0.2", "0.1", "--no-prediction", "--json"]
    elsewhere, _ = act(*flags, *moved, estimate=None)
    assert elsewhere["network_input"] == pytest.approx(result["network_input"])
    shift = np.subtract(elsewhere["trajectory"]["position"], motion["position"])
    assert shift == pytest.approx(np.tile([0.02, -0.1, -0.02], (len(shift), 1)))


def test_a_cloth_that_lies_folded_is_pulled_from_where_it_is_seen(tmp_path, capsys):
    (tmp_path / "none.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n"
    )
    words = ["act", "cloth-dragging", "--E=4e5", "--nu=0.3", "--density=400", "--side=0.2",
             "--thickness=0.001", "--damping=0.005", "--friction=0.5", "--no-prediction",
             "--json"]  # fmt: skip
    first, _ = told(capsys, words, 0)
    hand = np.array(first["trajectory"]["position"][-1])
    ahead = np.array([0.0, -np.sign(hand[1]), 0.0])
    aside = 0.14 * ahead - np.array([0.13, 0.0, 0.0])
    points = np.array([hand, hand + 0.28 * ahead, hand + aside])
    np.savez(tmp_path / "seen.npz", points=points)
    again, _ = told(capsys, [*words, "--lying", tmp_path / "seen.npz"], 0)
    path, time = np.array(again["trajectory"]["position"]), np.array(again["trajectory"]["time"])
    assert path[0] == pytest.approx(points[2] + [0.012, 0.0, 0.0], abs=1e-6)
    assert path[-1, :2] == pytest.approx(points[2, :2] - [0.54 * 0.2, 0.0])
    assert time[-1] == pytest.approx(first["trajectory"]["time"][-1])
    said = told(capsys, [*words, "--lying", tmp_path / "none.ply"], 2)
    assert "none.ply: has no points" in said
    rope = ["act", "rope-reaching", "--goal=0.35", "--length=0.25", "--diameter=0.014", *words[2:5]]
    assert "tried once" in told(capsys, [*rope, "--lying", tmp_path / "seen.npz"], 2)


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


def test_act_plans_what_execute_reads(act, tmp_path):
    cell, out = write_cell(tmp_path, cameras=False), tmp_path / "action.json"
    joints, points = tmp_path / "joints.csv", tmp_path / "ros.json"
    files = ("--cell", cell, "--out", out, "--joints", joints, "--trajectory", points)
    text, _ = act(*files, "--no-prediction")
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
        found = act("--json", "--damping", "0.004", estimate=estimated(sd))[0]["predicted"]
        low, high = found["interval_90"]["x"]
        assert 0.25 < low < high < 0.5 and low - 0.01 < found["reached"]["x"] < high + 0.01
        return high - low

    own = 0.008 * ESTIMATE["object"]["length"]  # deviation of the simulator
    usual, wide = (math.sqrt(spread(sd) ** 2 - (3.29 * own) ** 2) for sd in (0.068, 0.165))
    assert wide > 1.5 * usual
    assert 2.4 * own < spread(1e-4) < 4.2 * own


def test_act_polishes_and_warns_of_a_goal_outside_of_its_own_interval(act):
    """The stand-in's release reaches farther, as it says itself; a polished one does not."""
    made = {}
    for polish in ((), ("--polish",)):
        said, err = act("--json", "--damping", "0.004", "--seconds", "60", *polish)
        made[polish] = said
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
    """Run `gendom adapt` of an estimate's file, see `told`."""
    write_json(tmp_path / "estimate.json", ESTIMATE)

    def run(*flags, name="estimate.json", code=0):
        words = ("adapt", "rope-reaching", "--params", tmp_path / name, *flags)
        return told(capsys, words, code)

    return run


EXECUTION = ("--action", "0.15", "0.1", "--reached", "0.36")


@pytest.mark.slow
def test_adapt_learns_from_executions_one_after_the_other(adapt, act, tmp_path):
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    out, err = adapt(*EXECUTION, "--out", first)
    assert err == "" and f"written: {first}" in out
    assert "damping" in out and "not explained" in out
    learnt, row = read_json(first), {"action": [0.15, 0.1], "reached": [0.36]}
    assert learnt["executions"] == {"rope-reaching": [row]}
    assert learnt["damping"] != pytest.approx(0.004, rel=0.01)
    share = learnt["E"] / ESTIMATE["E"]
    assert learnt["bending_length"] == pytest.approx(0.1077 * share ** (1 / 3), rel=1e-3)
    # a second one goes on from there
    adapt("--action", 0.16, 0.1, "--reached", 0.355, "--out", second, name="first.json")
    by_turns, more_row = read_json(second), {"action": [0.16, 0.1], "reached": [0.355]}
    assert by_turns["executions"]["rope-reaching"] == [row, more_row]
    # and what is not explained by parameters moves the polished action
    flags = ("--json", "--polish", "--seconds", "60")
    with_it, without = (
        act(*flags, estimate=of)[0] for of in (by_turns, by_turns | {"executions": {}})
    )
    assert with_it["action"] != without["action"]


@pytest.mark.parametrize(
    ("flags", "text"),
    [
        ((), "--action: is missing; give both"),
        (("--action", "0.15", "0.1"), "--reached: is missing"),
        ((*EXECUTION, "--out", "adapted.txt"), "does not end in .json"),
    ],
)
def test_adapt_refuses(adapt, flags, text):
    assert text in adapt(*flags, code=2)


def test_act_takes_the_estimate_s_numbers_and_flags_before_them(act):
    changed = estimated(damping=0.007, friction=0.0)
    result, _ = act("--json", "--no-prediction", estimate=changed)
    assert (result["object"]["damping"], result["object"]["friction"]) == (0.007, 0.0)
    assert "predicted" not in result
    softer, _ = act("--E", "4.5e5", "--json")
    assert softer["object"]["E_over_rho"] == pytest.approx(500.0)
    assert "interval_90" not in softer["predicted"]  # that was of another E


UNUSABLE = ESTIMATE | {"verdict": {"usable": False, "reasons": ["it rests", "points stray"]}}
LOWER = ("--origin", "0.48", "0.30", "-0.13")
"""The release point lies 30 mm below the table."""


@pytest.mark.parametrize(
    ("flags", "goal", "estimate", "said", "forced"),
    [
        ((), "0.35", UNUSABLE, ["not usable: it rests, points stray; record the object again"], ""),
        (("--origin", "1.5", "0.2", "0.1"), "0.35", ESTIMATE, ["xarm7: (1.500"], "out of reach"),
        (LOWER, "0.35", ESTIMATE, ["table", "; choose another --origin"], "table"),
        (("--cell", "CELL", *LOWER), "0.35", ESTIMATE, ["table", "; choose another --or"], "table"),
        (("--nu", "0.45", "--E", "1e4"), "0.9", ESTIMATE,
         ["goal x 0.9 lies outside", "bending_ratio (bending length over size)",
          "nu (Poisson's ratio) 0.45 is 12.5 % above the range 0.2 to 0.4"],
         "above the range 0.2 to 0.4 that the policy was trained on; it uses 0.4"),
    ],
)  # fmt: skip
def test_what_is_refused_can_be_forced(act, flags, goal, estimate, said, forced, tmp_path):
    """An estimate that is not usable, a motion that the arm cannot do, what a policy never saw: all
    of it is named in one line."""
    cell = write_cell(tmp_path, cameras=False)
    flags = [cell if word == "CELL" else word for word in flags]
    run = partial(act, *flags, "--no-prediction", goal=goal, estimate=estimate)
    err = run(code=2)
    assert all(text in err for text in (*said, "--force"))
    result, err = run("--force", "--json")
    assert result["goal"] == {"x": float(goal)}
    assert forced in err and forced in "; ".join(result["warnings"])


@pytest.mark.parametrize(
    ("flags", "goal", "text", "estimate"),
    [
        (("--force",), "35", "goal x is 35 m", ESTIMATE),
        (("--force", "--diameter", "14"), "0.35", "14 m; give metres: 14 mm are 0.014", ESTIMATE),
        (("--force", "--origin", "480", "300", "120"), "0.35", "is 480 300 120 m", ESTIMATE),
        (("--force", "--nu", "0.5"), "0.35", "nu must lie in (-1, 0.5), got 0.5", ESTIMATE),
        ((), "0.9", "choose one between", ESTIMATE),
        (("--E", "1e5", "--length", "0.2"), "0.3", "give --diameter [m], --density [kg/m^3]", None),
        ((), "0.35", "not 'gendom-estimate/1'", ESTIMATE | {"format": "other/1"}),
        ((), "0.35", "could not convert string to float", ESTIMATE | {"nu": "x"}),
        ((), "0.35", "describes a cloth", ESTIMATE | {"object": {"kind": "cloth"}}),
        (("--policy", "x.onnx"), "0.35", "x.onnx: no such file", ESTIMATE),
        (("--origin", "nan", "0", "0"), "0.35", "--origin: is nan 0 0 m; give metres", ESTIMATE),
    ],
)
def test_act_tells_faults_in_one_line(act, flags, estimate, goal, text):
    assert text in act(*flags, estimate=estimate, goal=goal, code=2)


def test_train_then_evaluate(monkeypatch, tmp_path, capsys):
    pytest.importorskip("torch", reason="needs the extra `train`")
    pytest.importorskip("onnx", reason="needs the extra `train`")
    thrown = lambda self, *given, **how: Throws().carry_out(*given, **how)  # noqa: E731
    monkeypatch.setattr(Simulation, "carry_out", thrown)
    generate(Demonstrator(task=RopeReaching().of_one_size()), 200, tmp_path / "set", seed=0)
    paths = [tmp_path / f"{condition}.onnx" for condition in ("all", "none")]
    words = ["train", "rope-reaching", "--data", tmp_path / "set", "--epochs", "15"]
    words += ["--cases", "40", "--condition"]
    summary, _ = told(capsys, [*words, "all", "--out", paths[0], "--seed", "5", "--json"], 0)
    assert summary["training"]["seed"] == 5
    assert summary["training"]["demonstrations"] == 200
    assert summary["acted"]["cases"] == 40 and summary["acted"]["error"]["mean"] < 0.02
    out, _ = told(capsys, [*words, "none", "--out", paths[1], "--method", "inverse"], 0)
    assert "conditioned on no parameters" in out

    words = ["evaluate", "rope-reaching", "--policy", *paths, "--cases", "30"]
    result, _ = told(capsys, [*words, "--seed", "7", "--json"], 0)
    assert (result["seed"], result["cases"]) == (7, 30)
    assert [p["path"] for p in result["policies"]] == [str(path) for path in paths]
    assert [p["training_seed"] for p in result["policies"]] == [5, 0]
    sees, blind = (entry["error"]["mean"] for entry in result["policies"])
    assert 0.0 < sees < 0.8 * blind


def test_policies_that_ship_are_listed(capsys):
    rows = told(capsys, ["policies", "--json"], 0)[0]["policies"]
    assert {"rope-reaching", "rope-casting", "cloth-spreading"} <= {r["task"] for r in rows}
    assert all(row["acted"]["cases"] > 0 and row["demonstrations"] > 0 for row in rows)
    out, _ = told(capsys, ["policies"], 0)
    for text in ("no parameters", "misses by", "bending length over size"):
        assert text in out
