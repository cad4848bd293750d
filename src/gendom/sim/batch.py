"""Running on CUDA: all worlds in lockstep, substeps replayed from a graph."""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.columns import Grid
from gendom.sim.kernels import GRID_FULL, OK
from gendom.sim.worlds import LAY_ANEW, Frames, Worlds

SUBSTEPS_A_GRAPH = 8
"""Substeps recorded in one CUDA graph."""

BLOCK = 128
"""Threads of a block."""


class Batch:
    """All worlds together, stage by stage.

    Args:
        worlds: On any device; without graphs on the CPU, where tests run it.
    """

    def __init__(self, worlds: Worlds):
        self.worlds = worlds
        if worlds.device.is_cuda:
            self.load()
        W = worlds.num_worlds
        self.grips = worlds.make_grips(SUBSTEPS_A_GRAPH * W)
        self.lap = worlds.kernels.Lap()
        self.lap.time = worlds.zeros(1, wp.float64)
        self.lap.fastest = worlds.zeros((W, SUBSTEPS_A_GRAPH), worlds.real)
        for name in ("done", "trouble", "stale"):
            setattr(self.lap, name, worlds.zeros(W, wp.int32))
        self.make_grid()
        self.begin()

    def load(self) -> None:
        """Compile and load what ``run`` launches."""
        module = self.worlds.kernels.p2g.module  # that of all stages
        wp.load_module(module, device=self.worlds.device, block_dim=BLOCK)

    def run(self, frames: Frames) -> None:
        """Simulate all worlds to all times.

        Raises:
            SimulationError: If a world diverges, unless told to keep going.
        """
        s = self.worlds
        self.begin()
        chosen: Any = s.state.x[:, s.array(frames.particles, wp.int32)]
        now = frames.began
        for f, until in enumerate(frames.times):
            for name in s.carried:
                wp.copy(getattr(s.last_good, name), getattr(s.state, name))
            s.last_good_time[:] = now
            self.plan(now, until)
            while self.advance(now, keep_going=frames.keep_going):
                pass
            now = float(until)
            frames.x[f] = chosen.contiguous().numpy()
            frames.x[f, list(s.failures)] = np.nan
            if frames.on_frame is not None:
                frames.on_frame(f + 1)

    def begin(self) -> None:
        """Forget what was recorded; columns are laid anew first."""
        self._graph: Any = None
        self._graphs = 1
        self.worlds.clock.travel.fill_(LAY_ANEW)

    def plan(self, now: float, until: float) -> None:
        """Set every world's clock to the frame from ``now`` to ``until`` [s]."""
        s = self.worlds
        steps, dt = s.divide(slice(None), until - now)
        steps[list(s.failures)] = 0
        s.clock.steps.assign(steps)
        s.clock.dt.assign(dt)
        s.clock.step.zero_()
        s.clock.status.zero_()
        self.lap.time.fill_(now)

    def advance(self, now: float, *, keep_going: bool = False, most: int = 1 << 30) -> bool:
        """Take all worlds through some of their planned substeps, at most so many graphs.

        Returns:
            Whether there is more to do.

        Raises:
            SimulationError: If a world diverges, unless told to keep going.
        """
        clock = self.worlds.clock
        left = int((clock.steps.numpy() - clock.step.numpy()).max())
        if left <= 0:
            return False
        if self._graph is None and self.worlds.device.is_cuda:
            with wp.ScopedCapture(device=self.worlds.device) as capture:
                self._launch_graph()
            self._graph = capture.graph
        # a few at first: a world that finds no room for its nodes is soon noticed
        self._graphs = min(2 * self._graphs, math.ceil(left / SUBSTEPS_A_GRAPH), most)
        for _ in range(self._graphs):
            if self._graph is None:
                self._launch_graph()
            else:
                wp.capture_launch(self._graph)
        self.launch_tally()
        return self.settle(now, keep_going=keep_going)

    def settle(self, now: float, *, keep_going: bool = False) -> bool:
        """See to worlds that found no room or failed; whether there is more to do.

        Raises:
            SimulationError: If a world diverged, unless told to keep going.
        """
        s, clock = self.worlds, self.worlds.clock
        status = clock.status.numpy()
        full = status == GRID_FULL
        if full.any():
            s.make_room(self.grid)
            self.make_grid()
            self.begin()
            status = np.where(full, OK, status).astype(np.int32)
            clock.status.assign(status)
        failed = np.flatnonzero(status != OK)
        for w in failed:
            if int(w) not in s.failures:
                s.failures[int(w)] = s.failure(int(w), self.frame_start(int(w), now))
        if len(failed) and not keep_going:
            raise s.failures[int(failed[0])]
        return bool((self.unfinished() & (status == OK)).any())

    def frame_start(self, w: int, now: float) -> float:
        """When the frame began that world w is in [s]; ``now`` where worlds share frames."""
        return now

    def unfinished(self) -> NDArray[np.bool_]:
        """[W] whether a world has planned substeps before it."""
        clock = self.worlds.clock
        return clock.steps.numpy() > clock.step.numpy()

    def make_grid(self) -> None:
        """Make a grid with the room that worlds are known to need."""
        self.grid: Grid = self.worlds.make_grid(self.worlds.num_worlds)
        self.velocity = wp.zeros_like(self.grid.momentum)

    def _launch_graph(self) -> None:
        state = self.worlds.state
        self.launch_layout()
        for r in range(SUBSTEPS_A_GRAPH):
            self.launch_substep(r, state, state)

    def launch(self, kernel: Any, dim: Any, inputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.worlds.device, block_dim=BLOCK)

    def launch_tally(self) -> None:
        """Count what a graph has done."""
        s = self.worlds
        inputs = [s.setting.body.dx, s.clock, self.lap, self.grid.columns]
        self.launch(s.kernels.tally, s.num_worlds, inputs)

    def launch_layout(self) -> None:
        """Begin a graph: place its grippers, lay the columns of worlds that travelled too far."""
        s, k, lap, columns = self.worlds, self.worlds.kernels, self.lap, self.grid.columns
        W, N = s.num_worlds, s.num_particles
        self.launch_tally()
        self.launch(k.place, (SUBSTEPS_A_GRAPH, W), [s.clock, lap, s.paths, self.grips])
        self.launch(k.locate, (W, N), [s.scene, lap, s.state, columns])
        self.launch(k.empty, columns.low.shape, [lap, columns])
        self.launch(k.mark, (W, N), [s.scene, lap, s.state, columns])
        self.launch(k.lay, columns.low.shape, [s.clock, lap, columns])

    def launch_substep(
        self, r: int, before: Any, after: Any, momentum: wp.array | None = None
    ) -> None:
        """Substep r of a graph, from one state to the next, for every world that still runs.

        ``momentum`` is an empty grid that stays as the substep left it, for the reverse.
        """
        s, k, lap, columns = self.worlds, self.worlds.kernels, self.lap, self.grid.columns
        recorded = momentum is not None
        momentum = self.grid.momentum if momentum is None else momentum
        W, N = s.num_worlds, s.num_particles
        if not s.plastic:
            self.launch(k.tense, (W, N), [r, s.clock, lap, s.matter, s.scene, before, s.pulls])
        self.launch(k.p2g, (W, N), [
            r, s.clock, lap, s.matter, s.scene, before, s.pulls, columns, momentum,
        ])  # fmt: skip
        self.launch(k.grid_update, self.velocity.shape, [
            r, s.clock, lap, s.scene, s.paths, self.grips, columns, int(recorded), momentum,
            self.velocity,
        ])  # fmt: skip
        self.launch(k.g2p, (W, N), [
            r, s.clock, lap, s.matter, s.scene, columns, self.velocity, before, after,
        ])  # fmt: skip
