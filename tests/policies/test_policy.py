"""Using a policy: scaling, ranges, warnings, and faults of its file."""

import hashlib
import json
import logging
import math
from dataclasses import replace
from functools import partial
from importlib import resources

import numpy as np
import pytest

from gendom.errors import ParameterError, PolicyError
from gendom.materials import Cloth, Material, Rope, dimensionless_parameters
from gendom.policies import Description, GoalRange, Policy
from gendom.policies.graph import SEAL, _fields, _packed, _varint, check_graph, sealed
from gendom.policies.policy import Action, Column, _asset, _least
from policies.conftest import FakeSession, describe


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


@pytest.mark.parametrize("n", [0, 1, 127, 128, 300, 2**32, 2**63 - 1])
def test_whole_numbers_of_all_sizes(n):
    data = memoryview(b"\xff" + varint(n) + b"\x05")
    assert _varint(data, 1) == (n, 1 + len(varint(n)))
    assert list(_fields(memoryview(field(3, n) + field(9, b"ab")))) == [(3, n), (9, b"ab")]
    assert _packed(memoryview(varint(n) * 3)) == [n] * 3
    for bad in (b"", b"\xff", b"\xff" * 10 + b"\x01", b"\x80" * 10):
        with pytest.raises(ValueError, match="cut short"):
            _varint(memoryview(bad), 0)
    assert _varint(memoryview(b"\xff" * 9 + b"\x01"), 0)[1] == 10
    assert len(_packed(memoryview(b"\x01" * 100))) == 64
    fixed = varint(2 << 3 | 1) + bytes(range(8)) + varint(3 << 3 | 5) + bytes(range(4))
    wanted = [(2, bytes(range(8))), (3, bytes(range(4)))]
    assert [(k, bytes(v)) for k, v in _fields(memoryview(fixed))] == wanted  # type: ignore
    for cut in (fixed[:-1], fixed[:8], varint(2 << 3 | 2) + b"\x03ab"):
        with pytest.raises(ValueError, match="cut short"):
            list(_fields(memoryview(cut)))


FIXED = varint(9 << 3 | 1) + b"\xff" * 8 + varint(9 << 3 | 5) + b"\xff" * 4
NO_POLICY = "has the operator {!r}, which no policy has"
TOO_LARGE = "has weights of shape {}, at most two sides of 4096 are read"
GRAPHS = [
    (field(1, 3) + field(5, 4), None),
    (weights(4096, 4096) + weights(4096, packed=False), None),
    (weights(4097, 1), TOO_LARGE.format([4097, 1])),
    (weights(1, 4097), TOO_LARGE.format([1, 4097])),
    (weights(4097, packed=False), TOO_LARGE.format([4097])),
    (weights(2, 2, 2), TOO_LARGE.format([2, 2, 2])),
    (weights(*range(9, 19)), TOO_LARGE.format(list(range(9, 17)))),
    (operation(64) + operation(name=b"Concat"), None),
    (operation(65), "joins more than a policy does"),
    (2 * operation(name=b"Concat"), "joins more than a policy does"),
    (256 * operation(), None),
    (257 * operation(), "has more than 256 nodes and tensors"),
    (FIXED + operation(), None),
    (FIXED + operation(name=b"ConstantOfShape"), NO_POLICY.format("ConstantOfShape")),
    (operation(name=b"L" * 70), NO_POLICY.format("L" * 60)),
    (field(1, field(1, b"x")), NO_POLICY.format("")),
    (operation(name=b"\xff"), "is not an ONNX file"),
    (FIXED[:5], "is not an ONNX file"),
    (varint(9 << 3 | 3) + b"xx", "is not an ONNX file"),
    (field(15, b""), "has sparse weights"),
    (field(5, field(13, b"")), "keeps weights in another file"),
    (field(5, field(14, 1)), "keeps weights in another file"),
    (field(5, field(14, 0)), None),
]


@pytest.mark.parametrize(
    ("model", "said"),
    [
        *((before + field(7, graph), said) for graph, said in GRAPHS
          for before in (b"", FIXED + field(1, 8))),
        (field(20, b""), "holds functions of its own"),
        (field(25, 1), "holds functions of its own"),
        (field(7, 3), None),
        (b"\x07", "is not an ONNX file"),
        (b"a" + SEAL + b"0" * 64, "is damaged: it is not what was written"),
    ],
)  # fmt: skip
def test_what_a_file_may_hold(model, said, tmp_path):
    """Else it is refused before it runs: it could take all memory, or read another file."""
    if said is None:
        return check_graph(model, "p")
    (tmp_path / "p.onnx").write_bytes(model)
    for read, where in ((Policy.read, tmp_path / "p.onnx"), (partial(check_graph, model), "p")):
        with pytest.raises(PolicyError) as caught:
            read(where)
        fix = "; check that it is a policy written by gendom train"
        assert str(caught.value) == f"{where}: {said}{fix}"


def test_a_seal_is_the_digest_of_what_is_before():
    own = sealed(b"abc")
    assert own == b"abc" + SEAL + hashlib.sha256(b"abc").hexdigest().encode()
    assert sealed(own) == own
    assert _asset("a", True) == "a.onnx" and _asset("a", False) == "a-no-parameters.onnx"
    assert Policy.ships("rope-reaching") and not Policy.ships("none")
    shipped = sorted(p.name for p in (resources.files("gendom") / "assets").iterdir()
                     if p.name.endswith(".onnx"))  # fmt: skip
    assert [p.where.split("/")[-1] for p in Policy.shipped()] == shipped
    with pytest.raises(ParameterError, match="there is no task"):
        Policy.pretrained("juggling")


def test_ranges_of_goals_are_interpolated_in_the_logarithm():
    ends = GoalRange(at=(0.1, 1.0), low=((1.0, 5.0), (2.0, 4.0)), high=((3.0, 9.0), (4.0, 8.0)))
    np.testing.assert_allclose(ends(None), [[1.0, 4.0], [4.0, 9.0]])
    np.testing.assert_allclose(ends(10.0**-0.5), [[1.5, 3.5], [4.5, 8.5]])
    np.testing.assert_allclose(ends(0.01), [[1.0, 3.0], [5.0, 9.0]])
    assert GoalRange(at=(0.1,), low=((),), high=((),))(0.3).shape == (0, 2)


def test_descriptions_say_what_acting_relies_on():
    good = describe()
    assert list(good._faults()) == [] and good.goal_names == ("x",)
    trained = {"demonstrations": 9, "seed": 0, "epochs": 0, "architecture": "", "refine": 1}
    chances = {"method": "chance", "candidates": ((0.1, 0.2),)}
    at = (0.3, 0.5)
    for changes, said in (
        ({"training": {"demonstrations": 9}},
         "lacks training.seed, training.epochs, training.architecture"),
        ({"training": trained}, "lacks training.refine_cases"),
        ({"training": trained | {"refine": 0}}, None),
        ({"training": {"refine": 3}}, None),
        ({"task": {}}, "lacks task.name, task.item, task.ranges"),
        ({"goals": GoalRange(at=(), low=(), high=())}, "its goals are no ranges of 1 numbers"),
        ({"goals": GoalRange(at=(0.0, 0.1), low=((1.0,),) * 2, high=((2.0,),) * 2)},
         "its goals are no ranges of 1 numbers"),
        ({"goals": GoalRange(at=(0.2, 0.2), low=((1.0,),) * 2, high=((2.0,),) * 2)}, None),
        ({"goals": GoalRange(at=(0.2,), low=((1.0,),), high=((2.0,),))}, None),
        ({"goals": GoalRange(at=at, low=((1.0,),), high=((2.0,),) * 2)},
         "its goals are no ranges of 1 numbers"),
        ({"goals": GoalRange(at=at, low=((1.0,), ()), high=((2.0,),) * 2)},
         "its goals are no ranges of 1 numbers"),
        ({"conditioned_on": ("nu", "colour")}, "is conditioned on nu, colour"),
        ({"parameters": good.parameters | {"nu": (0.3, 0.3)}}, None),
        ({"parameters": good.parameters | {"nu": (0.31, 0.3)}},
         "has a range of parameters that ends before it begins"),
        ({"method": "chance"}, "has no actions to choose among"),
        ({"candidates": ((0.1, 0.2),)}, "has no actions to choose among"),
        (chances, None),
        (chances | {"candidates": ((0.1, 0.2), (0.1,))},
         "its actions to choose among are not of 2 numbers"),
    ):  # fmt: skip
        assert next(replace(good, **changes)._faults(), None) == said
    assert not good.inputs[0].log
    words = replace(good, training={"demonstrations": 7}), replace(good, conditioned_on=())
    shown = [Policy(None, w, where="f")._shown() for w in words]
    assert shown[0] == ("Policy (rope-reaching, distal)", [
        ("conditioned on", "bending_ratio, nu"), ("goal", "x"),
        ("trained", "on 7 demonstrations"), ("file", "f"),
    ])  # fmt: skip
    assert shown[1][1][0] == ("conditioned on", "no parameters")
    assert shown[1][1][2] == ("trained", "on ? demonstrations")
    action = Action(goal={}, action={"a": 1.0, "b": 2.0}, network_input={})
    assert action.values == (1.0, 2.0) and action.chance is None and action.warnings == ()


class Odd(FakeSession):
    """A network that gives other numbers."""

    def __init__(self, out):
        super().__init__()
        self.out = out

    def run(self, names, feed):
        super().run(names, feed)
        if isinstance(self.out, Exception):
            raise self.out
        return [np.array(self.out, np.float32)]


@pytest.mark.parametrize(
    ("out", "said"),
    [
        ([[0.1, 0.2]], None),
        ([[0.1]], "of shape (1, 1)"),
        ([[0.1, 0.2]] * 2, "of shape (2, 2)"),
        ([[0.1, np.inf]], "that are not finite"),
        (RuntimeError("x"), "not at all (RuntimeError)"),
    ],
)
def test_a_network_is_tried_at_the_middle_of_its_ranges(out, said):
    policy = Policy(session := Odd(out), describe(), where="f")
    if said is None:
        assert policy._tried() is policy
        assert session.fed["goal_x"] == pytest.approx(np.array([[1.45]]))
        assert session.fed["bending_ratio"] == pytest.approx(np.array([[0.475]]))
        assert session.fed["nu"] == pytest.approx(np.array([[0.3]]))
        return
    with pytest.raises(PolicyError) as caught:
        policy._tried()
    assert str(caught.value) == f"f: its network gives actions {said}; train it again"


@pytest.mark.parametrize(
    ("ratio", "nu", "said", "forced"),
    [
        (0.4, 0.3, [], None),
        (0.7 * 1.0099, 0.3, ["bending_ratio"], None),
        (0.7 * 1.0101, 0.3, ["bending_ratio"], "1.01 % above the range 0.25 to 0.7"),
        (0.4, 0.2 * 0.9901, ["nu"], None),
        (0.4, 0.2 * 0.9899, ["nu"], "1.01 % below the range 0.2 to 0.4"),
    ],
)
def test_parameters_outside_are_told_and_refused_from_a_hundredth_on(
    ratio, nu, said, forced, caplog
):
    policy, item = Policy(FakeSession(), describe(), where="f"), rope(ratio, nu)
    low, high = policy.goal_range(item)[0]
    goal = 0.5 * (low + high)
    used, words, beyond = policy._clipped(np.array([goal]), item)
    assert used["goal_x"] == goal and used["bending_ratio"] == pytest.approx(min(ratio, 0.7))
    assert used["nu"] == pytest.approx(max(nu, 0.2))
    assert [w.partition(" (")[0] for w in words] == said
    assert all(f"; it uses {used[name]:.4g}" in w for name, w in zip(said, words, strict=True))
    if forced is None:
        assert policy.act(goal, item).goal == {"x": goal}
        assert not beyond
    else:
        fix = "; check the object's numbers, or force it \\(--force\\)"
        with pytest.raises(
            PolicyError, match=f"^f: .*{forced} that the policy was trained on{fix}"
        ):
            policy.act(goal, item)
        action = policy.act(goal, item, force=True)
        assert tuple(r.message for r in caplog.records) == action.warnings == tuple(words)
        assert action.network_input == {n: used[n] for n in ("bending_ratio", "nu")}
    for off, ends in ((-0.001, low), (0.001, high)):
        clipped, told, refused = policy._clipped(np.array([ends + off]), item)
        assert clipped["goal_x"] == ends and "lies outside what the policy was" in told[0]
        assert next(iter(refused.values())) == f"choose one between {low:.4g} and {high:.4g}"


def test_goals_of_another_unit_are_refused_even_if_forced(caplog):
    """From ten times what can be reached on."""
    policy, item = Policy(FakeSession(), describe(), where="f"), rope(0.3)
    _, high = policy.goal_range(item)[0]
    with caplog.at_level(logging.WARNING, logger="gendom"):
        policy.act(9.99 * high, item, force=True)
    assert len(caplog.records) == 1
    for goal in (10.01 * high, -10.01 * high):
        with pytest.raises(
            PolicyError, match=r"m, 10 times as far as such a rope can reach; choose"
        ):
            policy.act(goal, item, force=True)
    zero = describe(goals=GoalRange(at=(0.3,), low=((0.0,),), high=((0.001,),)))
    policy = Policy(FakeSession(), zero, where="f")
    policy.act(9.99 * 0.25, item, force=True)  # of the object's size at least
    with pytest.raises(PolicyError, match="10 times as far"):
        policy.act(10.01 * 0.25, item, force=True)
    for bad in ([0.3, 0.3], [], math.nan, math.inf):
        with pytest.raises(PolicyError, match=r"goal is .* give 1 finite number: x"):
            policy.act(bad, item)


class Chances(FakeSession):
    """Gives a chance that grows with the first number of an action, and with nu."""

    def run(self, names, feed):
        assert names == ["chance"]
        self.fed = feed
        return [(0.1 + 0.5 * feed["release_x"] + 0.1 * (feed["nu"] - 0.3) * feed["release_z"])]


def test_the_first_of_the_surest_actions_is_chosen_for_all_likely_objects():
    known = ((0.4, 0.2), (0.995, 0.3), (1.0, 0.3), (0.6, 0.1))
    columns = (Column(name=n, mean=0.0, scale=1.0) for n in ("release_x", "release_z", "nu"))
    chances = {"method": "chance", "candidates": known, "inputs": tuple(columns),
               "goals": GoalRange(at=(0.3,), low=((),), high=((),)),
               "conditioned_on": ("nu",)}  # fmt: skip
    policy = Policy(Chances(), describe(**chances), where="f")
    items = [rope(nu=0.25), rope(nu=0.35), rope(nu=0.38)]
    given = np.array([0.25, 0.35, 0.38])
    every = np.array([[0.1 + 0.5 * x + 0.1 * (nu - 0.3) * z for x, z in known] for nu in given])
    found = policy._chances_of_candidates({"nu": given}, 3)
    np.testing.assert_allclose(found, every, atol=1e-6)
    action, chance = policy._asked(np.zeros(0), {"nu": 0.3}, items)
    assert action.tolist() == [0.995, 0.3] and chance == pytest.approx(every.mean(axis=0)[1])
    action, chance = policy._asked(np.zeros(0), {"nu": 0.3}, ())
    assert chance == pytest.approx(0.1 + 0.5 * 0.995)
    np.testing.assert_allclose(policy.actions(np.zeros((2, 0)), {"nu": 0.3}), [[0.995, 0.3]] * 2)
    # 3 thousandths less are as good
    assert _least(np.array([0.5, 0.9971, 1.0])) == 1 and _least(np.array([0.5, 0.9969, 1.0])) == 2
    assert _least(np.array([[0.2, 0.1], [0.1, 0.2]])).tolist() == [0, 1]
