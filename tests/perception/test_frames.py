"""Frames of several cameras are matched by time stamp."""

import numpy as np
import pytest

from gendom.errors import GendomError
from gendom.perception import Frame, Pictures, match_frames
from gendom.perception.frames import Matching


def frames(times):
    def read() -> Pictures:
        raise AssertionError("matching needs no pictures")

    return [Frame(time, f"frame at {time}", read) for time in times]


def matched(*times, tolerance=0.02):
    matching = Matching()
    sets = match_frames([frames(t) for t in times], tolerance=tolerance, matching=matching)
    return [tuple(f.time for f in found) for found in sets], matching


def test_same_times_all_match():
    sets, matching = matched([0.0, 0.1, 0.2], [0.0, 0.1, 0.2])
    assert sets == [(0.0, 0.0), (0.1, 0.1), (0.2, 0.2)]
    assert matching.used == 3 and matching.alone == [0, 0]


def test_nearest_wins():
    """20 ms behind at 30 Hz is 13 ms ahead of the next frame."""
    a = np.arange(5) / 30.0
    sets, matching = matched(a.tolist(), (a + 0.02).tolist(), tolerance=0.02)
    assert sets == [(a[k + 1], a[k] + 0.02) for k in range(4)]
    assert matching.alone == [1, 1]


def test_just_the_tolerance_apart_matches_whatever_the_rounding():
    a = np.arange(20) / 10.0
    sets, _ = matched(a.tolist(), (a + 0.02).tolist(), tolerance=0.02)
    assert len(sets) == 20


def test_dropped_frames_are_left_out():
    a = [k / 30 for k in range(6)]
    b = [t + 0.004 for k, t in enumerate(a) if k not in (2, 3)]
    sets, matching = matched(a, b)
    assert [s[0] for s in sets] == [a[k] for k in (0, 1, 4, 5)]
    assert matching.alone == [2, 0]


def test_apart_by_more_than_the_tolerance():
    sets, matching = matched([0.0, 1.0], [0.5, 1.5])
    assert sets == [] and matching.alone == [2, 2]
    assert matching.span == [(0.0, 1.0), (0.5, 1.5)]


def test_three_cameras_and_one():
    sets, _ = matched([0.0, 0.1], [0.01, 0.11], [0.1, 0.2])
    assert sets == [(0.1, 0.11, 0.1)]
    assert matched([0.3, 0.5])[0] == [(0.3,), (0.5,)]


def test_time_that_goes_back():
    with pytest.raises(GendomError, match=r"from 0\.2 s to 0\.1 s"):
        matched([0.0, 0.2, 0.1], [0.0, 0.2, 0.3])
