"""Tasks as Gymnasium environments."""

import warnings
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="needs the extra reality")

import gymnasium
from gymnasium.utils.env_checker import check_env

import gendom.reality.envs as envs
from gendom.errors import ParameterError, RobotError
from gendom.materials import Material
from gendom.reality import OBJECTS, RealRope, RealWorld
from gendom.tasks import RopeReaching, task_names
from reality.test_trials import NotYetRaised

POLYESTER = cast(RealRope, OBJECTS["rope-polyester"])
STRETCHED = np.array([0.15, 0.093])

NUMBERS = {
    "RopeReaching": {"action": 2, "goal": 1},
    "RopeCasting": {"action": 1, "goal": 2},
    "ClothSpreading": {"action": 1},
    "ClothDragging": {"action": 20},
}
"""How many numbers an action and a goal have."""

WITH_GOAL = {"object": "rope-polyester", "goal": 0.4}


def make(name, **kwargs) -> envs.TaskEnv:
    """The bare environment; a free hand unless told otherwise, and coarse steps for ropes."""
    made = gymnasium.make(f"gendom/{name}-v0", **{"robot": False, **kwargs})
    env = cast(envs.TaskEnv, made.unwrapped)
    if env.task.kind == "rope":
        env.world = replace(env.world, timestep=1e-3)
    return env


@pytest.mark.parametrize(
    "name",
    [
        "RopeCasting",
        *(pytest.param(n, marks=pytest.mark.slow) for n in NUMBERS if n != "RopeCasting"),
    ],
)
def test_gymnasium_finds_nothing_to_blame(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # It would have actions between -1 and 1; ours have units.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized")
        check_env(make(name, parameters=True), skip_render_check=True)


def test_every_task_has_an_id_those_of_other_packages_too(run_python):
    assert {f"gendom/{name}-v0" for name in NUMBERS} <= set(gymnasium.registry)
    assert len(NUMBERS) == len(task_names())
    code = """
import gymnasium
from gendom import tasks
class Dragging(tasks.RopeCasting): name = 'rope-dragging'
tasks.register(Dragging)
env = gymnasium.make('gendom.reality:gendom/RopeDragging-v0', robot=False)
print(type(env.unwrapped.task).__name__)"""
    assert run_python(code) == "Dragging"


@pytest.mark.parametrize("name", NUMBERS)
def test_spaces_hold_what_a_task_has(name):
    env = make(name, parameters=True)
    spaces = {**env.observation_space.spaces, "action": env.action_space}
    shapes = {key: len(space.low) for key, space in spaces.items()}
    assert shapes == {**NUMBERS[name], "sizes": 2, "parameters": 5}
    low, high = np.moveaxis(np.array([env.task.limits(item) for item in env.objects]), 2, 0)
    ends = [low.min(axis=0), high.max(axis=0)]
    np.testing.assert_array_equal([env.action_space.low, env.action_space.high], ends)


def test_objects_for_which_no_goal_is_found_are_refused(monkeypatch):
    """Its own weight stretches it."""
    monkeypatch.setattr("gendom.tasks.cases._ROUNDS", 2)
    weak = replace(POLYESTER, name="weak", material=Material(E=500.0, density=1000.0))
    env = make("RopeReaching")
    with pytest.raises(ParameterError, match="1 of 1 cases failed 2 times; give option goal"):
        env.reset(options={"object": weak})
    assert env.reset(options={"object": weak, "goal": 0.4})[1] == {"object": "weak"}


def test_what_is_observed():
    observation, _ = make("ClothSpreading").reset(options={"object": "cloth-rubber"})
    assert set(observation) == {"sizes"}
    assert observation["sizes"] == pytest.approx([0.3, 1e-3])
    with pytest.raises(ParameterError, match="reset: there is no option 'goal' here"):
        make("ClothSpreading").reset(options={"goal": 0.4})
    # parameters are seen only if asked for
    assert set(make("RopeReaching").reset(seed=0)[0]) == {"goal", "sizes"}
    env, m = make("RopeReaching", parameters=True), POLYESTER.material
    seen, _ = env.reset(options=WITH_GOAL)
    assert seen["parameters"] == pytest.approx([m.E_over_rho, m.nu, 0.004, 0.35, 900.0])
    given = (900.0, 0.3, 0.01, 0.5, 700.0)
    estimate, _ = env.reset(options=WITH_GOAL | {"parameters": given})
    assert estimate["parameters"] == pytest.approx(given)


def test_reaching_is_the_trial_and_its_goal():
    """What comes out is what the trial does, and the reward its distance from the goal."""
    env = make("RopeReaching")
    env.reset(options=WITH_GOAL)
    observation, reward, terminated, truncated, info = env.step(STRETCHED)
    world = RealWorld(robot=False, timestep=1e-3)
    direct = world.carry_out(RopeReaching(), [POLYESTER], [STRETCHED])[0].values
    assert info["reached"] == pytest.approx([direct["x"]], abs=1e-9)
    assert reward == pytest.approx(-abs(direct["x"] - 0.4), abs=1e-9) and reward < -0.02
    assert terminated and not truncated and observation["goal"] == pytest.approx([0.4])
    assert info["refused"] is None
    np.testing.assert_array_equal(info["action"], STRETCHED)


def test_spreading_rewards_the_share_that_lies_spread():
    """What else a task tells of is told too."""
    env = envs.TaskEnv(NotYetRaised(), objects=["cloth-cotton"], robot=False)
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step([0.1])
    assert terminated and info["unspread"] == pytest.approx(0.0, abs=1e-6)
    assert reward == info["share"] == pytest.approx(1.0) and info["reached"].shape == (0,)


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


def test_actions_beyond_the_limits_are_moved_into_them():
    env = make("RopeCasting")
    env.reset(seed=0)
    assert env.step([9.0])[4]["action"] == pytest.approx([0.27])
    # Within the space of both objects, but not within the limits of this one.
    small = replace(POLYESTER, name="small", length=0.2, diameter=0.01)
    env = make("RopeCasting", objects=[POLYESTER, small])
    env.reset(options={"object": small})
    assert 0.27 in env.action_space.high
    assert env.step([0.27])[4]["action"] == pytest.approx([0.18])


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"object": "rope-hemp"}, "no object 'rope-hemp'"),
        ({"object": "cloth-cotton"}, "choose rope-cotton, rope-polyester, rope-polyethylene"),
        ({"goal": np.nan}, "option goal must be finite, got nan"),
        ({"goal": (0.3, 0.1)}, r"option goal must be \[1\] numbers"),
        ({"goal": 1e6}, "option goal: is"),
        ({"target": 1.0}, "no option 'target'"),
        ({"goal": 0.4, "parameters": (1.0, 0.3)}, r"option parameters must be \[5\] numbers"),
        ({"goal": 0.4, "parameters": (1.0, 0.7, 0.01, 0.5, 700.0)}, "option parameters: is"),
    ],
)
def test_bad_options(options, match):
    with pytest.raises(ParameterError, match=match):
        make("RopeReaching", parameters=True).reset(options=options)


def test_bad_arguments_and_actions():
    for task, objects, match in (
        ("knitting", None, "no task 'knitting'"),
        ("rope-casting", ["cloth-cotton"], "cloth-cotton is none of this"),
        ("rope-casting", [], "objects: is empty"),
    ):
        with pytest.raises(ParameterError, match=match):
            envs.TaskEnv(task, objects=objects)
    env = make("RopeReaching")
    with pytest.raises(ParameterError, match="call reset first"):
        env.step([0.2])
    env.reset(options={"goal": 0.4})
    bad: list[Any] = [[np.nan, 0.1], [0.1, 0.1, 0.1], ["a", "b"]]
    for action in bad:
        with pytest.raises(ParameterError, match="action must be"):
            env.step(action)
