"""The lift and the tasks, by the arm and by a free hand."""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pytest

from gendom.errors import DeviceError, ParameterError, RobotError, SimulationError
from gendom.materials import Material, Rope, thickness_of, unit_of
from gendom.reality import (
    OBJECTS,
    RealCloth,
    RealRope,
    RealWorld,
    TrialRun,
    lift,
    lift_cameras,
    observe,
    task_trial,
)
from gendom.reality.arm import surroundings
from gendom.robot import LIFT_ENDS, XARM7, CollisionChecker, LiftMotion, predefined_lift
from gendom.tasks import ClothSpreading, RopeCasting, RopeReaching
from gendom.tasks.cloth_spreading import WAIT as SPREADING_WAIT
from gendom.tasks.world import Simulation

REACHING, CASTING, SPREADING = RopeReaching(), RopeCasting(), ClothSpreading()

POLYESTER = cast(RealRope, OBJECTS["rope-polyester"])
COTTON_CLOTH = cast(RealCloth, OBJECTS["cloth-cotton"])

STRETCHED = POLYESTER.length * np.array([0.5, 0.31])
"""A release point far from the top: a rope that is nearly straight does not buckle sideways."""

PAPER_CLOCK = np.sqrt((POLYESTER.length / 9.81) / (0.5 / 12.0))
"""Seconds in a unit of time of the paper's, for this rope."""

TOO_LONG = Rope(length=1.5, diameter=0.05, material=Material(E=1e6, density=900.0))
"""What is done with a rope so long is out of the arm's reach."""


def carried_out(world, task, item, action):
    """What came of one action, and what was seen of it."""
    outcome = world.carry_out(task, [item], [action], keep=True)[0]
    assert outcome.fault is None and outcome.seen is not None
    return outcome.values, outcome.seen


@dataclass(frozen=True, kw_only=True)
class NotYetRaised(ClothSpreading):
    """Over 50 ms after the hand has closed."""

    def times(self, item):
        return np.array([0.05 - SPREADING_WAIT * unit_of("s", item)])


@pytest.mark.parametrize(
    "name", ["rope-polyester", pytest.param("cloth-rubber-200mm", marks=pytest.mark.slow)]
)
def test_the_arm_lifts(name):
    """What is held goes where the tool goes, and keeps its place and direction there."""
    item = OBJECTS[name]
    trial = lift(item, replace(predefined_lift(item.kind), speed=0.2))
    run = TrialRun(replace(trial, timestep=1e-3 if item is POLYESTER else None))
    assert run.motion is not None and run.motion.slowed_by == 1.0
    run.motion.check_limits(XARM7)
    run.step_to(run.closes)
    world, path = run.world, run.trial.path
    offset = world.vertices()[world.held] - world.hand
    for time in np.linspace(run.closes + 0.1, run.end, 12):
        run.step_to(time)
        ideal = path.position_at(world.time)
        assert world.hand == pytest.approx(ideal, abs=1e-3)
        moved = world.vertices()[world.held] - ideal - offset
        assert np.linalg.norm(moved, axis=1).max() < 1e-3
    assert world.hand[2] == pytest.approx(path.position[-1, 2], abs=1e-3)
    if isinstance(item, RealRope):
        along = np.linalg.norm(np.diff(world.vertices(), axis=0), axis=1).sum()
        assert along == pytest.approx(item.length, rel=0.005)


@pytest.mark.parametrize("item", [POLYESTER, COTTON_CLOTH], ids=lambda item: item.kind)
def test_only_a_rope_that_is_held_still_is_quasi_static(item):
    lifts = [lift(item, predefined_lift(item.kind, end)) for end in LIFT_ENDS]
    assert [one.quasi_static for one in lifts] == [isinstance(item, RealRope), False, False]
    assert [one.quick for one in lifts] == [False, True, True]


def test_a_dropped_rope_lies_on_the_table():
    motion = LiftMotion(kind="rope", rise=0.1 / POLYESTER.length, speed=0.2, end="drop")
    run = TrialRun(replace(lift(POLYESTER, motion), timestep=1e-3), robot=False)
    opens = run.opens
    # closing, two waits and a rise of 0.5 s each, and a second in which it falls
    assert opens == pytest.approx(2.0) and run.end == pytest.approx(3.0)
    run.step_to(opens - 0.01)
    hand = run.world.hand
    assert run.world.vertices()[0, 2] > 0.09 and len(run.world.held) > 0
    run.step_to(run.end)
    assert len(run.world.held) == 0
    assert run.world.hand == pytest.approx(hand)
    assert run.world.vertices()[:, 2].max() < POLYESTER.diameter
    assert run.world.speed() < 0.02


@pytest.mark.parametrize(
    "trial",
    [
        lambda: lift(COTTON_CLOTH),
        lambda: task_trial(REACHING, POLYESTER, (0.089, 0.262)),
        lambda: task_trial(CASTING, POLYESTER, [0.27]),
        lambda: task_trial(SPREADING, COTTON_CLOTH, [0.25]),
    ],
    ids=["lift", "reach", "cast", "spread"],
)
def test_what_is_done_by_default_touches_nothing(trial):
    """Planned with the collision check, and free by the check alone, the lift's cameras too."""
    trial = trial()
    cameras = lift_cameras(trial.item)
    motion = TrialRun(trial, cameras=cameras).motion
    assert motion is not None
    thick = thickness_of(trial.item)
    assert CollisionChecker(XARM7, surroundings(cameras), opening=thick).along(motion) is None


def test_reaching_by_arm_and_by_free_hand():
    both, trial = [], replace(task_trial(REACHING, POLYESTER, STRETCHED), timestep=1e-3)
    for robot in (False, True):
        run = TrialRun(trial, robot=robot)
        seen = observe(REACHING, run)
        both.append((run, seen, REACHING.outcome(POLYESTER, seen)))
    (_, _, free), (run, _, arm) = both
    assert run.motion is not None and run.motion.slowed_by == 1.0
    run.motion.check_limits(XARM7)
    assert arm["x"] == pytest.approx(free["x"], abs=0.003)
    assert arm["sideways"] < 0.015
    L = POLYESTER.length
    wait = 3.0 * np.sqrt(L / 9.81)
    for run, seen, values in both:
        # the release keeps its time, here and on the task's clock, 0 when the hand begins to move
        moves = run.closes + wait
        assert run.opens == pytest.approx(moves + 0.57 * PAPER_CLOCK, abs=1e-9)
        assert run.end == pytest.approx(moves + 1.14 * PAPER_CLOCK, abs=1e-9)
        assert seen.times[0] == pytest.approx(-wait, abs=1e-9)
        assert seen.opens == pytest.approx(0.57 * PAPER_CLOCK, abs=1e-9)
        # the goal is measured in the task frame
        assert seen.points[0, 0] == pytest.approx([L, 0.0, 1.1 * L], abs=1e-3)
        for low in (seen.tip[0], seen.hand[0]):
            assert low == pytest.approx([L, 0.0, 0.1 * L], abs=2e-3)
        world = run.world
        for there, here in ((world.vertices(), seen.points[-1]), (world.hand, seen.hand[-1])):
            x, y, z = np.moveaxis(here, -1, 0)
            expected = np.stack([0.48 + y, 0.30 - x, 0.12 + z], axis=-1)
            np.testing.assert_allclose(there, expected, atol=1e-12)
        after = seen.times >= seen.opens
        x, y, _ = seen.tip[after].T
        assert (values["x"], values["sideways"]) == (x.max(), np.abs(y).max())
        # until the release the tip is where it was sent
        assert seen.tip[~after][-1] == pytest.approx([STRETCHED[0], 0.0, STRETCHED[1]], abs=1e-3)


def test_casting_by_free_hand_by_arm_and_in_our_simulator():
    L, way = POLYESTER.length, 0.25
    (free, seen), (arm, _), (ours, _) = (
        carried_out(world, CASTING, POLYESTER, [way])
        for world in (
            RealWorld(robot=False, timestep=5e-4),
            RealWorld(timestep=5e-4),
            Simulation(everything=True),
        )
    )
    still, before = np.array([0.0, 0.0, L]), seen.times <= 0.0
    assert seen.times[0] == pytest.approx(-3.0 * np.sqrt(L / 9.81))
    assert np.abs(seen.hand[before] - still).max() < 1e-9
    assert np.linalg.norm(seen.tip[before], axis=1).max() < 4e-3
    assert seen.hand[-1] == pytest.approx([way, 0.0, L], abs=1e-6)
    assert np.isinf(seen.opens)
    trial = task_trial(CASTING, POLYESTER, [way])
    assert trial.path.position[-1] == pytest.approx([0.45, 0.115, 0.15 + L])
    for origin in (trial.path.position[0], trial.layout.origin):
        assert origin == pytest.approx([0.45, -0.135, 0.15 + L])
    # all cast alike; a servo is never perfect: it is the arm that did it
    for other in (arm, ours):
        assert (other["x"], other["z"]) == pytest.approx((free["x"], free["z"]), abs=0.003)
        assert 0.0 < abs(other["x"] - free["x"])


def test_a_cloth_lies_where_the_task_has_it_and_is_held_beside_its_centre():
    """By what is within the fingers' breadth, half a spacing more."""
    cloth, n = COTTON_CLOTH, COTTON_CLOTH.vertices
    values, seen = carried_out(RealWorld(robot=False), NotYetRaised(), cloth, [0.25])
    assert seen.lattice == (n, n) and len(seen.times) == 6
    flat = np.pad(cloth.sheet[0], ((0, 0), (0, 1)))
    assert np.abs(seen.points[..., :2] - flat[:, :2]).max() < 1e-5
    assert 0.0 < seen.points[..., 2].min() and seen.points[..., 2].max() < 0.002
    # 4.5 mm and 1.95 mm beside the centre
    assert seen.hand[0] == pytest.approx([0.1545, 0.15195, 0.002], abs=1e-9)
    assert values == pytest.approx({"share": 1.0, "unspread": 0.0, "covered": 1.0}, abs=1e-6)
    run = TrialRun(task_trial(SPREADING, cloth, [0.25]), robot=False)
    run.step_to(run.closes)
    away = np.linalg.norm(flat[:, :2] - seen.hand[0, :2], axis=1)
    near = np.flatnonzero(away < 0.0125 + 0.525 * cloth.spacing)
    assert len(near) == 14 and run.world.held.tolist() == near.tolist()


def test_what_fails_is_a_fault_and_others_go_on(monkeypatch):
    """What the arm refuses, and a world that diverges."""
    done, items = [], [TOO_LONG, POLYESTER]
    actions = [np.array([0.5, 0.31]) * TOO_LONG.length, STRETCHED]
    world = RealWorld(timestep=1e-3)
    refused, reached = world.carry_out(REACHING, items, actions, on_frame=done.append)
    assert refused.values == {} and refused.seen is None
    assert refused.fault is not None and refused.fault.startswith("xarm7: (")
    assert "out of reach" in refused.fault
    assert reached.fault is None and reached.seen is None
    assert POLYESTER.length < reached.values["x"] < 2.0 * POLYESTER.length
    assert done == [1, 2]

    def diverge(*_):
        raise SimulationError("the second reality diverged", where="a rope, t = 0.1 s")

    monkeypatch.setattr("gendom.reality.world.Reality.step_to", diverge)
    (outcome,) = RealWorld(robot=False).carry_out(CASTING, [POLYESTER], [[0.2]])
    assert outcome.values == {} and "t = 0.1 s: the second" in (outcome.fault or "")


def test_what_cannot_be_is_refused_before_anything_is_done():
    done = []
    for actions, text in ([[0.2], [3.0]], "out of limits"), ([[0.2]], "for 2 objects"):
        with pytest.raises(ParameterError, match=text):
            RealWorld().carry_out(CASTING, [POLYESTER] * 2, actions, on_frame=done.append)
    assert done == []
    with pytest.raises(ParameterError, match="2 finite numbers"):
        task_trial(REACHING, POLYESTER, (np.nan, 0.1))
    with pytest.raises(RobotError, match="is for a cloth, and rope-polyester is a rope"):
        lift(POLYESTER, predefined_lift("cloth"))
    with pytest.raises(DeviceError, match="not on cuda"):
        RealWorld().on("cuda")
    assert RealWorld().on("cpu") == RealWorld()


def test_several_processes_do_the_same_as_one():
    actions = REACHING.sample_actions(POLYESTER, np.random.default_rng(0), 2)
    worlds = (RealWorld(robot=False, timestep=1e-3, jobs=jobs) for jobs in (1, 2))
    alone, together = (w.carry_out(REACHING, [POLYESTER] * 2, actions) for w in worlds)
    assert [o.values for o in alone] == [o.values for o in together]
    assert alone[0].values != alone[1].values
