"""Using a policy: scaling, ranges, warnings, and faults of its file."""

import json
import math
from importlib import resources

import numpy as np
import pytest

from gendom.errors import ParameterError, PolicyError
from gendom.materials import Cloth, Material, Rope, dimensionless_parameters
from gendom.policies import Description, Policy
from gendom.policies.graph import SEAL, sealed


def rope(bending=0.4, nu=0.3, length=0.25, diameter=0.014):
    """A rope of some bending length over its length."""
    modulus = (bending * length) ** 3 * 9.81 / (diameter / 4.0) ** 2
    material = Material(E=1000.0 * modulus, nu=nu, density=1000.0)
    return Rope(length=length, diameter=diameter, material=material)


def test_act_gives_metres_of_the_given_rope(make_policy):
    policy, session = make_policy()
    action = policy.act(0.35, rope())
    assert action.action == pytest.approx({"release_x": 0.15, "release_z": 0.1})
    assert action.goal == {"x": 0.35}
    assert session.fed["goal_x"] == pytest.approx(np.array([[1.4]]))
    assert session.fed["bending_ratio"] == pytest.approx(np.array([[0.4]]), rel=1e-6)
    assert action.warnings == ()
    seen = session.fed
    large = policy.act(0.70, rope(length=0.5, diameter=0.02))
    assert session.fed == {name: pytest.approx(value, rel=1e-6) for name, value in seen.items()}
    assert np.array(large.values) == pytest.approx(2.0 * np.array(action.values))
    with pytest.raises(PolicyError, match=r"goal x 1 lies .* between 0.6 and 0.9"):
        policy.act(1.0, rope(0.3, length=0.5, diameter=0.02))


def test_policy_without_parameters_sees_none_and_has_one_range(make_policy):
    policy, session = make_policy(conditioned_on=())
    action = policy.act(0.44, rope(0.5))
    assert set(session.fed) == {"goal_x"} and action.network_input == {}
    assert policy.goal_range(rope(0.5)) == pytest.approx(0.25 * np.array([[1.1, 1.8]]))
    assert policy.act(0.44, rope(0.05, nu=0.49)).warnings == ()


def test_a_policy_that_does_not_see_the_thickness_says_what_it_was_trained_with(
    make_policy, description
):
    """Also one of a file of before, which does not hold it."""
    ranges = {n: ends for n, ends in description.parameters.items() if n != "thickness_ratio"}
    policy, _ = make_policy(parameters=ranges)
    assert Description.from_json(policy.description.to_json(), where="x").parameters == ranges
    assert policy.act(0.35, rope(diameter=0.016)).warnings == ()
    (said,) = policy.act(0.35, rope(diameter=0.028)).warnings
    assert "(thickness over size) is 0.112, the policy was trained with 0.056 to 0.056" in said
    seen, _ = make_policy(parameters=ranges | {"thickness_ratio": (0.01, 0.1155)})
    assert seen.act(0.35, rope(diameter=0.028)).warnings == ()


def test_action_beyond_the_limits_is_moved_into_them(make_policy):
    policy, session = make_policy()
    session.offset = 0.5
    action = policy.act(0.35, rope())
    release, task = np.array(action.values), policy.task()
    task.check_action(rope(), release)
    with pytest.raises(ParameterError, match="out of limits"):
        task.check_action(rope(), [release[0] + 1e-4, release[1]])
    assert "moved by" in action.warnings[0]


def test_what_a_policy_cannot_take_is_refused(make_policy, description):
    policy, session = make_policy()
    policy.actions([1.4] * 3, {"bending_ratio": [0.1, 0.5, 2.0], "nu": 0.3})
    assert session.fed["bending_ratio"][:, 0] == pytest.approx([0.25, 0.5, 0.7])
    with pytest.raises(PolicyError, match="needs nu"):
        policy.actions([1.4], {"bending_ratio": 0.4})
    with pytest.raises(PolicyError, match="nu must be finite"):
        policy.actions([1.4], {"bending_ratio": 0.4, "nu": math.nan})
    both = policy.actions([1.4, 1.5], {**dimensionless_parameters(rope()), "nu": [0.3, 0.3]})
    assert both.shape == (2, 2)
    # another kind of object is refused
    policy, _ = make_policy()
    with pytest.raises(ParameterError, match="takes a rope, not a cloth"):
        policy.act(0.35, Cloth(side=0.2, thickness=0.001))
    # unknown task is refused
    for task in ({"name": "rope-juggling"}, description.task | {"colour": "red"}):
        policy, _ = make_policy(task=task)
        with pytest.raises(PolicyError, match=r"unknown here|there is no task"):
            policy.task()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda d: d.update(format="gendom-policy/1"), "'gendom-policy/3' and 'gendom-policy/2'"),
        (lambda d: d.pop("task"), "missing required field task"),
        (lambda d: d["parameters"].pop("nu"), r"lacks parameters\.nu"),
        (lambda d: d["inputs"][0].update(scale="red"), r"inputs\[0\]\.scale: expected float"),
        (lambda d: d.update(goals=3), "goals: expected object, got int"),
        (lambda d: d["training"].update(acted=3), "training: acted: expected object"),
        (lambda d: d["goals"]["at"].reverse(), "its goals are no ranges of 1 number"),
    ],
)
def test_broken_descriptions_are_refused(description, change, text):
    assert Description.from_json(description.to_json(), where="x.onnx") == description
    value = json.loads(description.to_json())
    change(value)
    with pytest.raises(PolicyError, match=text):
        Description.from_json(json.dumps(value), where="x.onnx")


def test_files_that_are_no_policies_are_refused(tmp_path):
    with pytest.raises(PolicyError, match="no such file"):
        Policy.read(tmp_path / "none.onnx")
    with pytest.raises(PolicyError, match="is a folder"):
        Policy.read(tmp_path)
    text = tmp_path / "text.onnx"
    text.write_text("not a network")
    with pytest.raises(PolicyError, match="is not an ONNX file"):
        Policy.read(text)
    # missing pretrained policy is told
    with pytest.raises(PolicyError, match=r"gendom dataset cloth-spreading"):
        Policy.pretrained("cloth-spreading", parameters=False)
    with pytest.raises(ParameterError, match=r"there is no task 'rope-juggling'; choose rope-r"):
        Policy.pretrained("rope-juggling")


def field(number, value):
    """A field of a message: a whole number, or bytes."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    return varint(number << 3 | 2) + varint(len(value)) + value


def varint(n):
    return bytes([*[n & 127 | 128] * (n > 127), *varint(n >> 7)]) if n > 127 else bytes([n])


def weights(*sides, packed=True):
    own = field(1, b"".join(map(varint, sides))) if packed else b"".join(field(1, n) for n in sides)
    return field(5, own)


def operation(inputs=1, name=b"Add"):
    return field(1, field(1, b"x") * inputs + field(4, name))


def test_a_policy_that_was_changed_is_refused(tmp_path):
    whole = (resources.files("gendom") / "assets" / "rope-reaching.onnx").read_bytes()
    assert sealed(whole) == whole and whole.count(SEAL) == 1
    path, rng = tmp_path / "p.onnx", np.random.default_rng(0)
    for at in rng.integers(8 * len(whole), size=20):
        data = bytearray(whole)
        data[at // 8] ^= 1 << (at % 8)
        path.write_bytes(data)
        with pytest.raises(PolicyError, match="is damaged: it is not what was written"):
            Policy.read(path)
    path.write_bytes(whole.partition(SEAL)[0])  # as 0.1 wrote it
    kept = Policy.read(path).description
    path.write_bytes(sealed(path.read_bytes()))
    assert path.read_bytes() == whole and Policy.read(path).description == kept


def graph(path, inputs, metadata, outputs=2):
    """An ONNX file that adds its inputs, and gives the sum as each number of an action."""
    onnx = pytest.importorskip("onnx", reason="needs the extra `train`")
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    network = helper.make_graph(
        [
            helper.make_node("Sum", inputs, ["sum"]),
            helper.make_node("Concat", ["sum"] * outputs, ["action"], axis=1),
        ],
        "sum",
        [helper.make_tensor_value_info(name, kind, ["batch", 1]) for name in inputs],
        [helper.make_tensor_value_info("action", kind, ["batch", outputs])],
    )
    model = helper.make_model(network, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, metadata)
    onnx.save(model, str(path))
    return path


def test_onnx_files_must_describe_themselves(tmp_path, description):
    names = ["goal_x", "bending_ratio", "nu"]
    about = {"gendom-policy": description.to_json()}
    policy = Policy.read(graph(tmp_path / "good.onnx", names, about))
    actions = policy.actions([1.0, 2.0], {"bending_ratio": 0.5, "nu": 0.25})
    assert actions == pytest.approx(np.array([[1.75] * 2, [2.75] * 2]))
    with pytest.raises(PolicyError, match="without 'gendom-policy' metadata"):
        Policy.read(graph(tmp_path / "bare.onnx", names, {}))
    with pytest.raises(PolicyError, match="does not say"):
        Policy.read(graph(tmp_path / "other.onnx", names[:2], about))
    # it is tried when it is read
    with pytest.raises(PolicyError, match=r"actions of shape \(1, 1\)"):
        Policy.read(graph(tmp_path / "one.onnx", names, about, outputs=1))
