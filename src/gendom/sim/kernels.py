"""The substep of the material point method: the loops over particles and grid nodes.

One source for both devices. On the CPU one thread advances one world through many substeps, so
that its particles and its grid stay in cache; on CUDA each stage of a substep is a kernel over
all worlds. Both call the same functions of ``transfers``, ``boundary`` and ``columns``.
Symplectic Euler.

Shapes: W worlds, N particles, G grippers, K path knots, L layouts of X x Y grid columns, M nodes.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.materials.laws import make_law
from gendom.sim.boundary import make_boundary
from gendom.sim.columns import MARGIN, Columns, make_columns
from gendom.sim.stencil import FUSED
from gendom.sim.transfers import make_transfers

OK = 0
GRID_FULL = 1
INVERTED = 2
DIVERGED = 3


@functools.cache
def make_kernels(real: Any, law_name: str, *, plastic: bool) -> SimpleNamespace:
    """Build all kernels for one scalar type and one material.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        law_name: Elastic law, see ``gendom.materials.laws``.
        plastic: Whether particles yield.

    Returns:
        Namespace with the types, ``columns``, ``boundary`` and ``transfers`` of the kernels,
        ``frame_substep``, ``advance`` (CPU) and the stages of a substep (CUDA): ``tally``,
        ``place``, ``locate``, ``empty``, ``mark``, ``lay`` where a graph begins, then ``tense``
        (of elastic bodies), ``p2g``, ``grid_update``, ``g2p`` for each of its substeps, and
        ``take``.
    """
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    mat33 = wp.types.matrix((3, 3), real)
    columns_of = make_columns(real)
    forget_bounds = columns_of.forget_bounds
    locate_particle = columns_of.locate_particle
    mark_particle = columns_of.mark_particle
    empty_column = columns_of.empty_column
    lay_column = columns_of.lay_column
    boundary = make_boundary(real)
    Scene, Paths, Grips = boundary.Scene, boundary.Paths, boundary.Grips
    place_gripper = boundary.place_gripper
    update_node = boundary.update_node
    law = make_law(law_name, real, plastic=plastic)
    transfers = make_transfers(real, law)
    Matter, State = transfers.Matter, transfers.State
    scatter_particle = transfers.scatter_particle
    move_particle = transfers.move_particle
    tense_particle = transfers.tense_particle
    tense_body = transfers.tense_body
    pull_type = transfers.pull_type
    yields = transfers.yields

    @wp.struct
    class Clock:
        """Where W worlds stand in the frame that they are in."""

        dt: wp.array(dtype=wp.float64)  # [W] [s]
        steps: wp.array(dtype=wp.int32)  # [W] substeps to do
        step: wp.array(dtype=wp.int32)  # [W] substeps done
        age: wp.array(dtype=wp.int32)  # [W] substeps done in all
        travel: wp.array(dtype=real)  # [W] distance since the columns were laid [m]
        status: wp.array(dtype=wp.int32)  # [W]
        culprit: wp.array(dtype=wp.int32)  # [W] particle
        frame: wp.array(dtype=wp.int32)  # [W] of a ``Plan``

    @wp.struct
    class Plan:
        """T frames that W worlds go through, each at its own pace."""

        time: wp.array(dtype=wp.float64)  # [T + 1] where each begins, and the last one's end [s]
        steps: wp.array2d(dtype=wp.int32)  # [T, W] equal substeps of each
        particles: wp.array(dtype=wp.int32)  # [P] whose positions are recorded where a frame ends
        x: wp.array3d(dtype=vec3)  # [T, W, P] [m]

    @wp.func
    def frame_substep(frame: int, w: int, plan: Plan):
        """Length of a world's substeps in a frame [s]; 0 where it has none."""
        dt = wp.float64(0.0)
        if plan.steps[frame, w] > 0:
            dt = (plan.time[frame + 1] - plan.time[frame]) / wp.float64(plan.steps[frame, w])
        return dt

    # ---- CPU: one thread, one world, many substeps -------------------------------------------

    @wp.kernel(enable_backward=False, module="unique", module_options=FUSED)
    def advance(
        w: int,
        time: wp.float64,  # [s] at substep 0
        clock: Clock,
        matter: Matter,
        scene: Scene,
        paths: Paths,
        grips: Grips,  # [W]
        pulls: wp.array2d(dtype=pull_type),  # [W, N] scratch
        # in rows: substep n of this call goes from row first + n * stride to the next; stride 0
        # works in place, 1 keeps every state, its grid and its layout for the reverse
        first: int,
        stride: int,
        state: State,
        # grid of this world alone
        columns: Columns,
        layout_of: wp.array(dtype=wp.int32),  # [L] the layout of each substep of this call
        momentum: wp.array2d(dtype=vec4),  # [L, M] and mass
        velocity: wp.array2d(dtype=vec4),  # [1, M] and mass; may be ``momentum`` where stride is 0
    ):
        N = state.x.shape[1]
        dx = scene.dx
        z0 = scene.z0
        inv_dx = real(1.0) / dx
        dt = clock.dt[w]
        h = real(dt)
        keep = wp.exp(-scene.damping[w] * h)
        begun = clock.step[w]
        step = int(begun)
        age = clock.age[w]
        travel = clock.travel[w]
        status = int(OK)
        layout = layout_of[0]
        while step < clock.steps[w] and status == OK:
            slot = (step - begun) * stride
            row = first + slot
            after = row + stride
            if travel >= real(MARGIN) * dx:
                layout = slot
                forget_bounds(layout, columns)
                for p in range(N):
                    locate_particle(layout, state.x[row, p], inv_dx, columns)
                X = columns.bounds[layout, 2] - columns.bounds[layout, 0] + 1
                Y = columns.bounds[layout, 3] - columns.bounds[layout, 1] + 1
                fits = X <= columns.low.shape[1] and Y <= columns.low.shape[2]
                if fits:
                    for i in range(X):
                        for j in range(Y):
                            empty_column(layout, i, j, columns)
                    for p in range(N):
                        mark_particle(layout, state.x[row, p], inv_dx, z0, columns)
                    columns.count[layout] = 0
                    for i in range(X):
                        for j in range(Y):
                            lay_column(layout, i, j, columns)
                    fits = columns.count[layout] <= momentum.shape[1]
                if not fits:
                    status = GRID_FULL
                    # the grid's need is read from the first layout
                    for a in range(4):
                        columns.bounds[0, a] = columns.bounds[layout, a]
                else:
                    travel = real(0.0)
            if yields == 0 and status == OK:
                culprit = tense_body(w, row, h, matter, state, pulls)
                if culprit >= 0:
                    status = INVERTED
                    clock.culprit[w] = culprit
            if status == OK:
                layout_of[slot] = layout
                t = time + wp.float64(step) * dt
                for g in range(grips.closed.shape[1]):
                    place_gripper(w, w, g, t, dt, paths, grips)
                nodes = columns.count[layout]
                # while: of a range the compiler cannot tell that its numbers are not negative,
                # and every index of an array would be looked at (a fifth slower)
                n = int(0)
                while n < nodes:
                    momentum[slot, n] = vec4()
                    n += 1
                p = int(0)
                while p < N:
                    scatter_particle(
                        w, p, row, layout, slot, h, inv_dx, z0, matter, state, pulls, columns,
                        momentum,
                    )  # fmt: skip
                    p += 1
                n = int(0)
                while n < nodes:
                    q = momentum[slot, n]
                    if q[3] > real(0.0):
                        u = update_node(w, w, layout, n, q, h, keep, scene, paths, grips, columns)
                        velocity[0, n] = vec4(u[0], u[1], u[2], q[3])
                    n += 1
                fastest = real(0.0)
                total = real(0.0)
                p = int(0)
                while p < N:
                    speed, upright = move_particle(
                        w, p, row, after, layout, 0, h, inv_dx, z0, matter, columns, velocity,
                        state, state,
                    )  # fmt: skip
                    if not upright:
                        status = INVERTED
                        clock.culprit[w] = p
                    fastest = wp.max(fastest, speed)
                    total += speed
                    p += 1
                # a sum keeps a NaN, a maximum may drop it
                if not (total < real(1.0e30)) or h * wp.sqrt(fastest) > dx:
                    status = DIVERGED
                travel += h * wp.sqrt(fastest)
                step += 1
                age += 1
        clock.step[w] = step
        clock.age[w] = age
        clock.travel[w] = travel
        clock.status[w] = status

    # ---- CUDA: a graph of GRAPH substeps; columns are laid anew only where it begins ------------
    #
    # A world that would leave its columns, that has done its substeps or that failed stands still
    # for the rest of the graph. Inside a graph nothing but the substep's kernels runs: how
    # far a world has travelled is summed from each substep's largest speed by whoever asks.

    @wp.struct
    class Lap:
        """What W worlds do in one graph."""

        time: wp.array(dtype=wp.float64)  # [1] of the frame's substep 0 [s]
        done: wp.array(dtype=wp.int32)  # [W] substeps done in the graph
        fastest: wp.array2d(dtype=real)  # [W, GRAPH] largest squared speed of each
        trouble: wp.array(dtype=wp.int32)  # [W] status found by any particle
        stale: wp.array(dtype=wp.int32)  # [W] 1 where the columns must be laid anew

    @wp.func
    def travelled(w: int, substeps: int, clock: Clock, lap: Lap):
        """Distance [m] since the columns were laid, so many substeps into the graph."""
        far = clock.travel[w]
        for q in range(substeps):
            far += real(clock.dt[w]) * wp.sqrt(lap.fastest[w, q])
        return far

    @wp.func
    def runs(w: int, r: int, dx: real, clock: Clock, lap: Lap):
        """Whether a world does substep r of the graph."""
        going = (
            clock.step[w] + r < clock.steps[w] and clock.status[w] == OK and lap.trouble[w] == OK
        )
        if going:
            going = travelled(w, r, clock, lap) < real(MARGIN) * dx
        return going

    @wp.kernel(enable_backward=False)
    def tally(dx: real, clock: Clock, lap: Lap, columns: Columns):
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
            columns.count[w] = 0
            forget_bounds(w, columns)

    @wp.kernel(enable_backward=False)
    def place(clock: Clock, lap: Lap, paths: Paths, grips: Grips):
        """Grippers [GRAPH * W, G] in every substep of the graph that begins."""
        r, w = wp.tid()
        dt = clock.dt[w]
        t = lap.time[0] + wp.float64(clock.step[w] + r) * dt
        for g in range(grips.closed.shape[1]):
            place_gripper(r * clock.dt.shape[0] + w, w, g, t, dt, paths, grips)

    @wp.kernel(enable_backward=False)
    def locate(scene: Scene, lap: Lap, state: State, columns: Columns):
        w, p = wp.tid()
        if lap.stale[w] == 1:
            locate_particle(w, state.x[w, p], real(1.0) / scene.dx, columns)

    @wp.kernel(enable_backward=False)
    def empty(lap: Lap, columns: Columns):
        w, i, j = wp.tid()
        if lap.stale[w] == 1:
            empty_column(w, i, j, columns)

    @wp.kernel(enable_backward=False)
    def mark(scene: Scene, lap: Lap, state: State, columns: Columns):
        w, p = wp.tid()
        if lap.stale[w] == 1:
            mark_particle(w, state.x[w, p], real(1.0) / scene.dx, scene.z0, columns)

    @wp.kernel(enable_backward=False)
    def lay(clock: Clock, lap: Lap, columns: Columns):
        w, i, j = wp.tid()
        if lap.stale[w] == 1:
            X = columns.bounds[w, 2] - columns.bounds[w, 0] + 1
            Y = columns.bounds[w, 3] - columns.bounds[w, 1] + 1
            if i >= X or j >= Y:
                return
            full = lay_column(w, i, j, columns)
            if full == 1 or X > columns.low.shape[1] or Y > columns.low.shape[2]:
                clock.status[w] = GRID_FULL

    @wp.kernel(enable_backward=False)
    def tense(
        r: int,
        clock: Clock,
        lap: Lap,
        matter: Matter,
        scene: Scene,
        state: State,
        pulls: wp.array2d(dtype=pull_type),
    ):
        """Pulls between the particles of an elastic body."""
        w, p = wp.tid()
        if runs(w, r, scene.dx, clock, lap):
            upright = tense_particle(w, p, w, real(clock.dt[w]), matter, state, pulls)
            if not upright:
                wp.atomic_max(lap.trouble, w, INVERTED)
                clock.culprit[w] = p

    @wp.kernel(enable_backward=False)
    def p2g(
        r: int,
        clock: Clock,
        lap: Lap,
        matter: Matter,
        scene: Scene,
        state: State,
        pulls: wp.array2d(dtype=pull_type),
        columns: Columns,
        momentum: wp.array2d(dtype=vec4),
    ):
        w, p = wp.tid()
        if r == 0 and p == 0:
            lap.stale[w] = 0  # laid by now
        if runs(w, r, scene.dx, clock, lap):
            scatter_particle(
                w, p, w, w, w, real(clock.dt[w]), real(1.0) / scene.dx, scene.z0, matter, state,
                pulls, columns, momentum,
            )  # fmt: skip

    @wp.kernel(enable_backward=False)
    def grid_update(
        r: int,
        clock: Clock,
        lap: Lap,
        scene: Scene,
        paths: Paths,
        grips: Grips,  # [GRAPH * W, G]
        columns: Columns,
        recorded: int,  # 1: the momentum stays for the reverse; 0: left empty for the next substep
        momentum: wp.array2d(dtype=vec4),  # [W, M]
        velocity: wp.array2d(dtype=vec4),  # [W, M]
    ):
        w, n = wp.tid()
        # one after the other: most threads of a world stand beyond its last node
        if n >= columns.count[w]:
            return
        if runs(w, r, scene.dx, clock, lap):
            q = momentum[w, n]
            if recorded == 0:
                momentum[w, n] = vec4()
            u = vec3()
            if q[3] > real(0.0):
                h = real(clock.dt[w])
                u = update_node(
                    w, r * clock.dt.shape[0] + w, w, n, q, h, wp.exp(-scene.damping[w] * h),
                    scene, paths, grips, columns,
                )  # fmt: skip
            velocity[w, n] = vec4(u[0], u[1], u[2], q[3])

    @wp.kernel(enable_backward=False)
    def g2p(
        r: int,
        clock: Clock,
        lap: Lap,
        matter: Matter,
        scene: Scene,
        columns: Columns,
        velocity: wp.array2d(dtype=vec4),
        state: State,
        state_out: State,
    ):
        w, p = wp.tid()
        dx = scene.dx
        if runs(w, r, dx, clock, lap):
            h = real(clock.dt[w])
            speed, upright = move_particle(
                w, p, w, w, w, w, h, real(1.0) / dx, scene.z0, matter, columns, velocity,
                state, state_out,
            )  # fmt: skip
            if not (speed * h * h <= dx * dx):
                wp.atomic_max(lap.trouble, w, DIVERGED)
                speed = real(0.0)
            elif not upright:
                wp.atomic_max(lap.trouble, w, INVERTED)
                clock.culprit[w] = p
            if p == 0:
                lap.done[w] = r + 1
            if speed > lap.fastest[w, r]:
                wp.atomic_max(lap.fastest, w, r, speed)

    @wp.kernel(enable_backward=False)
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
        if yields == 1:
            state_out.F[w, p] = rows.F[row, p]

    return SimpleNamespace(
        vec3=vec3,
        vec4=vec4,
        mat33=mat33,
        columns=columns_of,
        boundary=boundary,
        transfers=transfers,
        law=law,
        Clock=Clock,
        Plan=Plan,
        frame_substep=frame_substep,
        Lap=Lap,
        advance=advance,
        tally=tally,
        place=place,
        locate=locate,
        empty=empty,
        mark=mark,
        lay=lay,
        tense=tense,
        p2g=p2g,
        grid_update=grid_update,
        g2p=g2p,
        take=take,
    )
