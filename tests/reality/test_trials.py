"""The lift and the tasks, by the arm and by a free hand."""

import itertools
import math
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra reality")

from gendom.errors import (
    DeviceError,
    GendomError,
    ParameterError,
    RobotError,
    SimulationError,
)
from gendom.materials import Cloth, Material, Rope, thickness_of, unit_of
from gendom.reality import (
    OBJECTS,
    RealCloth,
    RealRope,
    RealWorld,
    TrialRun,
    as_real,
    default_cameras,
    find_object,
    lift,
    lift_cameras,
    looking_at,
    observe,
    task_trial,
)
from gendom.reality.arm import surroundings
from gendom.robot import LIFT_ENDS, XARM7, collision_along, tcp_pose
from gendom.tasks import ClothSpreading, RopeCasting, RopeReaching
from gendom.tasks.cloth_spreading import WAIT as SPREADING_WAIT
from gendom.tasks.world import Simulation
from reality.benches import stretch

REACHING, CASTING, SPREADING = RopeReaching(), RopeCasting(), ClothSpreading()

POLYESTER = cast(RealRope, OBJECTS["rope-polyester"])
COTTON_CLOTH = cast(RealCloth, OBJECTS["cloth-cotton"])

STRETCHED = POLYESTER.length * np.array([0.5, 0.31])
"""A release point far from the top: a rope that is nearly straight does not buckle sideways."""

PAPER_CLOCK = np.sqrt((POLYESTER.length / 9.81) / (0.5 / 12.0))
"""Seconds in a unit of time of the paper's, for this rope."""

TOO_LONG = Rope(length=1.5, diameter=0.05, material=Material(E=1e6, density=900.0))
"""What is done with a rope so long is out of the arm's reach."""


def reaching(item, release):
    return task_trial(REACHING, item, release)


def casting(item, way):
    return task_trial(CASTING, item, [way])


def spreading(item, A):
    return task_trial(SPREADING, item, [A])


def edges(item, vertices):
    """Lengths over rest lengths along the rope, or along both sides of the cloth."""
    if isinstance(item, RealRope):
        spacing = item.length / (item.vertices - 1)
        return np.linalg.norm(np.diff(vertices, axis=0), axis=1) / spacing
    grid = vertices.reshape(*item.counts, 3)
    return np.concatenate(
        [np.linalg.norm(np.diff(grid, axis=k), axis=-1).ravel() / item.spacing for k in (0, 1)]
    )


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


# ---- the lift ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [n if n == "rope-polyester" else pytest.param(n, marks=pytest.mark.slow) for n in OBJECTS],
)
def test_the_arm_lifts(name):
    item = OBJECTS[name]
    run = TrialRun(lift(item))
    assert run.motion is not None
    run.motion.check_limits(XARM7)
    assert run.slowed_by == 1.0
    path = run.trial.path
    apart, speed = [], 0.0
    run.step_to(run.closes)
    offset = run.world.vertices()[run.world.held] - run.world.hand
    for time in np.arange(run.closes + 0.1, run.end, 0.25):
        run.step_to(time)
        world = run.world
        ideal = path.position_at(world.time)
        apart.append(np.linalg.norm(world.hand - ideal))
        # What is held goes where the tool goes, and keeps its place and direction there.
        moved = world.vertices()[world.held] - ideal - offset
        apart.append(np.linalg.norm(moved, axis=1).max())
        q = world.robot.measured(world.data)
        assert (q >= XARM7.q_min).all() and (q <= XARM7.q_max).all()
        speed = max(speed, world.speed())
    assert max(apart) < 1e-3
    run.step_to(run.end)
    assert run.world.hand[2] == pytest.approx(path.position[-1, 2], abs=1e-3)
    assert abs(edges(item, run.world.vertices()).mean() - 1.0) < 0.005
    if isinstance(item, RealRope):
        assert abs(stretch(item, run.world.vertices())) < 0.005


def test_a_slowed_arm_finishes_its_lift():
    """A lift at 2 m/s is beyond the arm; what it does instead takes longer, its pauses do not."""
    run = TrialRun(lift(POLYESTER, rise=0.06, speed=2.0))
    assert 1.1 < run.slowed_by < 1.3
    run.step_to(run.end)
    top = run.trial.path.position[-1]
    assert run.world.hand == pytest.approx(top, abs=1e-3)


def test_a_hand_that_would_close_beside_the_object_says_so():
    trial = lift(POLYESTER, rise=0.05)
    trial = replace(trial, layout=replace(trial.layout, origin=(0.32, 0.1, 0.008)))
    run = TrialRun(trial, robot=False)
    with pytest.raises(GendomError, match=r"100\.\d mm away"):
        run.step_to(run.end)


def test_the_hand_of_the_arm_is_where_its_kinematics_say():
    run = TrialRun(lift(POLYESTER, rise=0.05))
    run.step_to(1.2)
    world = run.world
    tool = tcp_pose(XARM7, world.robot.measured(world.data))
    assert world.hand == pytest.approx(tool[:3, 3], abs=1e-5)


@pytest.mark.parametrize("item", [POLYESTER, COTTON_CLOTH], ids=lambda item: item.kind)
def test_only_a_rope_that_is_held_still_is_quasi_static(item):
    kept = [lift(item, end=end).quasi_static for end in LIFT_ENDS]
    assert kept == [isinstance(item, RealRope), False, False]
    assert [lift(item, end=end).quick for end in LIFT_ENDS] == [False, True, True]


def test_a_dropped_rope_lies_on_the_table():
    run = TrialRun(lift(POLYESTER, rise=0.1, speed=0.2, end="drop"), robot=False)
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


def test_a_swung_rope_goes_on_when_the_arm_stops():
    run = TrialRun(lift(POLYESTER, rise=0.28, speed=0.3, end="swing"))
    motion = run.motion
    assert motion is not None
    stops = motion.end - (run.trial.path.end - run.trial.path.time[-2])
    run.step_to(stops)
    still, tips = run.world.hand, []
    for time in np.arange(stops, run.end, 0.02):
        run.step_to(time)
        assert run.world.hand == pytest.approx(still, abs=1e-3)
        tips.append(run.world.vertices()[-1, 0])
    assert run.end == pytest.approx(stops + 1.0, abs=motion.blend)
    # It swings on, there and back.
    steps = np.diff(tips)
    assert np.ptp(tips) > 0.04 and steps.max() > 0.004 and steps.min() < -0.004


# ---- what the arm touches ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "trial",
    [
        *(pytest.param(lambda i=i: lift(i), id=f"lift {n}") for n, i in OBJECTS.items()),
        pytest.param(lambda: lift(POLYESTER, end="swing"), id="swing"),
        *(
            pytest.param(lambda x=x, z=z: reaching(POLYESTER, (x, z)), id=f"reach {x} {z}")
            for x, z in ((0.242, 0.08), (0.089, 0.262), (0.257, 0.154))
        ),
        *(pytest.param(lambda a=a: casting(POLYESTER, a), id=f"cast {a}") for a in (0.12, 0.27)),
        pytest.param(lambda: spreading(COTTON_CLOTH, 0.25), id="spread"),
    ],
)
def test_what_is_done_by_default_touches_nothing(trial):
    """Planned with the collision check, and free by the check alone, the lift's cameras too."""
    trial = trial()
    cameras = lift_cameras(trial.item)
    motion = TrialRun(trial, cameras=cameras).motion
    assert motion is not None
    thick = thickness_of(trial.item)
    assert collision_along(XARM7, motion, surroundings(cameras), opening=thick) is None


def test_a_camera_in_the_arms_way_is_refused():
    trial = lift(POLYESTER)
    above = trial.path.position[-1] + [0.0, 0.05, -0.05]
    camera = default_cameras()[0].at(looking_at(above, (0.5, 0.0, 0.0)))
    with pytest.raises(RobotError, match=r"and camera left collide, \d+\.\d mm deep"):
        TrialRun(trial, cameras=[camera])


# ---- rope reaching -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stretched():
    """A release by the free hand and by the arm: the run, what was seen, what is reached."""
    both = []
    for robot in (False, True):
        run = TrialRun(reaching(POLYESTER, STRETCHED), robot=robot)
        seen = observe(REACHING, run)
        both.append((run, seen, REACHING.outcome(POLYESTER, seen)))
    return both


def test_arm_and_free_hand_reach_the_same(stretched):
    (_, _, free), (run, _, arm) = stretched
    assert run.motion is not None
    run.motion.check_limits(XARM7)
    assert run.slowed_by == 1.0
    assert arm["x"] == pytest.approx(free["x"], abs=0.003)
    assert arm["sideways"] < 0.015


@pytest.mark.parametrize("release", [(0.1925, 0.0965), (0.1598, 0.1197), (0.1073, 0.1456)])
def test_the_demo_s_rope_stays_in_its_plane_under_the_arm(release):
    """The demo's releases; a rope without resistance to twist falls by 7 to 57 mm."""
    rope = OBJECTS["rope-cotton"]
    free, arm = (
        carried_out(RealWorld(robot=robot, timestep=1e-3), REACHING, rope, release)[0]
        for robot in (False, True)
    )
    assert free["sideways"] < 1e-3
    assert arm["sideways"] < 0.005
    assert arm["x"] == pytest.approx(free["x"], abs=1e-3)


def test_the_unloaded_hand_is_where_it_is_sent():
    """Servos that are told what weight and motion ask for have little left to correct."""
    run = TrialRun(reaching(POLYESTER, STRETCHED))
    motion, world, apart = run.motion, run.world, []
    assert motion is not None
    for time in np.arange(run.closes, run.opens, 0.02):
        world.step_to(time)  # the hand stays open
        apart.append(world.hand - motion.tcp_at(XARM7, world.time)[:3, 3])
    assert np.abs(apart).max() < 5e-6


def test_the_release_keeps_its_time(stretched):
    """Closing, a wait of 3 sqrt(L / g), then the paper's own times, worked out anew."""
    wait = 3.0 * np.sqrt(POLYESTER.length / 9.81)
    for run, seen, _ in stretched:
        moves = run.closes + wait
        assert run.opens == pytest.approx(moves + 0.57 * PAPER_CLOCK, abs=1e-9)
        assert run.end == pytest.approx(moves + 1.14 * PAPER_CLOCK, abs=1e-9)
        # And on the task's clock, which is 0 when the hand begins to move.
        assert seen.times[0] == pytest.approx(-wait, abs=1e-9)
        assert seen.times[-1] == pytest.approx(1.14 * PAPER_CLOCK, abs=0.01)
        assert seen.opens == pytest.approx(0.57 * PAPER_CLOCK, abs=1e-9)


def test_a_free_hand_keeps_the_rope_in_its_plane(stretched):
    assert stretched[0][2]["sideways"] == pytest.approx(0.0, abs=1e-9)


def test_the_goal_is_measured_in_the_task_frame(stretched):
    """Task x is the world's -y from 0.30 m, and the hanging rope shows where it begins.

    At the start the top is at task (L, 0, 1.1 L) and the tip at (L, 0, 0.1 L); 0.12 m is the
    height of the task's origin.
    """
    L = POLYESTER.length
    for run, seen, values in stretched:
        assert seen.points[0, 0] == pytest.approx([L, 0.0, 1.1 * L], abs=1e-3)
        assert seen.tip[0] == pytest.approx([L, 0.0, 0.1 * L], abs=2e-3)
        assert seen.hand[0] == pytest.approx([L, 0.0, 0.1 * L], abs=1e-3)
        assert np.linalg.norm(seen.points[:, 0] - seen.points[0, 0], axis=1).max() < 1e-3
        world = run.world
        for there, here in ((world.vertices(), seen.points[-1]), (world.hand, seen.hand[-1])):
            x, y, z = np.moveaxis(here, -1, 0)
            expected = np.stack([0.48 + y, 0.30 - x, 0.12 + z], axis=-1)
            np.testing.assert_allclose(there, expected, atol=1e-12)
        after = seen.times >= seen.opens
        tip = seen.tip[after]
        assert values["x"] == tip[:, 0].max()
        assert values["sideways"] == np.abs(tip[:, 1]).max()
        # Until the release the tip is where it was sent; then the rope's bend carries it off.
        held = seen.tip[~after][-1]
        assert held == pytest.approx([STRETCHED[0], 0.0, STRETCHED[1]], abs=1e-3)
        assert L < values["x"] < 2.0 * L


def test_the_hand_holds_the_tip_until_it_opens():
    run = TrialRun(reaching(POLYESTER, STRETCHED), robot=False)
    assert run.trial.reach == pytest.approx(0.03 * POLYESTER.length)
    run.step_to(run.opens - 0.005)
    assert POLYESTER.vertices - 1 in run.world.held
    run.step_to(run.opens + 0.005)
    assert len(run.world.held) == 0


@pytest.mark.slow
def test_a_slowed_arm_opens_later_and_what_follows_takes_its_time():
    """A tip of 0.6 m pulled back far is faster than the arm may be."""
    L = 0.6
    rope = as_real(Rope(length=L, diameter=0.03, material=Material(E=2e6, density=900.0)))
    run = TrialRun(reaching(rope, (0.24 * L, 0.6 * L)))
    assert run.slowed_by > 1.05
    seen = observe(REACHING, run)
    clock = np.sqrt((L / 9.81) / (0.5 / 12.0))
    assert seen.opens > 0.57 * clock + 0.1
    assert seen.times[-1] - seen.opens == pytest.approx(0.57 * clock, abs=0.01)
    held = (seen.times > 0.0) & (seen.times < seen.opens)
    apart = np.linalg.norm(seen.tip - seen.hand, axis=1)
    assert apart[held].max() < 0.01 < 0.1 * L < apart[~held].max()
    release = seen.hand[np.searchsorted(seen.times, seen.opens)]
    assert release == pytest.approx([0.24 * L, 0.0, 0.6 * L], abs=1e-3)


# ---- rope casting --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def casts():
    """Two casts by the free hand, the shorter first."""
    return [carried_out(RealWorld(robot=False), CASTING, POLYESTER, [way]) for way in (0.15, 0.25)]


def test_a_larger_cast_throws_the_tip_higher(casts):
    for values, seen in casts:
        tip = seen.tip - seen.tip[0]
        assert values["z"] == tip[:, 2].max()
        assert values["x"] == tip[np.argmax(tip[:, 2]), 0]
    (low, _), (high, _) = casts
    assert high["z"] > low["z"] + 0.02 and high["x"] > low["x"] + 0.05
    assert low["sideways"] == pytest.approx(0.0, abs=1e-9)


def test_a_cast_runs_along_the_world_s_y_and_waits_for_the_rope_to_hang_still(casts):
    L, second = POLYESTER.length, np.sqrt(POLYESTER.length / 9.81)
    for way, (_, seen) in zip((0.15, 0.25), casts, strict=True):
        assert seen.points[0, 0] == pytest.approx([0.0, 0.0, L], abs=1e-3)
        assert seen.tip[0] == pytest.approx([0.0, 0.0, 0.0], abs=2e-3)
        assert seen.times[0] == pytest.approx(-3.0 * second)
        before = seen.times <= 0.0
        still = np.array([0.0, 0.0, L])
        np.testing.assert_allclose(seen.hand[before], np.tile(still, (before.sum(), 1)), atol=1e-9)
        assert np.linalg.norm(seen.tip[before] - seen.tip[0], axis=1).max() < 2e-3
        assert seen.hand[-1] == pytest.approx([way, 0.0, L], abs=1e-6)
        assert np.isinf(seen.opens)
    trial = casting(POLYESTER, 0.25)
    assert trial.path.position[0] == pytest.approx([0.45, -0.135, 0.15 + L])
    assert trial.path.position[-1] == pytest.approx([0.45, 0.115, 0.15 + L])
    assert trial.layout.origin == pytest.approx([0.45, -0.135, 0.15 + L])


def test_the_arm_casts():
    """Quick as it is, the arm stays near the path that it was given."""
    run = TrialRun(casting(POLYESTER, 0.2))
    path, motion, world = run.trial.path, run.motion, run.world
    assert motion is not None and motion.blend == path.blend and run.slowed_by == 1.0
    for time in np.arange(run.closes, run.end, 0.01):
        run.step_to(time)
        ideal = motion.tcp_at(XARM7, world.time)[:3, 3]
        assert np.linalg.norm(world.hand - ideal) < 1e-3
        assert np.linalg.norm(ideal - path.position_at(world.time, motion.blend)) < 1e-3


@pytest.mark.parametrize("way", [0.15, 0.25])
def test_arm_and_free_hand_cast_alike(casts, way):
    free, _ = casts[0 if way < 0.2 else 1]
    arm, _ = carried_out(RealWorld(), CASTING, POLYESTER, [way])
    assert (arm["x"], arm["z"]) == pytest.approx((free["x"], free["z"]), abs=0.003)
    # A servo is never perfect: it is the arm that did it.
    assert 0.0 < abs(arm["x"] - free["x"]) and arm["sideways"] > 1e-6


def test_both_realities_cast_alike(casts):
    """Our simulator, and MuJoCo with a hand that follows the same path."""
    ours, our_seen = carried_out(Simulation(everything=True), CASTING, POLYESTER, [0.25])
    theirs, seen = casts[1]
    for name in ("x", "z"):
        assert ours[name] == pytest.approx(theirs[name], abs=0.003)
        assert ours[name] != theirs[name]
    t = seen.times
    hand = np.stack([np.interp(t, our_seen.times, our_seen.hand[:, k]) for k in range(3)], axis=1)
    moving = (t > 0.0) & (t < 0.5)
    np.testing.assert_allclose(hand[moving], seen.hand[moving], atol=1e-3)
    assert np.ptp(hand[moving, 0]) > 0.2


# ---- cloth spreading -----------------------------------------------------------------------------


def test_a_cloth_lies_where_the_task_has_it_and_is_held_beside_its_centre():
    cloth = COTTON_CLOTH
    values, seen = carried_out(RealWorld(robot=False), NotYetRaised(), cloth, [0.25])
    n = cloth.vertices
    assert seen.lattice == (n, n) and len(seen.times) == 6
    u, v = np.meshgrid(*2 * [np.linspace(0.0, cloth.side, n)], indexing="ij")
    lattice = seen.points.reshape(-1, n, n, 3)
    np.testing.assert_allclose(lattice[..., 0], np.tile(u, (6, 1, 1)), atol=1e-5)
    np.testing.assert_allclose(lattice[..., 1], np.tile(v, (6, 1, 1)), atol=1e-5)
    assert 0.0 < lattice[..., 2].min() and lattice[..., 2].max() < 0.002
    # 4.5 mm and 1.95 mm beside the centre
    assert seen.hand[0] == pytest.approx([0.1545, 0.15195, 0.002], abs=1e-9)
    flat = {"share": 1.0, "unspread": 0.0, "covered": 1.0}
    assert values == pytest.approx(flat, abs=1e-6)


def test_the_cloth_is_gripped_over_the_fingers_breadth():
    run = TrialRun(spreading(COTTON_CLOTH, 0.25), robot=False)
    run.step_to(run.closes)
    world = run.world
    corner = np.array([0.32, -0.15, 0.0])
    held = (world.vertices()[world.held] - corner)[:, :2] / COTTON_CLOTH.spacing
    # the hand is at (154.5, 151.95) mm, fingers reach 12.5 mm and points are 7.5 mm apart
    reach = 12.5 + 0.525 * 7.5
    near = {
        (i, j)
        for i, j in itertools.product(range(41), repeat=2)
        if math.hypot(7.5 * i - 154.5, 7.5 * j - 151.95) < reach
    }
    assert {(round(i), round(j)) for i, j in held} == near
    assert len(near) == 14


@pytest.mark.slow
def test_the_arm_spreads_a_cloth():
    """A = 0: 16 equal steps down; the centre ends where it began and the cloth lies flat on it."""
    run = TrialRun(spreading(COTTON_CLOTH, 0.0))
    assert run.motion is not None
    run.motion.check_limits(XARM7)
    seen = observe(SPREADING, run, 30.0)
    values = SPREADING.outcome(COTTON_CLOTH, seen)
    n, m = COTTON_CLOTH.counts
    centre = seen.points.reshape(-1, n, m, 3)[:, n // 2, m // 2]
    assert centre[-1] == pytest.approx(centre[0], abs=2e-3)
    assert centre[:, 2].max() - centre[0, 2] == pytest.approx(0.24, abs=2e-3)
    assert 0.05 < values["covered"] < 0.5  # it crumples
    assert values["share"] < values["covered"]
    assert np.abs(edges(COTTON_CLOTH, seen.points[-1]).mean() - 1.0) < 0.005
    assert seen.points[-1, :, 2].min() > 0.0


# ---- the world of tasks --------------------------------------------------------------------------


def test_the_world_s_settings_arrive():
    for world, timestep, density in [
        (RealWorld(robot=False), 2.5e-4, 1.2),
        (RealWorld(robot=False, timestep=1e-3, air_density=0.0), 1e-3, 0.0),
    ]:
        run = world.begin(REACHING, POLYESTER, STRETCHED)
        assert run.world.model.opt.timestep == timestep
        assert run.world.air.density == density
        assert run.motion is None
    assert RealWorld().begin(REACHING, POLYESTER, STRETCHED).motion is not None
    _, seen = carried_out(RealWorld(robot=False, frame_rate=40.0), REACHING, POLYESTER, STRETCHED)
    np.testing.assert_allclose(np.diff(seen.times), 0.025)


def test_cloths_of_tasks_take_long_steps_unless_told():
    for timestep, taken in [(None, 0.004), (0.002, 0.002)]:
        world = RealWorld(robot=False, timestep=timestep)
        run = world.begin(SPREADING, COTTON_CLOTH, [0.2])
        run.step_to(0.008)
        options = run.world.model.opt
        assert (options.timestep, options.tolerance) == (taken, 1e-4)
    lifted = TrialRun(lift(COTTON_CLOTH), robot=False)
    assert lifted.world.model.opt.tolerance == 1e-6


@pytest.mark.slow
def test_long_steps_leave_a_spreading_as_it_is():
    rubber = find_object("cloth-rubber-200mm")
    shares = [
        carried_out(RealWorld(robot=False, timestep=timestep), SPREADING, rubber, [0.2])[0]["share"]
        for timestep in (None, 0.002)
    ]
    assert shares == pytest.approx([1.0, 1.0], abs=0.02)


def test_an_object_without_a_name_is_carried_out():
    """It does what a named one does that has its numbers."""
    plain = Rope(
        length=POLYESTER.length,
        diameter=POLYESTER.diameter,
        material=POLYESTER.material,
        friction=POLYESTER.friction,
    )
    made = as_real(plain)
    assert (made.friction, made.material) == (POLYESTER.friction, POLYESTER.material)
    limp = replace(plain, material=replace(plain.material, E=0.3 * plain.material.E))
    world, way = RealWorld(robot=False), [[0.2]] * 3
    named, same, other = world.carry_out(CASTING, [POLYESTER, plain, limp], way)
    assert same.values == named.values
    assert abs(other.values["z"] - same.values["z"]) > 1e-3
    cloth = Cloth(side=0.2, thickness=0.001)
    values, seen = carried_out(world, NotYetRaised(), cloth, [0.1])
    assert values["share"] == pytest.approx(1.0)
    assert np.ptp(seen.points[0], axis=0)[:2] == pytest.approx([0.2, 0.2], abs=1e-5)


def test_what_the_arm_refuses_is_a_fault_and_others_go_on():
    done = []
    outcomes = RealWorld().carry_out(
        REACHING,
        [TOO_LONG, POLYESTER],
        [np.array([0.5, 0.31]) * TOO_LONG.length, STRETCHED],
        on_frame=done.append,
    )
    refused, reached = outcomes
    assert refused.values == {} and refused.seen is None
    assert refused.fault is not None and refused.fault.startswith("xarm7: position")
    assert "out of reach" in refused.fault
    assert reached.fault is None and reached.seen is None
    assert POLYESTER.length < reached.values["x"] < 2.0 * POLYESTER.length
    assert done == [1, 2]


def test_a_simulation_that_fails_is_a_fault(monkeypatch):
    def diverge(*_):
        raise SimulationError("the second reality diverged", where="a rope, t = 0.1 s")

    monkeypatch.setattr("gendom.reality.world.Reality.step_to", diverge)
    outcome = RealWorld(robot=False).carry_out(CASTING, [POLYESTER], [[0.2]])[0]
    assert outcome.values == {} and "t = 0.1 s: the second reality diverged" in (
        outcome.fault or ""
    )


def test_what_is_out_of_the_arms_reach_is_refused_with_where():
    with pytest.raises(RobotError, match=r"xarm7.*out of reach"):
        TrialRun(casting(as_real(TOO_LONG), 0.9))
    with pytest.raises(RobotError, match=r"xarm7.*out of reach"):
        RealWorld().begin(CASTING, TOO_LONG, [0.9])


@pytest.mark.parametrize(
    ("trial", "error", "match"),
    [
        (lambda: lift(POLYESTER, speed=0.0), RobotError, "speed is 0"),
        (lambda: lift(POLYESTER, rise=-0.1), RobotError, "height is -0.1"),
        (lambda: lift(POLYESTER, speed=np.nan), RobotError, "speed is nan"),
        (lambda: lift(POLYESTER, end="throw"), RobotError, "end is 'throw'"),
        (lambda: reaching(POLYESTER, (0.0, 0.0)), ParameterError, "out of limits"),
        (lambda: reaching(POLYESTER, (np.nan, 0.1)), ParameterError, "2 finite numbers"),
        (lambda: casting(POLYESTER, 0.0), ParameterError, "way 0 is out of limits"),
        (lambda: casting(POLYESTER, np.nan), ParameterError, "1 finite number"),
        (lambda: spreading(COTTON_CLOTH, -0.1), ParameterError, "A -0.1 is out of limits"),
        (lambda: spreading(COTTON_CLOTH, np.inf), ParameterError, "1 finite number"),
    ],
)
def test_bad_actions(trial, error, match):
    with pytest.raises(error, match=match):
        trial()


def test_bad_actions_end_everything_before_anything_is_done():
    done = []
    with pytest.raises(ParameterError, match="out of limits"):
        RealWorld().carry_out(CASTING, [POLYESTER] * 2, [[0.2], [3.0]], on_frame=done.append)
    with pytest.raises(ParameterError, match="for 2 objects"):
        RealWorld().carry_out(CASTING, [POLYESTER] * 2, [[0.2]])
    assert done == []


def test_several_processes_do_the_same_as_one():
    actions = REACHING.sample_actions(POLYESTER, np.random.default_rng(0), 2)
    worlds = (RealWorld(robot=False, timestep=1e-3, jobs=jobs) for jobs in (1, 2))
    alone, together = (w.carry_out(REACHING, [POLYESTER] * 2, actions) for w in worlds)
    assert [o.values for o in alone] == [o.values for o in together]
    assert alone[0].values != alone[1].values


def test_another_device_is_refused():
    with pytest.raises(DeviceError, match="not on cuda"):
        RealWorld().on("cuda")
    assert RealWorld().on("cpu") == RealWorld()
