"""Cloth dragging: what the tool does, within its limits, and that it spreads what hangs."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import STANDARD_GRAVITY, size_of, unit_of
from gendom.tasks import ClothDragging
from gendom.tasks.cloth_dragging import CLEAR, MAX_ACCELERATION, MAX_SPEED, NAMES

TASK = ClothDragging()


@pytest.mark.parametrize("side", [0.2, 0.5])
def test_every_motion_keeps_the_tool_s_limits(side):
    item = replace(TASK.item, side=side)
    low, high = TASK.limits(item).T
    rng = np.random.default_rng(0)
    hasty = low + (high - low) * rng.random((20, len(NAMES)))
    hasty[:, [n[0] == "t" for n in NAMES]] = low[NAMES.index("t1")]
    for action in (TASK.nearest(item, a) for a in hasty):
        path = TASK.tool_path(item, action)
        t = np.arange(0.0, path.end, 1e-3)
        v = np.diff(path.position_at(t, path.blend or 0.0), axis=0) / 1e-3
        a = np.diff(v, axis=0) / 1e-3
        assert np.linalg.norm(v, axis=1).max() <= 1.001 * MAX_SPEED * unit_of("m/s", item)
        assert np.linalg.norm(a, axis=1).max() <= 1.01 * MAX_ACCELERATION * STANDARD_GRAVITY
        assert path.end == pytest.approx(TASK.times(item)[-1])


@pytest.mark.parametrize(("hold", "at"), [(0.0, [0.515, 0.5065]), (0.47, [0.045, 0.0365])])
def test_the_tool_raises_all_of_it_goes_away_from_the_cloth_and_ends_on_the_table(hold, at):
    action = np.zeros(len(NAMES)) + 0.3 * TASK.action_units(TASK.item)
    action[0] = hold * size_of(TASK.item)
    action[[n[0] == "t" for n in NAMES]] = 2.5 * unit_of("s", TASK.item)
    position = TASK.tool_path(TASK.item, action).position / size_of(TASK.item)
    assert position[0] == pytest.approx([*at, 0.01])
    hangs = np.hypot(0.5 + hold, 0.5 + hold)
    assert position[2] - position[0] == pytest.approx([0.0, 0.0, hangs + CLEAR])
    assert position[-1, 2] == position[0, 2]
    # x away along the diagonal, y to the left of that
    x, y = (0.3 * np.array(d) / np.sqrt(2.0) for d in ([-1.0, -1.0], [1.0, -1.0]))
    assert position[-1, :2] - position[0, :2] == pytest.approx(x + y)


def test_what_takes_too_long_is_refused():
    high = TASK.limits(TASK.item)[:, 1]
    with pytest.raises(ParameterError, match="take at most"):
        TASK.check_action(TASK.item, high)
    assert TASK.allows(TASK.item, TASK.nearest(TASK.item, high))
