"""What several tests of the second reality need."""

from typing import cast

import pytest

pytest.importorskip("mujoco", reason="needs the extra reality")

from gendom.errors import DeviceError
from gendom.reality import OBJECTS, Layout, Reality, RealRope, default_cameras


@pytest.fixture(scope="session")
def rendering():
    """The test skips where nothing can be rendered, and says why."""
    rope = cast(RealRope, OBJECTS["rope-cotton"])
    layout = Layout(origin=(0.35, 0.0, rope.radius))
    with Reality(rope, layout, cameras=default_cameras()) as world:
        try:
            world.render(0)
        except DeviceError as error:
            pytest.skip(str(error))
