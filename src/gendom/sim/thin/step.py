"""A step of rods and shells, its transpose, and the kernels that take many.

The integrator is leapfrog (Stoermer-Verlet): forces at the start of a step advance velocities from
the middle of the previous step to the middle of this one, and velocities advance positions and
directions to its end. Contact with the table and obstacles changes velocities so that no point ends
in one of them, with Coulomb friction (Moreau 1988). Held points are moved with their gripper. Each
world uses one block of threads on CUDA, and one thread with SIMD lanes on the CPU. Between steps
its state is in rows in memory, that of short rods on CUDA in registers. Many rods without contact
are side by side on the CPU, a lane each (``advance_interleaved``).
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.native import functions_of
from gendom.sim.paths import make_path_type, make_paths
from gendom.sim.thin.contact import LISTED
from gendom.sim.thin.grips import LOCAL_STRETCH, STRETCH
from gendom.sim.thin.native import MODULE_OPTIONS, make_native, options_in_shared
from gendom.sim.thin.shells import ShellModel
from gendom.sim.thin.types import make_types

CHECKED = 256
"""Steps between two checks of a body's mean stretch."""

POSES = 64
"""Of grippers in the next steps that CUDA keeps in shared memory, see ``native/hold.h``."""


@functools.cache
def make_kernels(
    real: Any, kind: str, held: int = 0, row_length: int = 0, blocks: int = 0
) -> SimpleNamespace:
    """Build the kernels for one scalar type and one kind of body, ``rod`` or ``shell``; with
    ``held`` points of rods without contact with themselves in the registers of each thread, or
    what shells need in a step in shared memory, in rows of ``row_length``, with so many blocks on
    a multiprocessor."""
    types, native, paths_of = make_types(real), make_native(real, kind, held), make_paths(real)
    Registers = native.Registers
    ThinModel, ModelAdjoint, ThinRun = types.ThinModel, types.ModelAdjoint, types.ThinRun
    vec3, quat, Paths, rows = types.vec3, types.quat, make_path_type(real), wp.array3d(dtype=real)
    IN_SHARED_MEMORY = wp.constant(row_length > 0)
    numbers = wp.constant(row_length * ShellModel.shared_rows)
    limit, mean_limit = real(LOCAL_STRETCH**2), real(STRETCH)

    @wp.func
    def place_obstacles(model: ThinModel, w: int, thread: int, t: wp.float64, dt: real):
        """Where obstacles are at time t, and how they came there in a step of dt."""
        if thread == 0:
            per, paths = wp.float64(1.0) / wp.float64(dt), model.obstacle_paths
            for o in range(model.obstacles.shape[1]):
                was, before, _knot = paths_of.placed(w, o, t - wp.float64(dt), paths)
                centre, q, _last = paths_of.placed(w, o, t, paths)
                gone = q * wp.quat_inverse(before)
                axes = wp.quat_to_matrix(q)
                for c in range(3):
                    for k in range(3):
                        model.obstacles[w, o, 5 + 3 * c + k] = real(axes[k, c])
                    model.obstacles[w, o, 14 + c] = real(centre[c])
                    model.obstacles[w, o, 17 + c] = real(per * (centre[c] - was[c]))
                    model.obstacles[w, o, 20 + c] = real(
                        wp.float64(2.0) * per * gone[c] * wp.sign(gone[3])
                    )
        native.block_sync()

    @wp.func
    def hold_all(
        model: ThinModel, w: int, began: wp.float64, t: wp.float64, paths: Paths,
        state: rows, row: int,
    ):  # fmt: skip
        """Move held points to the poses at time t of the grippers that were closed at ``began``."""
        for g in range(model.holds.shape[1]):
            if paths_of.is_closed(w, g, began, paths):
                centre, q, _knot = paths_of.placed(w, g, t, paths)
                native.hold(model, w, g, vec3(centre), quat(q), state, row)
                native.block_sync()

    @wp.func
    def hold_all_adjoint(
        model: ThinModel, adjoint: ModelAdjoint, w: int, thread: int, began: wp.float64,
        t: wp.float64, paths: Paths,
    ):  # fmt: skip
        """Transpose of ``hold_all``."""
        for before in range(model.holds.shape[1]):
            g = model.holds.shape[1] - 1 - before
            if thread == 0 and paths_of.is_closed(w, g, began, paths):
                _centre, q, _knot = paths_of.placed(w, g, t, paths)
                native.hold_adjoint(model, adjoint, w, g, quat(q))
                paths_of.pose_adjoint(
                    w, g, t, wp.vec3d(adjoint.centre[w, g]), wp.vec3d(adjoint.turn[w, g]), paths,
                    adjoint.position, adjoint.path_turn,
                )  # fmt: skip
        native.block_sync()

    @wp.func
    def kick_of(run: ThinRun, w: int, p: int, k: int):
        """Time from the middle of the previous step to the middle of step k of a piece [s]."""
        kick = run.dt[w, p]
        if k == 0:
            kick = wp.float64(0.5) * (run.before[w, p] + kick)
        return real(kick)

    @wp.func
    def end_of(run: ThinRun, w: int, p: int, k: int):
        """When step k of a piece ends [s]."""
        return run.begins[w, p] + wp.float64(run.done[w, p] + k + 1) * run.dt[w, p]

    @wp.func
    def look_ahead(
        model: ThinModel, w: int, p: int, k: int, most: int, closed: int, thread: int, threads: int,
        paths: Paths, run: ThinRun,
    ):  # fmt: skip
        """Find the poses of closed grippers at the ends of ``most`` steps from step k on, each
        thread those of another step."""
        native.block_sync()
        for i in range(thread, most, threads):
            for g in range(model.holds.shape[1]):
                if (closed >> g) & 1 == 1:
                    at, q, _knot = paths_of.placed(w, g, end_of(run, w, p, k + i), paths)
                    native.put_pose(i + g * most, vec3(at), quat(q))
        native.block_sync()

    @wp.func
    def closed_from(model: ThinModel, w: int, began: wp.float64, paths: Paths) -> int:
        """Bits of the grippers that are closed from a time on."""
        closed = int(0)
        for g in range(wp.min(model.holds.shape[1], POSES // 2)):
            if paths_of.is_closed(w, g, began, paths):
                closed |= 1 << g
        return closed

    @wp.func
    def divide(run: ThinRun, w: int):
        """Make a span one piece of equal steps no longer than the world's longest."""
        span = run.span[1] - run.span[0]
        most = wp.ceil(span / run.substep[w] - wp.float64(1.0e-9))
        steps = wp.max(wp.float64(1.0), most)
        run.begins[w, 0] = run.span[0]
        run.before[w, 0] = run.dt[w, 0]
        run.steps[w, 0] = int(steps)
        run.dt[w, 0] = span / steps

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def begin(first: int, threads: int, model: ThinModel, state: rows):
        """Set lagged strains from a first state."""
        w = first + wp.tid() // threads
        native.forces(model, w, state, w, w, real(1.0e30))

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def begin_adjoint(
        first: int, threads: int, model: ThinModel, state: rows, adjoint: ModelAdjoint
    ):
        """Transpose of ``begin``; the scratch of the derivatives is 0."""
        w = first + wp.tid() // threads
        native.forces_adjoint(model, adjoint, w, state, w, real(1.0e30))
        native.block_sync()
        native.gather_adjoint(model, adjoint, w)

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def let_go(first: int, threads: int, model: ThinModel, dt: real, state: rows):
        """Take a step in which no gripper holds anything, from rows [W] to rows [W + w]."""
        w = first + wp.tid() // threads
        native.forces(model, w, state, w, w + state.shape[0] // 2, dt)
        native.block_sync()
        native.move(model, w, state, w, w + state.shape[0] // 2, dt, dt)

    @wp.func
    def steps_in_rows(
        model: ThinModel, paths: Paths, run: ThinRun, w: int, thread: int, threads: int, p: int,
        first: int, end: int,
    ) -> int:  # fmt: skip
        """Take steps of a piece; returns whether the squared stretch of an edge exceeded
        ``limit``. Grippers are closed that were when the piece began."""
        state, dt, row = run.state, real(run.dt[w, p]), int(w - run.offset + first * run.stride)
        most = POSES // wp.max(model.holds.shape[1], 2)
        closed = int(0)
        if threads > 1 and most > 1:
            closed = closed_from(model, w, run.begins[w, p], paths)
        bad = int(0)
        for k in range(first, end):
            next, t = row + run.stride, end_of(run, w, p, k)
            if closed != 0 and (k - first) % most == 0:
                look_ahead(model, w, p, k, most, closed, thread, threads, paths, run)
            if model.obstacles.shape[1] > 0:
                place_obstacles(model, w, thread, t, dt)
            if not native.forces(model, w, state, row, next, dt) <= limit:
                bad = 1
            native.block_sync()
            native.move(model, w, state, row, next, dt, kick_of(run, w, p, k))
            native.block_sync()
            if closed == 0:
                hold_all(model, w, run.begins[w, p], t, paths, state, next)
            for g in range(model.holds.shape[1]):
                if (closed >> g) & 1 == 1:
                    native.hold_ahead(model, w, g, (k - first) % most + g * most, state, next)
                    native.block_sync()
            if model.contact == 1:
                native.resolve(model, w, state, next, dt)
            row = next
            if model.contact * run.stride > 0:
                native.keep_list(model, w, state, row, state.shape[1] - LISTED)
        return bad

    @wp.func
    def steps_in_registers(
        model: ThinModel, paths: Paths, run: ThinRun, w: int, thread: int, threads: int, p: int,
        first: int, end: int,
    ) -> int:  # fmt: skip
        """As ``steps_in_rows``; each thread finds where grippers are at the end of another step."""
        row, h = int(w - run.offset + first * run.stride), real(run.dt[w, p])
        closed = closed_from(model, w, run.begins[w, p], paths)
        own = Registers()
        holds = native.begin(model, w, run.state, row, closed, own)
        most = POSES // wp.max(model.holds.shape[1], 2)
        shares = vec3()
        bad = int(0)
        for k in range(first, end):
            kick = h
            if k == 0:
                kick = kick_of(run, w, p, k)
            if k == first or k == 1:
                shares = native.shares_of(model, w, h, kick)
            ahead = (k - first) % most
            if closed != 0 and ahead == 0:
                look_ahead(model, w, p, k, most, closed, thread, threads, paths, run)
            if model.obstacles.shape[1] > 0:
                place_obstacles(model, w, thread, end_of(run, w, p, k), h)
            if not native.step_in_registers(
                model, w, own, holds, ahead, most, h, kick, shares
            ) <= limit:  # fmt: skip
                bad = 1
            if run.stride > 0:
                row += run.stride
                native.store(run.state, row, own)
        if run.stride == 0:
            native.store(run.state, row, own)
        native.block_sync()
        return bad

    steps = steps_in_registers if held else steps_in_rows
    # so many ropes on a multiprocessor: more have to keep too much in memory
    bounds = (32, 12 if real == wp.float64 else 16) if held == 1 else None
    advance_options = MODULE_OPTIONS
    if row_length:
        advance_options = options_in_shared(real, row_length)
        bounds = (ShellModel.threads_on_cuda, blocks)

    @wp.func
    def stop(run: ThinRun, w: int, p: int, k: int):
        """Stop a world at the end of step k of a piece."""
        run.stopped[w] = p
        run.stopped_at[w] = end_of(run, w, p, k)

    @wp.func
    def record(
        model: ThinModel, run: ThinRun, w: int, p: int, row: int, thread: int, threads: int
    ):  # fmt: skip
        """Record the frame at the end of a piece, if any, from a row of the state."""
        f = run.frame[w, p]
        if f >= 0:
            for k in range(thread, run.points.shape[0], threads):
                i = model.slot[run.points[k]]
                run.frames[f, w, k] = vec3(
                    run.state[row, 0, i], run.state[row, 1, i], run.state[row, 2, i]
                )

    @wp.kernel(module="unique", module_options=advance_options, launch_bounds=bounds)
    def advance(first: int, threads: int, model: ThinModel, paths: Paths, run: ThinRun):
        """Take the next pieces of a run, until a world exceeds a limit: ``limit`` of the squared
        stretch of an edge, or ``mean_limit`` of the mean, every CHECKED steps and where pieces
        end."""
        w = first + wp.tid() // threads
        thread = wp.tid() % threads
        state, kept = run.state, run.kept
        row = w - run.offset
        if IN_SHARED_MEMORY:
            wp.tile_empty(shape=numbers, dtype=real, storage="shared")
            native.begin_shared(model, w)
        if run.span.shape[0] > 0:
            if thread == 0:
                divide(run, w)
            native.block_sync()
        for p in range(run.piece[w, 0], run.piece[w, 1]):
            if run.stopped[w] < 0:
                if run.every >= 0:  # with what the list of pairs was made from, if there is room
                    to = w + p * run.every
                    for c in range(state.shape[1]):
                        for i in range(thread, state.shape[2], threads):
                            kept[to, c, i] = state[row, c, i]
                    if kept.shape[1] > state.shape[1]:
                        native.keep_list(model, w, kept, to, state.shape[1])
                if model.contact * run.stride > 0:
                    native.rebuild_lists(model, w, state, row, state.shape[1] - LISTED, real(0.0))
                bad = int(0)
                k = int(0)
                count = run.steps[w, p]
                last = row + count * run.stride
                while k < count and bad == 0:
                    end = wp.min(k + CHECKED, count)
                    bad = steps(model, paths, run, w, thread, threads, p, k, end)
                    k = end
                    if not native.mean_stretch(model, state, row + k * run.stride) <= mean_limit:
                        bad = 1
                    bad = native.block_any(bad)
                if model.contact == 1:
                    listed = model.pair_counts[w, 0, 0] + model.pair_counts[w, 0, 1]
                    if listed > model.near.shape[1]:
                        bad = 1
                if bad != 0:
                    stop(run, w, p, k - 1)
                else:
                    record(model, run, w, p, last, thread, threads)
                native.block_sync()

    @wp.func
    def steps_of(run: ThinRun, w: int, p: int) -> int:
        """Number of a world's steps in a piece; -1: it is none of the next ones."""
        count = int(-1)
        if run.stopped[w] < 0 and p >= run.piece[w, 0] and p < run.piece[w, 1]:
            count = run.steps[w, p]
        return count

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def advance_interleaved(
        first: int, threads: int, end: int, model: ThinModel, paths: Paths, run: ThinRun
    ):  # fmt: skip
        """As ``advance`` of rods that meet neither obstacles nor themselves, each in a lane of a
        CPU. Those with fewer steps in a piece wait for others where they were."""
        if wp.tid() % native.lanes() != 0:
            return
        w = first + wp.tid()
        lanes = wp.min(native.lanes(), end - w)
        native.load_lanes(model, w, lanes, run.state)
        for l in range(lanes):
            if run.span.shape[0] > 0:
                divide(run, w + l)
        for p in range(run.dt.shape[1]):
            least, most, moving = steps_of(run, w, p), int(0), int(0)
            for l in range(lanes):
                least = wp.min(least, steps_of(run, w + l, p))
                most = wp.max(most, steps_of(run, w + l, p))
                for g in range(model.holds.shape[1]):
                    until = end_of(run, w + l, p, run.steps[w + l, p])
                    if paths_of.moves(w + l, g, run.begins[w + l, p], until, paths):
                        moving |= 1 << g
            for k in range(most):
                if k < 2 or moving != 0:
                    for l in range(lanes):
                        own = w + l
                        if k < 2:
                            kick = kick_of(run, own, p, k)
                            native.set_step(model, w, l, real(run.dt[own, p]), kick)
                        for g in range(model.holds.shape[1]):
                            if k == 0 or (moving >> g) & 1 == 1:
                                t = end_of(run, own, p, k)
                                centre, q, _knot = paths_of.placed(own, g, t, paths)
                                native.set_pose(model, w, l, g, vec3(centre), quat(q))
                native.step_interleaved(model, w)
                if k + 1 >= least or (k + 1) % CHECKED == 0:
                    for l in range(lanes):
                        own, count = w + l, steps_of(run, w + l, p)
                        if k + 1 == count or (k < count and (k + 1) % CHECKED == 0):
                            native.store_lane(model, w, l, run.state, own)
                            bad = int(0)
                            if not native.worst_stretch(model, w, l) <= limit:
                                bad = 1
                            if not native.mean_stretch(model, run.state, own) <= mean_limit:
                                bad = 1
                            if bad != 0:
                                stop(run, own, p, k)
            for l in range(lanes):
                count = steps_of(run, w + l, p)
                if count >= 0:
                    record(model, run, w + l, p, w + l, 0, 1)
                if count < most:
                    native.load_lane(model, w, l, run.state, w + l)

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def reverse(
        first: int,
        threads: int,
        model: ThinModel,
        paths: Paths,
        run: ThinRun,
        frames_bar: wp.array3d(dtype=vec3),  # [T, W, n]
        adjoint: ModelAdjoint,
        turns_kept: rows,  # [., 6 turns, P] points before each of a step's turns
    ):
        """Transpose the next piece, if any, whose states ``advance`` has put in rows."""
        w = first + wp.tid() // threads
        thread = wp.tid() % threads
        p = run.piece[w, 0]
        if p >= run.piece[w, 1]:
            return
        f = run.frame[w, p]
        if f >= 0:
            for k in range(thread, model.points, threads):
                i = model.slot[k]
                for c in range(3):
                    adjoint.state[w, c, i] = adjoint.state[w, c, i] + frames_bar[f, w, k][c]
        native.block_sync()
        count = run.steps[w, p]
        state, began, dt = run.state, run.begins[w, p], real(run.dt[w, p])
        for back in range(count):
            k = count - 1 - back
            row, t, kick = (
                w - run.offset + k * run.stride,
                end_of(run, w, p, k),
                kick_of(run, w, p, k),
            )
            next = row + run.stride
            # the step is repeated: the next row is rewritten
            if model.obstacles.shape[1] > 0:
                place_obstacles(model, w, thread, t, dt)
            native.forces(model, w, state, row, next, dt)
            native.block_sync()
            if model.contact == 1:
                # the next row as contacts found it; steps from there have been transposed
                native.move(model, w, state, row, next, dt, kick)
                native.block_sync()
                hold_all(model, w, began, t, paths, state, next)
                native.resolve_adjoint(
                    model, adjoint, w, turns_kept, w - run.offset, state, next,
                    state.shape[1] - LISTED, dt,
                )  # fmt: skip
            hold_all_adjoint(model, adjoint, w, thread, began, t, paths)
            native.move_adjoint(model, adjoint, w, state, row, dt, kick)
            native.block_sync()
            native.forces_adjoint(model, adjoint, w, state, row, dt)
            native.block_sync()
            native.gather_adjoint(model, adjoint, w)
            native.block_sync()

    return functions_of(locals())
