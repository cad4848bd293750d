"""Running on the CPU: each thread simulates one world from the first frame to the last."""

import functools
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

import numpy as np
import warp as wp

from gendom.errors import SimulationError
from gendom.sim.device import making
from gendom.sim.mpm.boundary import make_boundary
from gendom.sim.mpm.grid import MARGIN, Grid, GridExhausted, SparseGrid, make_rebuild_world
from gendom.sim.mpm.model import CLOCK, REBUILD, Worlds
from gendom.sim.mpm.native import MODULE_OPTIONS
from gendom.sim.mpm.particles import make_rows
from gendom.sim.mpm.step import (
    DIVERGED,
    GRID_FULL,
    INVERTED,
    NOTHING_HELD,
    OK,
    make_stages,
    make_step,
)
from gendom.sim.mpm.types import make_types
from gendom.sim.setting import Frames


@functools.cache
def make_advance(real: Any, law_name: str, *, yields: bool) -> Any:
    """Build the kernel that takes one world through many substeps, see ``step.make_stages``."""
    k = make_stages(real, law_name, yields=yields)
    types = k.types
    Nodes, Pulls, Vectors = types.Nodes, types.Pulls, types.Vectors
    substep = make_step(real, law_name, yields=yields).substep
    rebuild = make_rebuild_world(real, make_rows(real))

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def advance(
        w: int,
        time: wp.float64,  # [s] at substep 0
        clock: types.Clock,
        matter: types.Matter,
        scene: types.Scene,
        paths: types.Paths,
        grips: types.Grips,  # [W]
        pulls: Pulls,  # [W, N] scratch
        touched: Vectors,  # [W, sections] scratch
        # in rows: substep n of this call goes from row first + n * stride to the next; stride 0
        # works in place, 1 keeps every state, its grid and its layout for the reverse
        first: int,
        stride: int,
        state: types.State,
        # grid of this world alone
        grid: SparseGrid,
        layout_of: wp.array(dtype=wp.int32),  # [L] the layout of each substep of this call
        momentum: Nodes,  # [L, M] and mass
        velocity: Nodes,  # [1, M] and mass; may be ``momentum`` where stride is 0
    ):
        N = state.x.shape[1]
        dx = scene.dx
        dt = clock.dt[w]
        begun = clock.step[w]
        step = int(begun)
        age = clock.age[w]
        travel = clock.travel[w]
        status = int(OK)
        layout = layout_of[0]
        while step < clock.steps[w] and status == OK:
            slot = (step - begun) * stride
            row = first + slot
            if travel >= real(MARGIN) * dx:
                layout = slot
                fits = rebuild(row, 0, 1, N, layout, momentum.shape[1], real(1.0) / dx, state, grid)
                near = int(0)
                for p in range(N):
                    if k.boundary.near_table(state.x[row, p], matter, scene):
                        near = 1
                clock.near_table[w] = near
                if fits:
                    travel = real(0.0)
                else:
                    status = GRID_FULL
                    # the grid's need is read from the first layout
                    for a in range(4):
                        grid.bounds[0, a] = grid.bounds[layout, a]
            if status == OK:
                layout_of[slot] = layout
                fastest, status = substep(
                    w, time + wp.float64(step) * dt, dt, age, row, row + stride, layout, slot,
                    clock, matter, scene, paths, grips, pulls, touched, state, grid, momentum,
                    velocity,
                )  # fmt: skip
                if status != INVERTED and status != NOTHING_HELD:  # it could be done
                    travel += real(dt) * wp.sqrt(fastest)
                    step += 1
                    age += 1
        clock.step[w] = step
        clock.age[w] = age
        clock.travel[w] = travel
        clock.status[w] = status

    return advance


@functools.cache
def make_hold_as_at(real: Any) -> Any:
    """Build the kernel that lets a world's grippers hold what they held before a substep."""
    hold_world_as_at = make_boundary(real, make_rows(real)).hold_as_at
    types = make_types(real)

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def hold_as_at(w: int, age: int, grips: types.Grips):
        hold_world_as_at(w, age, grips)

    return hold_as_at


class Threads:
    """Runs worlds in parallel, each in one thread.

    Args:
        worlds: Worlds on the CPU.
        count: Number of worlds in parallel.
    """

    def __init__(self, worlds: Worlds, count: int):
        self.worlds = worlds
        self.count = count
        # on the CPU these share the arrays' memory
        self.clock = {name: getattr(worlds.clock, name).numpy() for name in CLOCK}
        self.state = {name: getattr(worlds.state, name).numpy() for name in worlds.carried}
        self.low = worlds.low.numpy()
        # kernels are made in one thread: Python's parser fails with concurrent ones
        real, law = worlds.real, "neo-hookean"
        for yields in np.unique(worlds.yields):
            load(make_advance(real, law, yields=bool(yields)), worlds.device)
        if worlds.grips.count.shape[1]:
            load(make_hold_as_at(real), worlds.device)

    def run(self, frames: Frames) -> None:
        """Simulate all worlds to all times.

        Raises:
            SimulationError: If a world diverges, unless ``keep_going`` is set.
        """
        worlds = self.worlds
        done = np.zeros(worlds.num_worlds, dtype=int)
        stop = False

        def one_world(w: int) -> None:
            grid = worlds.make_grid(1)
            self.clock["travel"][w] = REBUILD
            now = frames.began
            for f, until in enumerate(frames.times):
                if stop:
                    return
                worlds.last_good_time[w] = now
                for name in worlds.carried:
                    getattr(worlds.last_good, name).numpy()[w] = self.state[name][w]
                steps, dt = worlds.divide(w, until - now)
                self.plan(w, begun=0, steps=steps, dt=dt)
                if w not in worlds.failures:
                    try:
                        grid = self.advance(w, now, grid)
                    except SimulationError as error:
                        worlds.failures[w] = error
                if w in worlds.failures:
                    if not frames.keep_going:
                        return
                    frames.x[f:, w] = np.nan
                    done[w] = len(frames.times)
                    return
                now = until
                frames.x[f, w] = self.state["x"][w, frames.particles]
                done[w] = f + 1

        def report() -> None:
            nonlocal reported
            if frames.on_frame is not None and done.min() > reported:
                reported = int(done.min())
                frames.on_frame(reported)

        reported = 0
        with ThreadPoolExecutor(max_workers=self.count) as pool:
            jobs = self._submit(pool, one_world)
            try:
                while wait(jobs, timeout=0.05).not_done:
                    report()
            except BaseException:
                stop = True
                raise
        report()
        for job in jobs:
            job.result()
        if worlds.failures and not frames.keep_going:
            raise worlds.failures[min(worlds.failures)]

    def for_worlds(self, work: Callable[[int], None]) -> None:
        """Do the work for every world; the first failure is raised."""
        with ThreadPoolExecutor(max_workers=self.count) as pool:
            for job in self._submit(pool, work):
                job.result()

    def _submit(self, pool: ThreadPoolExecutor, work: Callable[[int], None]) -> list[Future[None]]:
        # start with the slowest worlds, to balance the load of threads
        return [pool.submit(work, int(w)) for w in np.argsort(self.worlds.substep)]

    def plan(self, w: int, *, begun: int, steps: int, dt: float) -> None:
        """Set world w's clock: a frame's substeps from ``begun`` until ``steps`` are to be done."""
        clock = self.clock
        clock["step"][w], clock["steps"][w], clock["dt"][w] = begun, steps, dt
        clock["status"][w] = OK

    def hold_as_at(self, w: int, age: int) -> None:
        """Restore what world w's grippers held before its substep ``age``."""
        grips = self.worlds.grips
        if grips.count.shape[1]:
            kernel = make_hold_as_at(self.worlds.real)
            wp.launch(kernel, dim=1, inputs=[w, age, grips], device=self.worlds.device)

    def advance(self, w: int, now: float, grid: Grid) -> Grid:
        """Run world w's planned substeps; return the grid, which is larger if it had to grow.

        Raises:
            SimulationError: If the world diverges.
        """
        clock, worlds = self.clock, self.worlds
        while clock["step"][w] < clock["steps"][w]:
            self.launch(w, now, grid, worlds.state, w, 0, grid.momentum)
            status = clock["status"][w]
            if status == GRID_FULL:
                try:
                    worlds.make_room(grid)
                    grid = worlds.make_grid(1)
                except GridExhausted:
                    clock["status"][w] = status = DIVERGED
            if status not in (OK, GRID_FULL):
                raise worlds.failure(w, now)
        return grid

    def launch(
        self, w: int, now: float, grid: Grid, rows: Any, first: int, stride: int, velocity: wp.array
    ) -> None:
        """Call the kernel on state rows and grid; see there for ``first`` and ``stride``."""
        s = self.worlds
        wp.launch(
            make_advance(s.real, "neo-hookean", yields=bool(s.yields[w])),
            dim=1,
            inputs=[
                w, now, s.clock, s.matter, s.scene, s.paths, s.grips, s.pulls, s.touched, first,
                stride, rows,
                grid.layouts, grid.layout_of, grid.momentum, velocity,
            ],
            device=s.device,
        )  # fmt: skip


def load(kernel: Any, device: Any) -> None:
    """Compile a kernel, or load it from Warp's cache, before threads call it."""
    with making:
        wp.load_module(kernel.module, device=device)
