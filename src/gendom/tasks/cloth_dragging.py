"""Cloth dragging: a cloth that hangs from one hand is laid down and dragged to and fro, and what is
folded then is pulled over its folds, until it lies spread.

One hand can so spread cloths that are too limp for `cloth_spreading`: friction opens them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from gendom.materials import Item, size_of, thickness_of, unit_of
from gendom.robot.path import DOWN, GripperEvent, TcpPath
from gendom.tasks.cloth_spreading import MIN_HEIGHT, RANGES, WAIT, ClothSpreading
from gendom.tasks.task import Array, Quantity

WAYPOINTS = 5
"""After the top; the last one lies on the table."""

CLEAR, RISE_SPEED = 0.08, 0.5
"""How far above the table a cloth hangs once it is raised [sides], and how fast it is raised
[sqrt(g L)]."""

SETTLE, REST_AT_END = 3.0, 3.0
"""Still at the top, and at the end [sqrt(L / g)]."""

LONGEST = 16.0
"""Time from the top to the last waypoint, at most [sqrt(L / g)]."""

MAX_SPEED, MAX_ACCELERATION = 0.71, 0.8
"""Of the tool [sqrt(g L)], [g]: 1 m/s with a cloth of 0.2 m. What asks for more takes longer."""

BLEND = (1.0, 2.0)
"""Time in which the tool turns a corner: the sharper it is the longer [sqrt(L / g)]."""

PULL = ((-4.0, -0.06, 0.0), (0.0, -0.06, 0.0), (1.0, 0.09, 0.1), (1.6, 0.39, 0.1),
        (2.6, 0.54, 0.0), (5.6, 0.54, 0.0))  # fmt: skip
"""Times [sqrt(L / g)] and places of the tool where it pulls what is not spread yet, the first where
it closes: outwards from the outline and above the table [sides]."""

BOX = {"h": (0.0, 0.47), "x": (-1.6, 2.6), "y": (-1.0, 1.0), "z": (0.0, 1.45), "t": (BLEND[0], 4.0)}
"""Limits of each number of an action [sides], [sqrt(L / g)]."""

MEANING = {
    "hold": "from the centre towards the first corner, along each side, where it is held",
    "x": "along the diagonal, away from the cloth",
    "y": "to the left of that",
    "z": "height above the table",
    "t": "time from the one before",
}

NAMES = (
    "hold",
    *(f"{n}{k}" for k in range(1, WAYPOINTS + 1) for n in "xyzt" if f"{n}{k}" != f"z{WAYPOINTS}"),
)

MOTIONS = (
    (0.4411, -0.0952, 0.0379, 0.0592, 2.1259, -1.0132, 0.0149, 0.7237, 1.7486, -0.2009,
     0.2179, 0.5445, 3.1719, 1.2034, -0.2147, 0.2915, 3.4155, 2.4002, -0.3244, 2.8542),
    (0.4661, 0.177, 0.1301, 0.4117, 2.1557, -0.7219, 0.0005, 0.9777, 1.4828, -0.1814,
     -0.0853, 0.3338, 2.949, 1.7387, -0.0794, 0.1377, 3.6277, 2.0069, 0.145, 1.8607),
    (0.4641, -0.0309, 0.1814, 0.4428, 1.7946, -1.0355, 0.0948, 1.052, 1.5807, -0.5473,
     0.0386, 0.2544, 3.1209, 1.9538, -0.0962, 0.088, 3.5828, 2.309, -0.1801, 2.0697),
    (0.4661, -0.1202, 0.1415, 0.4055, 1.6162, -1.0094, 0.096, 0.9411, 2.0827, 0.3747,
     -0.063, 0.4067, 2.8558, 1.2009, -0.23, 0.2158, 3.5359, 2.6, -0.0606, 1.8086),
)  # fmt: skip
"""Numbers of actions, by `NAMES`, that spread many cloths [sides], [sqrt(L / g)]: found by CMA-ES
for cloths of unlike stiffness, friction, air and hold (experiments/dragging.py)."""


@dataclass(frozen=True, kw_only=True)
class ClothDragging(ClothSpreading):
    """A cloth is raised by its centre, its corner or a place between, hangs, and is led along a few
    waypoints.

    The task's frame: the cloth's first corner lies at the origin, its sides along x and y, the
    table is z = 0.

    Action: where the cloth is held [m]; `WAYPOINTS` places of the tool from where it rose, x along
    the cloth's diagonal and away from it, y to its left, z above the table (the last one is on it)
    [m], and the time t from the one before [s]. Outcomes, risk and error are those of
    `ClothSpreading`.
    """

    name: ClassVar[str] = "cloth-dragging"
    actions: ClassVar[tuple[Quantity, ...]] = tuple(
        Quantity(name=n, unit="s" if n[0] == "t" else "m", meaning=MEANING[n.rstrip("12345")])
        for n in NAMES
    )

    ranges: Mapping[str, tuple[float, float]] = field(
        # bending lengths of 0.05 to 0.17 sides
        default_factory=lambda: {**RANGES, "E_over_rho": (105.0, 4300.0)}
    )
    candidates: ClassVar[tuple[tuple[float, ...], ...]] = MOTIONS
    tries: ClassVar[int] = 5

    def limits(self, item: Item) -> Array:
        return np.array([BOX[n[0]] for n in NAMES]) * self.action_units(item)[:, None]

    def margin(self, item: Item, action: Array) -> float:
        return LONGEST - float(np.sum(self._waypoints(item, action)[1]))

    def limits_note(self, item: Item) -> str:
        return f"and take at most {LONGEST * unit_of('s', item):.3g} s"

    def tool_path(self, item: Item, action: Array) -> TcpPath:
        side = size_of(item)
        place, duration, blend = self._waypoints(item, action)
        # rounded off, the tool moves half a blend earlier: at 0
        rises = 0.5 * blend
        raised = rises + place[0, 2] / RISE_SPEED
        begins = raised + SETTLE
        time = np.r_[-WAIT, rises, raised, begins, begins + np.cumsum(duration), self.end]
        lowest = place[-1, 2]
        place = np.vstack([[0.0, 0.0, lowest], [0.0, 0.0, lowest], place[:1], place, place[-1:]])
        c = math.sqrt(0.5)
        axes = np.array([[-c, -c, 0.0], [c, -c, 0.0], [0.0, 0.0, 1.0]])
        held = 0.5 + np.array(self.off_centre) - action[0] / side
        start = np.array([*np.maximum(held, 0.5 - BOX["h"][1]), 0.0])
        return self._path(item, time, side * (start + place @ axes), blend)

    def _path(self, item: Item, time: Array, position: Array, blend: float) -> TcpPath:
        """Times and blend [sqrt(L / g)]; the hand closes at first."""
        time, blend = unit_of("s", item) * time, unit_of("s", item) * blend
        events = (GripperEvent(time=time[0], closed=True),)
        return TcpPath(
            time=time, position=position, quat_xyzw=np.array(DOWN), events=events, blend=blend
        )

    def next_path(self, item: Item, x: Array, hand: Array) -> TcpPath:
        # Corners that lie folded under the cloth unroll where it is pulled over them: at what lies
        # farthest to one side of the line from the hand to the far corner, to that side.
        away = x[:, :2] - hand[:2]
        far = away[np.argmax(np.linalg.norm(away, axis=1))]
        left = np.array([-far[1], far[0]]) / np.linalg.norm(far)
        widest = np.argmax(np.abs(aside := away @ left))
        way = left * np.sign(aside[widest])
        time, out, up = np.array(PULL).T
        place = size_of(item) * np.column_stack([np.outer(out, way), up])
        place += [*x[widest, :2], max(0.5 * thickness_of(item), MIN_HEIGHT)]
        near = np.argmin(np.linalg.norm(x[:, :2] - place[0, :2], axis=1))
        place[:2, 2] = np.maximum(place[:2, 2], x[near, 2])  # it need not lie on the table there
        return self._path(item, time + self.end - time[-1], place, BLEND[0])

    def _waypoints(self, item: Item, action: Array) -> tuple[Array, Array, float]:
        """[1 + WAYPOINTS, 3] the top and the waypoints, along the diagonal, to its left and above
        the table [sides]; [WAYPOINTS] times between them, no shorter than the tool's limits
        allow, and the blend [sqrt(L / g)]."""
        value = dict(zip(NAMES, np.asarray(action) / self.action_units(item), strict=True))
        low = max(0.5 * thickness_of(item), MIN_HEIGHT) / size_of(item)
        last = range(1, WAYPOINTS + 1)
        rows = [[value[f"x{k}"], value[f"y{k}"], low + value.get(f"z{k}", 0.0)] for k in last]
        top = low + math.sqrt(2.0) * (0.5 + value["hold"]) + CLEAR
        place = np.vstack([[0.0, 0.0, top], rows])
        duration = np.array([max(value[f"t{k}"], BLEND[0]) for k in last])
        needed = 1.5 / MAX_ACCELERATION * _sharpest(place, duration)[1]
        blend = float(np.clip(needed, *BLEND))
        duration = np.maximum(duration, blend)
        speed, turn = _sharpest(place, duration)
        hardest = 1.5 * turn / (MAX_ACCELERATION * blend)
        return place, duration * max(1.0, speed / MAX_SPEED, hardest), blend

    @property
    def end(self) -> float:
        return BLEND[1] + 1.5 / RISE_SPEED + SETTLE + LONGEST + REST_AT_END

    def T_world_task(self, item: Item) -> Array:
        # the diagonal runs along the base's y
        T = np.eye(4)
        c = math.sqrt(0.5)
        T[:2, :2] = [[c, -c], [c, c]]
        T[:3, 3] = [0.45, 0.7 * size_of(item), 0.0]
        return T


def _sharpest(place: Array, duration: Array) -> tuple[float, float]:
    """The largest speed between places [K + 1, n], and the largest change of velocity at one."""
    speed = np.zeros((len(place) + 1, place.shape[1]))
    speed[1:-1] = np.diff(place, axis=0) / duration[:, None]
    turns = np.linalg.norm(np.diff(speed, axis=0), axis=1)
    return float(np.linalg.norm(speed, axis=1).max()), float(turns.max())
