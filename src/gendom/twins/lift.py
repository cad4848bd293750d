"""The lift that every twin carries out, and how our simulator has it.

The object lies on the table z = 0, a rope along x from the origin, a cloth with its first corner
there and its diagonal along x. A hand holds the rope's first end, or the cloth's corner, and lifts
it. There is no air: other simulators have none, or another.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import LinearNDInterpolator, make_interp_spline

from gendom.arrays import Array
from gendom.materials import Cloth, Item, Rope, size_of, thickness_of
from gendom.reality.objects import grid
from gendom.robot import lift, predefined_lift
from gendom.sim import Body, Gripper, Physics, Table, cloth, rope

FINGERS = 0.025
"""Breadth of usual fingers [m]: how much of an object they hold."""

WAIT = 0.5
"""Before the lift and at its end [s]."""

BLEND = 0.2
"""In which the hand's speed changes [s]."""

FRAME_RATE, PATH_RATE = 10.0, 100.0
"""Of what is compared, and of the hand's path [1/s]."""


@dataclass(frozen=True, kw_only=True)
class Lift:
    """The predefined lift (`gendom.robot.predefined_lift`) of one object."""

    item: Item
    edge: float | None = None
    """Length of the segments that a rope has in the other simulator [m]; None: it has none."""

    @property
    def hold(self) -> float:
        """What lies within this distance of the rope's end, or of the corner, moves with the hand
        [m]. The joint beyond the last segment that is held stands for half a segment on both
        sides."""
        if self.edge is None or not isinstance(self.item, Rope):
            return FINGERS
        return (max(round(FINGERS / self.edge + 0.5), 1) - 0.5) * self.edge

    @property
    def height(self) -> float:
        """Of the object's middle, and so of the hand, above the table in the beginning [m]."""
        return 0.5 * thickness_of(self.item)

    @cached_property
    def path(self) -> tuple[Array, Array]:
        """Times [K] [s], and where the hand is [K, 3] [m]."""
        usual = predefined_lift(self.item.kind)
        height = usual.rise * size_of(self.item)
        start = (0.0, 0.0, self.height)
        path = lift(start, height=height, speed=usual.speed, wait=WAIT, after=WAIT)
        time = np.arange(int(path.end * PATH_RATE) + 1) / PATH_RATE
        return time, path.position_at(time, BLEND)

    @property
    def frames(self) -> Array:
        """[F] times at which shapes are compared [s]."""
        return self.path[0][:: round(PATH_RATE / FRAME_RATE)]

    @cached_property
    def body(self) -> Body:
        """The lying object in our simulator."""
        item, start = self.item, (0.0, 0.0, self.height)
        if isinstance(item, Rope):
            return rope(diameter=item.diameter, length=item.length, start=start)
        side, yaw = item.side, -math.pi / 4.0
        return cloth(
            width=side, height=side, thickness=item.thickness, dx=side / 15, corner=start, yaw=yaw
        )

    def simulated(self) -> Array:
        """[F, N, 3] points of `body` at the frames, by our simulator [m].

        Raises:
            SimulationError: It diverges.
        """
        from gendom.sim import Simulator  # Warp, which takes long to import

        time, hand = self.path
        simulator = Simulator(
            self.body,
            [self.item.material],
            grippers=[Gripper(time=time, position=hand, radius=self.hold)],
            table=Table(height=0.0, friction=self.item.friction),
            physics=Physics(air_density=0.0),
        )
        return np.asarray(simulator.run(self.frames), dtype=np.float64)[:, 0]

    def at(self, positions: Array, places: Array) -> Array:
        """What `simulated` says of other points.

        Args:
            positions: [F, N, 3] of `body` [m].
            places: [M, 3] where the points lie in the beginning [m].

        Returns:
            [F, M, 3] linear between the body's points.
        """
        rest = np.asarray(self.body.points, dtype=float)
        if isinstance(self.item, Rope):
            at = np.clip(places[:, 0], rest[0, 0], rest[-1, 0])
            return make_interp_spline(rest[:, 0], positions, k=1, axis=1)(at)
        middle = rest[:, :2].mean(axis=0)
        inside = middle + (places[:, :2] - middle) * (1.0 - 1e-9)
        moved = LinearNDInterpolator(rest[:, :2], np.moveaxis(positions, 1, 0))(inside)
        return np.moveaxis(np.asarray(moved, dtype=np.float64), 0, 1)


def sheet_points(lift: Lift, side: int) -> tuple[Array, np.ndarray]:
    """[V, 3] points of a lying cloth, so many along its side [m], and [F, 3] triangles."""
    assert isinstance(lift.item, Cloth)
    flat, triangles = grid(side, side, lift.item.side / (side - 1))
    half = math.sqrt(0.5)
    height = np.full(len(flat), lift.height)
    return np.column_stack([flat @ [[half, -half], [half, half]], height]), triangles


def segment_points(lift: Lift, segments: int) -> Array:
    """[S, 3] middles of a lying rope's segments [m]."""
    along = (np.arange(segments) + 0.5) * size_of(lift.item) / segments
    return along[:, None] * [1.0, 0.0, 0.0] + [0.0, 0.0, lift.height]
