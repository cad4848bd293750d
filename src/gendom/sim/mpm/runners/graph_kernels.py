"""Stages of the substep as CUDA kernels over all worlds, with what rebuilds their grids."""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.mpm.grid import MARGIN, SparseGrid, make_rebuild
from gendom.sim.mpm.native import MODULE_OPTIONS
from gendom.sim.mpm.step import DIVERGED, GRID_FULL, INVERTED, NOTHING_HELD, OK, make_stages

YIELDS = wp.constant(1.0e29)
"""Yield stresses below this are finite [Pa]."""

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
