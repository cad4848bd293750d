"""Cloth spreading: a cloth that hangs from its centre is brought down so that it lies spread.

After Kuroki et al. (2024). The gripper goes down in 16 steps of equal time; step i is, in
sixteenths of the height,

    1 - (4.5 - 0.5 i) A  for i = 1..8,     1 + (0.5 i - 4.0) A  for i = 9..16:

from 1 - 4 A to 1 - 0.5 A and from 1 + 0.5 A to 1 + 4 A. The halves sum to 8 - 18 A and 8 + 18 A, so
every A goes the whole height. Beyond A = 0.25 the first steps would go upwards; the paper is silent
there and its authors' code sets them to zero, which lengthens the way. Here they are zero too, and
all others are scaled to keep the height.

The paper's height is 0.16 m for cloths of 0.2 m, 0.8 of the side; so it is here for every cloth.

No way down opens a limp cloth: see docs/tasks.md for what was measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from gendom.arrays import Array
from gendom.materials import Cloth, Item, Material, size_of, thickness_of, unit_of
from gendom.robot.path import DOWN, GripperEvent, TcpPath
from gendom.tasks.task import Observed, Quantity, Scene, Task

CLOTH = Cloth(side=0.2, thickness=0.001, material=Material(E=4e5, density=400.0, damping=0.005))
"""What demonstrations are simulated with."""

RANGES = {
    # bending lengths of 0.06 to 0.16 sides: a shirting to 1 mm of rubber
    "E_over_rho": (190.0, 3500.0),
    "nu": (0.2, 0.45),
    "damping": (0.002, 0.02),
    "friction": (0.3, 0.8),
    "density": (150.0, 1200.0),
}

DOWN_STEPS = 16
"""In which a cloth is brought down."""

HEIGHT = 0.8
"""How far it is raised and brought down [sides]."""

LARGEST_A = 0.65
"""The largest acceleration of the authors' code."""

STEP_TIME = 0.28
"""Of each step [sqrt(L / g)]: 40 ms for a side of 0.2 m. The paper gives none."""

RISE_SPEED = 0.14
"""At which a cloth is raised [sqrt(g L)]: 0.2 m/s for a side of 0.2 m."""

WAIT, SETTLE, REST_AT_END = 3.0, 7.0, 7.0
"""Still before it is raised, at the top for the cloth to hang still, and at the end, for it to come
to rest [sqrt(L / g)]."""

OFF_CENTRE = (0.015, 0.0065)
"""How far beside its centre a cloth is held, along its sides [sides]: 3 mm for a side of 0.2 m, as
hands err. Held exactly there it would hang symmetrically, which is unstable: rounding would decide
how it folds."""

GRIP = 0.0125
"""Half the breadth of the fingers: how much of the centre they hold [m]."""

MIN_HEIGHT = 0.002
"""Lowest place of the tool point [m]: fingers reach 1 mm below it."""

START = 0.32
"""How far in front of a robot the nearest side of the cloth lies [m]."""

SPREAD = 0.75
"""Share that the paper asks for."""

CHOICES = tuple(round(0.05 * k, 2) for k in range(14))
"""Values of A that demonstrations try and policies choose among."""


@dataclass(frozen=True, kw_only=True)
class ClothSpreading(Task):
    """A cloth is raised by its centre, hangs, and is brought down with an acceleration A.

    The task's frame: the cloth's first corner lies at the origin, its sides along x and y, the
    table is z = 0.

    Action: A [-], the paper's acceleration, 0 to 0.65. There is no goal but to be spread: policies
    give the A for an object. `share` is how much of the cloth lies spread, smooth and free of
    wrinkles (see `gendom.tasks.areas`), `unspread` how much does not, `covered` how much of the
    table it covers over its own area: the paper's extended ratio. An object's best A is the
    smallest that reaches a share of 0.75.
    """

    name: ClassVar[str] = "cloth-spreading"
    kind: ClassVar[str] = "cloth"
    actions: ClassVar[tuple[Quantity, ...]] = (
        Quantity(name="A", unit="1", meaning="acceleration of the way down"),
    )
    goals: ClassVar[tuple[Quantity, ...]] = ()
    outcomes: ClassVar[tuple[Quantity, ...]] = (
        Quantity(name="share", unit="1", meaning="share of the area that lies flat, unwrinkled"),
        Quantity(name="unspread", unit="1", meaning="share that does not", limit=1.0 - SPREAD),
        Quantity(name="covered", unit="1", meaning="covered area of the table over the cloth's"),
    )
    watches: ClassVar[str] = "all"
    candidates: ClassVar[tuple[tuple[float, ...], ...]] = tuple((A,) for A in CHOICES)
    cost: ClassVar[float] = 64.0

    item: Item = CLOTH
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=lambda: dict(RANGES))
    off_centre: tuple[float, float] = OFF_CENTRE
    """[2] how far beside its centre a cloth is held, along its sides [sides]."""

    def limits(self, item: Item) -> Array:
        return np.array([[0.0, LARGEST_A]])

    def scene(self, item: Item) -> Scene:
        origin = (0.0, 0.0, 0.5 * thickness_of(item))
        return Scene(origin=origin, grip=GRIP, table=0.0, self_contact=True)

    def tool_path(self, item: Item, action: Array) -> TcpPath:
        side, second = size_of(item), unit_of("s", item)
        low = max(0.5 * thickness_of(item), MIN_HEIGHT)
        down = np.concatenate([[0.0], np.cumsum(step_shares(float(action[0])))])
        raised = HEIGHT / RISE_SPEED
        begins = raised + SETTLE
        time = np.concatenate(
            [[-WAIT, 0.0, raised], begins + STEP_TIME * np.arange(DOWN_STEPS + 1), [self.end]]
        )
        height = np.concatenate([[0.0, 0.0, 1.0], 1.0 - down, [0.0]])
        position = np.zeros((len(time), 3))
        position[:, :2] = side * (0.5 + np.array(self.off_centre))
        position[:, 2] = low + HEIGHT * side * height
        return TcpPath(
            time=second * time,
            position=position,
            quat_xyzw=np.array(DOWN),
            events=(GripperEvent(time=-WAIT * second, closed=True),),
            max_blend=second * min(2.0 * WAIT, SETTLE, 2.0 * REST_AT_END),
        )

    @property
    def end(self) -> float:
        """When all is over [sqrt(L / g)]."""
        return HEIGHT / RISE_SPEED + SETTLE + DOWN_STEPS * STEP_TIME + REST_AT_END

    def times(self, item: Item) -> Array:
        return unit_of("s", item) * np.array([self.end])

    def outcome(self, item: Item, seen: Observed) -> dict[str, float]:
        from gendom.tasks.areas import spread_areas  # Warp, which takes long to import

        triangles = lattice_triangles(*seen.lattice)
        share, covered = spread_areas(seen.points[-1] / size_of(item), triangles)
        return {"share": share, "unspread": 1.0 - share, "covered": covered}

    def error(self, item: Item, goal: Array, values: Mapping[str, float]) -> float:
        """What is missing of the share that is asked for [-]."""
        return max(0.0, SPREAD - values["share"])

    def T_world_task(self, item: Item) -> Array:
        T = np.eye(4)
        T[:3, 3] = [START, -0.5 * size_of(item), 0.0]
        return T


def step_shares(A: float) -> Array:
    """[16] way of each step, in heights."""
    i = np.arange(1, DOWN_STEPS + 1)
    steps = np.maximum(1.0 + np.where(i <= 8, 0.5 * i - 4.5, 0.5 * i - 4.0) * A, 0.0)
    return steps / steps.sum()


def lattice_triangles(rows: int, columns: int) -> np.ndarray:
    """[F, 3] vertices of the triangles of a lattice, row by row, all counter-clockwise where the
    second axis is to the left of the first."""
    at = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]
    halves = [np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]
    return np.concatenate([h.reshape(-1, 3) for h in halves])
