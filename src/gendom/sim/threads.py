"""Running on the CPU: every thread takes a world from the first frame to the last."""

import contextlib
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from gendom.errors import SimulationError
from gendom.sim.columns import Grid, GridExhausted
from gendom.sim.kernels import DIVERGED, GRID_FULL, OK
from gendom.sim.worlds import CLOCK, LAY_ANEW, Frames, Worlds


class Threads:
    """Worlds one by one, several side by side.

    Args:
        worlds: On the CPU.
        count: Worlds side by side.
    """

    def __init__(self, worlds: Worlds, count: int):
        self.worlds = worlds
        self.count = count
        # on the CPU these share the arrays' memory
        self.clock = {name: getattr(worlds.clock, name).numpy() for name in CLOCK}
        self.state = {name: getattr(worlds.state, name).numpy() for name in worlds.carried}
        self.low = worlds.low.numpy()

    def run(self, frames: Frames) -> None:
        """Simulate all worlds to all times.

        Raises:
            SimulationError: If a world diverges, unless told to keep going.
        """
        worlds = self.worlds
        done = np.zeros(worlds.num_worlds, dtype=int)
        stop = False

        def one_world(w: int) -> None:
            grid = worlds.make_grid(1)
            self.clock["travel"][w] = LAY_ANEW
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

        with ThreadPoolExecutor(max_workers=self.count) as pool:
            jobs = self._submit(pool, one_world)
            try:
                reported = 0
                while not all(job.done() for job in jobs):
                    for job in jobs:
                        if not job.done():
                            _wait(job)
                            break
                    if frames.on_frame is not None and done.min() > reported:
                        reported = int(done.min())
                        frames.on_frame(reported)
            except BaseException:
                stop = True
                raise
        if frames.on_frame is not None and done.min() > reported:
            frames.on_frame(int(done.min()))
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
        # the slowest worlds go first, so that no thread ends alone
        return [pool.submit(work, int(w)) for w in np.argsort(self.worlds.substep)]

    def plan(self, w: int, *, begun: int, steps: int, dt: float) -> None:
        """Set world w's clock: a frame's substeps from ``begun`` until ``steps`` are to be done."""
        clock = self.clock
        clock["step"][w], clock["steps"][w], clock["dt"][w] = begun, steps, dt
        clock["status"][w] = OK

    def advance(self, w: int, now: float, grid: Grid) -> Grid:
        """Take world w through its planned substeps; returns the grid, larger if it had to grow.

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
            s.kernels.advance,
            dim=1,
            inputs=[
                w, now, s.clock, s.matter, s.scene, s.paths, s.grips, s.pulls, first, stride, rows,
                grid.columns, grid.layout_of, grid.momentum, velocity,
            ],
            device=s.device,
        )  # fmt: skip


def _wait(job: Future[None]) -> None:
    with contextlib.suppress(TimeoutError):
        job.exception(timeout=0.05)
