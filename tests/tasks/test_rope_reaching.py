"""Rope reaching: limits and draws, physics, similarity, and what a robot is given."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Material
from gendom.materials.parameters import bending_length
from gendom.sim import Simulator
from gendom.tasks import TASKS, RopeReaching

TASK = RopeReaching(cells_across=1.0)  # coarse: a world takes a tenth of a second
L = TASK.length

# one release with a soft and a stiff rope, then one rope released farther and farther back
RELEASES = np.array([[0.45, 0.6], [0.45, 0.6], [0.85, 0.45], [0.6, 0.45], [0.35, 0.45]]) * L
MODULI = [250.0, 1000.0, 400.0, 400.0, 400.0]


def material(specific_modulus, nu=0.3, damping=0.0):
    return Material(E=1000.0 * specific_modulus, nu=nu, density=1000.0, damping=damping)


@pytest.fixture(scope="module")
def outcome():
    materials = [material(modulus) for modulus in MODULI]
    return TASK.simulate(RELEASES, materials, record_particles=True)


# ---- physics -------------------------------------------------------------------------------------


def test_stiffness_changes_the_reach():
    """Of ropes that damp as ropes do; without that small vibrations decide the reach with it."""
    soft, stiff = (material(modulus, damping=5e-3) for modulus in MODULI[:2])
    reached = TASK.simulate(RELEASES[:2], [soft, stiff]).reached
    assert reached[1] - reached[0] > 0.03 * L


def test_farther_back_reaches_farther(outcome):
    near, middle, far = outcome.reached[2:]
    assert near + 0.1 * L < middle < far - 0.1 * L


def test_the_tip_stays_within_the_rope_of_the_top(outcome):
    distance = np.linalg.norm(outcome.tip_path - TASK.top, axis=2)
    assert distance.max() < 1.03 * L  # weight and swing stretch the rope by rho g L / E, 1 to 2 %
    assert np.all(outcome.reached > L) and np.all(outcome.reached < 2.0 * L)


def test_the_tip_follows_its_gripper_until_it_opens(outcome):
    held = outcome.times <= TASK.release_time + 1e-9
    for w, release in enumerate(RELEASES):
        gripper = TASK.grippers(release)[1]
        offset = outcome.tip_path[held, w] - gripper.position_at(outcome.times[held])
        assert np.abs(offset - offset[0]).max() < 2e-3  # it slips a little
        assert np.linalg.norm(offset[0]) < 4e-3  # the last section's middle is not quite the end
    after = outcome.tip_path[-1] - np.insert(RELEASES, 1, 0.0, axis=1)
    assert np.all(np.linalg.norm(after, axis=1) > 0.1 * L)


def test_the_reach_is_the_farthest_x_after_the_release(outcome):
    bottom = TASK.body().x[:, 2] < TASK.bottom[2] + 0.5 * TASK.body().dx
    tip = outcome.positions[:, :, bottom, 0].mean(axis=2)
    free = outcome.times >= TASK.release_time - 1e-9
    np.testing.assert_allclose(outcome.reached, tip[free].max(axis=0), rtol=1e-6)
    assert np.all(tip[~free].max(axis=0) < outcome.reached)


def test_a_damped_rope_never_swings_past_the_vertical():
    """And where it hung before the release does not count."""
    thick_air = replace(TASK, damping=30.0)
    outcome = thick_air.simulate(RELEASES[:1], [material(400.0)], record_particles=True)
    assert outcome.tip_path[0, 0, 0] == pytest.approx(L)
    assert outcome.reached[0] < 0.9 * L


def test_a_rope_left_hanging_stays():
    body = TASK.body()
    top, _ = TASK.grippers(RELEASES[0])
    end = Simulator(body, [material(1000.0)], engine="mpm", grippers=[top]).run([0.15])[0, 0]
    assert np.abs(end - body.x)[:, :2].max() < 1e-4
    assert np.abs(end - body.x)[:, 2].max() < 2.0 * 9.81 * L**2 / 1000.0  # twice the static sag


def test_a_batch_equals_single_worlds(outcome):
    alone = TASK.simulate(RELEASES[1:2], [material(MODULI[1])], record_particles=True)
    np.testing.assert_array_equal(alone.tip_path[:, 0], outcome.tip_path[:, 1])


def test_particles_do_not_change_the_goal(outcome):
    plain = TASK.simulate(RELEASES[:1], [material(MODULI[0])])
    assert plain.positions is None and len(plain.times) == len(plain.tip_path)
    assert plain.times[0] == TASK.release_time and plain.times[-1] == TASK.end_time
    # other times divide into other substeps
    np.testing.assert_allclose(plain.reached, outcome.reached[:1], rtol=5e-3)


# ---- similarity ----------------------------------------------------------------------------------


def test_a_rope_of_twice_the_length_reaches_twice_as_far(outcome):
    large = TASK.scaled_to(2.0 * L)
    moduli = [
        large.conditioned_on(modulus, length=L, diameter=TASK.diameter) for modulus in MODULI[:2]
    ]
    assert moduli == pytest.approx([2.0 * modulus for modulus in MODULI[:2]])
    materials = [material(modulus) for modulus in moduli]
    reached = large.simulate(2.0 * RELEASES[:2], materials, record_particles=True).reached
    np.testing.assert_allclose(reached, 2.0 * outcome.reached[:2], rtol=2e-4)


def test_a_thinner_rope_of_equal_bending_length_reaches_as_far():
    thick = replace(TASK, cells_across=1.5, air_density=0.0)
    thin = thick.scaled_to(L, diameter=0.010)
    modulus = thin.conditioned_on(MODULI[1], length=L, diameter=TASK.diameter)
    given = bending_length(MODULI[1], TASK.diameter / 4.0, 9.81)
    assert bending_length(modulus, thin.diameter / 4.0, 9.81) == pytest.approx(given)
    reached = thin.simulate(RELEASES[1:2], [material(modulus, damping=5e-3)]).reached[0]
    # of two bending lengths
    two = [material(m, damping=5e-3) for m in MODULI[:2]]
    unmatched, matched = thick.simulate(RELEASES[:2], two).reached
    assert abs(reached - matched) < 0.02 * L < abs(reached - unmatched)


def test_the_papers_scene():
    """Its rope of E 500 to 10500 under gravity 12 gives our default rope's range."""
    paper = RopeReaching(length=0.5, diameter=0.028, gravity=12.0)
    assert [paper.move_time, paper.release_time, paper.end_time] == [0.38, 0.57, 1.14]
    low, high = (
        RopeReaching().conditioned_on(E, length=0.5, diameter=0.028, gravity=12.0)
        for E in (500.0, 10500.0)
    )
    assert RopeReaching().parameter_ranges["specific_modulus"] == (200.0, 4300.0)
    assert (low, high) == pytest.approx((200.0, 4300.0), rel=0.025)


def test_scaling_back_is_the_same_task():
    task = RopeReaching(damping=1.5)
    there = task.scaled_to(4.0 * L)
    assert there.diameter == pytest.approx(4.0 * task.diameter)
    assert there.damping == pytest.approx(task.damping / 2.0)
    assert there.end_time == pytest.approx(2.0 * task.end_time)
    assert there.scaled_to(L) == task


# ---- actions and draws ---------------------------------------------------------------------------


def test_sampled_actions_fill_what_is_allowed():
    actions = TASK.sample_actions(np.random.default_rng(0), 2000) / L
    distance = np.hypot(actions[:, 0] - 1.0, actions[:, 1] - 1.1)
    assert actions.shape == (2000, 2)
    for values, low, high in [
        (actions[:, 0], 0.24, 0.9),
        (actions[:, 1], 0.24, 1.0),
        (distance, 0.6, 0.94),
    ]:
        assert low <= values.min() < low + 0.02 and high - 0.02 < values.max() <= high
    # uniform: of two equal squares, each wholly allowed, none gets more
    squares = [
        int(np.sum((np.abs(actions[:, 0] - x) < 0.1) & (np.abs(actions[:, 1] - z) < 0.1)))
        for x, z in [(0.5, 0.5), (0.4, 0.66)]
    ]
    assert abs(squares[0] - squares[1]) < 4.0 * math.sqrt(sum(squares))
    for action in actions[:50] * L:
        np.testing.assert_array_equal(TASK.check_action(action), action)


@pytest.mark.parametrize(
    "action, says",
    [
        ((0.5, 0.2), "x in"),  # box
        ((0.06, 0.06), "from the top"),  # a corner that the rope cannot reach
        ((0.22, 0.24), "0.15 to 0.235 m from the top"),  # too close
        ((0.1, math.nan), "finite"),
        ((0.1, 0.1, 0.1), "two finite numbers"),
        (0.1, "two finite numbers"),
    ],
)
def test_actions_out_of_limits_are_refused(action, says):
    for use in (TASK.check_action, TASK.grippers, TASK.trajectory):
        with pytest.raises(ParameterError, match=says):
            use(action)


def test_draws_follow_the_seed_and_the_ranges():
    draws = [TASK.draw(np.random.default_rng([3, i])) for i in range(400)]
    assert TASK.draw(np.random.default_rng([3, 7])) == draws[7]
    assert len({draw["release_x"] for draw in draws}) == 400
    for name, (low, high) in TASK.parameter_ranges.items():
        values = np.array([draw[name] for draw in draws])
        assert low <= values.min() and values.max() <= high
    modulus = np.array([draw["specific_modulus"] for draw in draws])
    median = math.sqrt(200.0 * 4300.0)
    assert 160 < np.sum(modulus < median) < 240  # log-uniform; uniform would give 68
    for draw in draws[:20]:
        assert draw["youngs_modulus"] == draw["specific_modulus"] * draw["density"]
        assert (draw["length"], draw["diameter"]) == (L, TASK.diameter)
        TASK.check_action([draw[name] for name in TASK.action_names])


# ---- demonstrations ------------------------------------------------------------------------------


def test_a_world_that_diverges_fails_alone():
    draws = [
        {
            "release_x": x,
            "release_z": z,
            "youngs_modulus": 1000.0 * modulus,
            "poissons_ratio": 0.3,
            "density": 1000.0,
        }
        for (x, z), modulus in zip(RELEASES[:3], [MODULI[0], 0.1, MODULI[2]], strict=True)
    ]
    with pytest.raises(SimulationError):
        TASK.simulate(RELEASES[1:2], [material(0.1)])
    outcomes = TASK.demonstrate(draws)
    assert outcomes.faults[0] is None and outcomes.faults[2] is None
    assert outcomes.faults[1] is not None and " s" in outcomes.faults[1]
    goal = outcomes.columns["goal_x"]
    assert np.isnan(goal[1])
    others = TASK.simulate(RELEASES[[0, 2]], [material(MODULI[0]), material(MODULI[2])])
    np.testing.assert_array_equal(goal[[0, 2]], others.reached)
    substep = outcomes.columns["substep"]
    assert np.all(substep > 0.0) and substep[1] > substep[0] > substep[2]


def test_numbers_that_do_not_agree_are_refused():
    with pytest.raises(ParameterError, match="one release point"):
        TASK.simulate(RELEASES[:2], [material(400.0)])


@pytest.mark.parametrize(
    "setting",
    [
        {"length": 0.0},
        {"diameter": -0.01},
        {"gravity": math.nan},
        {"cells_across": 0.0},
        {"damping": -1.0},
        {"air_density": -1.0},
        {"diameter": 0.1},
    ],
)
def test_settings_out_of_range_are_refused(setting):
    with pytest.raises(ParameterError, match=next(iter(setting))):
        RopeReaching(**setting)


def test_scaling_to_nothing_is_refused():
    with pytest.raises(ParameterError, match="length"):
        TASK.scaled_to(0.0)
    with pytest.raises(ParameterError, match="specific_modulus"):
        TASK.conditioned_on(-1.0, length=L, diameter=0.01)


def test_settings_rebuild_the_task():
    task = RopeReaching(length=0.4, diameter=0.01, damping=0.5)
    settings = json.loads(json.dumps(task.settings()))
    assert TASKS[task.name](**settings) == task


# ---- robot ---------------------------------------------------------------------------------------


def test_trajectory_is_the_gripper_s_path():
    plan = json.loads(json.dumps(TASK.trajectory(RELEASES[0], control_dt=0.02)))
    time, position = np.array(plan["time"]), np.array(plan["position"])
    assert time[0] == 0.0 and time[-1] == plan["release_time"] == TASK.release_time
    assert 0.0 < np.diff(time).min() and np.diff(time).max() <= 0.02 + 1e-12
    np.testing.assert_allclose(position[0], [L, 0.0, 0.1 * L])
    np.testing.assert_allclose(position[-1], [0.45 * L, 0.0, 0.6 * L])
    np.testing.assert_allclose(position, TASK.grippers(RELEASES[0])[1].position_at(time))
    moving = time <= TASK.move_time + 1e-9
    speed = np.linalg.norm(np.diff(position[moving], axis=0), axis=1) / np.diff(time[moving])
    np.testing.assert_allclose(speed, plan["speed"])
    np.testing.assert_allclose(plan["top"], [L, 0.0, 1.1 * L])
    with pytest.raises(ParameterError, match="control_dt"):
        TASK.trajectory(RELEASES[0], control_dt=0.0)


def test_tasks_need_no_torch(run_python):
    code = "import sys, gendom.tasks; print('torch' in sys.modules)"
    assert run_python(code) == "False"
