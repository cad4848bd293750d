"""Running on CUDA: all worlds in lockstep, stage by stage, substeps replayed from a graph."""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.mpm.grid import MARGIN, Grid, SparseGrid, make_rebuild
from gendom.sim.mpm.model import REBUILD, Worlds
from gendom.sim.mpm.native import MODULE_OPTIONS
from gendom.sim.mpm.step import (
    DIVERGED,
    GRID_FULL,
    INVERTED,
    NOTHING_HELD,
    OK,
    make_stages,
)
from gendom.sim.setting import Frames

SUBSTEPS_A_GRAPH = 8
"""Substeps recorded in one CUDA graph."""

BLOCK = 128
"""Threads of a block."""

wp.set_module_options(MODULE_OPTIONS)


@functools.cache
def make_graph_kernels(real: Any, law_name: str, *, yields: bool) -> SimpleNamespace:
    """Build the stages of a substep as kernels over all worlds, see ``step.make_stages``.

    The grid is rebuilt only where a graph begins. A world that would leave its grid, that has done
    its substeps or that failed stands still for the rest of the graph. Inside a graph nothing but
    the substep's kernels runs: how far a world has travelled is summed from each substep's largest
    speed by the caller.

    Returns:
        Namespace with ``Lap``; ``tally``, ``pose``, ``locate``, ``clear``, ``mark``, ``number``
        where a graph begins; ``grasp``, ``forces``, ``touch``, ``p2g``, ``nodes``, ``g2p`` of
        each of its substeps; ``hold_as_at`` and ``take``.
    """
    k = make_stages(real, law_name, yields=yields)
    types = k.types
    vec4 = types.vec4
    Clock, Matter, Scene, State = types.Clock, types.Matter, types.Scene, types.State
    Paths, Grips = types.Paths, types.Grips
    rebuild = make_rebuild(real)
    reset, reach, widen, mark_box = rebuild.reset, rebuild.reach, rebuild.widen, rebuild.mark
    clear_column, number_column = rebuild.clear_column, rebuild.number_column
    branch, particle_forces = k.branch, k.forces.particle_forces
    scatter, move, node_velocity = k.scatter, k.move, k.transfer.node_velocity
    near_table, touch_section = k.boundary.near_table, k.touch
    grasp_world = k.boundary.grasp
    hold_world_as_at = k.boundary.hold_as_at
    pose_gripper = k.paths.pose_gripper
    plastic = wp.constant(int(yields))

    @wp.struct
    class Lap:
        """What W worlds do in one graph."""

        time: wp.array(dtype=wp.float64)  # [1] of the frame's substep 0 [s]
        done: wp.array(dtype=wp.int32)  # [W] substeps done in the graph
        fastest: wp.array2d(dtype=real)  # [W, GRAPH] largest squared speed of each
        trouble: wp.array(dtype=wp.int32)  # [W] status found by any particle
        stale: wp.array(dtype=wp.int32)  # [W] 1 where the grid must be rebuilt

    @wp.func
    def travelled(w: int, substeps: int, clock: Clock, lap: Lap):
        """Distance [m] since the grid was rebuilt, so many substeps into the graph."""
        far = clock.travel[w]
        for q in range(substeps):
            far += real(clock.dt[w]) * wp.sqrt(lap.fastest[w, q])
        return far

    @wp.func
    def runs(w: int, r: int, dx: real, clock: Clock, lap: Lap):
        """Whether a world does substep r of the graph by these kernels."""
        going = (
            clock.step[w] + r < clock.steps[w] and clock.status[w] == OK and lap.trouble[w] == OK
        )
        if going:
            going = travelled(w, r, clock, lap) < real(MARGIN) * dx
        return going

    @wp.kernel
    def tally(dx: real, clock: Clock, lap: Lap, grid: SparseGrid):
        """Count what a graph has done; call before the next one, and before reading ``step``."""
        w = wp.tid()
        n = lap.done[w]
        far = travelled(w, n, clock, lap)
        for q in range(lap.fastest.shape[1]):
            lap.fastest[w, q] = real(0.0)
        clock.travel[w] = far
        clock.step[w] = clock.step[w] + n
        clock.age[w] = clock.age[w] + n
        lap.done[w] = 0
        if clock.status[w] == OK and lap.trouble[w] != OK:
            clock.status[w] = lap.trouble[w]
        lap.trouble[w] = OK
        # a world that found no room keeps its bounds: the host reads from them what it needs
        if far >= real(MARGIN) * dx and clock.status[w] == OK:
            lap.stale[w] = 1
            clock.travel[w] = real(0.0)
            clock.near_table[w] = 0
            reset(w, grid)

    @wp.kernel
    def pose(clock: Clock, lap: Lap, paths: Paths, grips: Grips):
        """Grippers [GRAPH * W, G] in every substep of the graph that begins."""
        r, w = wp.tid()
        dt = clock.dt[w]
        t = lap.time[0] + wp.float64(clock.step[w] + r) * dt
        for g in range(grips.closed.shape[1]):
            pose_gripper(r * clock.dt.shape[0] + w, w, g, t, dt, paths, grips)

    @wp.kernel
    def locate(
        clock: Clock, matter: Matter, scene: Scene, lap: Lap, state: State, grid: SparseGrid
    ):
        w, p = wp.tid()
        if lap.stale[w] == 1:
            x = state.x[w, p]
            lower, upper = reach(x, real(1.0) / scene.dx)
            widen(w, lower, upper, grid)
            if near_table(x, matter, scene):
                clock.near_table[w] = 1

    @wp.kernel
    def clear(lap: Lap, grid: SparseGrid):
        w, i, j = wp.tid()
        if lap.stale[w] == 1:
            clear_column(w, i, j, grid)

    @wp.kernel
    def mark(scene: Scene, lap: Lap, state: State, grid: SparseGrid):
        w, p = wp.tid()
        if lap.stale[w] == 1:
            lower, upper = reach(state.x[w, p], real(1.0) / scene.dx)
            mark_box(w, lower, upper, grid)

    @wp.kernel
    def number(room: int, clock: Clock, lap: Lap, grid: SparseGrid):
        w, i, j = wp.tid()
        if lap.stale[w] == 1:
            X = grid.bounds[w, 2] - grid.bounds[w, 0] + 1
            Y = grid.bounds[w, 3] - grid.bounds[w, 1] + 1
            if i >= X or j >= Y:
                return
            number_column(w, i, j, grid)
            if grid.count[w] > room or X > grid.low.shape[1] or Y > grid.low.shape[2]:
                clock.status[w] = GRID_FULL

    @wp.kernel
    def grasp(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, paths: Paths, grips: Grips,
        state: State,
    ):  # fmt: skip
        """Open and close grippers."""
        w = wp.tid()
        if r == 0:
            lap.stale[w] = 0  # rebuilt by now
        if runs(w, r, scene.dx, clock, lap):
            dt = clock.dt[w]
            t = lap.time[0] + wp.float64(clock.step[w] + r) * dt
            empty = grasp_world(
                w, t, clock.age[w] + r, w, state.x.shape[1], matter, scene, paths, grips, state
            )
            if empty >= 0:
                wp.atomic_max(lap.trouble, w, NOTHING_HELD)
                clock.failed_particle[w] = empty

    @wp.kernel
    def forces(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, state: State,
        state_out: State, pulls: wp.array2d(dtype=types.pull),
    ):  # fmt: skip
        """Pulls between the particles of worlds that yield, or of those that do not."""
        w, p = wp.tid()
        if (matter.yield_stress[w] < real(YIELDS)) != (plastic == 1):
            return
        if runs(w, r, scene.dx, clock, lap):
            h = real(clock.dt[w])
            keep, share = branch(matter.damping[w], h, clock.age[w] + r)
            upright = particle_forces(w, p, w, w, h, keep, share, matter, state, state_out, pulls)
            if not upright:
                wp.atomic_max(lap.trouble, w, INVERTED)
                clock.failed_particle[w] = p

    @wp.kernel
    def touch(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, state: State,
        pulls: wp.array2d(dtype=types.pull), touched: wp.array2d(dtype=types.vec3),
    ):  # fmt: skip
        w, s = wp.tid()
        if clock.near_table[w] == 1 and runs(w, r, scene.dx, clock, lap):
            touch_section(w, s, w, real(clock.dt[w]), matter, scene, state, pulls, touched)

    @wp.kernel
    def p2g(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, grips: Grips, state: State,
        pulls: wp.array2d(dtype=types.pull), touched: wp.array2d(dtype=types.vec3),
        grid: SparseGrid, momentum: wp.array2d(dtype=vec4),
    ):  # fmt: skip
        w, p = wp.tid()
        if runs(w, r, scene.dx, clock, lap):
            scatter(
                w, p, w, r * clock.dt.shape[0] + w, w, w, real(clock.dt[w]), clock.near_table[w],
                matter, scene, grips, state, pulls, touched, grid, momentum,
            )  # fmt: skip

    @wp.kernel
    def nodes(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, grid: SparseGrid,
        recorded: int,  # 1: the momentum stays for the reverse; 0: left empty for the next substep
        momentum: wp.array2d(dtype=vec4),  # [W, M]
        velocity: wp.array2d(dtype=vec4),  # [W, M]
    ):  # fmt: skip
        w, n = wp.tid()
        # one after the other: most threads of a world stand beyond its last node
        if n >= grid.count[w]:
            return
        if runs(w, r, scene.dx, clock, lap):
            q = momentum[w, n]
            if recorded == 0:
                momentum[w, n] = vec4()
            velocity[w, n] = node_velocity(
                q, wp.exp(-scene.velocity_damping[w] * real(clock.dt[w]))
            )

    @wp.kernel
    def g2p(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, grips: Grips,
        grid: SparseGrid, velocity: wp.array2d(dtype=vec4), state: State, state_out: State,
    ):  # fmt: skip
        w, p = wp.tid()
        dx = scene.dx
        if runs(w, r, dx, clock, lap):
            h = real(clock.dt[w])
            row = r * clock.dt.shape[0] + w
            speed = move(w, p, w, w, row, w, w, h, scene, grips, grid, velocity, state, state_out)
            if not (speed * h * h <= dx * dx):
                wp.atomic_max(lap.trouble, w, DIVERGED)
                speed = real(0.0)
            if p == 0:
                lap.done[w] = r + 1
            if speed > lap.fastest[w, r]:
                wp.atomic_max(lap.fastest, w, r, speed)

    @wp.kernel
    def hold_as_at(age: wp.array(dtype=wp.int32), grips: Grips):
        """Hold in each world what was held before a substep."""
        w = wp.tid()
        hold_world_as_at(w, age[w], grips)

    @wp.kernel
    def take(
        done: wp.array(dtype=wp.int32),
        rows: State,  # [(GRAPH + 1) * W, N]
        state_out: State,  # [W, N]
    ):
        """The state in which each world has left a recorded graph."""
        w, p = wp.tid()
        row = done[w] * done.shape[0] + w
        state_out.x[w, p] = rows.x[row, p]
        state_out.v[w, p] = rows.v[row, p]
        state_out.C[w, p] = rows.C[row, p]
        if state_out.Z.shape[0] > 0:
            for c in range(6):
                state_out.Z[w, c, p] = rows.Z[row, c, p]
        if state_out.G.shape[0] > 0:
            state_out.G[w, p] = rows.G[row, p]

    return SimpleNamespace(
        Lap=Lap,
        tally=tally,
        pose=pose,
        locate=locate,
        clear=clear,
        mark=mark,
        number=number,
        grasp=grasp,
        forces=forces,
        p2g=p2g,
        nodes=nodes,
        g2p=g2p,
        touch=touch,
        hold_as_at=hold_as_at,
        take=take,
    )


YIELDS = wp.constant(1.0e29)
"""Yield stresses below this are finite [Pa]."""


class Batch:
    """All worlds together, stage by stage.

    Args:
        worlds: On any device; without graphs on the CPU, where tests run it.
    """

    def __init__(self, worlds: Worlds):
        self.worlds = worlds
        law = worlds.setting.law
        kinds = sorted({bool(yields) for yields in worlds.yields})
        self._all = [make_graph_kernels(worlds.real, law, yields=yields) for yields in kinds]
        self.stages = self._all[0]
        if worlds.device.is_cuda:
            self.load()
        W = worlds.num_worlds
        self.grips = worlds.grips
        worlds.place_grippers(self.grips, self.grip_rows)
        self.lap = self.stages.Lap()
        self.lap.time = worlds.zeros(1, wp.float64)
        self.lap.fastest = worlds.zeros((W, SUBSTEPS_A_GRAPH), worlds.real)
        for name in ("done", "trouble", "stale"):
            setattr(self.lap, name, worlds.zeros(W, wp.int32))
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
        for kind in self._all:
            self.launch(kind.forces, (W, N), [*now, s.matter, s.scene, before, after, s.pulls])
        if s.scene.table or s.scene.walls:
            self.launch(k.touch, s.touched.shape, [
                *now, s.matter, s.scene, before, s.pulls, s.touched,
            ])  # fmt: skip
        self.launch(k.p2g, (W, N), [
            *now, s.matter, s.scene, self.grips, before, s.pulls, s.touched, layouts, momentum,
        ])  # fmt: skip
        self.launch(k.nodes, self.velocity.shape, [
            *now, s.matter, s.scene, layouts, int(recorded), momentum, self.velocity,
        ])  # fmt: skip
        self.launch(k.g2p, (W, N), [
            *now, s.matter, s.scene, self.grips, layouts, self.velocity, before, after,
        ])  # fmt: skip

    def hold_as_at(self, age: wp.array) -> None:
        """Hold in each world what was held before substep ``age`` [W] of all."""
        s = self.worlds
        self.launch(self.stages.hold_as_at, s.num_worlds, [age, self.grips])
