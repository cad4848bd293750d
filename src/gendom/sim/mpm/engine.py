"""Engine of ``Simulator`` for the material point method: W worlds on a device, and their runs."""

# pyright: basic

from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from gendom.arrays import Array
from gendom.errors import SimulationError
from gendom.materials import Material
from gendom.sim.device import load_kernels
from gendom.sim.engine import Engine
from gendom.sim.mpm.block import ROOM_ALONE, ROOMS_OF_TWO
from gendom.sim.mpm.boundary import grip_constants
from gendom.sim.mpm.grid import grown_room, room_for
from gendom.sim.mpm.gripped import AHEAD
from gendom.sim.mpm.kernels import make_advance
from gendom.sim.mpm.particles import Variant
from gendom.sim.mpm.types import DIVERGED, GRID_FULL, INVERTED, NOTHING_HELD, OK, make_types
from gendom.sim.paths import paths_on
from gendom.sim.setting import DRAG, Frames, Setting, spread

CFL = 0.6
"""Default share of the time in which a pressure wave crosses one cell."""

SHORTEST_SUBSTEP = 1e-6
"""Below, a second takes hours, and float32 does not resolve motion [s]."""

MANY_WORLDS = 132
"""Above, two blocks share a multiprocessor, which wants them small."""

LARGE_BODY = 2048
"""Particles above which blocks are wide however many there are."""

WIDE = 256
"""Threads of a block that has a multiprocessor to itself."""

NARROW = 128
"""Threads of one of two blocks that share one; more leave too few registers for each."""

SUBSTEPS_A_SLICE = 128
"""Of a world in one launch."""

SLICES = 16
"""Launches on CUDA between two looks at how the worlds do."""

REBUILD = 1e30
"""Distance travelled [m] after which every world rebuilds its grid."""


class MpmEngine(Engine):
    """W worlds of material points.

    Raises:
        ParameterError: If arguments do not fit together.
    """

    def __init__(self, setting: Setting, *, substep: float | None, cfl: float | None):
        super().__init__(setting)
        s, W, N = setting, self.num_worlds, setting.body.num_particles
        self.num_points = N
        self.stiffness = spread(s.variation.stiffness, (W, N), "stiffness")
        limits = np.array([stable_substep(m, s.body.dx, cfl=cfl or CFL) for m in s.materials])
        limits = np.full(W, substep) if substep else limits / np.sqrt(self.stiffness.max(axis=1))
        self.setting = replace(s, substep=limits)
        self.setting.check_substep(
            SHORTEST_SUBSTEP,
            fix="a softer or denser material, larger cells, a longer substep, or engine='thin'",
        )
        self.types = make_types(self.real)
        self.damped = any(m.damping > 0.0 for m in s.materials)
        x = self.first_positions(N)
        self.room = room_for(x, s.body.dx)
        """Columns of a grid in x and y, and its nodes."""
        self.device_model = self._model()
        self.paths = paths_on(s.device, self.stacked, self.real)
        self.grips = self._grips()
        self.clock = self.allocate(self.types.Clock, **dict.fromkeys(self.types.Clock.vars, W))
        self.carried = ("x", "v", "C", *("Z",) * self.damped)
        self.low = self.zeros((W, N) if s.dtype == "float32" else (0, 0), self.types.vec3)
        self.state = self.make_state()
        wp.copy(self.state.x, self.array(x, self.types.vec3))
        self.together = s.device.is_cuda
        """Whether one launch runs all worlds; tests set it on the CPU."""
        self.particles: Any = None
        """Records of all worlds."""
        self.unsorted = self.zeros(W)
        """[W] distance travelled since records were sorted [m]."""

    # ---- state -----------------------------------------------------------------------------------

    def positions(self) -> Array:
        return self.state.x.numpy() + self.origin.astype(self.setting.dtype)

    def velocities(self) -> Array:
        return np.array(self.state.v.numpy())

    def set_velocities(self, v: ArrayLike, affine: ArrayLike) -> None:
        shape, dtype = (self.num_worlds, self.num_points, 3), self.setting.dtype
        C = spread(affine, (*shape, 3), "affine velocities")
        self.state.v.assign(spread(v, shape, "velocities").astype(dtype))
        self.state.C.assign(C.astype(dtype))

    # ---- running ---------------------------------------------------------------------------------

    def run(self, frames: Frames) -> None:
        """Simulate all worlds to all times.

        Raises:
            SimulationError: If a world diverges, unless told to keep going.
        """
        self.load(make_advance(self.variant, taped=False))
        failed_before = set(self.failures)
        plan = self.plan(frames.began, frames.times, frames.particles)
        self.in_threads(partial(Group.run, plan=plan, keep_going=frames.keep_going), self.groups())
        frames.x[...] = plan.x.numpy() + self.origin.astype(self.setting.dtype)
        frame = self.clock.frame.numpy()
        for w in self.failures:
            frames.x[0 if w in failed_before else frame[w] :, w] = np.nan
        if frames.on_frame is not None:
            frames.on_frame(len(frames.times))
        self.raise_failures(keep_going=frames.keep_going)

    def groups(self) -> list["Group"]:
        """The groups of worlds, the slowest first; what they share is made before threads take
        them."""
        if self.particles is None:
            self.particles = self.records(moduli=(self.num_worlds, 2, self.num_points))
            if not self.together:
                near = self.setting.body.lattice.transpose(2, 1, 0).reshape(1, 6, -1)
                near = np.repeat(near, self.num_worlds, axis=0)
                self.particles.near = self.array(near, wp.int32)
        if self.together:
            return [Group(self, slice(0, self.num_worlds))]
        return [Group(self, slice(w, w + 1)) for w in np.argsort(self.setting.substep).tolist()]

    def plan(self, began: float, times: Array, particles: Any) -> Any:
        """Set all worlds to go from ``began`` to each of the times [T] [s], at each of which the
        positions of the particles [P] are recorded, a ``FramePlan``."""
        s, T, W = self.setting, len(times), self.num_worlds
        time = np.concatenate([[began], times])
        span = np.diff(time)[:, None]
        steps = np.maximum(1, np.ceil(span / s.substep - 1e-9)).astype(np.int32)
        steps = np.where(span > 0.0, steps, 0)
        dt, FramePlan = span / np.maximum(1, steps), self.types.FramePlan
        plan = self.filled(FramePlan, time=time, steps=steps, dt=dt, particles=particles)
        plan.x = wp.empty((T, W, len(particles)), dtype=self.types.vec3, device=s.device)
        frame = np.zeros(W, dtype=np.int32)
        frame[list(self.failures)] = T  # worlds that failed are through
        self.clock.frame.assign(frame)
        self.clock.dt.assign(dt[0])
        self.clock.step.zero_()
        self.clock.status.zero_()
        self.used = True
        return plan

    def failure(self, w: int, frame_start: float) -> SimulationError:
        """Return the error of world w, which has failed."""
        status, step, dt, found = (
            getattr(self.clock, name).numpy()[w].item()
            for name in ("status", "step", "dt", "failed_particle")
        )
        error = partial(self.setting.error, w, frame_start + step * dt)
        if status == NOTHING_HELD:
            return error(
                f"gripper {found} closed on nothing",
                where=f"radius {self.stacked['radius'][w, found]:.4g} m",
                fix="move its path to the object",
            )
        inverted = status == INVERTED
        fast = "velocities grew beyond one cell a substep"
        return error(
            "a particle turned inside out" if inverted else fast,
            where=f"substep {dt:.3g} s",
            fix="use a smaller substep or cfl, or slower gripper motion",
            particle=found if inverted else None,
        )

    # ---- what kernels are compiled for, and what they share --------------------------------------

    @cached_property
    def variant(self) -> Variant:
        """What kernels are compiled for."""
        if not self.setting.device.is_cuda:
            return Variant(self.real, self.damped, self.together)
        crowded = self.num_worlds > MANY_WORLDS and self.num_points <= LARGE_BODY
        one = Variant(self.real, self.damped, self.together)
        taken = one.components * self.num_points * np.dtype(self.setting.dtype).itemsize
        most = self.setting.device.max_shared_memory_per_block
        rooms = [of for of in ROOMS_OF_TWO if 2 * of <= most] + [ROOM_ALONE] * (ROOM_ALONE <= most)
        room = next((of for of in rooms if taken <= of), 0)
        threads = NARROW if crowded and room != ROOM_ALONE else WIDE
        return replace(one, room=room, threads=threads)

    def records(self, **more: tuple[int, int, int]) -> Any:
        """Room for records of all worlds, with an array [W, n, N] more, and for reordering them."""
        W, N, variant = self.num_worlds, self.num_points, self.variant
        ((_, n, _),), reordered = more.values(), W * variant.sorts
        return self.allocate(
            self.types.Records,
            of=(1 if variant.room else W, variant.components, N),
            near=(W, 6, N),
            **dict.fromkeys(("order", "place"), (W, N)),
            spare=(reordered, variant.components + n, N),
            spare_order=(reordered, N),
            **more,
        )

    def load(self, kernel: Any) -> None:
        """Compile a kernel, or load it from Warp's cache, before threads call it."""
        load_kernels(kernel.module, self.setting.device, self.variant.threads)

    # ---- arrays ----------------------------------------------------------------------------------

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
        (W, G), N = self.stacked["radius"].shape, self.num_points
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
        grips.since = wp.full((W, G), -1, dtype=wp.int32, device=self.setting.device)
        grips.until = wp.full((W, G), -1, dtype=wp.int32, device=self.setting.device)
        grips.free = wp.full((W, N), 1.0, dtype=self.real, device=self.setting.device)
        return grips

    def make_state(self) -> Any:
        """States at zero, as ``carried`` names them; all have the worlds' own ``low``."""
        W, N, State = self.num_worlds, self.num_points, self.types.State
        have = {name: (W if name in self.carried else 0, N) for name in ("x", "v", "C", "Z")}
        state = self.allocate(State, **have)
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


class Group:
    """Worlds that share a grid and advance by themselves.

    On the CPU every world is a group, and threads take the groups in turn. On CUDA all worlds are
    one group, with a block of threads for each world.
    """

    def __init__(self, engine: "MpmEngine", worlds: slice):
        self.engine, self.worlds, self.count = engine, worlds, worlds.stop - worlds.start
        slowest = worlds.start + np.argsort(engine.setting.substep[worlds])
        self.order = engine.array(slowest, wp.int32)
        """[n] the worlds, the slowest first."""

    def begin(self) -> None:
        """Make a grid, which the worlds will build first."""
        self.grid = self.engine.make_grid(self.count, self.count, self.count)
        self.set_clock(travel=REBUILD)

    def set_clock(self, **values: Any) -> None:
        """Set these worlds' numbers of arrays of the clock."""
        for name, value in values.items():
            getattr(self.engine.clock, name)[self.worlds].assign(np.full(self.count, value))

    def read(self, name: str) -> Array:
        """[n] a copy of an array of these worlds' clock."""
        return np.array(getattr(self.engine.clock, name).numpy()[self.worlds])

    def run(self, plan: Any, *, keep_going: bool) -> None:
        """Take the worlds through all frames, or until one fails that is not to be left behind."""
        self.begin()
        more, launches = True, SLICES if self.engine.setting.device.is_cuda else 1
        while more:
            for _ in range(launches):
                self.advance(plan, SUBSTEPS_A_SLICE, plan.steps.shape[0], self.grid)
            more = self.look(plan, keep_going=keep_going)
        del self.grid

    def advance(self, plan: Any, most: int, frames: int, grid: Any, tape: Any = None) -> None:
        """Take the worlds further, by ``most`` substeps at most, through the first ``frames`` of
        the plan; a ``tape`` keeps everything that the reverse needs."""
        s = self.engine
        self.launch(make_advance(s.variant, taped=tape is not None), [
            most, frames, plan, s.clock, s.unsorted, s.device_model, s.paths, s.grips,
            s.state, grid, s.particles, s.types.Records() if tape is None else tape,
        ])  # fmt: skip

    def launch(self, kernel: Any, inputs: list[Any]) -> None:
        """Launch a block for each of the worlds."""
        threads = self.engine.variant.threads
        wp.launch(
            kernel,
            dim=(self.count, threads),
            inputs=[self.order, threads, self.count, *inputs],
            device=self.engine.setting.device,
            block_dim=threads,
        )

    def look(self, plan: Any, *, keep_going: bool) -> bool:
        """See to worlds that found no room or failed; return whether there is more to do."""
        s, last = self.engine, plan.steps.shape[0] - 1
        status, frame = self.read("status"), self.read("frame")
        full = status == GRID_FULL
        if full.any():
            diverged = s.make_room(self.grid, np.flatnonzero(full))
            status[full] = np.where(diverged, DIVERGED, OK)
            self.set_clock(status=status)
            self.begin()
        for n in np.flatnonzero(status != OK).tolist():
            w = self.worlds.start + n
            if w not in s.failures:
                began = float(plan.time.numpy()[min(frame[n], last)])
                s.failures[w] = s.failure(w, began)
        going = (status == OK) & (frame <= last)
        return bool(going.any()) and (keep_going or not s.failures)


def stable_substep(material: Material, dx: float, *, cfl: float = CFL) -> float:
    """Longest substep [s] at a share ``cfl`` of the Courant limit dx / wave speed.

    The wave speed is that of small strains; ``CFL`` leaves room for stiffening under compression.
    Source: Courant, Friedrichs and Lewy (1928).
    """
    return cfl * dx / material.wave_speed


def _triangles(frames: Array) -> Array:
    """[6, N] upper triangles U, row by row, of the frames R = U Q [N, 3, 3] with a rotation Q."""
    _, inverse = np.linalg.qr(np.linalg.inv(frames))
    U = np.linalg.inv(inverse)
    U = U * np.sign(np.diagonal(U, axis1=1, axis2=2))[:, None]
    rows, columns = np.triu_indices(3)
    return U[:, rows, columns].T
