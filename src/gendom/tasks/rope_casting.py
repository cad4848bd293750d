"""Rope casting: a rope hangs from the hand, which makes one quick horizontal move.

After Kuroki et al. (2024). In the authors' code the move takes 5 steps of a scene whose rope is 0.5
long under gravity 12, and goes 0.05 to 0.1 far: for a rope of 0.25 m that is 25 to 50 mm in 7.4 ms,
or 3.4 to 6.7 m/s, which no arm of 1 m/s does. Here the move goes 0.4 to 0.9 rope lengths at a speed
and an acceleration that an arm has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from gendom.arrays import Array, rigid
from gendom.materials import STANDARD_GRAVITY, Item, size_of, sizes_of, unit_of
from gendom.robot.path import DOWN, GripperEvent, TcpPath, TcpPaths
from gendom.tasks.task import ROPE, ROPE_RANGES, Observed, Quantity, Scene, Task

MOVE_LENGTH = (0.4, 0.9)
"""How far the hand goes [L]."""

SPEED = 0.46
"""Of the hand [sqrt(g L)]: 0.79 m/s for a rope of 0.3 m."""

ACCELERATION = 0.8
"""Largest acceleration of the hand [g]."""

WAIT = 3.0
"""Still before the move, for the rope to hang still [sqrt(L / g)]."""

WATCHED = 5.0
"""How long the tip is looked at after the longest move at constant speed [sqrt(L / g)]: a stiff
pendulum of this length swings forth and half back in 2.6."""

WATCHED_WHOLE = 10.0
"""The same where the whole motion counts."""

STANDS_WITHIN = 0.01
"""The hand stands once it is this near to where it ends [L]."""

FRAMES = 200
"""Times at which the tip is looked at."""

GRIP = 0.03
"""How much of the rope the hand holds [L]."""

PLACE = (0.45, 0.15)
"""In front of a robot: how far from its base the rope is cast, and how high its tip hangs [m]."""


@dataclass(frozen=True, kw_only=True)
class RopeCasting(Task):
    """One quick move of the hand, and the highest point of the rope's tip.

    The task's frame: the tip hangs at the origin, x along the cast, z up.

    Action: how far the hand goes [m], 0.4 to 0.9 L, at `speed`, its corners rounded off so that it
    accelerates by at most 0.8 g.

    Goal: (x, z) [m] of the tip where it is highest in its first swing forward: from when it is
    ahead of the hand, which has stopped, until it is behind. Over the whole motion that point jumps
    between the way forth and the way back where both are equally high, and no smooth policy can
    follow it (`whole_motion` takes it nevertheless, as the paper does).
    """

    name: ClassVar[str] = "rope-casting"
    kind: ClassVar[str] = "rope"
    actions: ClassVar[tuple[Quantity, ...]] = (
        Quantity(name="way", unit="m", meaning="how far the hand goes"),
    )
    goals: ClassVar[tuple[Quantity, ...]] = (
        Quantity(name="x", unit="m", meaning="of the tip's highest point, along the cast"),
        Quantity(name="z", unit="m", meaning="of the tip's highest point, above where it hung"),
    )
    outcomes: ClassVar[tuple[Quantity, ...]] = (
        Quantity(name="sideways", unit="m", meaning="largest distance of the tip from its plane"),
    )

    item: Item = ROPE
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=lambda: dict(ROPE_RANGES))
    speed: float = SPEED
    """Of the hand [sqrt(g L)]."""
    whole_motion: bool = False
    """Whether the highest point of the whole motion counts, not that of the first swing."""

    def limits(self, item: Item) -> Array:
        return size_of(item) * np.array([MOVE_LENGTH])

    def limits_of(self, items: Sequence[Item]) -> Array:
        return sizes_of(items)[:, None, None] * np.array([MOVE_LENGTH])

    def scene(self, item: Item) -> Scene:
        L = size_of(item)
        return Scene(origin=(0.0, 0.0, L), along=(0.0, 0.0, -1.0), grip=GRIP * L)

    def tool_path(self, item: Item, action: Array) -> TcpPath:
        (time,), (position,), blend = self._knots(item, action[None])
        closes = GripperEvent(time=time[0], closed=True)
        return TcpPath(
            time=time, position=position, quat_xyzw=np.array(DOWN), events=(closes,), blend=blend
        )

    def tool_paths(self, items: Sequence[Item], actions: Array) -> TcpPaths:
        time, position, _ = self._knots(items[0], actions)
        return TcpPaths.alike(self.tool_path(items[0], actions[0]), time, position)

    def _knots(self, item: Item, actions: Array) -> tuple[Array, Array, float]:
        """Times [W, 4] [s] and positions [W, 4, 3] [m] of the tool, and how they are rounded off
        [s]."""
        second, speed = unit_of("s", item), self.speed * unit_of("m/s", item)
        # rounded off, the move begins half a blend earlier: at 0
        blend = 1.5 * speed / (ACCELERATION * STANDARD_GRAVITY)
        begin = 0.5 * blend
        time = np.tile([-WAIT * second, begin, begin, second * self._watched], (len(actions), 1))
        time[:, 2] += actions[:, 0] / speed
        position = np.zeros((len(actions), 4, 3))
        position[..., 2] = size_of(item)
        position[:, 2:, 0] = actions
        return time, position, blend

    def times(self, item: Item) -> Array:
        return unit_of("s", item) * np.linspace(0.0, self._watched, FRAMES + 1)

    @property
    def _watched(self) -> float:
        """How long the tip is looked at [sqrt(L / g)]."""
        return MOVE_LENGTH[1] / self.speed + (WATCHED_WHOLE if self.whole_motion else WATCHED)

    def outcome(self, item: Item, seen: Observed) -> dict[str, float]:
        return {name: float(x[0]) for name, x in self.outcomes_of([item], seen[None]).items()}

    def outcomes_of(self, items: Sequence[Item], seen: Observed) -> dict[str, Array]:
        x, y, z = np.moveaxis(seen.tip, 2, 0)
        hand = seen.hand[..., 0]
        stands = np.abs(hand - hand[:, -1:]) <= STANDS_WITHIN * size_of(items[0])
        ahead = stands & (x > hand)
        since = np.logical_or.accumulate(ahead, axis=1)
        swings = ~np.logical_or.accumulate(since & ~ahead, axis=1) & since
        counts = swings | ~since[:, -1:] | self.whole_motion
        top = np.where(counts, z, -np.inf).argmax(axis=1)[:, None]
        highest = (np.take_along_axis(of, top, axis=1)[:, 0] - of[:, 0] for of in (x, z))
        return {**dict(zip("xz", highest, strict=True)), "sideways": np.abs(y).max(axis=1)}

    def T_world_task(self, item: Item) -> Array:
        # x runs along the base's y, the middle of the longest cast straight ahead
        place = [PLACE[0], -0.5 * MOVE_LENGTH[1] * size_of(item), PLACE[1]]
        return rigid([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], place)
