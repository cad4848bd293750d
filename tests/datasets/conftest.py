"""A recording for the tests, made here."""

import numpy as np
import pytest

from gendom.datasets import ObjectDescription, Recording


@pytest.fixture
def lift() -> Recording:
    """Five frames of a straight 0.4 m rope, 20 to 24 points, one end lifted by 1 cm a frame."""
    rng = np.random.default_rng(0)
    clouds = []
    for t in range(5):
        x = np.linspace(0.0, 0.4, 20 + t)
        height = 0.01 * t * x / 0.4
        cloud = np.stack([x, np.zeros_like(x), height], axis=1)
        clouds.append(cloud + 0.001 * rng.normal(size=cloud.shape))
    grip = np.stack([np.full(5, 0.4), np.zeros(5), 0.01 * np.arange(5)], axis=1)
    return Recording.from_frames(
        clouds,
        time=0.1 * np.arange(5),
        gripper_position=grip,
        gripper_axis=np.tile([-1.0, 0.0, 0.0], (5, 1)),
        object=ObjectDescription(kind="rope", length=0.4, mass=0.02, extra={"colour": "red"}),
        table_height=0.0,
        camera_positions=np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]]),
        source="made by a test",
        extra={"operator": "nobody", "takes": [1, 2]},
    )
