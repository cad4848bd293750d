"""Using a policy: scaling, ranges, warnings, and faults of its file."""

import json
import logging
import math

import numpy as np
import pytest

from gendom.errors import PolicyError
from gendom.policies import Description, GoalRange, Policy

ROPE = {"length": 0.25, "diameter": 0.014}


def test_import_brings_neither_torch_nor_the_simulator(run_python):
    code = (
        "import sys, gendom.policies; "
        "print(sorted({'torch', 'onnx', 'onnxruntime', 'warp'} & set(sys.modules)))"
    )
    assert run_python(code) == "[]"


def test_act_gives_metres_of_the_given_rope(make_policy):
    policy, session = make_policy()
    action = policy.act(0.35, 1000.0, 0.3, **ROPE)
    assert action.as_dict() == pytest.approx({"release_x": 0.15, "release_z": 0.125})
    assert session.fed["goal"] == pytest.approx(np.array([[1.4]]))
    assert action.warnings == ()


def test_action_scales_with_the_rope(make_policy):
    """Twice as long and thick, twice the specific modulus: the same motion, twice as large."""
    policy, session = make_policy()
    small = policy.act(0.36, 900.0, 0.3, **ROPE)
    seen = session.fed
    large = policy.act(0.72, 1800.0, 0.3, length=0.5, diameter=0.028)
    for name, value in seen.items():
        assert session.fed[name] == pytest.approx(value), name
    assert np.array(large.values) == pytest.approx(2.0 * np.array(small.values))


def test_a_thinner_rope_bends_as_a_softer_one(make_policy):
    policy, session = make_policy()
    policy.act(0.35, 2000.0, 0.3, length=0.25, diameter=0.007)
    assert session.fed["specific_modulus"] == pytest.approx(np.array([[500.0]]))


@pytest.mark.parametrize(
    ("modulus", "inside", "outside", "text"),
    [
        (400.0, 0.305, 0.295, "between 0.3 and 0.45 m"),
        (1600.0, 0.28, 0.42, "between 0.275 and 0.4 m"),
        (800.0, 0.42, 0.43, "between 0.2875 and 0.425 m"),  # half way between the two bins
    ],
)
def test_goal_range_depends_on_the_modulus(make_policy, modulus, inside, outside, text):
    policy, _ = make_policy()
    policy.act(inside, modulus, 0.3, **ROPE)
    with pytest.raises(PolicyError, match=text):
        policy.act(outside, modulus, 0.3, **ROPE)


def test_goal_range_is_told_in_metres_of_the_given_rope(make_policy):
    policy, _ = make_policy()
    with pytest.raises(PolicyError, match=r"goal 1 m .* between 0.6 and 0.9 m"):
        policy.act(1.0, 800.0, 0.3, length=0.5, diameter=0.028)


def test_policy_without_parameters_sees_none_and_has_one_range(make_policy):
    policy, session = make_policy(conditioned_on=())
    action = policy.act(0.44, **ROPE)
    assert set(session.fed) == {"goal"}
    assert (action.specific_modulus, action.poissons_ratio) == (None, None)
    assert policy.goal_range(1600.0) == (1.1, 1.8)
    assert policy.act(0.44, 10.0, 0.49, **ROPE).warnings == ()


def test_parameters_outside_are_clipped_with_a_warning(make_policy, caplog):
    policy, session = make_policy()
    with caplog.at_level(logging.WARNING, logger="gendom"):
        action = policy.act(0.35, 5000.0, 0.15, **ROPE)
    assert session.fed["specific_modulus"] == pytest.approx(np.array([[4000.0]]))
    assert session.fed["poissons_ratio"] == pytest.approx(np.array([[0.2]]))
    assert (action.specific_modulus, action.poissons_ratio) == (4000.0, 0.2)
    assert "25 % above" in action.warnings[0]
    assert "25 % below" in action.warnings[1]
    assert tuple(record.message for record in caplog.records) == action.warnings


def test_action_beyond_the_limits_is_moved_into_them(make_policy):
    policy, session = make_policy()
    session.offset = 0.5
    action = policy.act(0.35, 1000.0, 0.3, **ROPE)
    release = np.array(action.values)
    policy.task().check_action(release)
    with pytest.raises(Exception, match="out of limits"):
        policy.task().check_action([release[0] + 1e-5, release[1]])
    assert "moved by" in action.warnings[0]


def test_limits_leave_allowed_actions_alone(make_policy):
    policy, _ = make_policy()
    actions = np.array([[0.6, 0.5], [0.5, 0.4]])
    assert np.array_equal(policy.into_limits(actions), actions)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"goal": math.nan}, "goal must be positive"),
        ({"length": 0.0}, "length must be positive"),
        ({"diameter": -1.0}, "diameter must be positive"),
        ({"specific_modulus": math.inf}, "specific_modulus must be positive"),
        ({"specific_modulus": None}, "needs specific_modulus"),
        ({"poissons_ratio": None}, "needs poissons_ratio"),
        ({"poissons_ratio": math.nan}, "poissons_ratio must be finite"),
    ],
)
def test_bad_numbers_are_refused(make_policy, change, text):
    policy, _ = make_policy()
    given = {"goal": 0.35, "specific_modulus": 1000.0, "poissons_ratio": 0.3, **ROPE} | change
    with pytest.raises(PolicyError, match=text):
        policy.act(given.pop("goal"), **given)


def test_unknown_task_is_refused(make_policy, description):
    for task in ({"name": "rope-juggling"}, description.task | {"colour": "red"}):
        policy, _ = make_policy(task=task)
        with pytest.raises(PolicyError, match="unknown here"):
            policy.task()


def test_description_survives_json(description):
    again = Description.from_json(description.to_json(), where="x.onnx")
    assert again == description


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda d: d.update(format="gendom-policy/9"), "reads 'gendom-policy/1'"),
        (lambda d: d.pop("task"), "KeyError: 'task'"),
        (lambda d: d["task"].pop("length"), "KeyError: 'length'"),
        (lambda d: d["parameters"].pop("poissons_ratio"), "poissons_ratio"),
        (lambda d: d["inputs"][0].update(colour="red"), "TypeError"),
        (lambda d: d.update(goals=3), "incomplete or broken"),
    ],
)
def test_broken_descriptions_are_refused(description, change, text):
    value = json.loads(description.to_json())
    change(value)
    with pytest.raises(PolicyError, match=text):
        Description.from_json(json.dumps(value), where="x.onnx")


def test_range_of_all_covers_every_bin():
    goals = GoalRange(at=(100.0, 1000.0), low=(1.1, 1.0), high=(1.5, 1.4))
    assert goals(None) == (1.0, 1.5)
    assert goals(1.0) == (1.1, 1.5)
    assert goals(1e6) == (1.0, 1.4)


def test_files_that_are_no_policies_are_refused(tmp_path):
    with pytest.raises(PolicyError, match="no such file"):
        Policy.read(tmp_path / "none.onnx")
    with pytest.raises(PolicyError, match="cannot be read"):
        Policy.read(tmp_path)
    text = tmp_path / "text.onnx"
    text.write_text("not a network")
    with pytest.raises(PolicyError, match="is not an ONNX file"):
        Policy.read(text)


def test_missing_pretrained_policy_is_told():
    with pytest.raises(PolicyError, match=r"no pretrained policy 'rope-juggling\.onnx'"):
        Policy.pretrained("rope-juggling")


def graph(path, inputs, metadata):
    """An ONNX file that adds its inputs."""
    onnx = pytest.importorskip("onnx", reason="needs the extra `train`")
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    network = helper.make_graph(
        [helper.make_node("Sum", inputs, ["action"])],
        "sum",
        [helper.make_tensor_value_info(name, kind, ["batch", 1]) for name in inputs],
        [helper.make_tensor_value_info("action", kind, ["batch", 1])],
    )
    model = helper.make_model(network, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, metadata)
    onnx.save(model, str(path))
    return path


def test_onnx_files_must_describe_themselves(tmp_path, description):
    names = ["goal", "specific_modulus", "poissons_ratio"]
    about = {"gendom-policy": description.to_json()}
    policy = Policy.read(graph(tmp_path / "good.onnx", names, about))
    actions = policy.actions([1.0, 2.0], 1000.0, 0.25)
    assert actions == pytest.approx(np.array([[1001.25], [1002.25]]))
    with pytest.raises(PolicyError, match="without 'gendom-policy' metadata"):
        Policy.read(graph(tmp_path / "bare.onnx", names, {}))
    with pytest.raises(PolicyError, match="does not say"):
        Policy.read(graph(tmp_path / "other.onnx", names[:2], about))
