"""Paths of the tool: blends, samples, other frames, when they move; many side by side."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import RobotError
from gendom.robot import DOWN, GripperEvent, TcpPath, TcpPaths, pointing

KNOTS = np.array([[0.35, 0.0, 0.2], [0.35, 0.0, 0.2], [0.45, 0.0, 0.2], [0.45, 0.1, 0.25]])


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


def test_a_blend_is_the_convolution_with_its_kernel(path):
    blend = 0.12
    s = np.linspace(-0.5, 0.5, 4001)
    kernel = 6.0 * (s + 0.5) * (0.5 - s)
    for t in (0.43, 0.5, 0.7, 1.03, 1.97, 2.2):
        mean = np.trapezoid(kernel[:, None] * path.position_at(t - blend * s), s, axis=0)
        np.testing.assert_allclose(path.position_at(t, blend), mean, atol=1e-7)
    # deviation at a corner is as stated
    corner = np.array([[0, 0, 0], [0.3, 0, 0], [0.3, 0.3, 0]])
    path = TcpPath(time=np.arange(3.0), position=corner, quat_xyzw=np.array(DOWN))
    assert path.deviation(0.1) == pytest.approx(3 / 32 * 0.3 * np.sqrt(2) * 0.1, rel=1e-6)


def test_pointing_gives_the_axes_asked_for():
    R = Rotation.from_quat(pointing([0, 0, -2], [0, 1, 5])).as_matrix()
    np.testing.assert_allclose(R[:, 2], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(R[:, 1], [0, 1, 0], atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    with pytest.raises(RobotError, match="parallel or zero"):
        pointing([0, 0, 1], [0, 0, -3])


@pytest.mark.parametrize(
    "wrong",
    [
        {"time": [0.0, 0.0]},
        {"time": [0.0]},
        {"position": [[0, 0, np.nan], [0, 0, 1]]},
        {"quat_xyzw": [0, 0, 0, 0]},
        {"quat_xyzw": [[0, 0, 0, 1], [0, 0, 0, 1]]},
        {"events": (GripperEvent(time=1, closed=True), GripperEvent(time=0, closed=False))},
        {"max_blend": 0.0},
        {"max_blend": 0.4, "blend": 0.41},
        {"blend": -0.1},
        {"blend": math.nan},
    ],
)
def test_bad_paths(wrong):
    good = {"time": [0.0, 1.0], "position": [[0.4, 0, 0.2], [0.4, 0, 0.3]], "quat_xyzw": DOWN}
    assert TcpPath(**good, max_blend=0.4, blend=0.4).blend == 0.4
    with pytest.raises(RobotError, match="path of the tool"):
        TcpPath(**{**good, **wrong})


@pytest.mark.parametrize("blend", [0.2, 0.8])
def test_straight_between_its_samples_a_path_runs_as_it_does(path, blend):
    """At most h^2 / 8 times the acceleration is missed, samples h apart; blends may overlap."""
    own = replace(path, blend=blend, max_blend=1.0)
    t = np.linspace(-1.0, 4.0, 20001)
    speed = np.pad(np.diff(KNOTS, axis=0) / np.diff(path.time)[:, None], [(1, 1), (0, 0)])
    corners, missed = np.linalg.norm(np.diff(speed, axis=0), axis=1), []
    for number in (16, 64):
        time, position = own.sampled(number)
        assert np.all(np.diff(time) > 1e-9) and np.isin(path.time, time).all()
        assert time[0] <= own.moves
        between = np.stack([np.interp(t, time, column) for column in position.T], axis=1)
        missed.append(np.abs(between - path.position_at(t, blend)).max())
        acceleration = 1.5 / blend * (corners.max() if blend < 0.5 else corners.sum())
        assert 0.0 < missed[-1] <= acceleration * (blend / number) ** 2 / 8.0
    assert missed[1] < 0.1 * missed[0]


def test_a_path_in_another_frame_or_later_is_the_same_path_there(path):
    path = replace(path, blend=0.2)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.5, 1.2]).as_matrix()
    T[:3, 3] = [0.1, -0.2, 0.4]
    moved, t = path.moved(T).shifted(0.7), np.linspace(-0.2, 2.3, 40)
    for blend in (0.0, 0.2):
        there = T @ path.pose_at(t, blend)
        np.testing.assert_allclose(moved.pose_at(t + 0.7, blend), there, atol=1e-12)
    assert (moved.blend, moved.max_blend) == (0.2, 0.4)
    assert [e.time for e in moved.events] == pytest.approx([0.8, 3.2])
    assert moved.moves == pytest.approx(path.moves + 0.7)


def test_many_paths_are_as_each_alone(path):
    """To the last bit, whatever their numbers of knots and blends."""
    short = replace(path, time=path.time[:2] - 0.3, position=path.position[1:3])
    still = replace(path, position=np.repeat(KNOTS[:1], 4, axis=0))
    some = [path, replace(path, blend=0.06), short, still, replace(path, blend=0.3)]
    many, t = TcpPaths(some), np.linspace(-0.5, 2.5, 50)
    assert many.moves.tolist() == [p.moves for p in some]
    for one, found in zip(some, many.position_at(t), strict=True):
        np.testing.assert_array_equal(found, one.position_at(t, one.blend or 0.0))
    for one, time, position, count in zip(some, *many.sampled(), strict=True):
        own, place = one.sampled()
        np.testing.assert_array_equal(time[:count], own)
        np.testing.assert_array_equal(position[:count], place)
        assert (time[count:] == own[-1]).all() and (position[count:] == place[-1]).all()
