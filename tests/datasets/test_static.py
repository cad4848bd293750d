"""Shapes at rest, `gendom-static/1`."""

import json

import numpy as np
import pytest

from gendom.datasets import Recording
from gendom.errors import RecordingError

META = {
    "format": "gendom-static/1",
    "object": {"kind": "wire", "length": 0.6, "mass_per_length": 0.02},
    "source": "made up",
}


ANGLE = np.linspace(0.0, np.pi, 21)
LINE = 0.19 * np.stack([-np.cos(ANGLE), 0.0 * ANGLE, -np.sin(ANGLE)], axis=1)
LOOPS = np.stack([LINE, LINE + np.array([1e-3, 0.0, 0.0])])
"""[2, 21, 3] two half circles that hang, the second one a millimetre aside [m]."""


def saved(path, meta=META, loops=LOOPS):
    np.savez(path, meta=np.array(json.dumps(meta)), loops=loops)
    return path


def test_repeats_are_frames_of_a_rope_that_is_held_at_both_ends(tmp_path):
    recording = Recording.read(saved(tmp_path / "wire.npz"), on_warning=lambda _: None)
    assert recording.num_frames == 2 and recording.num_grippers == 2
    assert recording.extra["static"] and recording.extra["ordered_markers"]
    assert recording.quasi_static and recording.source == "made up"
    described = recording.object
    assert described.kind == "rope" and described.mass == pytest.approx(0.012)
    np.testing.assert_allclose(recording.frame(1), LOOPS[1], atol=1e-6)
    # clamped where the repeats are in the mean, along their first and last piece
    np.testing.assert_allclose(recording.gripper_position[0, 0], [-0.1895, 0.0, 0.0], atol=1e-9)
    first = LOOPS[0, 1] - LOOPS[0, 0]
    assert recording.gripper_axis is not None
    np.testing.assert_allclose(
        recording.gripper_axis[0, 0], first / np.linalg.norm(first), atol=1e-9
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"loops": np.zeros((2, 3))}, "loops: has shape"),
        ({"loops": np.full((1, 9, 3), np.nan)}, "not finite"),
        ({"meta": {**META, "object": {**META["object"], "kind": "cloth"}}}, "object.kind"),
        ({"meta": {**META, "object": {**META["object"], "length": -1.0}}}, "object.length"),
        ({"meta": {**META, "object": {"kind": "wire", "length": 1.0}}}, "mass_per_length"),
    ],
)
def test_what_is_no_shape_is_refused(tmp_path, change, words):
    with pytest.raises(RecordingError, match=words):
        Recording.read(saved(tmp_path / "bad.npz", **change))
