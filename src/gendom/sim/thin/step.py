"""A step of rods and shells, its transpose, and the kernels that take many.

The integrator is leapfrog (Stoermer-Verlet): forces at the start of a step advance velocities from
the middle of the previous step to the middle of this one, and velocities advance positions and
directions to its end. Contact with the table and obstacles changes velocities so that no point ends
in one of them, with Coulomb friction (Moreau 1988). Held points are moved with their gripper. Each
world uses one block of threads on CUDA, and one thread with SIMD lanes on the CPU.
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
from gendom.sim.thin.native import MODULE_OPTIONS, make_native
from gendom.sim.thin.types import make_types

CHECKED = 256
"""Steps between two checks of a body's mean stretch."""


@functools.cache
def make_kernels(real: Any, kind: str) -> SimpleNamespace:
    """Build the kernels for one scalar type and one kind of body, ``rod`` or ``shell``."""
    types, native, paths_of = make_types(real), make_native(real, kind), make_paths(real)
    ThinModel, ModelAdjoint, ThinRun = types.ThinModel, types.ModelAdjoint, types.ThinRun
    vec3, quat, Paths, rows = types.vec3, types.quat, make_path_type(real), wp.array3d(dtype=real)
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
    def step(
        model: ThinModel, paths: Paths, w: int, thread: int, state: rows, row: int, next: int,
        began: wp.float64, t: wp.float64, dt: real, kick: real,
    ) -> real:  # fmt: skip
        """Take a step of dt from one row of the state to the next; it ends at time t.

        Args:
            began: When the piece of the schedule began, for the grippers that are closed [s].
            kick: Time from the middle of the previous step to the middle of this one [s].

        Returns:
            The largest squared stretch of an edge, NaN if any is.
        """
        if model.obstacles.shape[1] > 0:
            place_obstacles(model, w, thread, t, dt)
        stretch = native.forces(model, w, state, row, next, dt)
        native.block_sync()
        native.move(model, w, state, row, next, dt, kick)
        native.block_sync()
        hold_all(model, w, began, t, paths, state, next)
        if model.contact == 1:
            native.resolve(model, w, state, next, dt)
        return stretch

    @wp.func
    def step_adjoint(
        model: ThinModel, adjoint: ModelAdjoint, paths: Paths, turns_kept: rows, w: int, at: int,
        thread: int, state: rows, row: int, next: int, began: wp.float64, t: wp.float64, dt: real,
        kick: real,
    ):  # fmt: skip
        """Transpose of ``step``, which is repeated: the next row is rewritten."""
        if model.obstacles.shape[1] > 0:
            place_obstacles(model, w, thread, t, dt)
        native.forces(model, w, state, row, next, dt)
        native.block_sync()
        if model.contact == 1:
            # the next row as contacts found it; steps from there have been transposed
            native.move(model, w, state, row, next, dt, kick)
            native.block_sync()
            hold_all(model, w, began, t, paths, state, next)
            listed = state.shape[1] - LISTED
            native.resolve_adjoint(model, adjoint, w, turns_kept, at, state, next, listed, dt)
        hold_all_adjoint(model, adjoint, w, thread, began, t, paths)
        native.move_adjoint(model, adjoint, w, state, row, dt, kick)
        native.block_sync()
        native.forces_adjoint(model, adjoint, w, state, row, dt)
        native.block_sync()
        native.gather_adjoint(model, adjoint, w)
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

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def advance(first: int, threads: int, model: ThinModel, paths: Paths, run: ThinRun):
        """Take the next pieces of a run, until a world exceeds a limit: ``limit`` of the squared
        stretch of an edge, or ``mean_limit`` of the mean, every CHECKED steps and where pieces
        end."""
        w = first + wp.tid() // threads
        thread = wp.tid() % threads
        state, kept, stride = run.state, run.kept, run.stride
        row = w - run.offset
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
                if model.contact * stride > 0:
                    native.rebuild_lists(model, w, state, row, state.shape[1] - LISTED, real(0.0))
                began = run.begins[w, p]
                h = real(run.dt[w, p])
                t = end_of(run, w, p, -1)
                bad = int(0)
                for k in range(run.steps[w, p]):
                    t = end_of(run, w, p, k)
                    kick = kick_of(run, w, p, k)
                    next = row + stride
                    if not step(
                        model, paths, w, thread, state, row, next, began, t, h, kick
                    ) <= limit:  # fmt: skip
                        bad = 1
                    row = next
                    if model.contact * stride > 0:
                        native.keep_list(model, w, state, row, state.shape[1] - LISTED)
                    if (k + 1) % CHECKED == 0:
                        if not native.mean_stretch(model, state, row) <= mean_limit:
                            bad = 1
                        if native.block_any(bad) != 0:
                            break
                if not native.mean_stretch(model, state, row) <= mean_limit:
                    bad = 1
                if model.contact == 1:  # noqa: SIM102 - Warp evaluates both sides of `and`
                    if model.near_count[w, 0] + model.near_count[w, 1] > model.near.shape[1]:
                        bad = 1
                if native.block_any(bad) != 0:
                    run.stopped[w] = p
                    run.stopped_at[w] = t
                else:
                    f = run.frame[w, p]
                    if f >= 0:
                        for k in range(thread, run.points.shape[0], threads):
                            i = model.slot[run.points[k]]
                            run.frames[f, w, k] = vec3(
                                state[row, 0, i], state[row, 1, i], state[row, 2, i]
                            )
                native.block_sync()

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
        for back in range(count):
            k = count - 1 - back
            row = w - run.offset + k * run.stride
            step_adjoint(
                model, adjoint, paths, turns_kept, w, w - run.offset, thread, run.state, row,
                row + run.stride, run.begins[w, p], end_of(run, w, p, k), real(run.dt[w, p]),
                kick_of(run, w, p, k),
            )  # fmt: skip

    return functions_of(locals())
