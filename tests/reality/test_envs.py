"""Tasks as Gymnasium environments."""

import itertools
import warnings
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra reality")
pytest.importorskip("gymnasium", reason="needs the extra reality")

import gymnasium
from gymnasium.utils.env_checker import check_env

import gendom.reality.envs as envs
from gendom.errors import ParameterError, RobotError
from gendom.installation import how_to_install
from gendom.materials import Material, unit_of
from gendom.reality import OBJECTS, RealRope, RealWorld
from gendom.tasks import ClothSpreading, RopeCasting, RopeReaching, task_names
from gendom.tasks.cloth_spreading import WAIT as SPREADING_WAIT
from gendom.tasks.world import Simulation

POLYESTER = cast(RealRope, OBJECTS["rope-polyester"])
STRETCHED = np.array([0.15, 0.093])

ALL = [
    "RopeReaching",
    "RopeCasting",
    "RopeCastingAtSpeed",
    "ClothSpreading",
]
NUMBERS = {
    "RopeReaching": {"action": 2, "goal": 1},
    "RopeCasting": {"action": 1, "goal": 2},
    "RopeCastingAtSpeed": {"action": 2, "goal": 2},
    "ClothSpreading": {"action": 1},
}
"""How many numbers an action and a goal have."""


def make(name, **kwargs) -> envs.TaskEnv:
    """The bare environment; a free hand unless told otherwise."""
    env = gymnasium.make(f"gendom/{name}-v0", **{"robot": False, **kwargs})
    return cast(envs.TaskEnv, env.unwrapped)


@dataclass(frozen=True, kw_only=True)
class NotYetRaised(ClothSpreading):
    """Over 50 ms after the hand has closed, and with an outcome of its own."""

    def times(self, item):
        return np.array([0.05 - SPREADING_WAIT * unit_of("s", item)])

    def outcome(self, item, seen):
        return {"share": 0.4, "covered": 0.6}


# ---- as Gymnasium asks for them ------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [n if n == "RopeCasting" else pytest.param(n, marks=pytest.mark.slow) for n in ALL],
)
def test_gymnasium_finds_nothing_to_blame(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # It would have actions between -1 and 1; ours have units.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized")
        check_env(make(name, parameters=True), skip_render_check=True)


@pytest.mark.parametrize("name", ALL)
def test_a_fresh_process_makes_it_as_documented(run_python, name):
    """By the id with the package in front of it, and without any other import."""
    code = (
        f"import gymnasium; env = gymnasium.make('gendom.reality:gendom/{name}-v0', "
        "parameters=True); observation, info = env.reset(seed=0); "
        "print(env.unwrapped.spec.id, *sorted(observation), info['object'])"
    )
    made, *names, item = run_python(code).split()
    assert made == f"gendom/{name}-v0" and item in OBJECTS
    goal = ["goal"] if "goal" in NUMBERS[name] else []
    assert names == [*goal, "parameters", "sizes"]


def test_every_task_has_an_id_those_of_other_packages_too(run_python):
    assert {f"gendom/{name}-v0" for name in ALL} <= set(gymnasium.registry)
    assert len(ALL) == len(task_names())
    code = (
        "import gymnasium\n"
        "from gendom import tasks\n"
        "class Dragging(tasks.RopeCasting): name = 'rope-dragging'\n"
        "tasks.register(Dragging)\n"
        "env = gymnasium.make('gendom.reality:gendom/RopeDragging-v0', robot=False)\n"
        "print(type(env.unwrapped.task).__name__)"
    )
    assert run_python(code) == "Dragging"


@pytest.mark.parametrize("name", ALL)
def test_every_number_has_a_unit(name):
    env = make(name, parameters=True)
    spaces = {**env.observation_space.spaces, "action": env.action_space}
    shapes = {key: len(space.low) for key, space in spaces.items()}
    assert shapes == {**NUMBERS[name], "sizes": 2, "parameters": 5}
    units = env.metadata["units"]
    assert {key: len(units[key]) for key in shapes} == shapes
    assert units["action"] == tuple(q.unit for q in env.task.actions)
    assert units["goal"] == ("m",) * NUMBERS[name].get("goal", 0)
    assert units["parameters"] == ("m^2/s^2", "1", "s", "1", "kg/m^3")


@pytest.mark.parametrize("name", ALL)
def test_the_action_space_is_the_task_s_limits(name):
    env = make(name)
    item = env.objects[0]
    limits = env.task.limits(item)
    np.testing.assert_array_equal([env.action_space.low, env.action_space.high], limits.T)
    larger = replace(item, **{size: 2.0 * getattr(item, size) for size in item.sizes})
    both = make(name, objects=[item, larger])
    limits = np.array([limits, env.task.limits(larger)])
    np.testing.assert_array_equal(both.action_space.low, limits[..., 0].min(axis=0))
    np.testing.assert_array_equal(both.action_space.high, limits[..., 1].max(axis=0))


# ---- objects and goals ---------------------------------------------------------------------------


def test_seeds_repeat_and_differ():
    env = make("RopeCasting")

    def drawn(seed):
        first = env.reset(seed=seed)
        return [first, *(env.reset() for _ in range(5))]

    a, b, c = drawn(4), drawn(4), drawn(5)
    assert [info for _, info in a] == [info for _, info in b]
    np.testing.assert_array_equal([o["goal"] for o, _ in a], [o["goal"] for o, _ in b])
    assert not np.array_equal([o["goal"] for o, _ in a], [o["goal"] for o, _ in c])
    assert len({info["object"] for _, info in a + c}) == 3


@pytest.mark.parametrize(
    "options", [{"object": "rope-cotton"}, {"goal": 0.4}, {"object": POLYESTER, "goal": 0.4}]
)
def test_what_is_given_leaves_later_draws_as_they_are(options):
    env = make("RopeReaching")
    first, _ = env.reset(seed=7)
    drawn = env.reset()
    given, info = env.reset(seed=7, options=options)
    if "goal" in options:
        assert given["goal"] == pytest.approx([0.4])
    else:
        assert given["goal"] != first["goal"] and info["object"] == "rope-cotton"
    again = env.reset()
    assert again[1] == drawn[1]
    np.testing.assert_array_equal(again[0]["goal"], drawn[0]["goal"])


def test_goals_grow_with_the_object():
    """Twice the size, alike in all else: twice the goal, whatever the size of the others."""
    m = POLYESTER.material
    large = replace(
        POLYESTER,
        name="large",
        length=2.0 * POLYESTER.length,
        diameter=2.0 * POLYESTER.diameter,
        material=replace(m, E=2.0 * m.E, damping=np.sqrt(2.0) * m.damping),
    )
    env = make("RopeCasting", objects=[POLYESTER])
    for seed in range(3):
        small_goal = env.reset(seed=seed)[0]["goal"]
        observation, info = env.reset(seed=seed, options={"object": large})
        assert info["object"] == "large"
        assert observation["goal"] == pytest.approx(2.0 * small_goal, rel=0.01)
        assert observation["sizes"] == pytest.approx([0.6, 0.032])


def test_objects_may_be_given_themselves():
    mine = replace(POLYESTER, name="mine", length=0.25, diameter=0.01)
    env = make("RopeCasting", objects=["rope-cotton", mine])
    seen = [env.reset(seed=s, options={"goal": (0.3, 0.1)}) for s in range(8)]
    assert {info["object"] for _, info in seen} == {"rope-cotton", "mine"}
    for observation, info in seen:
        sizes = [0.25, 0.01] if info["object"] == "mine" else [0.3, 0.016]
        assert observation["sizes"] == pytest.approx(sizes)
    env.reset(options={"object": mine, "goal": (0.3, 0.1)})
    direct = RealWorld(robot=False).carry_out(RopeCasting(), [mine], [[0.2]])[0]
    assert env.step([0.2])[4]["reached"] == pytest.approx([direct.values[n] for n in ("x", "z")])


def test_a_task_may_be_given_itself():
    task = RopeCasting(speed=0.3)
    env = envs.TaskEnv(task, objects=[POLYESTER], robot=False)
    env.reset(seed=0)
    direct = RealWorld(robot=False).carry_out(task, [POLYESTER], [[0.2]])[0].values
    assert env.step([0.2])[4]["reached"] == pytest.approx([direct["x"], direct["z"]])
    env = make("RopeCasting", objects=[POLYESTER])
    env.reset(seed=0)
    assert env.step([0.2])[4]["reached"][1] > direct["z"] + 0.01


@pytest.fixture
def simulated(monkeypatch):
    """What environments simulate for goals: action and outcome, one list a call."""
    calls, original = [], Simulation.carry_out

    def carry_out(self, task, items, actions, **rest):
        outcomes = original(self, task, items, actions, **rest)
        calls.append(list(zip(np.asarray(actions), outcomes, strict=True)))
        return outcomes

    monkeypatch.setattr(Simulation, "carry_out", carry_out)
    return calls


@pytest.mark.slow
def test_drawn_casting_goals_can_be_reached(simulated):
    """By the action that was drawn, and all over what a polyester rope does."""
    env = make("RopeCasting", objects=["rope-polyester"])
    goals = np.array([env.reset(seed=s)[0]["goal"] for s in range(20)])
    reached = []
    for way in np.linspace(env.action_space.low, env.action_space.high, 5):
        env.reset()
        reached.append(env.step(way)[4]["reached"])
    low, high = np.min(reached, axis=0), np.max(reached, axis=0)
    assert (goals >= low - 0.003).all() and (goals <= high + 0.003).all()
    assert (np.ptp(goals, axis=0) > 0.6 * (high - low)).all()
    for seed in range(3):
        [(action, _)] = simulated[seed]
        env.reset(seed=seed)
        assert env.step(action)[1] > -0.003


@pytest.mark.slow
def test_drawn_reaching_goals_keep_to_the_risk_s_limit(simulated, monkeypatch):
    """Of the releases that are drawn most fall out of the plane; the one that makes the goal does
    not, and so the second reality's rope gets there too."""
    monkeypatch.setattr(envs, "ACTIONS_A_BATCH", 3)
    monkeypatch.setattr(envs, "MAX_BATCHES", 20)
    env = make("RopeReaching")
    tried, rounds = 0, []
    for seed in range(4):
        simulated.clear()
        observation, info = env.reset(seed=seed)
        limit = 0.03 * 0.3
        found = [
            (action, outcome.values)
            for call in simulated
            for action, outcome in call
            if outcome.values["x"] == pytest.approx(observation["goal"][0], abs=1e-7)
        ]
        [(action, values)] = found
        assert values["sideways"] <= limit
        all_sideways = [o.values["sideways"] for call in simulated for _, o in call]
        tried += sum(sideways > limit for sideways in all_sideways)
        rounds.append(len(simulated))
        assert env.step(action)[1] > -0.006, info
    assert tried > 15 and min(rounds) < max(rounds) < 20


def test_objects_for_which_no_goal_is_found_are_refused():
    """Its own weight stretches it."""
    weak = replace(POLYESTER, name="weak", material=Material(E=500.0, density=1000.0))
    env = make("RopeReaching")
    with pytest.raises(ParameterError, match=r"no goal can be drawn \(.* s\).*give option goal"):
        env.reset(options={"object": weak})
    assert env.reset(options={"object": weak, "goal": 0.4})[1] == {"object": "weak"}


def test_a_task_without_goals_shows_none():
    observation, _ = make("ClothSpreading").reset(options={"object": "cloth-rubber"})
    assert set(observation) == {"sizes"}
    assert observation["sizes"] == pytest.approx([0.3, 1e-3])
    for goal in (0.4, (0.3, 0.1)):
        with pytest.raises(ParameterError, match="reset: there is no option 'goal' here"):
            make("ClothSpreading").reset(options={"goal": goal})


def test_parameters_are_seen_only_if_asked_for():
    blind, _ = make("RopeReaching").reset(seed=0)
    assert set(blind) == {"goal", "sizes"}
    env = make("RopeReaching", parameters=True)
    seen, _ = env.reset(options={"object": "rope-polyester", "goal": 0.4})
    material = POLYESTER.material
    assert seen["parameters"] == pytest.approx(
        [material.E / material.density, material.nu, 0.004, 0.35, 900.0]
    )
    assert seen["sizes"] == pytest.approx([0.3, 0.016])
    given = (900.0, 0.3, 0.01, 0.5, 700.0)
    options = {"object": "rope-polyester", "goal": 0.4, "parameters": given}
    estimate, _ = env.reset(options=options)
    assert estimate["parameters"] == pytest.approx(given)


# ---- steps ---------------------------------------------------------------------------------------


def test_reaching_is_the_trial_and_its_goal():
    """What comes out is what the trial does, and the reward its distance from the goal."""
    env = make("RopeReaching")
    env.reset(options={"object": "rope-polyester", "goal": 0.4})
    observation, reward, terminated, truncated, info = env.step(STRETCHED)
    world = RealWorld(robot=False)
    direct = world.carry_out(RopeReaching(), [POLYESTER], [STRETCHED])[0].values
    assert info["reached"] == pytest.approx([direct["x"]], abs=1e-9)
    assert reward == pytest.approx(-abs(direct["x"] - 0.4), abs=1e-9)
    assert reward < -0.02
    assert terminated and not truncated
    assert observation["goal"] == pytest.approx([0.4])
    assert info["sideways"] == pytest.approx(0.0, abs=1e-9)
    assert info["slowed_by"] == 1.0 and info["deviation"] == 0.0 and info["refused"] is None
    np.testing.assert_array_equal(info["action"], STRETCHED)


def test_the_arm_reaches_too():
    env = make("RopeReaching", robot=True)
    env.reset(options={"object": "rope-polyester", "goal": 0.4})
    info = env.step(STRETCHED)[4]
    assert 0.4 < info["reached"][0] < 0.55
    assert 0.0 < info["deviation"] < 0.03 and info["sideways"] > 0.0


def test_casting_goals_are_points():
    env = make("RopeCasting")
    observation, _ = env.reset(options={"object": "rope-polyester", "goal": (0.3, 0.15)})
    assert observation["goal"] == pytest.approx([0.3, 0.15])
    _, reward, _, _, info = env.step([0.2])
    off = info["reached"] - [0.3, 0.15]
    assert reward == pytest.approx(-np.hypot(*off))
    assert 0.05 < -reward < 0.2
    assert info["sideways"] == pytest.approx(0.0, abs=1e-9)


def test_speed_is_a_second_number_of_a_cast():
    env = make("RopeCastingAtSpeed")
    low, high = env.action_space.low[1], env.action_space.high[1]
    slow, fast = (
        (env.reset(options={"object": "rope-polyester", "goal": (0.3, 0.1)}), env.step([0.2, v]))[1]
        for v in (low, high)
    )
    assert fast[4]["reached"][1] > slow[4]["reached"][1] + 0.03
    np.testing.assert_array_equal(slow[4]["action"], [0.2, low])


def test_spreading_rewards_the_share_that_lies_spread():
    env = envs.TaskEnv(NotYetRaised(), objects=["cloth-cotton"], robot=False)
    env.reset(seed=0)
    observation, reward, terminated, _, info = env.step([0.1])
    assert reward == info["share"] == 0.4 and info["covered"] == 0.6
    assert info["reached"].shape == (0,) and info["refused"] is None
    assert terminated and set(observation) == {"sizes"}


@pytest.mark.slow
def test_a_sheet_of_rubber_is_brought_down():
    env = make("ClothSpreading")
    env.reset(options={"object": "cloth-rubber"})
    _, reward, _, _, info = env.step([0.1])
    assert 0.2 < info["covered"] <= 1.0
    assert 0.1 < reward == info["share"] <= info["covered"]


def test_what_the_arm_refuses_is_not_carried_out(monkeypatch):
    env = make("RopeReaching", robot=True)
    env.reset(seed=0)

    def refuse(*_, **__):
        raise RobotError("is out of reach", where="xarm7")

    monkeypatch.setattr("gendom.reality.trials.follow", refuse)
    _, reward, terminated, _, info = env.step(STRETCHED)
    assert terminated and reward == envs.REFUSED
    assert info["refused"] == "xarm7: is out of reach" and np.isnan(info["reached"]).all()
    assert set(info) == {"action", "reached", "refused"}


def test_a_refusal_is_worse_than_any_miss():
    """Of the largest object and the farthest goal that can be observed."""
    for name in ("RopeReaching", "RopeCasting", "ClothSpreading"):
        env = make(name)
        spaces = cast(dict[str, gymnasium.spaces.Box], env.observation_space.spaces)
        largest = float(spaces["sizes"].high.max())
        goal = spaces["goal"].high.astype(float) if "goal" in spaces else np.zeros(0)
        values = {q.name: -3.0 * largest for q in env.task.goals} or {"share": 0.0}
        worst = env.task.error(env.objects[0], goal, values)
        assert envs.REFUSED < -worst


# ---- actions -------------------------------------------------------------------------------------


def test_every_release_point_of_the_box_comes_into_the_limits():
    env = make("RopeReaching")
    low, high = env.action_space.low, env.action_space.high
    middle = 0.5 * (low + high)
    for item in env.objects:
        moved = 0
        for x, z in itertools.product(*np.linspace(low, high, 30).T):
            asked = np.array([x, z])
            action = env.task.nearest(item, asked)
            env.task.check_action(item, action)
            # Straight towards the middle, from the limits, not beyond.
            away, off = asked - middle, action - asked
            assert abs(away[0] * off[1] - away[1] * off[0]) < 1e-12
            far = np.linalg.norm(off)
            moved += bool(far > 1e-12)
            if far > 1e-6:
                assert not env.task.allows(item, action - 1e-5 * off / far)
        # Both ways: a good part is moved, and a good part is not.
        assert 200 < moved < 700


def test_allowed_release_points_stay_as_they_are(monkeypatch):
    env = make("RopeReaching")
    item, carried = env.objects[0], []
    env.reset(options={"object": item, "goal": 0.4})

    def refuse(self, task, item, action):
        carried.append(action)
        raise RobotError("is not asked for", where="here")

    monkeypatch.setattr(RealWorld, "begin", refuse)
    actions = env.task.sample_actions(item, np.random.default_rng(0), 50)
    for action in actions:
        assert action in env.action_space
        np.testing.assert_array_equal(env.step(action)[4]["action"], action)
    np.testing.assert_array_equal(carried, actions)


def test_actions_beyond_the_limits_are_moved_into_them():
    env = make("RopeCasting")
    env.reset(seed=0)
    assert env.step([9.0])[4]["action"] == pytest.approx([0.27])
    assert env.step([-9.0])[4]["action"] == pytest.approx([0.12])
    # Within the space of both objects, but not within the limits of this one.
    small = replace(POLYESTER, name="small", length=0.2, diameter=0.01)
    env = make("RopeCasting", objects=[POLYESTER, small])
    env.reset(options={"object": small})
    assert 0.27 in env.action_space.high
    assert env.step([0.27])[4]["action"] == pytest.approx([0.18])


@pytest.mark.parametrize("action", [[np.nan, 0.1], [0.1], [0.1, 0.1, 0.1], ["a", "b"], None])
def test_bad_actions_are_refused(action):
    env = make("RopeReaching")
    env.reset(options={"goal": 0.4})
    with pytest.raises(ParameterError, match=r"action must be"):
        env.step(action)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"object": "rope-hemp"}, "no object 'rope-hemp'"),
        ({"object": "cloth-cotton"}, "choose rope-cotton, rope-polyester, rope-polyethylene"),
        ({"object": OBJECTS["cloth-cotton"]}, "cloth-cotton is none of this task"),
        ({"goal": np.nan}, "option goal must be finite, got nan"),
        ({"goal": (0.3, 0.1)}, r"option goal must be \[1\] numbers"),
        ({"goal": 1e6}, "option goal: is"),
        ({"target": 1.0}, "no option 'target'"),
        ({"parameters": (1.0, 0.3, 0.01, 0.5, 700.0)}, "no option 'parameters' here"),
    ],
)
def test_bad_options(options, match):
    with pytest.raises(ParameterError, match=match):
        make("RopeReaching").reset(options=options)


def test_bad_parameters():
    env = make("RopeReaching", parameters=True)
    for parameters, match in [
        ((1.0, 0.3), r"option parameters must be \[5\] numbers"),
        ((1.0, 0.7, 0.01, 0.5, 700.0), "option parameters: is"),
    ]:
        with pytest.raises(ParameterError, match=match):
            env.reset(options={"goal": 0.4, "parameters": parameters})


def test_bad_arguments():
    with pytest.raises(ParameterError, match="no task 'knitting'"):
        envs.TaskEnv("knitting")
    with pytest.raises(ParameterError, match="cloth-cotton is none of this task"):
        envs.TaskEnv("rope-casting", objects=["cloth-cotton"])
    with pytest.raises(ParameterError, match="objects: is empty"):
        envs.TaskEnv("rope-casting", objects=[])
    with pytest.raises(ParameterError, match="call reset first"):
        envs.TaskEnv("rope-casting").step([0.2])


# ---- with and without Gymnasium ------------------------------------------------------------------


def test_the_second_reality_needs_no_gymnasium(run_python):
    blocked = "import sys; sys.modules['gymnasium'] = None\n"
    assert run_python(blocked + "import gendom.reality; print('there')") == "there"
    code = "try:\n import gendom.reality.envs\nexcept Exception as e: print(type(e).__name__, e)"
    message = run_python(blocked + code)
    assert message.startswith("DeviceError") and how_to_install("reality") in message


@pytest.mark.parametrize(
    "code",
    [
        "import gymnasium; e = gymnasium.make('gendom.reality.envs:gendom/RopeCasting-v0')",
        "import gymnasium, gendom.reality; e = gymnasium.make('gendom/RopeCasting-v0')",
    ],
)
def test_make_finds_what_it_names(run_python, code):
    assert "RopeCasting" in run_python(code + "; print(e.unwrapped)")
