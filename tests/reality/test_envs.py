"""The three tasks as Gymnasium environments."""

import itertools
import warnings
from typing import cast

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra reality")
pytest.importorskip("gymnasium", reason="needs the extra reality")

import gymnasium
from gymnasium.utils.env_checker import check_env

import gendom.reality.envs as envs
from gendom.errors import DeviceError, ParameterError, RobotError
from gendom.reality import (
    OBJECTS,
    Performance,
    RealRope,
    carry_out_reaching,
    reaching,
    reaching_task,
)
from gendom.reality.world import Reality

ROPES = {n: cast(RealRope, OBJECTS[n]) for n in ("rope-cotton", "rope-polyester")}
STRETCHED = np.array([0.15, 0.093])


def make(name, **kwargs) -> envs.TaskEnv:
    """The bare environment; a free hand unless told otherwise."""
    env = gymnasium.make(f"gendom/{name}-v0", **{"robot": False, **kwargs})
    return cast(envs.TaskEnv, env.unwrapped)


@pytest.mark.parametrize(
    "name", ["RopeReaching", "RopeCasting", pytest.param("ClothSpreading", marks=pytest.mark.slow)]
)
def test_gymnasium_finds_nothing_to_blame(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # It would have actions between -1 and 1; ours have units.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized")
        check_env(make(name, parameters=True), skip_render_check=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["RopeReaching", "RopeCasting"])
def test_gymnasium_finds_nothing_to_blame_in_pictures(rendering, name):
    env = make(name, robot=True, render_mode="rgb_array")
    check_env(env)


@pytest.mark.parametrize("name", ["RopeReaching", "RopeCasting", "ClothSpreading"])
def test_a_fresh_process_makes_it_as_documented(run_python, name):
    """By the id with the package in front of it, and without any other import."""
    code = (
        f"import gymnasium; env = gymnasium.make('gendom.reality:gendom/{name}-v0', "
        "parameters=True); observation, info = env.reset(seed=0); "
        "print(env.unwrapped.spec.id, *sorted(observation), info['object'])"
    )
    made, *names, item = run_python(code).split()
    assert made == f"gendom/{name}-v0" and item in OBJECTS
    assert names == ["goal", "parameters", "sizes"]


@pytest.mark.parametrize("name", ["RopeReaching", "RopeCasting", "ClothSpreading"])
def test_every_number_has_a_unit(name):
    env = make(name, parameters=True)
    units = env.metadata["units"]
    spaces = {**env.observation_space.spaces, "action": env.action_space}
    assert {key: len(space.low) for key, space in spaces.items()} == {
        key: len(names) for key, names in units.items()
    }


def test_seeds_repeat_and_differ():
    env = make("RopeReaching")

    def drawn(seed):
        first = env.reset(seed=seed)
        return [first, *(env.reset() for _ in range(5))]

    a, b, c = drawn(4), drawn(4), drawn(5)
    assert [info for _, info in a] == [info for _, info in b]
    np.testing.assert_array_equal([o["goal"] for o, _ in a], [o["goal"] for o, _ in b])
    assert not np.array_equal([o["goal"] for o, _ in a], [o["goal"] for o, _ in c])
    assert len({info["object"] for _, info in a + c}) == 3


def test_a_given_object_leaves_the_goals_as_they_are_drawn():
    env = make("RopeReaching")
    free, _ = env.reset(seed=7)
    given, info = env.reset(seed=7, options={"object": "rope-cotton"})
    assert info["object"] == "rope-cotton"
    assert given["goal"] == free["goal"]


def test_reaching_is_the_trial_and_its_goal():
    """What comes out is what the trial does, and the reward its distance from the goal."""
    env = make("RopeReaching")
    env.reset(options={"object": "rope-polyester", "goal": 0.4})
    observation, reward, terminated, truncated, info = env.step(STRETCHED)
    trial = reaching(ROPES["rope-polyester"], STRETCHED)
    direct = carry_out_reaching(Performance(trial, robot=False))
    assert info["reached"] == pytest.approx([direct.reached], abs=1e-9)
    assert reward == pytest.approx(-abs(direct.reached - 0.4), abs=1e-9)
    assert reward < -0.02
    assert terminated and not truncated
    assert observation["goal"] == pytest.approx([0.4])
    assert info["sideways"] == pytest.approx(0.0, abs=1e-9)
    assert info["slowed_by"] == 1.0 and info["deviation"] == 0.0 and info["refused"] is None
    np.testing.assert_array_equal(info["action"], STRETCHED)


def test_the_arm_reaches_too():
    env = make("RopeReaching", robot=True)
    env.reset(options={"object": "rope-polyester"})
    info = env.step(STRETCHED)[4]
    assert 0.4 < info["reached"][0] < 0.55
    assert 0.0 < info["deviation"] < 0.03 and info["sideways"] > 0.0


def test_every_release_point_of_the_box_comes_into_the_limits():
    env = make("RopeReaching")
    low, high = env.action_space.low, env.action_space.high
    for item in ROPES.values():
        task = reaching_task(item)
        moved = 0
        for x, z in itertools.product(*np.linspace(low, high, 30).T):
            action = env.allowed(item, np.array([x, z]))
            task.check_action(action)
            away = np.array([x, z]) - task.top[[0, 2]]
            off = action - np.array([x, z])
            assert abs(away[0] * off[1] - away[1] * off[0]) < 1e-12
            moved += bool(np.linalg.norm(off) > 1e-12)
        # Both ways: a good part is moved, and a good part is not.
        assert 200 < moved < 700


def test_allowed_release_points_stay_as_they_are():
    env = make("RopeReaching")
    item = ROPES["rope-cotton"]
    for action in reaching_task(item).sample_actions(np.random.default_rng(0), 50):
        np.testing.assert_array_equal(env.allowed(item, action), action)
        assert action in env.action_space


def test_casting_goals_are_points():
    env = make("RopeCasting")
    observation, _ = env.reset(options={"object": "rope-polyester", "goal": (0.3, 0.2)})
    assert observation["goal"] == pytest.approx([0.3, 0.2])
    _, reward, _, _, info = env.step([0.2])
    off = info["reached"] - [0.3, 0.2]
    assert reward == pytest.approx(-np.hypot(*off))
    assert 0.05 < -reward < 0.2
    assert info["sideways"] == pytest.approx(0.0, abs=1e-9)


def test_drawn_casting_goals_can_be_reached():
    """Between what a polyester rope does for the least and the largest cast."""
    env = make("RopeCasting", objects=["rope-polyester"])
    goals = np.array([env.reset(seed=s)[0]["goal"] for s in range(20)])
    ends = []
    for action in envs.CAST_ACTIONS:
        env.reset()
        ends.append(env.step([action])[4]["reached"])
    assert (goals >= ends[0] - 0.01).all() and (goals <= ends[1] + 0.01).all()


@pytest.mark.slow
def test_spreading_rewards_the_extended_ratio():
    env = make("ClothSpreading")
    observation, _ = env.reset(options={"object": "cloth-rubber"})
    assert observation["goal"] == pytest.approx([0.75])
    assert observation["sizes"] == pytest.approx([0.3, 1e-3])
    _, reward, _, _, info = env.step([0.1])
    assert 0.2 < reward <= 1.0 and reward == info["reached"][0]


def test_parameters_are_seen_only_if_asked_for():
    blind, _ = make("RopeReaching").reset(seed=0)
    assert set(blind) == {"goal", "sizes"}
    env = make("RopeReaching", parameters=True)
    seen, _ = env.reset(options={"object": "rope-polyester"})
    material = OBJECTS["rope-polyester"].material
    assert seen["parameters"] == pytest.approx([material.E / material.density, material.nu])
    assert seen["sizes"] == pytest.approx([0.3, 0.016])
    estimate, _ = env.reset(options={"object": "rope-polyester", "parameters": (900.0, 0.3)})
    assert estimate["parameters"] == pytest.approx([900.0, 0.3])


def test_what_the_arm_refuses_is_not_carried_out(monkeypatch):
    env = make("RopeReaching", robot=True)
    env.reset(seed=0)

    def refuse(*_, **__):
        raise RobotError("is out of reach", where="xarm7")

    monkeypatch.setattr("gendom.reality.trials.follow", refuse)
    _, reward, terminated, _, info = env.step(STRETCHED)
    assert terminated and reward == envs.REFUSED
    assert info["refused"] == "xarm7: is out of reach" and np.isnan(info["reached"]).all()


def test_actions_beyond_the_box_are_clipped():
    env = make("RopeCasting")
    env.reset(seed=0)
    assert env.step([9.0])[4]["action"] == pytest.approx([0.25])


@pytest.mark.parametrize("action", [[np.nan, 0.1], [0.1], [0.1, 0.1, 0.1], ["a", "b"], None])
def test_bad_actions_are_refused(action):
    env = make("RopeReaching")
    env.reset(seed=0)
    with pytest.raises(ParameterError, match=r"action: is .*give 2 finite numbers"):
        env.step(action)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"object": "rope-hemp"}, "no object 'rope-hemp'"),
        ({"object": "cloth-cotton"}, "choose rope-cotton, rope-polyester, rope-polyethylene"),
        ({"goal": np.nan}, "goal: is nan"),
        ({"goal": 1e6}, "option goal: is"),
        ({"target": 1.0}, "no option 'target'"),
        ({"parameters": (1.0, 0.3)}, "parameters=True"),
    ],
)
def test_bad_options(options, match):
    with pytest.raises(ParameterError, match=match):
        make("RopeReaching").reset(options=options)


def test_bad_arguments():
    with pytest.raises(ParameterError, match="cloth-cotton is none of this task"):
        envs.RopeCastingEnv(objects=["cloth-cotton"])
    with pytest.raises(ParameterError, match="objects: is empty"):
        envs.RopeCastingEnv(objects=[])
    with pytest.raises(ParameterError, match="render_mode: is 'human'"):
        envs.RopeCastingEnv(render_mode="human")
    with pytest.raises(ParameterError, match="call reset first"):
        envs.RopeCastingEnv().step([0.2])


def test_pictures_show_the_object_move(rendering):
    env = make("RopeCasting", render_mode="rgb_array")
    env.reset(options={"object": "rope-cotton"})
    before = env.render()
    env.step([0.2])
    after = env.render()
    assert before is not None and after is not None
    for picture in (before, after):
        assert picture.shape == (480, 640, 3) and picture.dtype == np.uint8
        red = (picture[..., 0] > 2 * picture[..., 1].astype(int) + 20).sum()
        assert red > 200
    assert (before != after).mean() > 0.005
    env.close()
    env.close()


def test_no_pictures_without_a_render_mode():
    env = make("RopeCasting")
    env.reset()
    assert env.render() is None


def test_where_nothing_can_be_rendered_the_message_says_what_to_install(monkeypatch):
    def refuse(*_):
        raise DeviceError("no OpenGL context", fix="apt install libegl1")

    monkeypatch.setattr(Reality, "_open_renderer", refuse)
    env = make("RopeCasting", render_mode="rgb_array")
    env.reset()
    with pytest.raises(DeviceError, match="apt install libegl1"):
        env.render()
    # It still acts.
    assert env.step([0.2])[2]


def test_the_second_reality_needs_no_gymnasium(run_python):
    blocked = "import sys; sys.modules['gymnasium'] = None\n"
    assert run_python(blocked + "import gendom.reality; print('there')") == "there"
    code = "try:\n import gendom.reality.envs\nexcept Exception as e: print(type(e).__name__, e)"
    message = run_python(blocked + code)
    assert message.startswith("DeviceError") and "gendom[reality]" in message


@pytest.mark.parametrize(
    "code",
    [
        "import gymnasium; e = gymnasium.make('gendom.reality.envs:gendom/RopeCasting-v0')",
        "import gymnasium, gendom.reality; e = gymnasium.make('gendom/RopeCasting-v0')",
    ],
)
def test_make_finds_what_it_names(run_python, code):
    assert "RopeCasting" in run_python(code + "; print(e.unwrapped)")
