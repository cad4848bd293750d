"""Policies and what is learnt from executions, beside formulas and slow searches."""

import hashlib
import logging
import math
from dataclasses import replace
from functools import partial
from importlib import resources
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from gendom.errors import ParameterError, PolicyError
from gendom.materials import dimensionless_parameters
from gendom.policies import GoalRange, Policy
from gendom.policies.adaptation import Execution, adapt
from gendom.policies.graph import SEAL, _fields, _packed, _varint, check_graph, sealed
from gendom.policies.policy import Action, Column, _asset, _least
from gendom.tasks.task import Outcome
from policies.ballistic import ROPE, TASK, Throws, reach_of
from policies.conftest import FakeSession, describe
from policies.test_adapt import KNOWN, POSTERIOR, belief_of, executed
from policies.test_policy import field, operation, rope, varint, weights

NS: Any = SimpleNamespace

# ---- learning from executions --------------------------------------------------------------------

ACTIONS = np.array([[0.4, 0.4], [0.42, 0.43], [0.3, 0.45], [0.5, 0.35]])
OFFS = (0.01, -0.015, 0.02, 0.0)


def reached(belief, vector):
    """[N] in lengths, of `ACTIONS`."""
    alike = dimensionless_parameters(belief.at(vector))
    known = alike["bending_ratio"], alike["damping"]
    return np.array([reach_of(x, z, *known) for x, z in ACTIONS])


def gram(a, b):
    """8 mm of a metre, alike over 5 cm of one."""
    return np.array(
        [[0.008**2 * math.exp(-0.5 * ((x - y) @ (x - y)) / 0.05**2) for y in b] for x in a]
    )


def test_a_belief_is_the_most_likely_one_and_the_rest_a_gaussian_process():
    """By a simplex search of the same sum of squares, and normal equations."""
    belief = belief_of(ROPE, POSTERIOR, known=KNOWN)
    seen = [executed(*a, off=off) for a, off in zip(ACTIONS, OFFS, strict=True)]
    found = adapt(TASK, belief, seen, world=Throws())
    L = ROPE.length
    y, K = np.array([e.reached[0] for e in seen]) / L, gram(ACTIONS, ACTIONS) + 0.002**2 * np.eye(4)
    prior = np.linalg.inv(belief.covariance)

    def cost(z):
        v = belief.mean + z * belief.sd
        r, d = y - reached(belief, v), v - belief.mean
        return r @ np.linalg.solve(K, r) + d @ prior @ d

    best = minimize(
        cost, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10}
    )
    at = belief.mean + best.x * belief.sd
    np.testing.assert_allclose((found.belief.mean - at) / belief.sd, 0.0, atol=0.02)
    mean = found.belief.mean
    h = 1e-4 * belief.sd
    J = np.stack([(reached(belief, mean + d) - reached(belief, mean - d)) / (2.0 * abs(d).max())
                  for d in np.diag(h)], axis=1)  # fmt: skip
    covariance = np.linalg.inv(J.T @ np.linalg.solve(K, J) + prior)
    np.testing.assert_allclose(found.belief.covariance, covariance, rtol=0.02, atol=1e-7)
    left = y - reached(belief, mean)
    np.testing.assert_allclose(found.residuals[:, 0], left * L, atol=1e-9)
    assert found.discrepancy is not None
    for at in (ACTIONS[0], ACTIONS[1] + 0.02, np.array([0.9, 0.1])):
        k = gram([at], ACTIONS)[0]
        by, deviation = found.discrepancy(at * L)
        assert by == pytest.approx([k @ np.linalg.solve(K, left) * L], abs=1e-9)
        variance = 0.008**2 - k @ np.linalg.solve(K, k)
        assert deviation == pytest.approx(math.sqrt(variance) * L, rel=1e-6)
    # where it is all known, only the rest is found
    fixed = adapt(TASK, belief, seen, world=Throws(), refine=False)
    np.testing.assert_array_equal(fixed.belief.mean, belief.mean)
    np.testing.assert_allclose(fixed.belief.covariance, belief.covariance)
    np.testing.assert_allclose(fixed.residuals[:, 0], (y - reached(belief, belief.mean)) * L)


ASKED: list[float] = []


class Bends(Throws):
    """Reaches that bend back beyond some E, so that whole steps gain nothing."""

    def carry_out(self, task, items, actions, **_):
        found = []
        for item in items:
            x = math.log(item.material.E / ROPE.material.E)
            ASKED.append(round(x, 9))
            bad = x > self.risky_above
            found.append(Outcome(values={}, fault="burst") if bad else Outcome(
                values={"x": item.length * (1.0 + self.off * math.tanh(60.0 * x)), "sideways": 0.0}
            ))  # fmt: skip
        return found


@pytest.mark.parametrize("most", [9.0, 0.02])
def test_the_best_of_four_shares_of_a_step_is_taken(most):
    """A step of the slope at the middle goes too far; a world that fails is none of them."""
    posterior = {"names": ["E_over_rho"], "mean": [math.log(8e5 / 900)], "covariance": [[0.3**2]]}
    belief = belief_of(ROPE, posterior, known=("nu", "friction", "damping"))
    seen = Execution(action=np.array([0.12, 0.12]), reached=np.array([0.3 * 1.05]))
    world = Bends(off=0.05, risky_above=most)
    ASKED.clear()
    found = adapt(TASK, belief, [seen], world=world)
    h = 0.05 * 0.3
    slope = 0.05 * math.tanh(60.0 * h) / h
    variance = 0.008**2 + 0.002**2
    H = slope**2 / variance + 1.0 / 0.3**2
    step = slope * 0.05 / variance / H
    assert ASKED[:3] == pytest.approx([0.0, h, -h], abs=1e-6)
    assert ASKED[3:7] == pytest.approx([step * s for s in (1.0, 0.5, 0.25, 0.1)], abs=1e-6)
    costs = [(0.05 - 0.05 * math.tanh(60.0 * x)) ** 2 / variance + (x / 0.3) ** 2
             if x < most else math.inf for x in ASKED[3:7]]  # fmt: skip
    best = ASKED[3:7][int(np.argmin(costs))]
    assert (best == ASKED[3]) is (most > 1.0)
    assert ASKED[7:9] == pytest.approx([best + h, best - h], abs=1e-6)
    # where one end of the differences fails they say nothing
    assert (found.belief.sd[0] < 0.29) == (most > 1.0)


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
