"""What objects say of themselves."""

import pytest

from gendom.datasets import ObjectDescription, Recording
from gendom.materials import Material
from gendom.policies import Policy
from gendom.sim import Simulator, Solver, rope

MADE = {
    "(rope, 2 frames) | length 0.3 m | mass 0.02 kg | 1 to 2 a frame": lambda: (
        Recording.from_frames(
            [[[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]],
            time=[0.0, 0.5],
            gripper_position=[[0.0, 0.0, 0.0]] * 2,
            object=ObjectDescription(kind="rope", length=0.3, mass=0.02, grasp_inset=0.01),
        )
    ),
    "(rope-casting, distal) | bending_ratio, nu": lambda: Policy.pretrained("rope-casting"),
    "(rope, 1 world) | float64 | points": lambda: Simulator(
        rope(length=0.3, diameter=0.01), [Material()], solver=Solver(threads=1)
    ),
}


@pytest.mark.parametrize("says", MADE)
def test_objects_are_short_and_useful(says):
    item = MADE[says]()
    text, page = repr(item), item._repr_html_()
    assert text.startswith(type(item).__name__) and len(text.splitlines()) <= 8
    for words in says.split(" | "):
        assert words in text and words in page
