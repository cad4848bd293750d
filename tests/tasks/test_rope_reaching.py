"""Rope reaching: limits, physics, similarity."""

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import Material, Rope
from gendom.tasks import RopeReaching
from gendom.tasks.world import Simulation

TASK = RopeReaching()
PLANE = RopeReaching(bow=0.0)
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
    return np.array([o.values["x"] for o in outcomes])


def test_stiffness_damping_and_release_change_the_reach():
    items = [*(rope(m) for m in MODULI), rope(MODULI[3], damping=0.02)]
    reaches = reached(TASK, items, ACTIONS[[*range(5), 3]])
    soft, stiff, near, middle, far, damped = reaches
    assert abs(stiff - soft) > 0.01 * L
    assert near + 0.05 * L < middle < far - 0.05 * L and damped < middle
    assert np.all(reaches > L) and np.all(reaches < 2.0 * L)


def test_a_rope_of_twice_the_length_reaches_twice_as_far():
    """At equal dimensionless parameters; the air's is turned off, since density stays."""
    large = [rope(2.0 * m, length=2.0 * L, diameter=0.028, damping=0.005 * 2**0.5) for m in MODULI]
    small = reached(PLANE, [rope(m) for m in MODULI], ACTIONS, air_density=0.0)
    np.testing.assert_allclose(
        reached(PLANE, large, 2.0 * ACTIONS, air_density=0.0), 2.0 * small, rtol=1e-3
    )


def test_both_engines_reach_the_same():
    items, actions = [rope(400.0)] * 2, ACTIONS[3:]
    by_rods = reached(PLANE, items, actions)
    by_particles = reached(PLANE, items, actions, engine="mpm")
    np.testing.assert_allclose(by_rods, by_particles, atol=0.015 * L)


def test_a_clamped_arc_falls_out_of_its_plane_unless_it_hangs_perfectly():
    """Near to the top the arc is unstable; far from it, a rope nearly straight is not."""
    stiff, world = rope(2000.0), Simulation()
    near, far = np.array([[0.7, 0.5], [0.25, 0.55]]) * L
    perfect, real = (world.carry_out(t, [stiff], [near])[0].values for t in (PLANE, TASK))
    assert perfect["sideways"] < 1e-6 * L
    assert real["sideways"] > 0.1 * L and abs(real["x"] - perfect["x"]) > 0.05 * L
    perfect, real = (world.carry_out(t, [stiff], [far])[0].values for t in (PLANE, TASK))
    assert TASK.risk is not None
    assert real["sideways"] < TASK.risk.limit * L
    assert real["x"] == pytest.approx(perfect["x"], abs=0.01 * L)


def test_sampled_actions_fill_what_is_allowed():
    actions = TASK.sample_actions(TASK.item, np.random.default_rng(0), 2000) / L
    distance = np.hypot(actions[:, 0] - 1.0, actions[:, 1] - 1.1)
    for values, low, high in [
        (actions[:, 0], 0.24, 0.9),
        (actions[:, 1], 0.24, 1.0),
        (distance, 0.6, 0.94),
    ]:
        assert low <= values.min() < low + 0.02 and high - 0.02 < values.max() <= high


@pytest.mark.parametrize("action", [(0.06, 0.06), (0.22, 0.24)])
def test_releases_too_near_to_the_top_or_too_far_are_refused(action):
    limits = r"0\.15 to 0\.235 m from the top at \(0\.25, 0\.275\) m"
    with pytest.raises(ParameterError, match=limits):
        TASK.check_action(TASK.item, action)


def test_the_tool_is_still_when_it_opens():
    path = TASK.tool_path(TASK.item, ACTIONS[0])
    opens = path.events[1].time
    for blend in (0.0, path.max_blend):
        before, after = path.position_at(opens + np.array([-1e-5, 1e-5]), blend)
        assert np.linalg.norm(after - before) < 1e-12
    np.testing.assert_allclose(path.position_at(opens), np.insert(ACTIONS[0], 1, 0.0))
    # the reach is the farthest x after the release
    world = Simulation(everything=True)
    outcome = world.carry_out(TASK, [rope(400.0)], ACTIONS[4:], keep=True)[0]
    seen = outcome.seen
    assert seen is not None
    free = seen.times >= seen.opens - 1e-9
    assert outcome.values["x"] == seen.tip[free, 0].max() > seen.tip[~free, 0].max()
