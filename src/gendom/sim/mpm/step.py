"""The substep of the material point method, forward and transposed: the algorithm at a glance.

    1. grasp             grippers open and close                          (boundary)
    2. internal forces   pulls between particles, damping, air            (internal_forces)
    3. touch             table and walls change momenta                   (boundary)
    4. p2g               mass and momentum of particles that are not held, to the grid
    5. nodes             velocity = momentum / mass                       (transfer)
    6. g2p               velocity and affine velocity, from the grid or a gripper; x += dt v

``make_stages`` has each as a function of one particle, section or node in rows of particles
(``types.State``); ``make_step`` puts them together for one thread and one world, as the CPU runs
it. CUDA runs the same stages as kernels over all worlds (``runners.graph``), or the same functions
on particles in the memory of a block (``runners.block_kernels``). Symplectic Euler.

Shapes: W worlds, N particles, G grippers, L layouts of the grid, M nodes.
"""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.adjoint.boundary import make_boundary_adjoint, make_row_bars
from gendom.sim.mpm.boundary import FOLLOWS, make_boundary
from gendom.sim.mpm.compensated_sum import make_compensated_sum
from gendom.sim.mpm.elasticity import make_maxwell_branch
from gendom.sim.mpm.grid import SparseGrid
from gendom.sim.mpm.internal_forces import make_internal_forces
from gendom.sim.mpm.particles import make_rows
from gendom.sim.mpm.poses import make_poses
from gendom.sim.mpm.transfer import make_bspline, make_transfer
from gendom.sim.mpm.types import Namespace, make_types

OK = 0
GRID_FULL = 1
INVERTED = 2
DIVERGED = 3
NOT_FINITE = 4
"""Status of a world whose derivatives overflowed."""
NOTHING_HELD = 5
"""Status of a world in which a gripper closed on nothing."""


@functools.cache
def make_stages(real: Any, law_name: str, *, yields: bool) -> Namespace:
    """Build the stages of a substep on rows of particles.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        law_name: Elastic law, see ``gendom.materials.laws``.
        yields: Whether the worlds that run it yield.

    Returns:
        Namespace with ``touch``, ``scatter``, ``move`` and their transposes, and with what it has
        them from: ``types``, ``transfer``, ``branch``, ``forces``, ``boundary`` and
        ``boundary_adjoint``.
    """
    types = make_types(real)
    Nodes, Pulls, Vectors = types.Nodes, types.Pulls, types.Vectors
    vec3 = types.vec3
    Matter, Scene, State, Grips = types.Matter, types.Scene, types.State, types.Grips
    MatterBars, SceneBars = types.MatterBars, types.SceneBars
    forces = make_internal_forces(real, law_name, yields=yields)
    bspline, transfer = make_bspline(real), make_transfer(real)
    rows, row_bars = make_rows(real), make_row_bars(real)
    boundary = make_boundary(real, rows)
    boundary_adjoint = make_boundary_adjoint(real, rows, row_bars)
    compensates = wp.constant(int(types.compensates))
    compensated_sum = make_compensated_sum(real)

    @wp.func
    def momentum_of(
        w: int, p: int, row: int, dt: real, matter: Matter, scene: Scene, state: State,
        pulls: Pulls,
    ):  # fmt: skip
        """Momentum of a particle with the impulses of the substep, but for the table's."""
        v = state.v[row, p] + dt * scene.gravity[w]
        return matter.mass[w] * v + forces.impulse_on(p, matter, pulls, w)

    @wp.func
    def section_motion(
        w: int, s: int, row: int, dt: real, matter: Matter, scene: Scene, state: State,
        pulls: Pulls,
    ):  # fmt: skip
        """Mean position of section s, and its mean velocity without contact."""
        size = matter.section
        x = vec3()
        q = vec3()
        for p in range(s * size, (s + 1) * size):
            x += state.x[row, p]
            q += momentum_of(w, p, row, dt, matter, scene, state, pulls)
        share = real(1.0) / real(size)
        return share * x, (share / matter.mass[w]) * q

    @wp.func
    def touch(
        w: int, s: int, row: int, dt: real, matter: Matter, scene: Scene, state: State,
        pulls: Pulls, touched: Vectors,
    ):  # fmt: skip
        """Set the change of a section's velocity by table and walls."""
        change = vec3()
        if boundary.near_table(state.x[row, s * matter.section], matter, scene):
            x, u = section_motion(w, s, row, dt, matter, scene, state, pulls)
            change = boundary.contact(w, x, u, dt, matter.contact_radius, scene)
        touched[w, s] = change

    @wp.func
    def touch_adjoint(
        w: int, s: int, row: int, dt: real, matter: Matter, scene: Scene, state: State,
        pulls: Pulls, touched: Vectors, bars: MatterBars, scene_bars: SceneBars,
    ):  # fmt: skip
        """Transpose of ``touch``: adds to the derivatives by x and by momenta, which are found in
        those by v."""
        if wp.length_sq(touched[w, s]) > real(0.0):
            size = matter.section
            change_bar = vec3()
            for p in range(s * size, (s + 1) * size):
                change_bar += bars.v[w, p]
            x, u = section_motion(w, s, row, dt, matter, scene, state, pulls)
            x_bar, u_bar = boundary_adjoint.contact_adjoint(
                w, x, u, dt, matter.contact_radius, scene, change_bar, scene_bars
            )
            for p in range(s * size, (s + 1) * size):
                bars.x[w, p] = bars.x[w, p] + x_bar / real(size)
                bars.v[w, p] = bars.v[w, p] + u_bar / real(size)
            # u is momentum over mass
            first = s * size
            bars.mass[w, first] = bars.mass[w, first] - wp.dot(u_bar, u) / matter.mass[w]

    @wp.func
    def scatter(
        w: int, p: int, row: int, grip_row: int, layout: int, slot: int, dt: real, near: int,
        matter: Matter, scene: Scene, grips: Grips, state: State, pulls: Pulls, touched: Vectors,
        grid: SparseGrid, momentum: Nodes,
    ):  # fmt: skip
        """Add a particle's mass and momentum to its 27 nodes, unless a gripper carries it."""
        free = grips.free[w, p]
        if free > real(0.0):
            mass = matter.mass[w]
            x = state.x[row, p]
            q = momentum_of(w, p, row, dt, matter, scene, state, pulls)
            if near == 1:
                q += mass * touched[w, p // matter.section]
            if free < real(1.0):
                q = mass * boundary.guided(w, p, grip_row, x, q / mass, dt, scene.dx, matter, grips)
            inv_dx = real(1.0) / scene.dx
            node, f, c = transfer.given_by(x, q, state.C[row, p], mass, layout, inv_dx, grid)
            bspline.scatter(momentum, slot, grid.start, layout, node, f, c)

    @wp.func
    def scatter_adjoint(
        w: int, p: int, row: int, grip_row: int, layout: int, slot: int, dt: real, near: int,
        matter: Matter, scene: Scene, grips: Grips, state: State, pulls: Pulls, touched: Vectors,
        grid: SparseGrid, nodes_bar: Nodes, bars: MatterBars, scene_bars: SceneBars,
    ):  # fmt: skip
        """Transpose of ``scatter``: sets the derivatives by v (as found in those by momentum)
        and C, adds to those by x and mass. Returns the square of what it found."""
        free = grips.free[w, p]
        mass = matter.mass[w]
        x_bar = vec3()
        u_bar = vec3()
        C_bar = types.mat33()
        mass_bar = real(0.0)
        if free > real(0.0):
            x = state.x[row, p]
            own = momentum_of(w, p, row, dt, matter, scene, state, pulls) / mass
            u = own
            if near == 1:
                u += touched[w, p // matter.section]
            v = u
            if free < real(1.0):
                v = boundary.guided(w, p, grip_row, x, u, dt, scene.dx, matter, grips)
            x_bar, q_bar, C_bar, mass_bar = transfer.p2g_adjoint(
                x, mass * v, state.C[row, p], mass, layout, slot, real(1.0) / scene.dx, grid,
                nodes_bar,
            )  # fmt: skip
            u_bar = mass * q_bar
            mass_bar += wp.dot(q_bar, v)
            if free < real(1.0):
                by_x, u_bar_own, lam_bar, by_mass = boundary_adjoint.guided_adjoint(
                    w, p, grip_row, x, u, dt, scene.dx, matter, u_bar, grips, scene_bars
                )
                x_bar += by_x
                mass_bar += by_mass
                bars.lam[w, p] = bars.lam[w, p] + lam_bar
                bars.mu[w, p] = bars.mu[w, p] + real(2.0) * lam_bar
                u_bar = u_bar_own
            # its own velocity is momentum over mass
            mass_bar -= wp.dot(u_bar, own) / mass
        bars.x[w, p] = bars.x[w, p] + x_bar
        bars.v[w, p] = u_bar
        bars.C[w, p] = C_bar
        bars.mass[w, p] = bars.mass[w, p] + mass_bar
        return wp.length_sq(x_bar) + wp.length_sq(u_bar)

    @wp.func
    def momentum_adjoint(
        w: int, p: int, row: int, dt: real, matter: Matter, scene: Scene, state: State,
        bars: MatterBars, stretches: Pulls,
    ):  # fmt: skip
        """Transpose of ``momentum_of``; returns the derivative by gravity."""
        v_bar = bars.v[w, p]
        speed = state.v[row, p] + dt * scene.gravity[w]
        bars.mass[w, p] = bars.mass[w, p] + wp.dot(v_bar, speed) / matter.mass[w]
        forces.impulse_on_adjoint(w, p, matter, bars, stretches)
        return dt * v_bar

    @wp.func
    def move(
        w: int, p: int, row: int, row_out: int, grip_row: int, layout: int, slot: int, dt: real,
        scene: Scene, grips: Grips, grid: SparseGrid, velocity: Nodes, state: State,
        state_out: State,
    ):  # fmt: skip
        """Advance a particle to the next state; return its squared speed."""
        x = state.x[row, p]
        v = vec3()
        C = types.mat33()
        if grips.free[w, p] > real(0.0):
            v, C = transfer.g2p(layout, slot, x, real(1.0) / scene.dx, grid, velocity)
        else:
            v, spin, _by_b = boundary.carried(w, p, grip_row, x, real(FOLLOWS), dt, grips)
            C = wp.skew(spin)
        if compensates == 1:
            there, low = compensated_sum(x, dt * v, state.low[w, p])
            state_out.x[row_out, p] = there
            state.low[w, p] = low
        else:
            state_out.x[row_out, p] = x + dt * v
        state_out.v[row_out, p] = v
        state_out.C[row_out, p] = C
        return wp.length_sq(v)

    @wp.func
    def move_adjoint(
        w: int, p: int, row: int, grip_row: int, layout: int, slot: int, dt: real, scene: Scene,
        grips: Grips, grid: SparseGrid, velocity: Nodes, state: State, nodes_bar: Nodes,
        bars: MatterBars, scene_bars: SceneBars,
    ):  # fmt: skip
        """Transpose of ``move``; derivatives by v and C are not needed afterwards."""
        x = state.x[row, p]
        x_bar = bars.x[w, p]
        v_bar = bars.v[w, p] + dt * x_bar
        C_bar = bars.C[w, p]
        if grips.free[w, p] > real(0.0):
            inv_dx = real(1.0) / scene.dx
            node, f, c = transfer.taken_by(x, v_bar, C_bar, layout, inv_dx, grid)
            bspline.scatter(nodes_bar, slot, grid.start, layout, node, f, c)
            x_bar += transfer.g2p_adjoint(x, v_bar, C_bar, layout, slot, inv_dx, grid, velocity)
        else:
            spin_bar = boundary_adjoint.turned_adjoint(C_bar)
            x_bar += boundary_adjoint.carried_adjoint(
                w, p, grip_row, real(FOLLOWS), dt, v_bar, spin_bar, grips, scene_bars
            )
        bars.x[w, p] = x_bar

    return Namespace(
        touch, touch_adjoint, scatter, scatter_adjoint, momentum_adjoint, move, move_adjoint,
        types=types, bspline=bspline, transfer=transfer, branch=make_maxwell_branch(real).branch,
        forces=forces, boundary=boundary, boundary_adjoint=boundary_adjoint, paths=make_poses(real),
        largest=1.0e37 if real == wp.float32 else 1.0e300,
    )  # fmt: skip


@functools.cache
def make_step(real: Any, law_name: str, *, yields: bool) -> Namespace:
    """Build ``substep`` and ``substep_adjoint`` of one world by one thread (CPU); see above."""
    k = make_stages(real, law_name, yields=yields)
    types = k.types
    Nodes, Pulls, Vectors = types.Nodes, types.Pulls, types.Vectors
    vec3 = types.vec3
    Matter, Scene, State = types.Matter, types.Scene, types.State
    Paths, Grips, Clock = types.Paths, types.Grips, types.Clock
    MatterBars, SceneBars = types.MatterBars, types.SceneBars
    forces, boundary, boundary_adjoint = k.forces, k.boundary, k.boundary_adjoint
    close_substep, largest = make_closing(real).close_substep, k.largest

    # while, not range: with range the compiler cannot tell that indices are not negative, and
    # checks every array index (a fifth slower)

    @wp.func
    def substep(
        w: int, t: wp.float64, dt: wp.float64, age: int, row: int, row_out: int, layout: int,
        slot: int, clock: Clock, matter: Matter, scene: Scene, paths: Paths, grips: Grips,
        pulls: Pulls, touched: Vectors, state: State, grid: SparseGrid, momentum: Nodes,
        velocity: Nodes,
    ):  # fmt: skip
        """Advance a row of particles from t to the next row; return the largest squared speed and
        the status. The grid's momentum is left in ``slot``. Nothing moves in a substep in which a
        gripper closes on nothing or a particle turns inside out."""
        N = state.x.shape[1]
        G = grips.closed.shape[1]
        h = real(dt)
        if G > 0:
            empty = boundary.grasp(w, t, age, row, N, matter, scene, paths, grips, state)
            if empty >= 0:
                clock.failed_particle[w] = empty
                return real(0.0), NOTHING_HELD
        for g in range(G):
            k.paths.pose_gripper(w, w, g, t, dt, paths, grips)
        keep, share = k.branch(matter.damping[w], h, age)
        inverted = forces.body_forces(w, row, row_out, h, keep, share, matter, state, state, pulls)
        if inverted >= 0:
            clock.failed_particle[w] = inverted
            return real(0.0), INVERTED
        near = clock.near_table[w]
        if near == 1:
            for s in range(N // matter.section):
                k.touch(w, s, row, h, matter, scene, state, pulls, touched)
        nodes = grid.count[layout]
        k.bspline.clear(momentum, slot, nodes)
        p = int(0)
        while p < N:
            k.scatter(
                w, p, row, w, layout, slot, h, near, matter, scene, grips, state, pulls, touched,
                grid, momentum,
            )  # fmt: skip
            p += 1
        k.bspline.normalise(
            momentum, slot, velocity, 0, nodes, wp.exp(-scene.velocity_damping[w] * h)
        )
        fastest = real(0.0)
        total = real(0.0)
        p = int(0)
        while p < N:
            speed = k.move(
                w, p, row, row_out, w, layout, 0, h, scene, grips, grid, velocity, state, state
            )
            fastest = wp.max(fastest, speed)
            total += speed
            p += 1
        # a sum keeps a NaN, a maximum may drop it
        if not (total < real(1.0e30)) or h * wp.sqrt(fastest) > scene.dx:
            return fastest, DIVERGED
        return fastest, OK

    @wp.func
    def substep_adjoint(
        w: int, t: wp.float64, dt: wp.float64, age: int, row: int, layout: int, slot: int,
        matter: Matter, scene: Scene, paths: Paths, grips: Grips, pulls: Pulls, touched: Vectors,
        state: State, grid: SparseGrid, momentum: Nodes, velocity: Nodes, nodes_bar: Nodes,
        bars: MatterBars, scene_bars: SceneBars,
    ):  # fmt: skip
        """Propagate derivatives by the state after a recorded substep to the state before it.

        Return a particle whose derivatives are not finite, or -1.
        """
        N = state.x.shape[1]
        G = grips.closed.shape[1]
        h = real(dt)
        nodes = grid.count[layout]
        damping_factor = wp.exp(-scene.velocity_damping[w] * h)
        keep, share = k.branch(matter.damping[w], h, age)
        # what the substep had besides the recorded momentum; Z and G after it are not asked for
        for g in range(G):
            k.paths.pose_gripper(w, w, g, t, dt, paths, grips)
        forces.body_forces(w, row, row + 1, h, keep, share, matter, state, state, pulls)
        near = int(0)
        if scene.table == 1 or scene.walls == 1:
            near = 1
            for s in range(N // matter.section):
                k.touch(w, s, row, h, matter, scene, state, pulls, touched)
        k.bspline.normalise(momentum, slot, velocity, 0, nodes, damping_factor)
        k.bspline.clear(nodes_bar, 0, nodes)
        # 6
        p = int(0)
        while p < N:
            k.move_adjoint(
                w, p, row, w, layout, 0, h, scene, grips, grid, velocity, state, nodes_bar, bars,
                scene_bars,
            )  # fmt: skip
            p += 1
        # 5
        by_factor = wp.float64(0.0)
        n = int(0)
        while n < nodes:
            q_bar, factor_bar = k.transfer.node_velocity_adjoint(
                momentum[slot, n], nodes_bar[0, n], damping_factor
            )
            nodes_bar[0, n] = q_bar
            by_factor += wp.float64(factor_bar)
            n += 1
        scene_bars.damping_factor[w] = scene_bars.damping_factor[w] + by_factor
        # 4, 3, 2
        failed = int(-1)
        p = int(0)
        while p < N:
            size = k.scatter_adjoint(
                w, p, row, w, layout, 0, h, near, matter, scene, grips, state, pulls, touched, grid,
                nodes_bar, bars, scene_bars,
            )  # fmt: skip
            if not (size < real(largest)) and failed < 0:
                failed = p
            p += 1

        if near == 1:
            for s in range(N // matter.section):
                k.touch_adjoint(
                    w, s, row, h, matter, scene, state, pulls, touched, bars, scene_bars
                )
        forces.body_forces_adjoint(w, row, h, keep, share, matter, state, bars, scene_bars, pulls)
        by_gravity = vec3()
        p = int(0)
        while p < N:
            by_gravity += k.momentum_adjoint(w, p, row, h, matter, scene, state, bars, pulls)
            p += 1
        scene_bars.gravity[w] = scene_bars.gravity[w] + boundary_adjoint.wide(by_gravity)
        # 1
        close_substep(w, w, t, dt, age, matter, scene, paths, grips, scene_bars)
        if G > 0:
            boundary_adjoint.grasp_adjoint(
                w, t, age, row, matter, scene, paths, grips, state, bars, scene_bars
            )
        return failed

    return Namespace(substep, substep_adjoint)


@functools.cache
def make_closing(real: Any) -> Namespace:
    """Build what adds the sums of substeps to derivatives by paths and rates.

    Returns:
        Namespace with ``close_substep``, for one, and ``close_rates``, for the rates of several
        equally long ones.
    """
    types = make_types(real)
    Matter, Scene, Paths, Grips = types.Matter, types.Scene, types.Paths, types.Grips
    SceneBars = types.SceneBars
    pose_gripper_adjoint = make_poses(real).pose_gripper_adjoint
    branch_adjoint = make_maxwell_branch(real).branch_adjoint

    @wp.func
    def close_rates(
        w: int, dt: wp.float64, age: int, matter: Matter, scene: Scene, bars: SceneBars
    ):
        """Add derivatives by damping rates; reset their sums."""
        h = real(dt)
        slope = wp.float64(-h * wp.exp(-scene.velocity_damping[w] * h))
        bars.velocity_damping[w] = bars.velocity_damping[w] + slope * bars.damping_factor[w]
        by_damping = branch_adjoint(
            matter.damping[w], h, age, real(bars.branch_factor[w]), real(bars.branch_share[w])
        )
        bars.damping[w] = bars.damping[w] + wp.float64(by_damping)
        bars.damping_factor[w] = wp.float64(0.0)
        bars.branch_factor[w] = wp.float64(0.0)
        bars.branch_share[w] = wp.float64(0.0)

    @wp.func
    def close_substep(
        w: int, grip_row: int, t: wp.float64, dt: wp.float64, age: int, matter: Matter,
        scene: Scene, paths: Paths, grips: Grips, bars: SceneBars,
    ):  # fmt: skip
        """Add a substep's derivatives by gripper paths and damping rates; reset the sums."""
        for g in range(grips.closed.shape[1]):
            if grips.closed[grip_row, g] == 1:
                pose_gripper_adjoint(grip_row, w, g, t, dt, paths, bars)
        close_rates(w, dt, age, matter, scene, bars)

    return Namespace(close_substep, close_rates)
