"""Stages of the substep as CUDA kernels over all worlds, with what rebuilds their grids."""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.grid import MARGIN, SparseGrid, make_rebuild
from gendom.sim.mpm.native import MODULE_OPTIONS
from gendom.sim.mpm.step import DIVERGED, GRID_FULL, INVERTED, NOTHING_HELD, OK, make_stages
from gendom.sim.mpm.types import Namespace

YIELDS = wp.constant(1.0e29)
"""Yield stresses below this are finite [Pa]."""

wp.set_module_options(MODULE_OPTIONS)


@functools.cache
def make_graph_kernels(real: Any, law_name: str, *, yields: bool) -> Namespace:
    """Build the stages of a substep as kernels over all worlds, see ``step.make_stages``.

    The grid is rebuilt only where a graph begins. A world that would leave its grid, that has done
    its substeps or that failed stands still for the rest of the graph. Inside a graph nothing but
    the substep's kernels runs: how far a world has travelled is summed from each substep's largest
    speed by the caller.

    Returns:
        Namespace with ``Lap``; ``tally``, ``pose``, ``locate``, ``clear``, ``mark``, ``number``
        where a graph begins; ``grasp``, ``forces``, ``touch``, ``p2g``, ``nodes``, ``g2p`` of
        each of its substeps; and ``hold_as_at``.
    """
    k = make_stages(real, law_name, yields=yields)
    types = k.types
    Nodes, Pulls, Vectors = types.Nodes, types.Pulls, types.Vectors
    vec4 = types.vec4
    Clock, Matter, Scene, State = types.Clock, types.Matter, types.Scene, types.State
    Paths, Grips = types.Paths, types.Grips
    rebuild = make_rebuild(real)
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
            rebuild.reset(w, grid)

    @wp.kernel
    def pose(clock: Clock, lap: Lap, paths: Paths, grips: Grips):
        """Grippers [GRAPH * W, G] in every substep of the graph that begins."""
        r, w = wp.tid()
        dt = clock.dt[w]
        t = lap.time[0] + wp.float64(clock.step[w] + r) * dt
        for g in range(grips.closed.shape[1]):
            k.paths.pose_gripper(r * clock.dt.shape[0] + w, w, g, t, dt, paths, grips)

    @wp.kernel
    def locate(
        clock: Clock, matter: Matter, scene: Scene, lap: Lap, state: State, grid: SparseGrid
    ):
        w, p = wp.tid()
        if lap.stale[w] == 1:
            x = state.x[w, p]
            lower, upper = rebuild.reach(x, real(1.0) / scene.dx)
            rebuild.widen(w, lower, upper, grid)
            if k.boundary.near_table(x, matter, scene):
                clock.near_table[w] = 1

    @wp.kernel
    def clear(lap: Lap, grid: SparseGrid):
        w, i, j = wp.tid()
        if lap.stale[w] == 1:
            rebuild.clear_column(w, i, j, grid)

    @wp.kernel
    def mark(scene: Scene, lap: Lap, state: State, grid: SparseGrid):
        w, p = wp.tid()
        if lap.stale[w] == 1:
            lower, upper = rebuild.reach(state.x[w, p], real(1.0) / scene.dx)
            rebuild.mark(w, lower, upper, grid)

    @wp.kernel
    def number(room: int, clock: Clock, lap: Lap, grid: SparseGrid):
        w, i, j = wp.tid()
        if lap.stale[w] == 1:
            X = grid.bounds[w, 2] - grid.bounds[w, 0] + 1
            Y = grid.bounds[w, 3] - grid.bounds[w, 1] + 1
            if i >= X or j >= Y:
                return
            rebuild.number_column(w, i, j, grid)
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
            empty = k.boundary.grasp(
                w, t, clock.age[w] + r, w, state.x.shape[1], matter, scene, paths, grips, state
            )
            if empty >= 0:
                wp.atomic_max(lap.trouble, w, NOTHING_HELD)
                clock.failed_particle[w] = empty

    @wp.kernel
    def forces(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, state: State,
        state_out: State, pulls: Pulls,
    ):  # fmt: skip
        """Pulls between the particles of worlds that yield, or of those that do not."""
        w, p = wp.tid()
        if (matter.yield_stress[w] < real(YIELDS)) != (plastic == 1):
            return
        if runs(w, r, scene.dx, clock, lap):
            h = real(clock.dt[w])
            keep, share = k.branch(matter.damping[w], h, clock.age[w] + r)
            upright = k.forces.particle_forces(
                w, p, w, w, h, keep, share, matter, state, state_out, pulls
            )
            if not upright:
                wp.atomic_max(lap.trouble, w, INVERTED)
                clock.failed_particle[w] = p

    @wp.kernel
    def touch(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, state: State, pulls: Pulls,
        touched: Vectors,
    ):  # fmt: skip
        w, s = wp.tid()
        if clock.near_table[w] == 1 and runs(w, r, scene.dx, clock, lap):
            k.touch(w, s, w, real(clock.dt[w]), matter, scene, state, pulls, touched)

    @wp.kernel
    def p2g(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, grips: Grips, state: State,
        pulls: Pulls, touched: Vectors, grid: SparseGrid, momentum: Nodes,
    ):  # fmt: skip
        w, p = wp.tid()
        if runs(w, r, scene.dx, clock, lap):
            k.scatter(
                w, p, w, r * clock.dt.shape[0] + w, w, w, real(clock.dt[w]), clock.near_table[w],
                matter, scene, grips, state, pulls, touched, grid, momentum,
            )  # fmt: skip

    @wp.kernel
    def nodes(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, grid: SparseGrid,
        recorded: int,  # 1: the momentum stays for the reverse; 0: left empty for the next substep
        momentum: Nodes,  # [W, M]
        velocity: Nodes,  # [W, M]
    ):  # fmt: skip
        w, n = wp.tid()
        # one after the other: most threads of a world stand beyond its last node
        if n >= grid.count[w]:
            return
        if runs(w, r, scene.dx, clock, lap):
            q = momentum[w, n]
            if recorded == 0:
                momentum[w, n] = vec4()
            velocity[w, n] = k.transfer.node_velocity(
                q, wp.exp(-scene.velocity_damping[w] * real(clock.dt[w]))
            )

    @wp.kernel
    def g2p(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, grips: Grips,
        grid: SparseGrid, velocity: Nodes, state: State, state_out: State,
    ):  # fmt: skip
        w, p = wp.tid()
        dx = scene.dx
        if runs(w, r, dx, clock, lap):
            h = real(clock.dt[w])
            row = r * clock.dt.shape[0] + w
            speed = k.move(w, p, w, w, row, w, w, h, scene, grips, grid, velocity, state, state_out)
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
        k.boundary.hold_as_at(w, age[w], grips)

    return Namespace(
        tally, pose, locate, clear, mark, number, grasp, forces, p2g, nodes, g2p, touch, hold_as_at,
        Lap=Lap,
    )  # fmt: skip
