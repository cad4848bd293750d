"""What every task shares: limits, draws, settings, registry; how our simulator does it, and
demonstrations that act for goals, as one would in a laboratory."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from gendom import cli, tasks
from gendom.errors import ParameterError
from gendom.materials import (
    PARAMETERS,
    Cloth,
    Material,
    Rope,
    dimensionless_parameters,
    size_of,
    to_columns,
    with_dimensionless,
)
from gendom.policies import Policy
from gendom.policies.demonstrations import Demonstrations
from gendom.tasks import RopeCasting, RopeReaching, find_task, load_task, rebuild, task_names
from gendom.tasks.demonstrator import ACTION_NOISE, Demonstrator
from gendom.tasks.task import DRAWN
from gendom.tasks.world import Simulation

ALL = [find_task(name) for name in task_names()]
each = pytest.mark.parametrize("kind", ALL, ids=[k.name for k in ALL])


def another_size(task):
    """The task's object, twice as large."""
    item = task.item
    return replace(item, **{name: 2.0 * getattr(item, name) for name in item.sizes})


@each
def test_settings_rebuild_a_task(kind):
    task = kind(ranges={"nu": (0.1, 0.2), "E_over_rho": (300.0, 400.0)})
    settings = json.loads(json.dumps({"name": task.name, **task.settings()}))
    assert rebuild(settings) == task
    assert rebuild(settings) != kind()
    with pytest.raises(ParameterError, match="unknown here"):
        rebuild(settings | {"colour": "red"})


@each
def test_draws_follow_the_seed_and_the_ranges(kind):
    task = kind()
    items = [task.draw_items([np.random.default_rng([3, i])])[0] for i in range(400)]
    assert task.draw_items([np.random.default_rng([3, 7])])[0] == items[7]
    own = dimensionless_parameters(task.item)
    alike = [dimensionless_parameters(item) for item in items]
    as_thick = {"thickness_ratio": own["thickness_ratio"]}
    columns = [
        {**to_columns(with_dimensionless(item, as_thick)), "density": item.material.density,
         "thickness_ratio": its["thickness_ratio"]}
        for item, its in zip(items, alike, strict=True)
    ]  # fmt: skip
    for name, (low, high) in task.ranges.items():
        values = np.array([c[name] for c in columns])
        assert 0.999 * low <= values.min() < values.max() <= 1.001 * high
        middle = math.sqrt(low * high) if DRAWN[name].log else 0.5 * (low + high)
        assert 160 < np.sum(values < middle) < 240
    for name, value in own.items():
        if (PARAMETERS[name].column or name) not in task.ranges:
            np.testing.assert_allclose([its[name] for its in alike], value, rtol=1e-12)


@each
def test_sampled_actions_are_allowed_at_every_size(kind):
    task = kind()
    for item in (task.item, another_size(task)):
        actions = task.sample_actions(item, np.random.default_rng(0), 300)
        low, high = task.limits(item).T
        for action in actions:
            np.testing.assert_array_equal(task.check_action(item, action), action)
            np.testing.assert_array_equal(task.nearest(item, action), action)
        if task.candidates:
            assert len(np.unique(actions, axis=0)) == len(task.candidates)
        else:
            assert np.all(actions.min(axis=0) < low + 0.1 * (high - low))
    large, small = another_size(task), task.item
    units = task.action_units(large) / task.action_units(small)
    np.testing.assert_allclose(task.limits(large), task.limits(small) * units[:, None])


@each
def test_actions_beyond_the_limits_are_moved_no_farther_than_needed(kind):
    task = kind()
    low, high = task.limits(task.item).T
    far = high + 3.0 * (high - low)
    moved = task.nearest(task.item, far)
    assert task.allows(task.item, moved)
    assert not task.allows(task.item, moved + 1e-4 * (far - moved))
    for action, said in ((math.nan, "finite number"), ([0.1] * 7, "finite number"),
                         (high + 1.0, f"{task.actions[0].name} in \\[")):  # fmt: skip
        with pytest.raises(ParameterError, match=said):
            task.check_action(task.item, action)


@each
def test_paths_are_alike_at_every_size(kind):
    """Twice the size: twice the way, the times sqrt(2) times as long; except fingers and pads."""
    task, large = kind(), another_size(kind())
    action = task.sample_actions(task.item, np.random.default_rng(1), 1)[0]
    units = task.action_units(large) / task.action_units(task.item)
    small_path = task.tool_path(task.item, action)
    large_path = task.tool_path(large, action * units)
    # a cloth that hangs clear of the table rises over the fingers' height, too
    late = 0.0021 / 0.5 if task.name == "cloth-dragging" else 1e-12
    np.testing.assert_allclose(large_path.time, math.sqrt(2.0) * small_path.time, atol=late)
    np.testing.assert_allclose(large_path.position, 2.0 * small_path.position, atol=0.0021)
    np.testing.assert_allclose(task.times(large), math.sqrt(2.0) * task.times(task.item))
    assert small_path.moves == pytest.approx(0.0, abs=1e-12)


def test_ranges_and_objects_are_checked():
    for ranges, says in [
        ({"mass": (1.0, 2.0)}, "unknown parameter 'mass'"),
        ({"nu": (0.4, 0.3)}, "range of nu: is 0.4 to 0.3; give two finite numbers, the lower"),
        ({"E_over_rho": (0.0, 1.0)}, "positive numbers"),
        ({"damping": (math.nan, 1.0)}, "range of damping"),
        ({"nu": (0.2, 0.6)}, r"range of nu: Poisson's ratio nu must lie in \(-1, 0.5\), got 0.6"),
        ({"nu": (0.2, 0.5)}, "range of nu"),
        ({"E_over_rho": (0.0, 0.0)}, "range of E_over_rho: Young's modulus E must be positive"),
        ({"damping": (1.0, 20.0)}, "range of damping: damping is 1 s; give s: 1 ms are 0.001 s"),
        ({"density": (0.5, 1.5)}, "range of density: density is .* give kg/m"),
    ]:
        with pytest.raises(ParameterError, match=says):
            RopeReaching(ranges=ranges)
    with pytest.raises(ParameterError, match="takes a rope, not a cloth"):
        RopeReaching(item=Cloth(side=0.2, thickness=0.001))


def test_unknown_tasks_are_refused_with_those_that_there_are():
    with pytest.raises(ParameterError, match="choose rope-reaching, rope-casting"):
        find_task("knitting")
    with pytest.raises(ParameterError, match="'rope-reaching' already"):  # a name is given once
        tasks.register(type("Other", (RopeReaching,), {}))


def test_a_file_is_code_only_where_a_person_names_it(tmp_path):
    path, trace = tmp_path / "task.py", tmp_path / "trace"
    path.write_text(f"open({str(trace)!r}, 'w')\n")
    with pytest.raises(ParameterError, match="there is no task"):
        find_task(str(path))
    assert not trace.exists()
    with pytest.raises(ParameterError, match="defines 0 tasks"):
        load_task(str(path))
    assert trace.exists()


def test_objects_of_several_sizes_are_carried_out_in_their_order():
    """One that fails does not stop the others."""
    task, world = RopeReaching(bow=0.0), Simulation(air_density=0.0)
    items = [Rope(length=L, diameter=0.05 * L, material=Material(E=2e6 * L)) for L in (0.3, 0.5)]
    weak = replace(items[0], material=Material(E=500.0, density=1000.0))  # its weight stretches it
    thin = replace(items[0], diameter=0.006)  # rods differ in thickness, too
    items, sizes = [*items, weak, items[0], thin], np.array([[0.3], [0.5], [0.3], [0.3], [0.3]])
    actions = np.array([[0.4, 0.4], [0.6, 0.4], [0.6, 0.4], [0.8, 0.4], [0.4, 0.4]]) * sizes
    outcomes = world.carry_out(task, items, actions)
    assert outcomes[2].values == {} and " s" in (outcomes[2].fault or "")
    for k in (0, 1, 3, 4):
        alone = world.carry_out(task, [items[k]], actions[k : k + 1])[0]
        assert outcomes[k].fault is None and alone.values["x"] == outcomes[k].values["x"]
    x = [outcome.values.get("x", 0.0) / 0.3 for outcome in outcomes]
    assert x[0] > x[3] + 0.05 and abs(x[4] - x[0]) > 0.01
    # numbers that do not agree are refused
    with pytest.raises(ParameterError, match="for 1 objects"):
        world.carry_out(task, items[:1], actions[:2])
    with pytest.raises(ParameterError, match="out of limits"):
        world.carry_out(task, items[:1], [[0.0, 0.0]])


def test_kept_shapes_begin_with_the_move():
    task = RopeReaching()
    actions = task.sample_actions(task.item, np.random.default_rng(0), 1)
    seen, plain = (
        Simulation(everything=everything).carry_out(task, [task.item], actions, keep=True)[0].seen
        for everything in (True, False)
    )
    assert seen is not None and plain is not None
    assert seen.times[0] == 0.0 and seen.points.shape[1] > 20 > plain.points.shape[1] == 1
    np.testing.assert_allclose(seen.tip[0], seen.hand[0], atol=1e-9)
    held = seen.times < seen.opens
    np.testing.assert_allclose(seen.tip[held], seen.hand[held], atol=1e-6)


def test_memory_that_does_not_suffice_means_smaller_batches(monkeypatch, caplog):
    task = RopeReaching()
    actions = task.sample_actions(task.item, np.random.default_rng(0), 5)
    expected = Simulation().carry_out(task, [task.item] * 5, actions)
    original, sizes = Simulation._side_by_side, []

    def small(self, task, items, *rest):
        sizes.append(len(items))
        if len(items) > 2:
            raise RuntimeError("Failed to allocate 12345 bytes on device 'cuda:0'")
        return original(self, task, items, *rest)

    monkeypatch.setattr(Simulation, "_side_by_side", small)
    found = Simulation().carry_out(task, [task.item] * 5, actions)
    assert [o.values for o in found] == [o.values for o in expected]
    assert sizes == [5, 2, 3, 1, 2] and "smaller batches" in caplog.text


CASTING = RopeCasting()
LONG = replace(CASTING.item, length=0.5, diameter=0.028)


def test_actions_are_those_for_goals_that_the_object_reaches_with_some_noise():
    seen = []

    def acts(cases):
        seen.extend(zip(cases.items, cases.goal, strict=True))
        return np.full((len(cases), 1), 0.6 * size_of(LONG))

    source = Demonstrator(task=CASTING, items=(LONG,), acts=acts)
    rngs = [np.random.default_rng([4, i]) for i in range(40)]
    way = source.draw(rngs)["way"] / size_of(LONG)
    assert 0.7 * ACTION_NOISE < way.std() < 1.4 * ACTION_NOISE
    assert abs(way.mean() - 0.6) < 0.5 * ACTION_NOISE
    assert {item for item, _ in seen} == {LONG}
    assert np.ptp([goal[0] for _, goal in seen]) > 0.1  # each has its own goal
    # a demonstration depends on its own seed alone, and says how it was drawn
    assert source.draw([np.random.default_rng([4, 7])])["way"][0] == 0.5 * way[7]
    assert source.about() != Demonstrator(task=CASTING, items=(LONG,)).about()


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
    usual = dimensionless_parameters(CASTING.item)["bending_ratio"]
    assert np.ptp(data.parameters["bending_ratio"]) > 0.1 * usual
