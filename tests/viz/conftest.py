"""A made-up lift: a thin row of points that one end pulls up from the table."""

import numpy as np
import pytest


def lift(frames=20, recorded=40, simulated=120):
    """Arguments of a `CloudSequence` for a rope of 0.25 m, lifted by 5 mm a frame."""
    rng = np.random.default_rng(0)

    def cloud(t, count):
        s = np.sort(rng.uniform(0.0, 1.0, count))
        shape = np.stack([0.3 + 0.25 * s, 0.0 * s, 0.005 * t * (1.0 - s) ** 2], axis=1)
        return shape + rng.normal(scale=0.002, size=shape.shape)

    rise = 0.005 * np.arange(frames)
    gripper = np.stack([np.full(frames, 0.3), np.zeros(frames), rise], axis=1)
    return {
        "recorded": [cloud(t, recorded) for t in range(frames)],
        "simulated": [cloud(t, simulated) for t in range(frames)],
        "times": 0.1 * np.arange(frames),
        "table_height": -0.006,
        "gripper": gripper[:, None],
        "chamfer": np.linspace(0.002, 0.006, frames),
    }


@pytest.fixture
def make_lift():
    return lift
