"""Frames of several cameras are matched by time stamp; times between rows."""

import numpy as np
import pytest

from gendom.errors import GendomError
from gendom.perception import Frame, MatchedFrames, Pictures, RobotPath


def frames(times):
    def read() -> Pictures:
        raise AssertionError("matching needs no pictures")

    return [Frame(time, f"frame at {time}", read) for time in times]


A = [k / 30.0 for k in range(6)]
TENTHS = [k / 10.0 for k in range(20)]


@pytest.mark.parametrize(
    ("times", "expected", "alone"),
    [
        # 20 ms behind at 30 Hz is 13 ms ahead of the next frame: the nearest wins
        ([A, [t + 0.02 for t in A]], [(A[k + 1], A[k] + 0.02) for k in range(5)], [1, 1]),
        # just the tolerance apart, whatever the rounding
        ([TENTHS, [t + 0.02 for t in TENTHS]], [(t, t + 0.02) for t in TENTHS], [0, 0]),
        # dropped frames
        (
            [A, [t + 0.004 for k, t in enumerate(A) if k not in (2, 3)]],
            [(A[k], A[k] + 0.004) for k in (0, 1, 4, 5)],
            [2, 0],
        ),
        ([[0.0, 1.0], [0.5, 1.5]], [], [2, 2]),
        ([[0.0, 0.1], [0.01, 0.11], [0.1, 0.2]], [(0.1, 0.11, 0.1)], [1, 1, 1]),
        ([[0.3, 0.5]], [(0.3,), (0.5,)], [0]),
    ],
    ids=["nearest", "rounding", "dropped", "apart", "three", "one"],
)
def test_matching(times, expected, alone):
    matched = MatchedFrames([frames(t) for t in times])
    assert [tuple(f.time for f in found) for found in matched] == expected
    assert matched.used == len(expected) and matched.alone == alone
    assert matched.spans == [(t[0], t[-1]) for t in times]


def test_time_that_goes_back():
    with pytest.raises(GendomError, match=r"from 0\.2 s to 0\.1 s"):
        list(MatchedFrames([frames([0.0, 0.2, 0.1]), frames([0.0, 0.2, 0.3])]))


def test_path_between_its_rows():
    axis = np.array([[[0, 0, 1.0]], [[1.0, 0, 0]]])
    path = RobotPath(np.array([0.0, 2.0]), np.array([[[0, 0, 0.0]], [[0, 0, 1.0]]]), axis)
    position, direction = np.array(path.at(0.5))
    np.testing.assert_allclose(position, [[0, 0, 0.25]])
    np.testing.assert_allclose(direction, [[0.1**0.5, 0.0, 0.9**0.5]])
    assert path.at(2.1) is None and path.at(2.0) is not None and path.closed_at(1.0) is None
    # a gripper stays as the last row says
    closed = np.array([[True], [True], [False]])
    path = RobotPath(np.array([0.0, 1.0, 2.0]), np.zeros((3, 1, 3)), closed=closed)
    states = [path.closed_at(time) for time in (0.0, 1.99, 2.0, 2.1)]
    assert np.array(states)[:, 0].tolist() == [True, True, False, False]
