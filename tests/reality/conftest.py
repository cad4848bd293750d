"""What several tests of the second reality need; without MuJoCo none of them is collected."""

import importlib.util
from typing import cast

import pytest

from gendom.errors import DeviceError

collect_ignore_glob = ["test_*.py"] * (importlib.util.find_spec("mujoco") is None)


@pytest.fixture(scope="session")
def rendering():
    """The test skips where nothing can be rendered, and says why."""
    from gendom.reality import OBJECTS, Layout, Reality, RealRope, default_cameras

    rope = cast(RealRope, OBJECTS["rope-cotton"])
    layout = Layout(origin=(0.35, 0.0, rope.radius))
    with Reality(rope, layout, cameras=default_cameras()) as world:
        try:
            world.render(0)
        except DeviceError as error:
            pytest.skip(str(error))
