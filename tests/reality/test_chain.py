"""From an object to a recording in one call."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra reality")

from gendom.errors import RobotError
from gendom.reality import OBJECTS
from gendom.reality.chain import record_and_perceive

ROPE = OBJECTS["rope-cotton"]


@pytest.mark.slow
def test_a_drop_is_recorded_and_perceived_in_one_call(rendering, tmp_path):
    recording, sights = record_and_perceive(ROPE, tmp_path, frame_rate=5.0, seed=3, end="drop")
    assert (tmp_path / "recording.npz").is_file() and len(sights) == 2
    assert not recording.quasi_static
    # It opens 0.5 s after a rise that takes 4.5 s, begun 0.5 s after it closed.
    np.testing.assert_array_equal(recording.holds[:, 0], recording.time < 5.49)
    assert recording.frame(-1)[:, 2].max() < 0.03 < recording.gripper_position[-1, 0, 2]


def test_an_unknown_end_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(RobotError, match="end is 'throw'; choose hold, swing, drop"):
        record_and_perceive(ROPE, tmp_path, end="throw")
    assert list(tmp_path.iterdir()) == []
