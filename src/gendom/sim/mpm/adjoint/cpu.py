"""What the CPU keeps of a simulation to reverse it: each world by itself, on its own thread."""

import functools
import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.mpm.adjoint.sums import Sums, Trouble
from gendom.sim.mpm.engine import MpmEngine
from gendom.sim.mpm.grid import SparseGrid
from gendom.sim.mpm.model import REBUILD, Worlds
from gendom.sim.mpm.native import MODULE_OPTIONS
from gendom.sim.mpm.runners.cpu import Threads, load
from gendom.sim.mpm.step import GRID_FULL, NOT_FINITE, OK, make_step
from gendom.sim.mpm.types import make_types

STRETCH = 64
"""Substeps that are recorded, and reversed, at a time."""


@functools.cache
def make_reverse(real: Any, law_name: str, *, yields: bool) -> Any:
    """Build the kernel that reverses a recorded stretch of one world, see ``step.make_stages``."""
    types = make_types(real)
    Nodes, Pulls, Vectors = types.Nodes, types.Pulls, types.Vectors
    substep_adjoint = make_step(real, law_name, yields=yields).substep_adjoint

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def reverse(
        w: int,
        slots: int,  # substeps to reverse
        begun: int,  # number in its frame of the first recorded substep
        age: int,  # substeps before it in all
        time: wp.float64,  # [s] at substep 0 of the frame
        dt: wp.float64,  # [s]
        matter: types.Matter,
        scene: types.Scene,
        paths: types.Paths,
        grips: types.Grips,  # [W]
        pulls: Pulls,  # [W, N] scratch
        touched: Vectors,  # [W, sections] scratch
        # the recording
        state: types.State,  # [S + 1, N]
        grid: SparseGrid,  # S layouts
        layout_of: wp.array(dtype=wp.int32),  # [S]
        momentum: Nodes,  # [S, M]
        # scratch
        velocity: Nodes,  # [1, M]
        nodes_bar: Nodes,  # [1, M]
        # by the state: of the last row on entry, of the first on return
        bars: types.MatterBars,
        scene_bars: types.SceneBars,
        trouble: Trouble,
    ):
        status = int(OK)
        slot = int(slots - 1)
        while slot >= 0 and status == OK:
            failed = substep_adjoint(
                w, time + wp.float64(begun + slot) * dt, dt, age + slot, slot, layout_of[slot],
                slot,
                matter, scene, paths, grips, pulls, touched, state, grid, momentum, velocity,
                nodes_bar, bars, scene_bars,
            )  # fmt: skip
            if failed >= 0:
                status = NOT_FINITE
                trouble.failed_particle[w] = failed
                trouble.slot[w] = slot
            slot -= 1
        trouble.status[w] = status

    return reverse


class WorldTape:
    """Stretches of every world, recorded, or their first states from which they are run again.

    Args:
        simulator: Not run before, on the CPU.
        memory: Bound on what is kept [bytes].
    """

    def __init__(self, simulator: MpmEngine, memory: float):
        self.simulator = simulator
        self.memory = memory
        self._threads = Threads(simulator.worlds, simulator.threads)
        self._stretches: list[list[_Stretch]] = []
        worlds = simulator.worlds
        for yields in np.unique(worlds.yields):
            reverse = make_reverse(worlds.real, "neo-hookean", yields=bool(yields))
            load(reverse, worlds.device)

    def forward(self, times: NDArray[np.float64]) -> NDArray[np.floating]:
        """Positions [T, W, N, 3] at the times [m].

        Raises:
            SimulationError: If a world diverges.
        """
        s, threads = self.simulator, self._threads
        worlds = s.worlds
        self._stretches = [_plan(worlds, w, s.time, times) for w in range(s.num_worlds)]
        substeps = sum(stretch.substeps for world in self._stretches for stretch in world)
        keeps_all = substeps * _Recording.bytes_a_substep(worlds) <= self.memory
        frames = np.empty((len(times), s.num_worlds, s.body.num_particles, 3), dtype=s.dtype)

        def one_world(w: int) -> None:
            grid = worlds.make_grid(1)
            for stretch in self._stretches[w]:
                begin = {name: view[w].copy() for name, view in threads.state.items()}
                begin["low"] = threads.low[w : w + 1].copy()  # none in float64
                if not stretch.substeps:
                    pass
                elif keeps_all:
                    stretch.recording = self._record(w, stretch, begin)
                    for name in worlds.carried:
                        rows = getattr(stretch.recording.rows, name).numpy()
                        threads.state[name][w] = rows[stretch.substeps]
                else:
                    stretch.begin = begin
                    self._begin(w, stretch)
                    grid = threads.advance(w, stretch.time, grid)
                if stretch.ends_frame >= 0:
                    frames[stretch.ends_frame, w] = threads.state["x"][w]

        threads.for_worlds(one_world)
        return frames

    def backward(self, bar: NDArray[np.floating], sums: Sums) -> None:
        """Carry derivatives [T, W, N, 3] by the positions back to the first state.

        Raises:
            SimulationError: If a derivative is not finite.
        """

        def one_world(w: int) -> None:
            spare: _Recording | None = None
            for stretch in reversed(self._stretches[w]):
                if stretch.ends_frame >= 0:
                    sums.add_positions(w, bar[stretch.ends_frame, w])
                if stretch.substeps:
                    recording = stretch.recording
                    if recording is None:
                        assert stretch.begin is not None  # kept by forward
                        recording = spare = self._record(w, stretch, stretch.begin, spare)
                    self._reverse(w, stretch, recording, sums)

        self._threads.for_worlds(one_world)

    def _begin(self, w: int, stretch: "_Stretch") -> None:
        """Set world w's clock to the stretch; its grid is rebuilt first."""
        until = stretch.begun + stretch.substeps
        self._threads.plan(w, begun=stretch.begun, steps=until, dt=stretch.dt)
        self._threads.hold_as_at(w, stretch.age)
        self._threads.clock["age"][w] = stretch.age
        self._threads.clock["travel"][w] = REBUILD

    def _record(
        self,
        w: int,
        stretch: "_Stretch",
        begin: dict[str, NDArray[Any]],
        spare: "_Recording | None" = None,
    ) -> "_Recording":
        """Run a stretch from its first state and keep everything its reverse needs.

        Into ``spare`` where that is long enough.
        """
        worlds = self.simulator.worlds
        recording = spare
        if recording is None or recording.slots < stretch.substeps:
            recording = _Recording(worlds, stretch.substeps)
        while True:
            grid, rows = recording.grid, recording.rows
            for name in worlds.carried:
                getattr(rows, name).numpy()[0] = begin[name]
            self._threads.low[w : w + 1] = begin["low"]
            self._begin(w, stretch)
            self._threads.launch(w, stretch.time, grid, rows, 0, 1, recording.velocity)
            status = self._threads.clock["status"][w]
            if status != GRID_FULL:
                break
            worlds.make_room(grid, layouts=1)
            recording = _Recording(worlds, stretch.substeps)
        if status != OK:
            raise worlds.failure(w, stretch.time)
        return recording

    def _reverse(self, w: int, stretch: "_Stretch", recording: "_Recording", sums: Sums) -> None:
        """Carry world w's derivatives from the end of a recorded stretch to its beginning."""
        s, grid = self.simulator.worlds, recording.grid
        wp.launch(
            make_reverse(s.real, "neo-hookean", yields=bool(s.yields[w])),
            dim=1,
            inputs=[
                w, stretch.substeps, stretch.begun, stretch.age, stretch.time, stretch.dt,
                s.matter, s.scene, s.paths, s.grips, s.pulls, s.touched, recording.rows,
                grid.layouts, grid.layout_of, grid.momentum,
                recording.velocity, s.zeros(recording.velocity.shape, s.types.vec4),
                sums.matter, sums.scene, sums.trouble,
            ],
            device=s.device,
        )  # fmt: skip
        if sums.trouble.status.numpy()[w] == NOT_FINITE:
            start = stretch.time, stretch.begun, stretch.age, stretch.dt
            x = recording.rows.x.numpy()
            raise sums.overflow(self.simulator, w, start, lambda slot, _w: x[slot])


@dataclass
class _Stretch:
    """Consecutive substeps of one world inside one frame."""

    time: float  # of the frame's substep 0 [s]
    dt: float  # [s]
    begun: int  # number in the frame of the first substep
    age: int  # substeps before it in all
    substeps: int
    ends_frame: int  # the frame that its last substep completes, or -1
    begin: dict[str, NDArray[Any]] | None = None
    recording: "_Recording | None" = None


def _plan(worlds: Worlds, w: int, began: float, times: NDArray[np.float64]) -> list[_Stretch]:
    """Cut a world's substeps into stretches that end with frames."""
    plan: list[_Stretch] = []
    now, age = began, 0
    for f, until in enumerate(times):
        n, dt = (value.item() for value in worlds.divide(w, until - now))
        cuts = [*range(0, n, STRETCH), n] if n else [0, 0]
        for a, b in itertools.pairwise(cuts):
            ends = f if b == n else -1
            plan.append(_Stretch(now, dt, a, age + a, b - a, ends))
        age += n
        now = float(until)
    return plan


class _Recording:
    """States, grids and layouts of consecutive substeps of one world."""

    def __init__(self, worlds: Worlds, slots: int):
        # nothing is read before it was written: memory that is never needed is never touched
        self.slots = slots
        pages = _Pages((slots + 1) * self.bytes_a_substep(worlds))
        self.grid = worlds.make_grid(slots, make=pages.take)
        self.rows = worlds.make_state(slots + 1, pages.take)
        self.velocity = worlds.zeros((1, self.grid.momentum.shape[1]), worlds.types.vec4)

    @staticmethod
    def bytes_a_substep(worlds: Worlds) -> int:
        X, Y, M = worlds.room
        real = worlds.numpy_type.itemsize
        return worlds.state_bytes + real * 4 * M + 4 * (3 * X * Y + 6)


class _Pages:
    """Memory for many arrays in one piece, for which the system may use large pages.

    To touch a page of 4 KB for the first time takes as long as to compute what is written to it.

    Args:
        size: Of all arrays together [bytes]; a little more is set aside.
    """

    ALIGNED = 64
    """Multiple at which each array begins [bytes]."""

    def __init__(self, size: int):
        # numpy asks the system for large pages
        self._memory = np.empty(size + (1 << 12), dtype=np.uint8)
        self._taken = 0

    def take(self, shape: int | tuple[int, ...], *, dtype: Any, device: Any) -> wp.array:
        """An array that is not filled."""
        shape = (shape,) if isinstance(shape, int) else shape
        inner = getattr(dtype, "_shape_", ())
        scalar = np.dtype(wp.dtype_to_numpy(getattr(dtype, "_wp_scalar_type_", dtype)))
        size = math.prod(shape + inner) * scalar.itemsize
        self._taken += -(self._memory.ctypes.data + self._taken) % self.ALIGNED
        piece = self._memory[self._taken : self._taken + size]
        self._taken += size
        numbers = piece.view(scalar).reshape(shape + inner)
        return wp.array(numbers, dtype=dtype, device=device, copy=False)
