"""Running on CUDA: all worlds in lockstep, stage by stage, substeps replayed from a graph."""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.mpm.grid import Grid
from gendom.sim.mpm.model import REBUILD, Worlds
from gendom.sim.mpm.runners.graph_kernels import make_graph_kernels
from gendom.sim.mpm.step import GRID_FULL, OK
from gendom.sim.setting import Frames

SUBSTEPS_A_GRAPH = 8
"""Substeps recorded in one CUDA graph."""

LAP = ("time", "fastest", "done", "trouble", "stale")
"""The arrays of a lap."""

BLOCK = 128
"""Threads of a block."""


class Batch:
    """All worlds together, stage by stage.

    Args:
        worlds: On any device; without graphs on the CPU, where tests run it.
    """

    def __init__(self, worlds: Worlds):
        self.worlds = worlds
        law = "neo-hookean"
        kinds = sorted({bool(yields) for yields in worlds.yields})
        self._all = [make_graph_kernels(worlds.real, law, yields=yields) for yields in kinds]
        self.stages = self._all[0]
        if worlds.device.is_cuda:
            self.load()
        W = worlds.num_worlds
        self.grips = worlds.grips
        worlds.place_grippers(self.grips, self.grip_rows)
        self.lap = worlds.allocate(
            self.stages.Lap, time=1, fastest=(W, SUBSTEPS_A_GRAPH), done=W, trouble=W, stale=W
        )
        self.make_grid()
        self.begin()

    @property
    def grip_rows(self) -> int:
        """Moments at which the poses of grippers are kept, one for each world and substep."""
        return SUBSTEPS_A_GRAPH * self.worlds.num_worlds

    def load(self) -> None:
        """Compile and load what ``run`` launches."""
        module = self.stages.p2g.module  # that of all stages
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
        """Forget what was recorded; grids are rebuilt first."""
        self._graph: Any = None
        self._graphs = 1
        self.worlds.clock.travel.fill_(REBUILD)

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
        self.launch_rebuild()
        for r in range(SUBSTEPS_A_GRAPH):
            self.launch_substep(r, state, state)

    def launch(self, kernel: Any, dim: Any, inputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.worlds.device, block_dim=BLOCK)

    def launch_tally(self) -> None:
        """Count what a graph has done."""
        s = self.worlds
        inputs = [s.setting.body.dx, s.clock, self.lap, self.grid.layouts]
        self.launch(self.stages.tally, s.num_worlds, inputs)

    def launch_rebuild(self) -> None:
        """Begin a graph: pose its grippers, rebuild the grids of worlds that travelled too far."""
        s, k, lap, layouts = self.worlds, self.stages, self.lap, self.grid.layouts
        W, N, columns = s.num_worlds, s.num_particles, layouts.low.shape
        self.launch_tally()
        self.launch(k.pose, (SUBSTEPS_A_GRAPH, W), [s.clock, lap, s.paths, self.grips])
        self.launch(k.locate, (W, N), [s.clock, s.matter, s.scene, lap, s.state, layouts])
        self.launch(k.clear, columns, [lap, layouts])
        self.launch(k.mark, (W, N), [s.scene, lap, s.state, layouts])
        self.launch(k.number, columns, [self.grid.momentum.shape[1], s.clock, lap, layouts])

    def launch_substep(
        self, r: int, before: Any, after: Any, momentum: wp.array | None = None
    ) -> None:
        """Substep r of a graph, from one state to the next, for every world that still runs.

        ``momentum`` is an empty grid that stays as the substep left it, for the reverse.
        """
        s, k, lap, layouts = self.worlds, self.stages, self.lap, self.grid.layouts
        recorded = momentum is not None
        momentum = self.grid.momentum if momentum is None else momentum
        W, N = s.num_worlds, s.num_particles
        now = [r, s.clock, lap]
        self.launch(k.grasp, W, [*now, s.matter, s.scene, s.paths, self.grips, before])
        self.launch_forces(now, before, after)
        self.launch(k.p2g, (W, N), [
            *now, s.matter, s.scene, self.grips, before, s.pulls, s.touched, layouts, momentum,
        ])  # fmt: skip
        self.launch(k.nodes, self.velocity.shape, [
            *now, s.matter, s.scene, layouts, int(recorded), momentum, self.velocity,
        ])  # fmt: skip
        self.launch(k.g2p, (W, N), [
            *now, s.matter, s.scene, self.grips, layouts, self.velocity, before, after,
        ])  # fmt: skip

    def launch_forces(self, now: list[Any], before: Any, after: Any) -> None:
        """Pulls between particles, and what table and walls do."""
        s = self.worlds
        for kind in self._all:
            self.launch(kind.forces, s.pulls.shape, [
                *now, s.matter, s.scene, before, after, s.pulls,
            ])  # fmt: skip
        if s.scene.table or s.scene.walls:
            self.launch(self.stages.touch, s.touched.shape, [
                *now, s.matter, s.scene, before, s.pulls, s.touched,
            ])  # fmt: skip

    def hold_as_at(self, age: wp.array) -> None:
        """Hold in each world what was held before substep ``age`` [W] of all."""
        s = self.worlds
        self.launch(self.stages.hold_as_at, s.num_worlds, [age, self.grips])
