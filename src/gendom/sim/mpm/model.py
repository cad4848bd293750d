"""W worlds on a device: their parameters, state and clocks."""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.errors import SimulationError
from gendom.sim.mpm.grid import Grid, grown_room, make_grid, room_for
from gendom.sim.mpm.step import INVERTED, NOTHING_HELD
from gendom.sim.mpm.types import make_types
from gendom.sim.setting import DRAG, Setting, spread

CLOCK = (
    "dt", "steps", "step", "age", "travel", "near_table", "status", "failed_particle", "frame"
)  # fmt: skip
"""The arrays of a clock."""

REBUILD = 1e30
"""Distance travelled [m] after which every world rebuilds its grid."""


class Worlds:
    """Arrays of W worlds of one body, in the form required by kernels.

    Raises:
        ParameterError: If shapes do not fit or the law is unknown.
    """

    def __init__(self, setting: Setting):
        s = setting
        self.setting = s
        self.device = s.device
        self.substep = s.substep
        self.numpy_type = np.dtype(s.dtype)
        self.real = wp.float32 if s.dtype == "float32" else wp.float64
        self.types = make_types(self.real)
        # elastic worlds run kernels of their own: what the others do does not show in them
        self.yields = np.array([math.isfinite(m.yield_stress) for m in s.materials])
        self.damped = any(m.damping > 0.0 for m in s.materials)
        W, N = len(s.materials), s.body.num_particles
        self.num_worlds, self.num_particles = W, N
        self.stiffness = spread(s.stiffness, (W, N), "stiffness")
        # heights are counted from the table: near 0 float32 resolves what presses on it
        self.origin = np.array([0.0, 0.0, s.table.height if s.table is not None else 0.0])
        x = spread(np.asarray(s.positions, dtype=float) - self.origin, (W, N, 3), "positions")
        self.room = room_for(_distinct(x), s.body.dx)
        self.matter = self._matter()
        self.scene = self._scene()
        self.paths = self._paths()
        self.grips = self._grips()
        self.clock = self._clock()
        self.carried = (
            "x",
            "v",
            "C",
            *(("Z",) if self.damped else ()),
            *(("G",) if self.yields.any() else ()),
        )
        self.low = self.zeros((W, N) if s.dtype == "float32" else (0, 0), self.types.vec3)
        self.state = self.make_state(W, wp.zeros)
        wp.copy(self.state.x, self.array(x, self.types.vec3))
        if self.yields.any():
            self.state.G.fill_(self.types.mat33(np.eye(3)))
        self.pulls = self.zeros((W, N), self.types.pull)
        self.touched = self.zeros((W, N // s.body.section), self.types.vec3)
        self.last_good = self.make_state(W)
        for name in self.carried:
            wp.copy(getattr(self.last_good, name), getattr(self.state, name))
        self.last_good_time = np.full(W, s.start_time)
        self.failures: dict[int, SimulationError] = {}

    def _matter(self) -> Any:
        s = self.setting
        lame = np.array([m.lame_of(s.body.lateral_constraint) for m in s.materials])
        share = _distinct(self.stiffness)
        air = spread(s.air_density, (self.num_worlds,), "air_density")
        across = s.body.thickness if s.body.kind == "rope" else 1.0
        matter = self.types.Matter()
        matter.mu = self.array(np.broadcast_to(lame[:, :1] * share, self.stiffness.shape))
        matter.lam = self.array(np.broadcast_to(lame[:, 1:] * share, self.stiffness.shape))
        matter.yield_stress = self.array(np.minimum([m.yield_stress for m in s.materials], 1e30))
        matter.mass = self.array(np.array([m.density for m in s.materials]) * s.body.volume)
        matter.damping = self.array(np.array([m.damping for m in s.materials]))
        self.drag_by_air = 0.5 * DRAG.get(s.body.kind, 0.0) * across / s.body.section
        matter.drag = self.array(self.drag_by_air * air)
        matter.volume = s.body.volume
        matter.sheet = int(s.body.kind == "cloth")
        matter.section = s.body.section
        matter.contact_radius = s.body.contact_radius
        matter.lattice = self.array(s.body.lattice, wp.int32)
        matter.rest_frame = self.array(s.body.rest_frames, self.types.mat33)
        matter.frame = self.array(_triangles(s.body.rest_frames))
        alone = (s.body.lattice == np.arange(len(s.body.x))[:, None, None]).any(axis=2)
        matter.per_span = self.array(np.where(alone, 1.0, 0.5).T[:2])
        return matter

    def _scene(self) -> Any:
        s, k, W = self.setting, self.types, self.num_worlds
        friction = s.table.friction if s.table is not None else 0.0
        scene = k.Scene()
        scene.dx = s.body.dx
        scene.gravity = self.array(spread(s.gravity, (W, 3), "gravity"), k.vec3)
        scene.velocity_damping = self.array(spread(s.velocity_damping, (W,), "velocity_damping"))
        scene.friction = self.array(spread(friction, (W,), "friction"))
        scene.table = int(s.table is not None)
        scene.walls = int(s.box is not None)
        if s.box is not None:
            scene.box_lower = k.vec3(*(s.box.lower - self.origin))
            scene.box_upper = k.vec3(*(s.box.upper - self.origin))
        return scene

    def _paths(self) -> Any:
        stacked = self.setting.grippers.arrays
        paths = self.types.Paths()
        paths.time = self.array(stacked["time"], wp.float64)
        paths.position = self.array(stacked["position"] - self.origin, wp.vec3d)
        paths.orientation = self.array(stacked["orientation"], wp.quatd)
        paths.turn = self.array(stacked["turn"], wp.vec3d)
        paths.turns = self.array(stacked["turns"], wp.int32)
        paths.hold_from = self.array(stacked["hold_from"], wp.float64)
        paths.hold_until = self.array(stacked["hold_until"], wp.float64)
        paths.radius = self.array(stacked["radius"])
        paths.may_miss = self.array(stacked["may_miss"], wp.int32)
        return paths

    def _grips(self) -> Any:
        W, G, N = self.num_worlds, len(self.setting.grippers[0]), self.num_particles
        grips = self.types.Grips()
        self.place_grippers(grips, W)
        grips.since = wp.full((W, G), -1, dtype=wp.int32, device=self.device)
        grips.until = wp.full((W, G), -1, dtype=wp.int32, device=self.device)
        grips.count = self.zeros((W, G), wp.int32)
        grips.particle = self.zeros((W, G, N), wp.int32)
        grips.weight = self.zeros((W, G, N), self.real)
        grips.place = self.zeros((W, G, N), self.types.vec3)
        grips.free = wp.full((W, N), 1.0, dtype=self.real, device=self.device)
        grips.held_by = self.zeros((W, N), wp.int32)
        return grips

    def place_grippers(self, grips: Any, rows: int) -> None:
        """Allocate the poses of all grippers for ``rows`` times."""
        shape = (rows, len(self.setting.grippers[0]))
        grips.closed = self.zeros(shape, wp.int32)
        for name in ("centre", "velocity", "spin"):
            setattr(grips, name, self.zeros(shape, self.types.vec3))
        grips.orientation = self.zeros(shape, self.types.mat33)

    def _clock(self) -> Any:
        W = self.num_worlds
        clock = self.types.Clock()
        clock.dt = self.zeros(W, wp.float64)
        clock.travel = self.zeros(W, self.real)
        for name in set(CLOCK) - {"dt", "travel"}:
            setattr(clock, name, self.zeros(W, wp.int32))
        return clock

    def make_state(self, rows: int, make: Any = wp.empty) -> Any:
        """Room for states, as ``carried`` names them; all have the worlds' own ``low``."""
        N, k = self.num_particles, self.types
        kinds = {"x": k.vec3, "v": k.vec3, "C": k.mat33, "G": k.mat33, "Z": k.real}
        state = k.State()
        state.low = self.low
        for name, dtype in kinds.items():
            have = rows if name in self.carried else 0
            shape = (have, 6, N) if name == "Z" else (have, N)
            setattr(state, name, make(shape, dtype=dtype, device=self.device))
        return state

    @property
    def state_bytes(self) -> int:
        """Size of one world's state [bytes]."""
        numbers = {"x": 3, "v": 3, "C": 9, "Z": 6, "G": 9}
        return (
            sum(map(numbers.__getitem__, self.carried))
            * self.num_particles
            * self.numpy_type.itemsize
        )

    def deformation_at(self, x: NDArray[np.floating]) -> NDArray[np.floating]:
        """[..., N, 3, 3] deformation gradients F of particles at [..., N, 3] [-]."""
        body = self.setting.body
        x = x.astype(float)
        first, second = body.lattice[:, :, 0], body.lattice[:, :, 1]
        return np.swapaxes(x[..., second, :] - x[..., first, :], -1, -2) @ body.rest_frames

    def make_grid(self, layouts: int, *, rows: int | None = None, make: Any = wp.zeros) -> Grid:
        """A grid with the room that worlds are known to need."""
        return make_grid(self.room, layouts, self.types.vec4, self.device, rows=rows, make=make)

    def make_room(self, grid: Grid, layouts: int | None = None) -> None:
        """Let later grids hold what did not fit into the (first) layouts of this one.

        Raises:
            GridExhausted: If no real object needs so much.
        """
        self.room = grown_room(self.room, grid.layouts.bounds.numpy()[:layouts], grid)

    def divide(self, w: int | slice, interval: float) -> tuple[Any, Any]:
        """Number and length [s] of a frame's equal substeps, no longer than each world's limit."""
        substep = self.substep[w]
        if not interval > 0.0:
            return 0 * substep.astype(np.int32), 0.0 * substep
        n = np.maximum(1, np.ceil(interval / substep - 1e-9)).astype(np.int32)
        return n, interval / n

    def failure(self, w: int, frame_start: float) -> SimulationError:
        """Return the error of world w, which has failed."""
        clock = self.clock
        status = clock.status.numpy()[w]
        time = frame_start + float(clock.step.numpy()[w]) * float(clock.dt.numpy()[w])
        found = int(clock.failed_particle.numpy()[w])
        if status == NOTHING_HELD:
            return self.setting.error(
                w,
                time,
                f"gripper {found} closed on nothing",
                where=f"radius {self.setting.grippers[w][found].radius:.4g} m",
                fix="move its path to the object, or give it may_miss=True",
                particle=None,
            )
        inverted = status == INVERTED
        return self.setting.error(
            w,
            time,
            "a particle turned inside out"
            if inverted
            else "velocities grew beyond one cell a substep",
            where=f"substep {clock.dt.numpy()[w]:.3g} s",
            fix="use a smaller substep or cfl, or slower gripper motion",
            particle=found if inverted else None,
        )

    def array(self, values: Any, dtype: Any = None) -> wp.array:
        """An array on the device, of the simulation's scalar type unless told otherwise.

        Numbers that a broadcast array repeats are repeated on the device.
        """
        dtype = dtype or self.real
        values = np.asarray(values)
        axes = values.ndim - len(getattr(dtype, "_shape_", ()))
        distinct = _distinct(values, axes)
        sent = wp.array(np.ascontiguousarray(distinct), dtype=dtype, device=self.device)
        if distinct.shape == values.shape:
            return sent
        shape = values.shape[:axes]
        strides = tuple(
            0 if few < many else int(step or 0)
            for few, many, step in zip(sent.shape, shape, sent.strides, strict=True)
        )
        repeated = wp.array(
            ptr=sent.ptr, shape=shape, strides=strides, dtype=dtype, device=self.device
        )
        full = wp.empty(shape, dtype=dtype, device=self.device)
        wp.copy(full, repeated)
        return full

    def zeros(self, shape: Any, dtype: Any) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=self.device)


def _triangles(frames: NDArray[np.floating]) -> NDArray[np.floating]:
    """[6, N] upper triangles U, row by row, of the frames R = U Q [N, 3, 3] with a rotation Q."""
    _, inverse = np.linalg.qr(np.linalg.inv(frames))
    U = np.linalg.inv(inverse)
    U = U * np.sign(np.diagonal(U, axis1=1, axis2=2))[:, None]
    rows, columns = np.triu_indices(3)
    return U[:, rows, columns].T


def _distinct(values: NDArray[Any], axes: int | None = None) -> NDArray[Any]:
    """The array without what broadcasting repeats along its first axes, which have length 1."""
    if values.size == 0:
        return values
    steps = values.strides[:axes]
    return values[tuple(slice(0, 1) if step == 0 else slice(None) for step in steps)]
