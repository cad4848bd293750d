"""The lift and the three tasks, by the arm and by a free hand."""

import itertools
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra reality")

from gendom.errors import GendomError, ParameterError, RobotError
from gendom.reality import (
    OBJECTS,
    Performance,
    RealCloth,
    RealRope,
    carry_out_casting,
    carry_out_reaching,
    carry_out_spreading,
    casting,
    covered_area,
    default_cameras,
    lift,
    lift_cameras,
    looking_at,
    reaching,
    reaching_task,
    spreading,
    stretch,
)
from gendom.reality.arm import surroundings
from gendom.robot import XARM7, collision_along, tcp_pose
from gendom.tasks.rope_reaching import PAPER_TIMES

POLYESTER = cast(RealRope, OBJECTS["rope-polyester"])
COTTON_CLOTH = cast(RealCloth, OBJECTS["cloth-cotton"])

STRETCHED = POLYESTER.length * np.array([0.5, 0.31])
"""A release point far from the top: a rope that is nearly straight does not buckle sideways."""


def edges(item, vertices):
    """Lengths over rest lengths along the rope, or along both sides of the cloth."""
    if isinstance(item, RealRope):
        spacing = item.length / (item.vertices - 1)
        return np.linalg.norm(np.diff(vertices, axis=0), axis=1) / spacing
    grid = vertices.reshape(*item.counts, 3)
    return np.concatenate(
        [np.linalg.norm(np.diff(grid, axis=k), axis=-1).ravel() / item.spacing for k in (0, 1)]
    )


@pytest.mark.parametrize(
    "name",
    [n if n == "rope-polyester" else pytest.param(n, marks=pytest.mark.slow) for n in OBJECTS],
)
def test_the_arm_lifts(name):
    item = OBJECTS[name]
    performance = Performance(lift(item))
    assert performance.motion is not None
    performance.motion.check_limits(XARM7)
    assert performance.slowed_by == 1.0
    path = performance.trial.path
    apart, speed = [], 0.0
    performance.step_to(performance.closes)
    offset = performance.world.vertices()[performance.world.held] - performance.world.hand
    for time in np.arange(performance.closes + 0.1, performance.end, 0.25):
        performance.step_to(time)
        world = performance.world
        ideal = path.position_at(world.time)
        apart.append(np.linalg.norm(world.hand - ideal))
        # What is held goes where the tool goes, and keeps its place and direction there.
        moved = world.vertices()[world.held] - ideal - offset
        apart.append(np.linalg.norm(moved, axis=1).max())
        q = world.robot.measured(world.data)
        assert (q >= XARM7.q_min).all() and (q <= XARM7.q_max).all()
        speed = max(speed, world.speed())
    assert max(apart) < 1e-3
    performance.step_to(performance.end)
    assert performance.world.hand[2] == pytest.approx(path.position[-1, 2], abs=1e-3)
    assert abs(edges(item, performance.world.vertices()).mean() - 1.0) < 0.005
    if isinstance(item, RealRope):
        assert abs(stretch(item, performance.world.vertices())) < 0.005


def test_a_performance_takes_the_time_step_that_it_is_given():
    steps = [
        Performance(reaching(POLYESTER, STRETCHED), robot=False, timestep=step)
        for step in (None, 2.5e-4)
    ]
    assert [p.world.model.opt.timestep for p in steps] == [1e-3, 2.5e-4]


def test_a_slowed_arm_finishes_its_lift():
    """A lift at 2 m/s is beyond the arm; what it does instead takes longer, its pauses do not."""
    performance = Performance(lift(POLYESTER, rise=0.06, speed=2.0))
    assert 1.1 < performance.slowed_by < 1.3
    performance.step_to(performance.end)
    top = performance.trial.path.position[-1]
    assert performance.world.hand == pytest.approx(top, abs=1e-3)


@pytest.mark.parametrize(
    "trial",
    [
        *(pytest.param(lambda i=i: lift(i), id=f"lift {n}") for n, i in OBJECTS.items()),
        *(
            pytest.param(lambda x=x, z=z: reaching(POLYESTER, (x, z)), id=f"reach {x} {z}")
            for x, z in ((0.242, 0.08), (0.089, 0.262), (0.257, 0.154))
        ),
        *(pytest.param(lambda a=a: casting(POLYESTER, a), id=f"cast {a}") for a in (-0.25, 0.25)),
        pytest.param(lambda: spreading(COTTON_CLOTH, 0.25), id="spread"),
    ],
)
def test_what_is_done_by_default_touches_nothing(trial):
    """Planned with the collision check, and free by the check alone, the lift's cameras too."""
    trial = trial()
    cameras = lift_cameras(trial.item)
    motion = Performance(trial, cameras=cameras).motion
    assert motion is not None
    thick = getattr(trial.item, "diameter", None) or trial.item.thickness
    assert collision_along(XARM7, motion, surroundings(cameras), opening=thick) is None


def test_a_camera_in_the_arms_way_is_refused():
    trial = lift(POLYESTER)
    above = trial.path.position[-1] + [0.0, 0.05, -0.05]
    camera = default_cameras()[0].at(looking_at(above, (0.5, 0.0, 0.0)))
    with pytest.raises(RobotError, match=r"and camera left collide, \d+\.\d mm deep"):
        Performance(trial, cameras=[camera])


@pytest.fixture(scope="module")
def stretched():
    """A release by the free hand and by the arm: performance and what is reached."""
    both = []
    for robot in (False, True):
        performance = Performance(reaching(POLYESTER, STRETCHED), robot=robot)
        both.append((performance, carry_out_reaching(performance)))
    return both


def test_arm_and_free_hand_reach_the_same(stretched):
    (_, free), (performance, arm) = stretched
    assert performance.motion is not None
    performance.motion.check_limits(XARM7)
    assert performance.slowed_by == 1.0
    assert arm.reached == pytest.approx(free.reached, abs=0.003)
    assert arm.sideways < 0.015


@pytest.mark.parametrize("release", [(0.1925, 0.0965), (0.1598, 0.1197), (0.1073, 0.1456)])
def test_the_demo_s_rope_stays_in_its_plane_under_the_arm(release):
    """The demo's releases; a rope without resistance to twist falls by 7 to 57 mm."""
    rope = cast(RealRope, OBJECTS["rope-cotton"])
    free, arm = (
        carry_out_reaching(Performance(reaching(rope, release), robot=robot))
        for robot in (False, True)
    )
    assert free.sideways < 1e-3
    assert arm.sideways < 0.005
    assert arm.reached == pytest.approx(free.reached, abs=1e-3)


def test_the_unloaded_hand_is_where_it_is_sent():
    """Servos that are told what weight and motion ask for have little left to correct."""
    performance = Performance(reaching(POLYESTER, STRETCHED))
    motion, world, apart = performance.motion, performance.world, []
    assert motion is not None
    for time in np.arange(performance.closes, performance.opens, 0.02):
        world.step_to(time)  # the hand stays open
        apart.append(world.hand - motion.tcp_at(XARM7, world.time)[:3, 3])
    assert np.abs(apart).max() < 5e-6


def test_the_release_keeps_its_time(stretched):
    """Closing, half a second's pause, then the task's own clock sqrt(L / g), worked out anew."""
    clock = np.sqrt((POLYESTER.length / 9.81) / (0.5 / 12.0))
    for performance, outcome in stretched:
        hangs = performance.closes + 0.5
        assert performance.opens == pytest.approx(hangs + PAPER_TIMES[1] * clock, abs=1e-9)
        assert performance.end == pytest.approx(hangs + PAPER_TIMES[2] * clock, abs=1e-9)
        assert outcome.times[-1] == pytest.approx(performance.end, abs=0.01)


def test_a_free_hand_keeps_the_rope_in_its_plane(stretched):
    (_, free), _ = stretched
    assert free.sideways == pytest.approx(0.0, abs=1e-9)


def test_the_goal_is_measured_in_the_task_frame(stretched):
    """Task x is the world's -y from 0.30 m, and the hanging rope shows where it begins.

    At the start the top is at task (L, 0, 1.1 L) and the tip at (L, 0, 0.1 L); 0.12 m is the
    height of the task's origin.
    """
    task = reaching_task(POLYESTER)
    for performance, outcome in stretched:
        start = outcome.vertices[0]
        L = POLYESTER.length
        assert start[0] == pytest.approx([0.48, 0.30 - L, 0.12 + 1.1 * L], abs=1e-3)
        assert start[-1] == pytest.approx([0.48, 0.30 - L, 0.12 + 0.1 * L], abs=2e-3)
        after = outcome.times >= performance.opens
        tip = outcome.vertices[after, -1]
        assert outcome.reached == pytest.approx(0.30 - tip[:, 1].min(), abs=1e-12)
        assert outcome.sideways == pytest.approx(np.abs(tip[:, 0] - 0.48).max(), abs=1e-12)
        # At the release the tip is where it was sent, half a grip beyond the tool at most.
        assert tip[0, 1] == pytest.approx(0.30 - STRETCHED[0], abs=5e-3)
        assert tip[0, 2] == pytest.approx(0.12 + STRETCHED[1], abs=5e-3)
        assert task.bottom[0] < outcome.reached < 2.0 * L


def test_the_hand_holds_the_tip_until_it_opens():
    performance = Performance(reaching(POLYESTER, STRETCHED), robot=False)
    performance.step_to(performance.opens - 0.005)
    assert POLYESTER.vertices - 1 in performance.world.held
    performance.step_to(performance.opens + 0.005)
    assert len(performance.world.held) == 0


def test_a_larger_cast_throws_the_tip_higher():
    casts = [carry_out_casting(Performance(casting(POLYESTER, a), robot=False)) for a in (0.1, 0.2)]
    for done in casts:
        assert done.highest[1] == done.vertices[:, -1, 2].max()
    (near, low), (far, high) = (done.highest for done in casts)
    assert high > low + 0.02 and far > near + 0.05


def test_a_cast_the_other_way_is_its_mirror_image():
    there, back = (
        carry_out_casting(Performance(casting(POLYESTER, a), robot=False)) for a in (0.15, -0.15)
    )
    np.testing.assert_allclose(there.highest, back.highest, atol=1e-6)
    np.testing.assert_allclose(
        there.vertices, back.vertices * np.array([1.0, -1.0, 1.0]), atol=1e-5
    )
    # Along the cast, whichever way it goes.
    assert there.vertices[-1, 0, 1] > 0.0 and there.highest[0] > 0.0


def test_the_arm_casts():
    """Quick as it is, the arm stays near the path that it was given."""
    free = carry_out_casting(Performance(casting(POLYESTER, 0.2), robot=False))
    performance = Performance(casting(POLYESTER, 0.2))
    motion, world = performance.motion, performance.world
    assert motion is not None
    apart = []

    def look(_):
        ideal = motion.tcp_at(XARM7, world.time)[:3, 3]
        apart.append(np.linalg.norm(world.hand - ideal))

    vertices = performance.watch(np.arange(performance.closes, performance.end, 0.01), look)
    assert max(apart) < 1e-3
    tip = vertices[np.argmax(vertices[:, -1, 2]), -1] - vertices[0, -1]
    assert tip[1] == pytest.approx(free.highest[0], abs=0.01)
    assert vertices[:, -1, 2].max() == pytest.approx(free.highest[1], abs=0.01)


@pytest.mark.slow
def test_the_arm_spreads_a_cloth():
    """A = 0: 16 equal steps down; the centre ends where it began and the cloth lies flat on it."""
    performance = Performance(spreading(COTTON_CLOTH, 0.0))
    assert performance.motion is not None
    performance.motion.check_limits(XARM7)
    outcome = carry_out_spreading(performance)
    n, m = COTTON_CLOTH.counts
    centre = outcome.vertices.reshape(-1, n, m, 3)[:, n // 2, m // 2]
    assert centre[-1] == pytest.approx(centre[0], abs=2e-3)
    assert centre[:, 2].max() - centre[0, 2] == pytest.approx(0.16, abs=2e-3)
    assert 0.05 < outcome.ratio < 0.5  # it crumples
    assert np.abs(edges(COTTON_CLOTH, outcome.vertices[-1]).mean() - 1.0) < 0.005
    assert outcome.vertices[-1, :, 2].min() > 0.0


def flat(cloth, turn=0.0):
    """[V, 3] a flat cloth on the table, turned about the vertical [rad]."""
    n, m = cloth.counts
    grid = cloth.spacing * np.array(list(itertools.product(range(n), range(m))), dtype=float)
    x = np.concatenate([grid, np.zeros((n * m, 1))], axis=1)
    c, s = np.cos(turn), np.sin(turn)
    return x @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("turn", [0.0, 0.3, np.pi / 4])
def test_a_flat_cloth_covers_its_own_area(turn):
    found = covered_area(COTTON_CLOTH, flat(COTTON_CLOTH, turn) - [0.4, 0.2, 0.0])
    assert found == pytest.approx(COTTON_CLOTH.side**2, rel=0.01)


def test_a_cloth_folded_in_half_covers_half():
    x = flat(COTTON_CLOTH)
    x[:, 0] = np.minimum(x[:, 0], COTTON_CLOTH.side - x[:, 0])
    assert covered_area(COTTON_CLOTH, x) == pytest.approx(COTTON_CLOTH.side**2 / 2.0, rel=0.01)


def test_a_cloth_folded_twice_covers_a_quarter():
    x = flat(COTTON_CLOTH)
    x[:, :2] = np.minimum(x[:, :2], COTTON_CLOTH.side - x[:, :2])
    assert covered_area(COTTON_CLOTH, x) == pytest.approx(COTTON_CLOTH.side**2 / 4.0, rel=0.01)


@pytest.mark.parametrize(
    ("trial", "error", "match"),
    [
        (lambda: lift(POLYESTER, speed=0.0), RobotError, "speed is 0"),
        (lambda: lift(POLYESTER, rise=-0.1), RobotError, "height is -0.1"),
        (lambda: lift(POLYESTER, speed=np.nan), RobotError, "speed is nan"),
        (lambda: reaching(POLYESTER, (0.0, 0.0)), ParameterError, "out of limits"),
        (lambda: reaching(POLYESTER, (np.nan, 0.1)), ParameterError, "two finite numbers"),
        (lambda: casting(POLYESTER, 0.0), RobotError, "action is 0.0"),
        (lambda: casting(POLYESTER, np.nan), RobotError, "action is nan"),
        (lambda: spreading(COTTON_CLOTH, -0.1), RobotError, "A is -0.1"),
        (lambda: spreading(COTTON_CLOTH, np.inf), RobotError, "A is inf"),
    ],
)
def test_bad_actions(trial, error, match):
    with pytest.raises(error, match=match):
        trial()


def test_what_is_out_of_the_arms_reach_is_refused_with_where():
    with pytest.raises(RobotError, match=r"xarm7.*out of reach"):
        Performance(casting(POLYESTER, 3.0))


def test_a_hand_that_would_close_beside_the_object_says_so():
    trial = lift(POLYESTER, rise=0.05)
    trial = replace(trial, layout=replace(trial.layout, origin=(0.32, 0.1, 0.008)))
    performance = Performance(trial, robot=False)
    with pytest.raises(GendomError, match=r"100\.\d mm away"):
        performance.step_to(performance.end)


def test_the_hand_of_the_arm_is_where_its_kinematics_say():
    performance = Performance(lift(POLYESTER, rise=0.05))
    performance.step_to(1.2)
    world = performance.world
    tool = tcp_pose(XARM7, world.robot.measured(world.data))
    assert world.hand == pytest.approx(tool[:3, 3], abs=1e-5)
