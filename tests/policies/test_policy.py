"""Using a policy: scaling, ranges, warnings, and faults of its file."""

import json
import logging
import math
from importlib import resources

import numpy as np
import pytest

from gendom.errors import ParameterError, PolicyError
from gendom.materials import Cloth, Material, Rope, dimensionless_parameters
from gendom.policies import Description, GoalRange, Policy
from gendom.policies.graph import SEAL, check_graph, sealed
from gendom.policies.policy import Column
from gendom.tasks import ClothSpreading
from policies.conftest import FakeSession, describe

ASSETS = resources.files("gendom") / "assets"


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


GOOD = json.loads(describe().to_json())
TRAINED = {"demonstrations": 9, "seed": 0, "epochs": 0, "architecture": "", "refine": 1}
CHANCE = {"method": "chance", "candidates": [[0.1, 0.2]]}
NO_RANGES = "its goals are no ranges of 1 numbers"


def ranges(at, low, high):
    return {"goals": {"at": at, "low": low, "high": high}}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"format": "gendom-policy/1"}, "'gendom-policy/3' and 'gendom-policy/2'"),
        ({"task": None}, "missing required field task"),
        ({"inputs": [GOOD["inputs"][0] | {"scale": "red"}]}, "inputs[0].scale: expected float"),
        ({"goals": 3}, "goals: expected object, got int"),
        ({"training": {"acted": 3}}, "training: acted: expected object"),
        ({"training": {"demonstrations": 9}},
         "lacks training.seed, training.epochs, training.architecture;"),
        ({"training": TRAINED}, "lacks training.refine_cases;"),
        ({"training": TRAINED | {"refine": 0}}, None),
        ({"training": {"refine": 3}}, None),
        ({"task": {}}, "lacks task.name, task.item, task.ranges;"),
        ({"parameters": {"nu": [0.2, 0.4]}}, "lacks parameters.bending_ratio, parameters.damping"),
        (ranges([], [], []), NO_RANGES),
        (ranges([0.0, 0.1], [[1.0]] * 2, [[2.0]] * 2), NO_RANGES),
        (ranges([0.2, 0.1], [[1.0]] * 2, [[2.0]] * 2), NO_RANGES),
        (ranges([0.2, 0.2], [[1.0]] * 2, [[2.0]] * 2), None),
        (ranges([0.2], [[1.0]], [[2.0]]), None),
        (ranges([0.3, 0.5], [[1.0]], [[2.0]] * 2), NO_RANGES),
        (ranges([0.3, 0.5], [[1.0], []], [[2.0]] * 2), NO_RANGES),
        ({"conditioned_on": ["nu", "colour"]}, "is conditioned on nu, colour;"),
        ({"parameters": GOOD["parameters"] | {"nu": [0.3, 0.3]}}, None),
        ({"parameters": GOOD["parameters"] | {"nu": [0.31, 0.3]}},
         "has a range of parameters that ends before it begins;"),
        ({"method": "chance"}, "has no actions to choose among;"),
        ({"candidates": [[0.1, 0.2]]}, "has no actions to choose among;"),
        (CHANCE, None),
        (CHANCE | {"candidates": [[0.1, 0.2], [0.1]]},
         "its actions to choose among are not of 2 numbers;"),
    ],
)  # fmt: skip
def test_broken_descriptions_are_refused(description, changes, said):
    assert Description.from_json(json.dumps(GOOD), where="x.onnx") == description
    value = {name: own for name, own in (GOOD | changes).items() if own is not None}
    if said is None:
        Description.from_json(json.dumps(value), where="x.onnx")
        return
    with pytest.raises(PolicyError) as caught:
        Description.from_json(json.dumps(value), where="x.onnx")
    assert str(caught.value).startswith("x.onnx: gendom-policy") and said in str(caught.value)


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
    assert Policy.ships("rope-reaching") and not Policy.ships("cloth-spreading", parameters=False)
    shipped = sorted(path.name for path in ASSETS.iterdir() if path.name.endswith(".onnx"))
    assert [policy.where.split("/")[-1] for policy in Policy.shipped()] == shipped


def test_a_policy_that_was_changed_is_refused(tmp_path):
    whole = (ASSETS / "rope-reaching.onnx").read_bytes()
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


FIXED = varint(9 << 3 | 1) + b"\xff" * 8 + varint(9 << 3 | 5) + b"\xff" * 4
LONGEST = b"\x48" + b"\xff" * 9 + b"\x01"
"""Fields that are skipped: of 8 and of 4 bytes, and a whole number of as many bytes as may be."""
NO_POLICY = "has the operator {!r}, which no policy has"
TOO_LARGE = "has weights of shape {}, at most two sides of 4096 are read"
CUT = [FIXED[:5], FIXED[:-1], b"\x48", b"\xff", b"\x4a\x03ab", b"\x48" + b"\xff" * 10 + b"\x01"]
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
    (field(9, 0) + LONGEST + operation(name=b"Loop"), NO_POLICY.format("Loop")),
    *((cut, "is not an ONNX file") for cut in CUT),
    (varint(9 << 3 | 3) + b"xx", "is not an ONNX file"),
    (field(15, b""), "has sparse weights"),
    (field(16, b"") + field(5, field(0, 5000)), None),
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
    with pytest.raises(PolicyError) as caught:
        Policy.read(tmp_path / "p.onnx")
    fix = "check that it is a policy written by gendom train"
    assert str(caught.value) == f"{tmp_path / 'p.onnx'}: {said}; {fix}"


def test_ranges_of_goals_are_interpolated_in_the_logarithm():
    ends = GoalRange(at=(0.1, 1.0), low=((1.0, 5.0), (2.0, 4.0)), high=((3.0, 9.0), (4.0, 8.0)))
    np.testing.assert_allclose(ends(None), [[1.0, 4.0], [4.0, 9.0]])
    np.testing.assert_allclose(ends(10.0**-0.5), [[1.5, 3.5], [4.5, 8.5]])
    np.testing.assert_allclose(ends(0.01), [[1.0, 3.0], [5.0, 9.0]])
    assert GoalRange(at=(0.1,), low=((),), high=((),))(0.3).shape == (0, 2)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ([[0.1, 0.2]] * 2, "of shape (2, 2)"),
        ([[0.1, np.inf]], "that are not finite"),
        (RuntimeError("x"), "not at all (RuntimeError)"),
    ],
)
def test_a_network_is_tried_at_the_middle_of_its_ranges(make_policy, answer, said):
    policy, session = make_policy()
    assert policy._tried() is policy
    middle = {"goal_x": 1.45, "bending_ratio": 0.475, "nu": 0.3}
    assert {name: value[0, 0] for name, value in session.fed.items()} == pytest.approx(middle)
    session.answer = answer
    with pytest.raises(PolicyError) as caught:
        policy._tried()
    assert str(caught.value) == f"fake.onnx: its network gives actions {said}; train it again"


@pytest.mark.parametrize(
    ("ratio", "nu", "name", "beyond"),
    [
        (0.4, 0.3, None, None),
        (0.7 * 1.0099, 0.3, "bending_ratio", None),
        (0.7 * 1.0101, 0.3, "bending_ratio", "1.01 % above the range 0.25 to 0.7"),
        (0.4, 0.2 * 0.9901, "nu", None),
        (0.4, 0.2 * 0.9899, "nu", "1.01 % below the range 0.2 to 0.4"),
    ],
)
def test_parameters_outside_are_told_and_refused_from_a_hundredth_on(
    make_policy, ratio, nu, name, beyond, caplog
):
    (policy, session), item = make_policy(), rope(ratio, nu)
    low, high = policy.goal_range(item)[0]
    goal = 0.5 * (low + high)
    if beyond is not None:
        fix = r"; check the object's numbers, or force it \(--force\)"
        said = f"^fake.onnx: {name} .*{beyond} that the policy was trained on{fix}"
        with pytest.raises(PolicyError, match=said):
            policy.act(goal, item)
    action = policy.act(goal, item, force=beyond is not None)
    used = {"bending_ratio": min(ratio, 0.7), "nu": max(nu, 0.2)}
    assert action.network_input == pytest.approx(used) and action.goal == {"x": goal}
    assert tuple(r.message for r in caplog.records) == action.warnings
    assert [w.partition(" (")[0] for w in action.warnings] == [name] * (name is not None)
    assert all(w.endswith(f"; it uses {used[name]:.4g}") for w in action.warnings)
    for off, end in ((-0.001, low), (0.001, high)):
        with pytest.raises(PolicyError, match=f"choose one between {low:.4g} and {high:.4g}"):
            policy.act(end + off, item)
        told = policy.act(end + off, item, force=True).warnings[0]
        assert "lies outside what the policy was" in told
        assert 0.25 * session.fed["goal_x"][0, 0] == pytest.approx(end, rel=1e-6)


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
    """Gives a chance that grows with A, and the more the larger nu is."""

    def run(self, names, feed):
        assert names == ["chance"]
        return [0.1 + 0.5 * feed["A"] * (0.7 + feed["nu"])]


def test_the_first_of_the_surest_actions_is_chosen_for_all_likely_objects():
    """Of those that are less sure by at most 3 thousandths than the surest."""
    task, known = ClothSpreading(), ((0.2,), (0.5941,), (0.6,))
    columns = tuple(Column(name=n, mean=0.0, scale=1.0) for n in ("A", "nu"))
    about = describe(
        ("nu",), task={"name": task.name, **task.settings()}, method="chance", candidates=known,
        inputs=columns, outputs=columns[:1], goals=GoalRange(at=(0.3,), low=((),), high=((),)),
    )  # fmt: skip
    policy = Policy(Chances(), about, where="f")
    item, *likely = (
        Cloth(side=0.2, thickness=0.001, material=Material(nu=nu)) for nu in (0.3, 0.25, 0.35, 0.38)
    )
    alone, all_likely = policy.act((), item), policy.act((), item, likely=likely)
    assert alone.action == {"A": 0.5941}
    assert alone.chance == pytest.approx(0.1 + 0.5 * 0.5941)
    assert all_likely.action == {"A": 0.6}  # of the next the mean is 3.03 thousandths less
    assert all_likely.chance == pytest.approx(0.1 + 0.5 * 0.6 * (0.7 + 0.98 / 3.0))
    every = policy.actions(np.zeros((2, 0)), {"nu": [0.3, 0.4]})
    np.testing.assert_allclose(every, [[0.5941], [0.6]])
