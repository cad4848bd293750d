"""Cloth spreading: the paper's steps, the share that lies spread on known shapes; and dragging:
what the tool does, within its limits."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import STANDARD_GRAVITY, size_of, unit_of
from gendom.reality import RealWorld
from gendom.tasks import ClothDragging, ClothSpreading, RopeReaching
from gendom.tasks.areas import spread_areas
from gendom.tasks.cloth_dragging import CLEAR, MAX_ACCELERATION, MAX_SPEED, NAMES
from gendom.tasks.cloth_spreading import CLOTH, lattice_triangles, step_shares
from gendom.tasks.task import Outcome
from gendom.tasks.world import Simulation

TASK, DRAGGING = ClothSpreading(), ClothDragging()
N = 41


def sheet(z=lambda u, v: 0.0 * u, x=lambda u, v: u):
    """[V, 3] of a square of side 1; u, v are its own coordinates."""
    v, u = np.meshgrid(*2 * [np.linspace(0.0, 1.0, N)], indexing="ij")
    return np.stack([x(u, v), v, z(u, v)], axis=-1).reshape(-1, 3)


def test_steps_are_the_paper_s():
    i = np.arange(1, 17)
    for A in (0.0, 0.1, 0.25):
        expected = np.where(i < 9, 1.0 - (4.5 - 0.5 * i) * A, 1.0 + (0.5 * i - 4.0) * A)
        assert 16.0 * step_shares(A) == pytest.approx(expected)
    # beyond the paper's largest no step goes up and the height stays
    steps = step_shares(0.6)
    assert steps.min() == 0.0 and steps.sum() == pytest.approx(1.0)
    assert np.all(np.diff(steps) >= 0.0)
    # the height is 0 16 m for the paper's cloths
    position = TASK.tool_path(TASK.item, np.array([0.2])).position
    assert np.ptp(position[:, 2]) == pytest.approx(0.16)
    # beside the centre, as a hand errs: 3 mm and 1.3 mm
    assert position[0, :2] == pytest.approx([0.103, 0.1013])
    assert position[-1, 2] == position[0, 2]


TURN = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
LAYERS = {
    "x": lambda u, v: np.minimum(u, 1.0 - u), "z": lambda u, v: np.where(u > 0.5, 0.01, 0.0)
}  # fmt: skip


@pytest.mark.parametrize(
    ("x", "share", "covered"),
    [
        (sheet(), (0.99, 1.01), (0.99, 1.01)),
        (sheet() + np.array([3.0, -2.0, 0.01]), (0.99, 1.01), (0.99, 1.01)),
        (sheet() @ TURN.T, (0.99, 1.01), (0.99, 1.01)),
        (sheet(**LAYERS), (0.48, 0.52), (0.48, 0.52)),
        # slopes of 0.75 are mostly beyond 20 degrees, those of 0.04 nowhere
        (sheet(z=lambda u, v: 0.04 * np.abs(np.sin(6 * np.pi * u))), (0, 0.5), (0.99, 1.01)),
        (sheet(z=lambda u, v: 0.002 * np.abs(np.sin(6 * np.pi * u))), (0.99, 1.01), (0.99, 1.01)),
        (sheet(z=lambda u, v: np.where(u > 0.5, 0.2, 0.0)), (0.47, 0.53), (0.9, 1.01)),
        (0.3 * np.random.default_rng(0).random((N * N, 3)), (0, 0.1), (0, 0.3)),
        (np.zeros((N * N, 3)), (0, 0.01), (0, 0.01)),
    ],
    ids=["flat", "moved", "turned", "folded", "waves", "ripples", "raised", "crumpled", "heaped"],
)
def test_what_lies_flat_is_spread(x, share, covered):
    for found, (low, high) in zip(
        spread_areas(x, lattice_triangles(N, N)), (share, covered), strict=True
    ):
        assert low <= found <= high


def test_layers_that_stick_in_the_mpm_are_told_once(monkeypatch, caplog):
    def side_by_side(self, task, items, *rest):
        return [Outcome(values={}) for _ in items]

    monkeypatch.setattr(Simulation, "_side_by_side", side_by_side)
    cloths, rope = [CLOTH, replace(CLOTH, side=0.3)], RopeReaching()
    Simulation().carry_out(TASK, cloths, [[0.3], [0.3]])
    Simulation(engine="mpm").carry_out(rope, [rope.item], [[0.12, 0.12]])
    assert caplog.text == ""
    Simulation(engine="mpm").carry_out(TASK, cloths, [[0.3], [0.3]])
    assert [(r.levelname, "stick" in r.message) for r in caplog.records] == [("WARNING", True)]


def assert_within_limits(path, item):
    t = np.arange(path.start, path.end, 1e-3)
    v = np.diff(path.position_at(t, path.blend or 0.0), axis=0) / 1e-3
    a = np.diff(v, axis=0) / 1e-3
    assert np.linalg.norm(v, axis=1).max() <= 1.001 * MAX_SPEED * unit_of("m/s", item)
    assert np.linalg.norm(a, axis=1).max() <= 1.01 * MAX_ACCELERATION * STANDARD_GRAVITY


@pytest.mark.parametrize("side", [0.2, 0.5])
def test_every_motion_keeps_the_tool_s_limits_and_what_takes_too_long_is_refused(side):
    item = replace(DRAGGING.item, side=side)
    of_hold_and_time = DRAGGING.action_units(item)[[0, 4]]
    assert of_hold_and_time == pytest.approx([side, (side / STANDARD_GRAVITY) ** 0.5])
    low, high = DRAGGING.limits(item).T
    with pytest.raises(ParameterError, match="take at most"):
        DRAGGING.check_action(item, high)
    hasty = low + (high - low) * np.random.default_rng(0).random((20, len(NAMES)))
    hasty[:, [n[0] == "t" for n in NAMES]] = low[NAMES.index("t1")]
    for action in (DRAGGING.nearest(item, a) for a in (high, *hasty)):
        assert DRAGGING.allows(item, action)
        path = DRAGGING.tool_path(item, action)
        assert_within_limits(path, item)
        assert path.end == pytest.approx(DRAGGING.times(item)[-1])


@pytest.mark.parametrize(("hold", "at"), [(0.0, [0.515, 0.5065]), (0.47, [0.045, 0.0365])])
def test_the_tool_raises_all_of_it_goes_away_from_the_cloth_and_ends_on_the_table(hold, at):
    action = np.zeros(len(NAMES)) + 0.3 * DRAGGING.action_units(DRAGGING.item)
    action[0] = hold * size_of(DRAGGING.item)
    action[[n[0] == "t" for n in NAMES]] = 2.5 * unit_of("s", DRAGGING.item)
    position = DRAGGING.tool_path(DRAGGING.item, action).position / size_of(DRAGGING.item)
    assert position[0] == pytest.approx([*at, 0.01])
    hangs = np.hypot(0.5 + hold, 0.5 + hold)
    assert position[2] - position[0] == pytest.approx([0.0, 0.0, hangs + CLEAR])
    assert position[-1, 2] == position[0, 2]
    # x away along the diagonal, y to the left of that
    x, y = (0.3 * np.array(d) / np.sqrt(2.0) for d in ([-1.0, -1.0], [1.0, -1.0]))
    assert position[-1, :2] - position[0, :2] == pytest.approx(x + y)


class Raised(ClothDragging):
    """One corner is raised, which is not enough, and then another, from how it lies."""

    tries, end = 2, property(lambda self: 1.5)

    def tool_path(self, item, action, at=0.04):
        place = size_of(item) * np.array([[at, at, 0.01], [at, at, 0.01], [0.5, 0.5, 0.3]])
        return self._path(item, np.array([-0.2, 0.0, 1.0]), place, 1.0)

    def next_path(self, item, x, hand):
        assert hand / size_of(item) == pytest.approx([0.5, 0.5, 0.3], abs=1e-3)
        assert x[0] == pytest.approx(hand, abs=0.1 * size_of(item))
        return self.tool_path(item, None, x[-1, 0] / size_of(item) - 0.04)

    def outcome(self, item, seen):
        return super().outcome(item, seen) | {"unspread": 1.0}


@pytest.mark.parametrize("world", [Simulation(), RealWorld(robot=False)])
def test_a_further_try_begins_with_the_cloth_as_it_lies(world):
    task, item = Raised(), replace(DRAGGING.item, side=0.12)
    action = np.array(task.candidates[3]) * task.action_units(item)
    (found,) = world.carry_out(task, [item], [action], keep=True)
    x = found.seen.points[-1] / size_of(item)
    assert found.tries == 2
    # the first corner has fallen, onto the table or the cloth
    assert x[0, 2] < 0.15 and x[-1, 2] > 0.25


@pytest.mark.parametrize("turn", [0.3, 2.5])
def test_what_is_not_spread_is_pulled_to_its_wider_side(turn):
    side, hand = size_of(DRAGGING.item), np.array([0.3, -0.2, 0.002])
    c, s = np.cos(turn), np.sin(turn)
    # the far corner ahead, a corner 0.7 sides to the left, and 0.3 to the right, where it is folded
    outline = side * np.array([[0.0, 0.0], [1.4, 0.0], [0.7, 0.7], [0.8, -0.3]])
    x = np.column_stack([outline @ [[c, s], [-s, c]] + hand[:2], [0.0, 0.0, 0.02, 0.0]])
    path = DRAGGING.next_path(DRAGGING.item, x, hand)
    (closing,) = path.events
    assert closing.closed and closing.time == path.start
    assert path.end == pytest.approx(DRAGGING.times(DRAGGING.item)[-1])
    first, last = path.position[[0, -1], :2]
    way = (last - first) / np.linalg.norm(last - first)
    assert way == pytest.approx([-s, c])
    assert (x[2, :2] - first) == pytest.approx(0.06 * side * way)
    assert path.position[:2, 2] == pytest.approx(0.02)  # where that corner stands up
    assert_within_limits(path, DRAGGING.item)
