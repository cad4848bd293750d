"""Rope reaching and casting: the hand's motion, its limits, physics, which point counts."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import Material, Rope
from gendom.robot import XARM7, TcpPaths, follow
from gendom.tasks import Observed, RopeCasting, RopeReaching
from gendom.tasks.world import Simulation

REACHING, PLANE, CASTING = RopeReaching(), RopeReaching(bow=0.0), RopeCasting()
L = 0.25

# one release with a soft and a stiff rope, then one rope released farther and farther back
ACTIONS = np.array([[0.45, 0.45], [0.45, 0.45], [0.8, 0.3], [0.6, 0.35], [0.35, 0.55]]) * L
MODULI = [250.0, 1000.0, 400.0, 400.0, 400.0]


def rope(E_over_rho, *, damping=0.005, length=L, diameter=0.014):
    material = Material(E=1000.0 * E_over_rho, nu=0.3, density=1000.0, damping=damping)
    return Rope(length=length, diameter=diameter, material=material)


def reached(task, items, actions, **settings):
    outcomes = Simulation(**settings).carry_out(task, items, actions)
    assert [o.fault for o in outcomes] == [None] * len(items)
    return np.array([[o.values[name] for name in ("x", "sideways")] for o in outcomes]).T


def test_stiffness_damping_and_release_change_the_reach():
    items = [*(rope(m) for m in MODULI), rope(MODULI[3], damping=0.02)]
    reaches, _ = reached(REACHING, items, ACTIONS[[*range(5), 3]])
    soft, stiff, near, middle, far, damped = reaches
    assert abs(stiff - soft) > 0.01 * L
    assert near + 0.05 * L < middle < far - 0.05 * L and damped < middle
    assert np.all(reaches > L) and np.all(reaches < 2.0 * L)


def test_a_rope_of_twice_the_length_reaches_twice_as_far():
    """At equal dimensionless parameters; the air's is turned off, since density stays."""
    large = [rope(2.0 * m, length=2.0 * L, diameter=0.028, damping=0.005 * 2**0.5) for m in MODULI]
    small, _ = reached(PLANE, [rope(m) for m in MODULI], ACTIONS, air_density=0.0)
    twice, _ = reached(PLANE, large, 2.0 * ACTIONS, air_density=0.0)
    np.testing.assert_allclose(twice, 2.0 * small, rtol=1e-3)


def test_both_engines_reach_the_same():
    rods, particles = (
        reached(PLANE, [rope(400.0)] * 2, ACTIONS[3:], engine=engine)[0]
        for engine in ("thin", "mpm")
    )
    np.testing.assert_allclose(rods, particles, atol=0.015 * L)


def test_a_clamped_arc_falls_out_of_its_plane_unless_it_hangs_perfectly():
    """Near to the top the arc is unstable; far from it, a rope nearly straight is not."""
    stiff, near_and_far = [rope(2000.0)] * 2, np.array([[0.7, 0.5], [0.25, 0.55]]) * L
    x, sideways = reached(PLANE, stiff, near_and_far)
    assert sideways[0] < 1e-6 * L
    real_x, real_sideways = reached(REACHING, stiff, near_and_far)
    assert real_sideways[0] > 0.1 * L and abs(real_x[0] - x[0]) > 0.05 * L
    assert REACHING.risk is not None and real_sideways[1] < REACHING.risk.limit * L
    assert real_x[1] == pytest.approx(x[1], abs=0.01 * L)


def test_sampled_actions_fill_what_is_allowed():
    x, z = REACHING.sample_actions(REACHING.item, np.random.default_rng(0), 2000).T / L
    distance = np.hypot(x - 1.0, z - 1.1)
    for values, low, high in ((x, 0.24, 0.9), (z, 0.24, 1.0), (distance, 0.6, 0.94)):
        assert low <= values.min() < low + 0.02 and high - 0.02 < values.max() <= high


@pytest.mark.parametrize("action", [(0.06, 0.06), (0.22, 0.24)])
def test_releases_too_near_to_the_top_or_too_far_are_refused(action):
    limits = r"0\.15 to 0\.235 m from the top at \(0\.25, 0\.275\) m"
    with pytest.raises(ParameterError, match=limits):
        REACHING.check_action(REACHING.item, action)


def test_the_tool_is_still_when_it_opens_and_the_farthest_x_after_that_counts():
    path = REACHING.tool_path(REACHING.item, ACTIONS[0])
    opens = path.events[1].time
    for blend in (0.0, path.max_blend):
        before, after = path.position_at(opens + np.array([-1e-5, 1e-5]), blend)
        assert np.linalg.norm(after - before) < 1e-12
    np.testing.assert_allclose(path.position_at(opens), np.insert(ACTIONS[0], 1, 0.0))
    world = Simulation(everything=True)
    outcome = world.carry_out(REACHING, [rope(400.0)], ACTIONS[4:], keep=True)[0]
    seen = outcome.seen
    assert seen is not None
    free = seen.times >= seen.opens - 1e-9
    assert outcome.values["x"] == seen.tip[free, 0].max() > seen.tip[~free, 0].max()


def test_the_hand_casts_with_its_speed_and_acceleration():
    item = rope(1000.0, length=0.3)
    path = CASTING.tool_path(item, np.array([0.2]))
    t = np.linspace(-0.1, 1.0, 20001)
    x = path.position_at(t, path.blend or 0.0)[:, 0]
    v = np.gradient(x, t)
    assert x[0] == 0.0 and x[-1] == pytest.approx(0.2)
    assert np.abs(x[t <= 0.0]).max() < 1e-12 and x[t > 0.01][0] > 0.0
    assert v.max() == pytest.approx(0.46 * math.sqrt(9.81 * 0.3), rel=1e-4)
    assert np.abs(np.gradient(v, t)).max() == pytest.approx(0.8 * 9.81, rel=1e-2)
    # the arm does it as it is asked
    for action in CASTING.limits(item)[0]:
        path = CASTING.tool_path(item, np.array([action])).moved(CASTING.T_world_task(item))
        motion = follow(XARM7, path)
        assert motion.slowed_by == 1.0 and motion.blend == path.blend


@pytest.mark.parametrize(
    ("hand", "x", "z", "highest", "whole"),
    [
        # behind the hand it counts only if asked for
        ([0.0, 0.1, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2], [0.0, 0.0, 0.1, 0.25, 0.4, 0.3, 0.1, 0.0],
         [0.0, 0.0, 0.0, 0.02, 0.1, 0.05, 0.08, 0.15], (0.4, 0.1), (0.0, 0.15)),
        # nor does what is reached while the hand still moves
        ([0.0, 0.1, 0.2, 0.2, 0.2], [0.0, 0.2, 0.25, 0.3, 0.1], [0.0, 0.3, 0.1, 0.2, 0.0],
         (0.3, 0.2), (0.2, 0.3)),
    ],
)  # fmt: skip
def test_a_cast_s_highest_point_is_before_the_hand_that_stands(hand, x, z, highest, whole):
    tip, T = np.stack([x, np.zeros(len(x)), z], axis=1)[:, None], len(x)
    path = np.stack([hand, np.zeros(T), np.full(T, 0.3)], axis=1)
    times = np.linspace(0.0, 0.01 * (T - 1), T)
    seen = Observed(times=times, points=tip, hand=path, opens=math.inf)
    found = CASTING.outcome(CASTING.item, seen)
    assert (found["x"], found["z"]) == highest
    found = RopeCasting(whole_motion=True).outcome(CASTING.item, seen)
    assert (found["x"], found["z"]) == whole


class Aside(RopeReaching):
    """It says anew where the tool goes with one rope."""

    def tool_path(self, item, action):
        path = super().tool_path(item, action)
        return replace(path, position=path.position + np.array([0.0, 0.01, 0.0]))


@pytest.mark.parametrize("task", [REACHING, CASTING, RopeCasting(whole_motion=True), Aside()])
def test_many_ropes_are_led_and_judged_as_each_alone(task):
    rng, items = np.random.default_rng(4), [rope(400.0)] * 20
    actions = task.draw_actions(items, [rng] * 20)
    paths, t = task.tool_paths(items, actions), task.times(items[0])
    each = TcpPaths([task.tool_path(items[0], action) for action in actions])
    for found, wanted in zip(paths.sampled(), each.sampled(), strict=True):
        np.testing.assert_array_equal(found, wanted)
    assert paths.events == each.events
    hand, tip = paths.position_at(t), 0.02 * rng.normal(size=(20, len(t), 1, 3)).cumsum(axis=1)
    np.testing.assert_array_equal(hand, each.position_at(t))
    opens = rng.choice(t[: len(t) // 2], 20)
    seen = Observed(times=t, points=tip, hand=hand, opens=opens)
    found = task.outcomes_of(items, seen)
    for w, item in enumerate(items):
        assert {name: x[w] for name, x in found.items()} == task.outcome(item, seen[w])
    assert len(set(found["x"])) == 20
