"""A recording for the tests, made here."""

import numpy as np
import pytest

from gendom.datasets import ObjectDescription, Recording


@pytest.fixture
def lift() -> Recording:
    """Five frames of a straight 0.4 m rope, 20 to 24 points, one end lifted by 1 cm a frame."""
    rng, grip = np.random.default_rng(0), np.linspace([0.4, 0.0, 0.0], [0.4, 0.0, 0.04], 5)
    clouds = [np.linspace([0.0, 0.0, 0.0], at, 20 + t) for t, at in enumerate(grip)]
    clouds = [cloud + 0.001 * rng.normal(size=cloud.shape) for cloud in clouds]
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
