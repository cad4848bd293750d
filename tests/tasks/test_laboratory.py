"""Demonstrations that act for goals, as one would in a laboratory."""

from dataclasses import replace

import numpy as np

from gendom import cli
from gendom.materials import dimensionless_parameters, size_of
from gendom.policies import Policy
from gendom.policies.demonstrations import Demonstrations
from gendom.tasks import RopeCasting
from gendom.tasks.demonstrator import ACTION_NOISE, Demonstrator

TASK = RopeCasting()
ROPE = replace(TASK.item, length=0.5, diameter=0.028)


def test_actions_are_those_for_goals_that_the_object_reaches_with_some_noise():
    seen = []

    def acts(cases):
        seen.extend(zip(cases.items, cases.goal, strict=True))
        return np.full((len(cases), 1), 0.6 * size_of(ROPE))

    source = Demonstrator(task=TASK, items=(ROPE,), acts=acts)
    rngs = [np.random.default_rng([4, i]) for i in range(40)]
    way = source.draw(rngs)["way"] / size_of(ROPE)
    assert 0.7 * ACTION_NOISE < way.std() < 1.4 * ACTION_NOISE
    assert abs(way.mean() - 0.6) < 0.5 * ACTION_NOISE
    assert {item for item, _ in seen} == {ROPE}
    assert np.ptp([goal[0] for _, goal in seen]) > 0.1  # each has its own goal
    # a demonstration depends on its own seed alone, and says how it was drawn
    assert source.draw([np.random.default_rng([4, 7])])["way"][0] == 0.5 * way[7]
    assert source.about() != Demonstrator(task=TASK, items=(ROPE,)).about()


def test_a_set_of_a_policys_own_actions_stays_near_what_it_would_do(tmp_path, refused):
    policy = Policy.pretrained("rope-casting")
    words = ["dataset", "rope-casting", "--size", "20", "--out", str(tmp_path / "set"), "--policy"]
    for flags, says in (
        ([policy.where, "--cluster", "local"], "cannot share"),
        ([Policy.pretrained("rope-reaching").where], "is for rope-reaching"),
    ):
        assert says in refused(*words, *flags)
    assert cli.main([*words, policy.where]) == 0
    data = Demonstrations.read(tmp_path / "set")
    asked = policy.actions(data.goal, data.parameters)
    # what was reached, asked for again, asks for nearly the same: goals are those of the rope
    assert np.abs(asked - data.action).max() < 0.02
    usual = dimensionless_parameters(TASK.item)["bending_ratio"]
    assert np.ptp(data.parameters["bending_ratio"]) > 0.1 * usual
