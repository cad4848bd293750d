"""Paths of the tool: blends of their own, samples, other frames, when they move."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import RobotError
from gendom.robot import DOWN, XARM7, GripperEvent, TcpPath, TcpPaths, follow

KNOTS = np.array([[0.35, 0.0, 0.2], [0.35, 0.0, 0.2], [0.45, 0.0, 0.2], [0.45, 0.1, 0.25]])
TURNS = Rotation.from_euler("zyx", [[0, 0, 180], [0, 0, 180], [40, 0, 180], [40, 30, 150]], True)


@pytest.fixture
def path():
    """Waits for half a second, goes 0.1 m in one direction and on in another."""
    return TcpPath(
        time=np.array([0.0, 0.5, 1.0, 2.0]),
        position=KNOTS,
        quat_xyzw=np.array(DOWN),
        events=(GripperEvent(time=0.1, closed=True), GripperEvent(time=2.5, closed=False)),
        max_blend=0.4,
    )


# ---- a blend of its own --------------------------------------------------------------------------


@pytest.mark.parametrize("blend", [0.06, 0.3])
def test_the_arm_takes_a_path_s_own_blend(path, blend):
    """Neither as short as it could, nor longer."""
    shortest = follow(XARM7, path).blend
    motion = follow(XARM7, replace(path, blend=blend))
    assert motion.blend == blend != shortest
    t = np.linspace(0.2, 2.2, 60)
    tool = motion.tcp_at(XARM7, t)[:, :3, 3]
    np.testing.assert_allclose(tool, path.position_at(t, blend), atol=5e-6)


def test_whoever_asks_for_another_blend_gets_it(path):
    assert follow(XARM7, replace(path, blend=0.3), blend=0.2).blend == 0.2


def test_slowing_down_keeps_a_path_s_own_blend(path):
    quick = replace(path, time=0.12 * path.time, events=(), blend=0.06)
    with pytest.raises(RobotError, match=r"acceleration.*times as long"):
        follow(XARM7, quick)
    motion = follow(XARM7, quick, slow_down=True)
    assert motion.blend == 0.06 and motion.slowed_by > 1.0


@pytest.mark.parametrize("blend", [0.41, -0.1, math.nan])
def test_a_blend_beyond_the_longest_is_refused(path, blend):
    assert replace(path, blend=0.4).blend == 0.4
    with pytest.raises(RobotError, match=r"path of the tool: has blend .* max_blend 0\.4"):
        replace(path, blend=blend)


# ---- samples -------------------------------------------------------------------------------------


def test_without_a_blend_the_samples_are_the_knots(path):
    for own in (path, replace(path, blend=0.0)):
        time, position = own.sampled()
        np.testing.assert_array_equal(time, path.time)
        np.testing.assert_allclose(position, path.position, atol=1e-12)


@pytest.mark.parametrize("blend", [0.2, 0.8])
def test_straight_between_its_samples_a_path_runs_as_it_does(path, blend):
    """At most h^2 / 8 times the acceleration is missed, samples h apart; blends may overlap."""
    own = replace(path, blend=blend, max_blend=1.0)
    t = np.linspace(-1.0, 4.0, 20001)
    missed = []
    for number in (16, 64):
        time, position = own.sampled(number)
        assert np.all(np.diff(time) > 1e-9) and np.isin(path.time, time).all()
        assert time[0] <= own.moves
        between = np.stack([np.interp(t, time, column) for column in position.T], axis=1)
        missed.append(np.abs(between - path.position_at(t, blend)).max())
        corners = np.linalg.norm(np.diff(_velocity(path, [0.2, 0.7, 1.5, 3.0]), axis=0), axis=1)
        acceleration = 1.5 / blend * (corners.max() if blend < 0.5 else corners.sum())
        assert 0.0 < missed[-1] <= acceleration * (blend / number) ** 2 / 8.0
    assert missed[1] < 0.1 * missed[0]


def test_samples_that_differ_by_rounding_are_taken_once():
    """Corners a blend apart: the end of one is the begin of the other, to the last digit or not."""
    time = np.arange(7) / 10.0
    position = np.outer([0, 1, 1, 0, 2, 1, 1], [0.05, 0.0, 0.0]) + KNOTS[0]
    path = TcpPath(time=time, position=position, quat_xyzw=np.array(DOWN), blend=0.1)
    sampled, where = path.sampled(10)
    assert np.diff(sampled).min() == pytest.approx(0.01)
    speed = np.abs(np.diff(where[:, 0]) / np.diff(sampled))
    assert speed.max() <= np.abs(np.diff(position[:, 0])).max() / 0.1 + 1e-9


def _velocity(path, time, h=1e-6):
    ends = [path.position_at(np.add(time, side * h)) for side in (-1.0, 1.0)]
    return (ends[1] - ends[0]) / (2.0 * h)


# ---- when it moves -------------------------------------------------------------------------------


def test_a_path_moves_when_its_wait_is_over_or_half_a_blend_before(path):
    assert path.moves == 0.5
    assert replace(path, blend=0.3).moves == pytest.approx(0.35)
    before, after = replace(path, blend=0.3).position_at([0.35, 0.36], 0.3)
    np.testing.assert_array_equal(before, KNOTS[0])
    assert np.linalg.norm(after - KNOTS[0]) > 1e-6


def test_a_path_that_stays_never_moves(path):
    assert replace(path, position=np.tile(KNOTS[:1], (4, 1)), blend=0.1).moves == math.inf


def test_turning_is_moving():
    path = TcpPath(
        time=np.array([1.0, 2.0]),
        position=KNOTS[:2],
        quat_xyzw=TURNS.as_quat()[1:3],
    )
    assert path.moves == 1.0


# ---- elsewhere and later -------------------------------------------------------------------------


@pytest.mark.parametrize("turns", [False, True])
def test_a_path_in_another_frame_is_the_same_path_there(path, turns):
    path = replace(path, quat_xyzw=TURNS.as_quat() if turns else path.quat_xyzw, blend=0.2)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.5, 1.2]).as_matrix()
    T[:3, 3] = [0.1, -0.2, 0.4]
    moved = path.moved(T)
    t = np.linspace(-0.2, 2.3, 40)
    for blend in (0.0, 0.2):
        np.testing.assert_allclose(moved.pose_at(t, blend), T @ path.pose_at(t, blend), atol=1e-12)
    assert (moved.events, moved.blend, moved.max_blend) == (path.events, 0.2, 0.4)
    np.testing.assert_array_equal(moved.time, path.time)
    back = moved.moved(np.linalg.inv(T))
    np.testing.assert_allclose(back.pose_at(t), path.pose_at(t), atol=1e-12)


def test_a_shifted_path_does_everything_later(path):
    later = replace(path, blend=0.2).shifted(0.7)
    t = np.linspace(-0.2, 2.3, 40)
    np.testing.assert_allclose(
        later.position_at(t + 0.7, 0.2), path.position_at(t, 0.2), atol=1e-12
    )
    assert [e.time for e in later.events] == pytest.approx([0.8, 3.2])
    assert later.blend == 0.2 and later.moves == pytest.approx(1.1)


# ---- many paths ----------------------------------------------------------------------------------


def test_many_paths_are_as_each_alone(path):
    """To the last bit, whatever their numbers of knots and blends."""
    short = TcpPath(time=path.time[:2] - 0.3, position=path.position[1:3], quat_xyzw=np.array(DOWN))
    still = replace(path, position=np.repeat(KNOTS[:1], 4, axis=0))
    turning = replace(still, quat_xyzw=TURNS.as_quat())
    some = [path, replace(path, blend=0.06), short, still, replace(path, blend=0.3), turning]
    many, t = TcpPaths(some), np.linspace(-0.5, 2.5, 50)
    assert many.moves.tolist() == [p.moves for p in some]
    assert many.turning.tolist() == [False] * 5 + [True]
    for one, found in zip(some, many.position_at(t), strict=True):
        np.testing.assert_array_equal(found, one.position_at(t, one.blend or 0.0))
    for one, time, position, count in zip(some, *many.sampled(), strict=True):
        own, place = one.sampled()
        np.testing.assert_array_equal(time[:count], own)
        np.testing.assert_array_equal(position[:count], place)
        assert (time[count:] == own[-1]).all() and (position[count:] == place[-1]).all()


def test_a_blend_is_sampled_at_its_knots_and_within(path):
    """Nothing closer than rounding, nothing lost."""
    time, position = replace(path, blend=0.2).sampled(per_blend=4)
    expected = [0.0, *(c + d for c in (0.5, 1.0, 2.0) for d in (-0.1, -0.05, 0.0, 0.05, 0.1))]
    np.testing.assert_allclose(time, expected, atol=1e-12)
    np.testing.assert_array_equal(position, path.position_at(time, 0.2))
