"""The estimator on a real recording, judged by what is known of the object otherwise."""

import pytest

from gendom.datasets import Recording
from gendom.estimation import EstimateSettings, estimate


@pytest.mark.slow
def test_red_rope(real_data):
    """Bending length near the 0.11 to 0.12 m of an elastica fitted by hand; the replay matches."""
    recording = Recording.read(real_data / "rope_red_lift.npz")
    found = estimate(recording, EstimateSettings(starts=1))
    assert found.usable
    assert 0.09 <= found.record["bending_length"] <= 0.15
    assert found.record["chamfer_last"] <= 0.012
