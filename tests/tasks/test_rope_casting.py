"""Rope casting: the hand's motion, and which highest point counts."""

import math

import numpy as np
import pytest

from gendom.materials import Material, Rope
from gendom.robot import XARM7, follow
from gendom.tasks import Observed, RopeCasting
from gendom.tasks.world import Simulation

TASK = RopeCasting()
ROPE = Rope(
    length=0.3, diameter=0.016, material=Material(E=1.2e6, nu=0.35, density=900.0, damping=0.004)
)


def seen(x, z, hand):
    """A tip that goes (x, z) [T] while the hand goes along x."""
    T = len(x)
    tip = np.stack([x, np.zeros(T), z], axis=1)[:, None]
    path = np.stack([hand, np.zeros(T), np.full(T, 0.3)], axis=1)
    return Observed(
        times=np.linspace(0.0, 0.01 * (T - 1), T), points=tip, hand=path, opens=math.inf
    )


def test_the_hand_keeps_speed_and_acceleration():
    path = TASK.tool_path(ROPE, np.array([0.2]))
    t = np.linspace(-0.1, 1.0, 20001)
    x = path.position_at(t, path.blend or 0.0)[:, 0]
    v = np.gradient(x, t)
    assert x[0] == 0.0 and x[-1] == pytest.approx(0.2)
    assert np.abs(x[t <= 0.0]).max() < 1e-12 and x[t > 0.01][0] > 0.0
    assert v.max() == pytest.approx(0.46 * math.sqrt(9.81 * 0.3), rel=1e-4)
    assert np.abs(np.gradient(v, t)).max() == pytest.approx(0.8 * 9.81, rel=1e-2)
    # the arm does it as it is asked
    for action in TASK.limits(ROPE)[0]:
        path = TASK.tool_path(ROPE, np.array([action])).moved(TASK.T_world_task(ROPE))
        motion = follow(XARM7, path)
        assert motion.slowed_by == 1.0 and motion.blend == path.blend


def test_a_highest_point_behind_the_hand_does_not_count_unless_asked_for():
    hand = np.array([0.0, 0.1, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2])
    x = np.array([0.0, 0.0, 0.1, 0.25, 0.4, 0.3, 0.1, 0.0])
    z = np.array([0.0, 0.0, 0.0, 0.02, 0.1, 0.05, 0.08, 0.15])
    first = TASK.outcome(ROPE, seen(x, z, hand))
    assert (first["x"], first["z"]) == (0.4, 0.1)
    whole = RopeCasting(whole_motion=True).outcome(ROPE, seen(x, z, hand))
    assert (whole["x"], whole["z"]) == (0.0, 0.15)
    # what is reached while the hand still moves does not count
    hand = np.array([0.0, 0.1, 0.2, 0.2, 0.2])
    x = np.array([0.0, 0.2, 0.25, 0.3, 0.1])
    z = np.array([0.0, 0.3, 0.1, 0.2, 0.0])
    assert TASK.outcome(ROPE, seen(x, z, hand))["z"] == 0.2


def test_farther_casts_go_farther_and_stiffness_moves_them():
    stiff = Rope(length=0.3, diameter=0.016, material=Material(E=4e6, density=900.0))
    outcomes = Simulation().carry_out(TASK, [ROPE, ROPE, stiff], [[0.15], [0.25], [0.25]])
    x, z = np.array([[o.values["x"], o.values["z"]] for o in outcomes]).T
    assert x[1] > x[0] + 0.05
    assert math.hypot(x[2] - x[1], z[2] - z[1]) > 0.02
    assert all(o.values["sideways"] < 1e-9 for o in outcomes)
