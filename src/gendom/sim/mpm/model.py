"""W worlds on a device: their parameters, state and clocks."""

# pyright: basic

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.arrays import Array
from gendom.errors import SimulationError
from gendom.sim.mpm.boundary import grip_constants
from gendom.sim.mpm.grid import grown_room, room_for
from gendom.sim.mpm.gripped import AHEAD
from gendom.sim.mpm.step import INVERTED, NOTHING_HELD
from gendom.sim.mpm.types import make_types
from gendom.sim.paths import paths_on
from gendom.sim.setting import DRAG, Setting, spread


class Worlds:
    """Arrays of W worlds of one body, in the form required by kernels.

    Raises:
        ParameterError: If shapes do not fit.
    """

    def __init__(self, setting: Setting):
        s = setting
        self.setting = s
        self.device = s.device
        self.substep = s.substep
        self.numpy_type = np.dtype(s.dtype)
        self.real = wp.float32 if s.dtype == "float32" else wp.float64
        self.types = make_types(self.real)
        self.damped = any(m.damping > 0.0 for m in s.materials)
        W, N = len(s.materials), s.body.num_particles
        self.num_worlds, self.num_particles = W, N
        self.stiffness = spread(s.stiffness, (W, N), "stiffness")
        # heights are counted from the table: near 0 float32 resolves what presses on it
        self.origin = np.array([0.0, 0.0, s.table.height if s.table is not None else 0.0])
        x = spread(np.asarray(s.positions, dtype=float) - self.origin, (W, N, 3), "positions")
        self.room = room_for(x, s.body.dx)
        self.device_model = self._model()
        stacked = s.grippers.arrays
        position = stacked["position"] - self.origin
        self.paths = paths_on(s.device, {**stacked, "position": position}, self.real)
        self.grips = self._grips()
        self.clock = self.allocate(self.types.Clock, **dict.fromkeys(self.types.Clock.vars, W))
        self.carried = ("x", "v", "C", *("Z",) * self.damped)
        self.low = self.zeros((W, N) if s.dtype == "float32" else (0, 0), self.types.vec3)
        self.state = self.make_state()
        wp.copy(self.state.x, self.array(x, self.types.vec3))
        self.failures: dict[int, SimulationError] = {}

    def _model(self) -> Any:
        s, W = self.setting, self.num_worlds
        lame = np.array([m.lame_of(s.body.lateral_constraint) for m in s.materials])
        air = spread(s.air_density, (W,), "air_density")
        across = s.body.thickness if s.body.kind == "rope" else 1.0
        self.drag_by_air = 0.5 * DRAG.get(s.body.kind, 0.0) * across / s.body.section
        beyond, grip_stiffness = grip_constants(s.body)
        return self.filled(
            self.types.Model,
            mu=lame[:, :1] * self.stiffness,
            lam=lame[:, 1:] * self.stiffness,
            mass=np.array([m.density for m in s.materials]) * s.body.volume,
            damping=np.array([m.damping for m in s.materials]),
            drag=self.drag_by_air * air,
            volume=s.body.volume,
            sheet=int(s.body.kind == "cloth"),
            section=s.body.section,
            beyond=beyond,
            grip_stiffness=grip_stiffness,
            contact_radius=s.body.contact_radius,
            lattice=s.body.lattice,
            frame=_triangles(s.body.rest_frames),
            dx=s.body.dx,
            gravity=spread(s.gravity, (W, 3), "gravity"),
            velocity_damping=spread(s.velocity_damping, (W,), "velocity_damping"),
            table=int(s.table is not None),
            friction=spread(s.table.friction if s.table else 0.0, (W,), "friction"),
        )

    def _grips(self) -> Any:
        W, G, N = self.num_worlds, len(self.setting.grippers[0]), self.num_particles
        lists = dict.fromkeys(("particle", "weight", "place"), (W, G, N))
        listed = [name for name in self.types.Grips.vars if name.startswith("held_")]
        poses = ("closed", "centre", "orientation", "velocity", "spin")
        grips = self.allocate(
            self.types.Grips,
            count=(W, G),
            held=W,
            **dict.fromkeys((*listed, "stored_free", "driven"), (W, N)),
            **lists,
            **dict.fromkeys(poses, (AHEAD * W, G)),
        )
        grips.since = wp.full((W, G), -1, dtype=wp.int32, device=self.device)
        grips.until = wp.full((W, G), -1, dtype=wp.int32, device=self.device)
        grips.free = wp.full((W, N), 1.0, dtype=self.real, device=self.device)
        return grips

    def make_state(self) -> Any:
        """States at zero, as ``carried`` names them; all have the worlds' own ``low``."""
        W, N, State = self.num_worlds, self.num_particles, self.types.State
        have = {name: W if name in self.carried else 0 for name in ("x", "v", "C", "Z")}
        shapes = {name: (n, 6, N) if name == "Z" else (n, N) for name, n in have.items()}
        state = self.allocate(State, **shapes)
        state.low = self.low
        return state

    def make_grid(self, worlds: int, layouts: int, rows: int, make: Any = wp.zeros) -> Any:
        """A grid with the room that worlds are known to need: so many layouts, and so many rows of
        momentum, which ``make`` fills."""
        X, Y, M = self.room
        grid = self.allocate(
            self.types.Grid,
            make,
            bounds=(layouts, 4),
            count=layouts,
            momentum=(rows, M),
            **dict.fromkeys(("low", "high", "start"), (layouts, X, Y)),
        )
        grid.velocity = self.zeros((worlds, M), self.types.vec4)
        grid.tally = self.zeros((worlds, M), wp.int32)
        return grid

    def make_room(self, grid: Any, layouts: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Let later grids hold what did not fit into the given layouts of this one.

        Returns:
            [len(layouts)] whether no real object needs so much: the world has diverged.
        """
        bounds = grid.bounds.numpy()
        exhausted = np.zeros(len(layouts), dtype=bool)
        for n, layout in enumerate(layouts):
            room = grown_room(self.room, bounds[layout], grid)
            exhausted[n] = room is None
            self.room = room or self.room
        return exhausted

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
                fix="move its path to the object",
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
        """An array on the device, of the simulation's scalar type unless told otherwise."""
        return wp.array(np.ascontiguousarray(values), dtype=dtype or self.real, device=self.device)

    def filled(self, struct: Any, **values: Any) -> Any:
        """A struct of these numbers and arrays."""
        made = struct()
        for name, value in values.items():
            kind = struct.vars[name].type
            is_array = isinstance(kind, wp.array)
            setattr(made, name, self.array(value, kind.dtype) if is_array else value)
        return made

    def allocate(self, struct: Any, make: Any = wp.zeros, **shapes: Any) -> Any:
        """A struct of arrays of these shapes; ``make`` fills them."""
        made = struct()
        for name, shape in shapes.items():
            dtype = struct.vars[name].type.dtype
            setattr(made, name, make(shape, dtype=dtype, device=self.device))
        return made

    def zeros(self, shape: Any, dtype: Any) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=self.device)


def _triangles(frames: Array) -> Array:
    """[6, N] upper triangles U, row by row, of the frames R = U Q [N, 3, 3] with a rotation Q."""
    _, inverse = np.linalg.qr(np.linalg.inv(frames))
    U = np.linalg.inv(inverse)
    U = U * np.sign(np.diagonal(U, axis1=1, axis2=2))[:, None]
    rows, columns = np.triu_indices(3)
    return U[:, rows, columns].T
