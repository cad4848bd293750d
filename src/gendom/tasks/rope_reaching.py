"""Rope reaching: pull the tip of a hanging rope back, let go, and see how far it swings.

After Kuroki et al. (2024), "GenDOM: Generalizable One-shot Deformable Object Manipulation with
Parameter-Aware Policy". Their scene has no unit: a rope 0.5 long and 0.028 thick under gravity
12. Here every length is a multiple of the rope's length L and every time of sqrt(L / g); the
paper's times and moduli carry over by

    t = t_paper sqrt((L / g) / (0.5 / 12)),        E / rho = (E / rho)_paper (g L) / (12 * 0.5).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from gendom.arrays import Array, rigid
from gendom.materials import Item, size_of, sizes_of, unit_of
from gendom.robot.path import GripperEvent, TcpPath, TcpPaths, pointing
from gendom.tasks.task import ROPE, ROPE_RANGES, Observed, Quantity, Scene, Task

PAPER_CLOCK = math.sqrt(0.5 / 12.0)
"""Unit of time of the paper's scene [-]."""

ARRIVES, RELEASES, ENDS = (t / PAPER_CLOCK for t in (0.38, 0.57, 1.14))
"""When the tip arrives, is let go, and the rollout ends [sqrt(L / g)]: the paper's times."""

RELEASE_X, RELEASE_Z = (0.24, 0.9), (0.24, 1.0)
"""Box of release points, in rope lengths from the task's origin."""

RELEASE_DISTANCE = (0.6, 0.94)
"""Distance of a release point from where the top is held [L]."""

TOP_HEIGHT = 1.1
"""Height at which the top is held, in rope lengths; it is one length in front of the origin."""

GRIP = 0.03
"""How much of each end is held [L]."""

BOW = 0.002
"""How far simulated ropes are bowed sideways at first [L]."""

WAIT = 3.0
"""Still, between closing and moving [sqrt(L / g)]."""

FRAMES = 150
"""Times at which the tip is looked at between release and end."""

ORIGIN = (0.48, 0.30, 0.12)
"""Where the task's origin is in front of a robot [m]. Its x runs along the base's -y: the rope
swings across, in front of the arm, and hangs clear of the table."""


@dataclass(frozen=True, kw_only=True)
class RopeReaching(Task):
    """A rope hangs from a stand; the tool pulls its tip to a release point and lets go.

    The task's frame: x forward, z up. The top is held at (L, 0, 1.1 L), so the tip hangs at
    (L, 0, 0.1 L). The tool moves on a straight line at constant speed to the release point
    (x, 0, z), holds still, and opens; the top stays held.

    Action: release point (x, z) [m] from the box x in [0.24, 0.9] L, z in [0.24, 1.0] L, less what
    is closer to the top than 0.6 L or farther than 0.94 L. The paper draws from the whole box, but
    a rope does not stretch to its far corners, and close to the top it stands in an arc that may
    fall to either side.

    Goal: the farthest x [m] that the tip reaches in its first swing. It is the maximum from the
    release until 0.53 of the pendulum's period after it: the tip has then swung forward once and
    is not back a second time. (The first time that the tip's velocity turns back would not do:
    right after the release the rope's own vibration turns it back and forth.)

    A rope whose ends are clamped close together stands in an arc that is unstable: it falls out of
    the plane, the sooner the stiffer it is and the less straight it hung. Which rope does so at
    which release can be simulated; how far it then swings is not predictable. `sideways` [m], the
    tip's farthest way from y = 0, shows it.
    """

    name: ClassVar[str] = "rope-reaching"
    kind: ClassVar[str] = "rope"
    actions: ClassVar[tuple[Quantity, ...]] = (
        Quantity(name="release_x", unit="m", meaning="where the tip is let go, forward"),
        Quantity(name="release_z", unit="m", meaning="where the tip is let go, up"),
    )
    goals: ClassVar[tuple[Quantity, ...]] = (
        Quantity(name="x", unit="m", meaning="farthest reach of the tip"),
    )

    outcomes: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            name="sideways", unit="m", limit=0.03,
            meaning="largest distance of the tip from its plane",
        ),
    )  # fmt: skip

    item: Item = ROPE
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=lambda: dict(ROPE_RANGES))

    bow: float = BOW
    """How far simulated ropes are bowed sideways at first [L]; 0: not at all, as in the paper, so
    that none falls out of its plane."""

    def limits(self, item: Item) -> Array:
        return size_of(item) * np.array([RELEASE_X, RELEASE_Z])

    def limits_of(self, items: Sequence[Item]) -> Array:
        return sizes_of(items)[:, None, None] * np.array([RELEASE_X, RELEASE_Z])

    def margin(self, item: Item, action: Array) -> float:
        return float(_margin(action / size_of(item)))

    def margins(self, items: Sequence[Item], actions: Array) -> Array:
        return _margin(actions / sizes_of(items)[:, None])

    def limits_note(self, item: Item) -> str:
        near, far = (limit * size_of(item) for limit in RELEASE_DISTANCE)
        x, _, z = self.top(item)
        return f"{near:.4g} to {far:.4g} m from the top at ({x:.4g}, {z:.4g}) m"

    def top(self, item: Item) -> Array:
        """[3] where the top is held [m]."""
        return size_of(item) * np.array([1.0, 0.0, TOP_HEIGHT])

    def scene(self, item: Item) -> Scene:
        bow, grip = self.bow * size_of(item), GRIP * size_of(item)
        return Scene(origin=self.top(item), along=(0.0, 0.0, -1.0), bow=bow, stand=grip, grip=grip)

    def tool_path(self, item: Item, action: Array) -> TcpPath:
        second = unit_of("s", item)
        return TcpPath(
            time=second * np.array([-WAIT, 0.0, ARRIVES, ENDS]),
            position=self._knots(item, action[None])[0],
            quat_xyzw=POINTING_FORWARD,
            events=(
                GripperEvent(time=-WAIT * second, closed=True),
                GripperEvent(time=RELEASES * second, closed=False),
            ),
            # the tool is still when it opens
            max_blend=2.0 * second * min(RELEASES - ARRIVES, WAIT),
        )

    def tool_paths(self, items: Sequence[Item], actions: Array) -> TcpPaths:
        path = self.tool_path(items[0], actions[0])
        return TcpPaths.alike(path, path.time, self._knots(items[0], actions))

    def _knots(self, item: Item, actions: Array) -> Array:
        """[W, 4, 3] where the tool waits, begins, arrives and ends [m]."""
        knots = np.zeros((len(actions), 4, 3))
        knots[:, :2] = self.top(item) - [0.0, 0.0, size_of(item)]
        knots[:, 2:, ::2] = actions[:, None]
        return knots

    def times(self, item: Item) -> Array:
        return unit_of("s", item) * np.linspace(RELEASES, ENDS, FRAMES + 1)

    def outcome(self, item: Item, seen: Observed) -> dict[str, float]:
        return {name: float(x[0]) for name, x in self.outcomes_of([item], seen[None]).items()}

    def outcomes_of(self, items: Sequence[Item], seen: Observed) -> dict[str, Array]:
        free = seen.times >= np.asarray(seen.opens)[:, None] - 1e-9
        forward, aside = seen.tip[..., 0], np.abs(seen.tip[..., 1])
        return {
            "x": np.where(free, forward, -np.inf).max(axis=1),
            "sideways": np.where(free, aside, 0.0).max(axis=1),
        }

    def T_world_task(self, item: Item) -> Array:
        return rigid([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], ORIGIN)


def _margin(release: Array) -> Array:
    """How far points [..., 2] are within `RELEASE_DISTANCE`, all in rope lengths."""
    near, far = RELEASE_DISTANCE
    distance = np.hypot(release[..., 0] - 1.0, release[..., 1] - TOP_HEIGHT)
    return np.minimum(distance - near, far - distance)


POINTING_FORWARD = pointing((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
"""quat_xyzw in the task's frame of a gripper that points along y, away from the arm, its fingers
opening along x: so it is not in the rope's way."""
