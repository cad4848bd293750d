"""Cameras that place the object in different places."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.estimation import EstimateSettings, LiftScene, Problem
from gendom.estimation.verdict import _blamed_on_cameras


@pytest.fixture(scope="module")
def seen(cloth_lift):
    """Each half of the points by a camera."""
    lift = cloth_lift.seen(points=400)
    return replace(lift, seen_by=np.where(np.arange(len(lift.points)) % 2, 1, 2))


def compared(cloth_lift, recording):
    settings = EstimateSettings(scene=cloth_lift.settings)
    problem = Problem([LiftScene.of(recording, cloth_lift.settings)], settings)
    truth = problem.prior.vector(cloth_lift.truth)
    comparisons = problem.compare([truth], derivatives=False)[0]
    assert comparisons is not None
    return problem.parts[0], comparisons.parts[0]


def drifted(recording, by):
    """The second camera is off from the middle of the lift on."""
    points, half = recording.points.copy(), recording.offsets[recording.num_frames // 2]
    late = (np.arange(len(points)) >= half) & (recording.seen_by == 2)
    return replace(recording, points=points + np.outer(late, by))


def test_a_camera_that_drifts_is_named(cloth_lift, seen):
    part, comparison = compared(cloth_lift, drifted(seen, (0.0, 0.006, 0.01)))
    far, first, last = comparison.cameras_apart()
    assert far == pytest.approx(0.0117, abs=0.004)
    assert seen.num_frames // 2 <= first < last < seen.num_frames
    thick = "points lie 4.0 mm outside an object 2 mm thick: is its thickness right?"
    (said,) = _blamed_on_cameras([thick], part, comparison)
    assert f"frames {first} to {last} two cameras place the object {1e3 * far:.0f} mm" in said


def test_cameras_that_agree_are_not_blamed(cloth_lift, seen):
    part, comparison = compared(cloth_lift, seen)
    assert comparison.cameras_apart()[0] < 0.002
    assert _blamed_on_cameras(["why"], part, comparison) == ["why"]
    nameless = compared(cloth_lift, replace(seen, seen_by=None))[1]
    assert nameless.cameras_apart() == (0.0, 0, 0)


@pytest.mark.parametrize(("apart", "said"), [(0.011, []), (0.013, ["13 mm"]), ("far", [])])
def test_what_perception_measured_is_a_reason_by_itself(cloth_lift, seen, apart, said):
    extra = {"perception": {"cameras_apart": {"table": 0.1, "at_worst": apart}}}
    part, comparison = compared(cloth_lift, replace(seen, extra=extra))
    reasons = _blamed_on_cameras([], part, comparison)
    assert reasons == [
        f"cameras' clouds of the object are {by} apart: calibrate again" for by in said
    ]


def test_a_file_keeps_them(tmp_path, seen):
    seen.write(tmp_path / "lift.npz")
    again = Recording.read(tmp_path / "lift.npz")
    np.testing.assert_array_equal(again.seen_by, seen.seen_by)
    few = again.head(3).seen_by
    assert few is not None and len(few) == seen.offsets[3]
    with pytest.raises(RecordingError, match="seen_by: has 5 entries for"):
        replace(seen, seen_by=np.ones(5, dtype=np.uint8))
