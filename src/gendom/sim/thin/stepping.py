"""Kernels that step rods and shells through pieces of equal steps, and their transposes.

The integrator is leapfrog (Stoermer-Verlet): forces at the start of a step advance velocities from
the middle of the previous step to the middle of this one, and velocities advance positions and
directions to its end. Contact with the table changes velocities so that no point ends
beyond them, with Coulomb friction (Moreau 1988). Held points are moved with their gripper. Each
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

from gendom.sim.paths import make_path_type, make_paths
from gendom.sim.thin.contact import LISTED
from gendom.sim.thin.native import MODULE_OPTIONS
from gendom.sim.thin.types import make_types

CHECKED = 256
"""Steps between two checks of a body's mean stretch."""


@functools.cache
def make_stepping(real: Any, kind: str) -> SimpleNamespace:
    """Build the kernels for one scalar type and one kind of body, ``rod`` or ``shell``.

    Returns:
        Namespace with ``begin`` (lagged strains from the first state), ``advance`` and ``reverse``,
        and the functions that they call, for use in other kernels.
    """
    types = make_types(real)
    paths_of = make_paths(real)
    pose, pose_adjoint, narrow = paths_of.pose, paths_of.pose_adjoint, paths_of.narrow
    is_closed = paths_of.is_closed
    Paths = make_path_type(real)
    Body, Bars, Plan, vec3, quat = types.Body, types.Bars, types.Plan, types.vec3, types.quat

    @wp.func_native("gendom::meet();")
    def meet(): ...

    @wp.func_native("return gendom::any_of(value);")
    def any_of(value: int) -> int: ...

    @wp.func_native(f"return gendom::{kind}_forces(body, w, state, row, next, dt);")
    def forces(
        body: Body, w: int, state: wp.array3d(dtype=real), row: int, next: int, dt: real
    ) -> real: ...

    @wp.func_native(f"gendom::{kind}_move(body, w, state, row, next, dt, kick);")
    def move(
        body: Body, w: int, state: wp.array3d(dtype=real), row: int, next: int, dt: real,
        kick: real,
    ): ...  # fmt: skip

    @wp.func_native("gendom::hold(body, w, g, centre, turned, state, next);")
    def hold(
        body: Body, w: int, g: int, centre: vec3, turned: quat, state: wp.array3d(dtype=real),
        next: int,
    ): ...  # fmt: skip

    @wp.func_native("gendom::hold_adjoint(body, bars, w, g, turned);")
    def hold_adjoint(body: Body, bars: Bars, w: int, g: int, turned: quat): ...

    @wp.func_native(f"gendom::{kind}_move_adjoint(body, bars, w, state, row, dt, kick);")
    def move_adjoint(
        body: Body, bars: Bars, w: int, state: wp.array3d(dtype=real), row: int, dt: real,
        kick: real,
    ): ...  # fmt: skip

    @wp.func_native(f"gendom::{kind}_forces_adjoint(body, bars, w, state, row, dt);")
    def forces_adjoint(
        body: Body, bars: Bars, w: int, state: wp.array3d(dtype=real), row: int, dt: real
    ): ...

    @wp.func_native(f"gendom::{kind}_gather_adjoint(body, bars, w);")
    def gather_adjoint(body: Body, bars: Bars, w: int): ...

    @wp.func
    def quat_of(R: wp.mat33d):
        q = wp.quat_from_matrix(R)
        return quat(real(q[0]), real(q[1]), real(q[2]), real(q[3]))

    @wp.func
    def wide(a: vec3):
        return wp.vec3d(wp.float64(a[0]), wp.float64(a[1]), wp.float64(a[2]))

    @wp.func
    def kick_of(plan: Plan, w: int, p: int, k: int):
        """Time from the middle of the previous step to the middle of step k of a piece [s]."""
        kick = plan.dt[w, p]
        if k == 0:
            kick = wp.float64(0.5) * (plan.before[w, p] + kick)
        return real(kick)

    @wp.func_native(f"return gendom::{kind}_stretch(body, state, row);")
    def mean_stretch(body: Body, state: wp.array3d(dtype=real), row: int) -> real: ...

    @wp.func_native("return gendom::moved_on(body, w, state, row, c, far);")
    def moved_on(
        body: Body, w: int, state: wp.array3d(dtype=real), row: int, c: int, far: real
    ) -> int: ...

    @wp.func_native("gendom::begin_list(body, w, state, row, c);")
    def begin_list(body: Body, w: int, state: wp.array3d(dtype=real), row: int, c: int): ...

    @wp.func_native("gendom::list_pairs(body, w);")
    def list_pairs(body: Body, w: int): ...

    @wp.func_native("return gendom::near_pairs(body, w).number();")
    def number_near(body: Body, w: int) -> int: ...

    @wp.func_native("gendom::begin_close(body, w);")
    def begin_close(body: Body, w: int): ...

    @wp.func_native("gendom::list_close(body, w, state, row);")
    def list_close(body: Body, w: int, state: wp.array3d(dtype=real), row: int): ...

    @wp.func_native("gendom::count_contacts(body, w, state, row);")
    def count_contacts(body: Body, w: int, state: wp.array3d(dtype=real), row: int): ...

    @wp.func_native("return gendom::push_apart(body, w, state, row, dt, turn);")
    def push_apart(
        body: Body, w: int, state: wp.array3d(dtype=real), row: int, dt: real, turn: int
    ) -> int: ...

    @wp.func_native("gendom::take_push(body, w, state, row);")
    def take_push(body: Body, w: int, state: wp.array3d(dtype=real), row: int): ...

    @wp.func_native("gendom::end_turn(body, w, state, row);")
    def end_turn(body: Body, w: int, state: wp.array3d(dtype=real), row: int): ...

    @wp.func_native("gendom::end_turn_adjoint(body, bars, w, state, row);")
    def end_turn_adjoint(
        body: Body, bars: Bars, w: int, state: wp.array3d(dtype=real), row: int
    ): ...

    @wp.func
    def relist(body: Body, w: int, state: wp.array3d(dtype=real), row: int, c: int, far: real):
        """List pairs anew if a point of components c to c + 2 has moved farther than this."""
        if any_of(moved_on(body, w, state, row, c, far)) != 0:
            begin_list(body, w, state, row, c)
            meet()
            list_pairs(body, w)
            meet()

    @wp.func
    def choose_close(body: Body, w: int, state: wp.array3d(dtype=real), row: int):
        """List those of the pairs that a step's turns go over."""
        begin_close(body, w)
        meet()
        list_close(body, w, state, row)
        meet()

    @wp.func
    def meet_itself(body: Body, w: int, state: wp.array3d(dtype=real), row: int, dt: real):
        """Apply self-contact at the end of a step."""
        relist(body, w, state, row, 0, real(0.5) * body.contact_margin)
        if number_near(body, w) > 0:
            choose_close(body, w, state, row)
            for turn in range(body.contact_most_turns):
                count_contacts(body, w, state, row)
                meet()
                again = any_of(push_apart(body, w, state, row, dt, turn))
                end_turn(body, w, state, row)
                meet()
                if again == 0:
                    break

    @wp.func_native("gendom::keep_list(body, w, state, row, c);")
    def keep_list(body: Body, w: int, state: wp.array3d(dtype=real), row: int, c: int): ...

    @wp.func_native("gendom::keep_turn(body, kept, at, state, row, turn);")
    def keep_turn(
        body: Body, kept: wp.array3d(dtype=real), at: int, state: wp.array3d(dtype=real), row: int,
        turn: int,
    ): ...  # fmt: skip

    @wp.func_native("gendom::put_back(body, kept, at, state, row, turn);")
    def put_back(
        body: Body, kept: wp.array3d(dtype=real), at: int, state: wp.array3d(dtype=real), row: int,
        turn: int,
    ): ...  # fmt: skip

    @wp.func_native("gendom::push_apart_adjoint(body, bars, w, state, row, dt, turn);")
    def push_apart_adjoint(
        body: Body, bars: Bars, w: int, state: wp.array3d(dtype=real), row: int, dt: real,
        turn: int,
    ): ...  # fmt: skip

    @wp.func
    def meet_itself_adjoint(
        body: Body, bars: Bars, turns_kept: wp.array3d(dtype=real), w: int, at: int,
        state: wp.array3d(dtype=real), row: int, dt: real,
    ):  # fmt: skip
        """Transpose of ``meet_itself``; the row is as that found it, with the list it kept."""
        relist(body, w, state, row, state.shape[1] - LISTED, real(0.0))
        if number_near(body, w) > 0:
            choose_close(body, w, state, row)
            turns = int(0)
            for turn in range(body.contact_most_turns):
                keep_turn(body, turns_kept, at, state, row, turn)
                count_contacts(body, w, state, row)
                meet()
                again = any_of(push_apart(body, w, state, row, dt, turn))
                end_turn(body, w, state, row)
                meet()
                turns += 1
                if again == 0:
                    break
            for back in range(turns):
                turn = turns - 1 - back
                end_turn_adjoint(body, bars, w, state, row)
                meet()
                put_back(body, turns_kept, at, state, row, turn)
                meet()
                count_contacts(body, w, state, row)
                meet()
                push_apart_adjoint(body, bars, w, state, row, dt, turn)
                meet()
                take_push(body, w, bars.state, w)
                meet()

    @wp.func
    def strains_begin(body: Body, w: int, state: wp.array3d(dtype=real), row: int):
        """Set the lagged strains to the strains of the state."""
        forces(body, w, state, row, row, real(1.0e30))

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def begin(first: int, lanes: int, body: Body, state: wp.array3d(dtype=real)):
        w = first + wp.tid() // lanes
        strains_begin(body, w, state, w)

    @wp.func
    def hold_all(
        body: Body, w: int, began: wp.float64, t: wp.float64, paths: Paths,
        state: wp.array3d(dtype=real), row: int,
    ):  # fmt: skip
        """Move held points to the poses at time t of the grippers that were closed at ``began``."""
        for g in range(body.holds.shape[1]):
            if is_closed(w, g, began, paths):
                centre, R, _knot = pose(w, g, t, paths)
                hold(body, w, g, narrow(centre), quat_of(R), state, row)
                meet()

    @wp.func
    def hold_all_adjoint(
        body: Body, bars: Bars, w: int, lane: int, began: wp.float64, t: wp.float64, paths: Paths
    ):
        """Transpose of ``hold_all``."""
        for before in range(body.holds.shape[1]):
            g = body.holds.shape[1] - 1 - before
            if lane == 0 and is_closed(w, g, began, paths):
                _centre, R, _knot = pose(w, g, t, paths)
                hold_adjoint(body, bars, w, g, quat_of(R))
                by_centre = bars.centre[w, g]
                by_turn = bars.turn[w, g]
                pose_adjoint(
                    w, g, t, wide(by_centre), wide(by_turn), paths, bars.position, bars.path_turn
                )
        meet()

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def advance(
        first: int,  # world
        lanes: int,  # threads of a world
        body: Body,
        paths: Paths,
        plan: Plan,
        piece: wp.array2d(dtype=wp.int32),  # [W, 2] first piece, and the one after the last
        # step k of the call goes from row w + k stride - offset to the next; stride 0: in place
        offset: int,
        stride: int,
        state: wp.array3d(dtype=real),
        # [W + pieces * every] states at the start of pieces; with LISTED more components they, and
        # the states of a stride, tell what the list of pairs was made from
        kept: wp.array3d(dtype=real),
        every: int,  # -1: none are kept
        limit: real,  # of the squared stretch of an edge
        mean_limit: real,  # of the mean stretch, every CHECKED steps and where pieces end
        stopped: wp.array(dtype=wp.int32),  # [W] the piece in which a world exceeded a limit, or -1
        stopped_at: wp.array(dtype=wp.float64),  # [W] when [s]
        frames: wp.array3d(dtype=vec3),  # [T, W, K]
        points: wp.array(dtype=wp.int32),  # [K] recorded
    ):
        w = first + wp.tid() // lanes
        lane = wp.tid() % lanes
        row = w - offset
        for p in range(piece[w, 0], piece[w, 1]):
            if stopped[w] < 0:
                if every >= 0:
                    for c in range(state.shape[1]):
                        for i in range(lane, state.shape[2], lanes):
                            kept[w + p * every, c, i] = state[row, c, i]
                    if kept.shape[1] > state.shape[1]:
                        keep_list(body, w, kept, w + p * every, state.shape[1])
                if body.contact * stride > 0:
                    relist(body, w, state, row, state.shape[1] - LISTED, real(0.0))
                t0 = plan.begins[w, p]
                dt = plan.dt[w, p]
                h = real(dt)
                bad = int(0)
                t = t0 + wp.float64(plan.done[w, p]) * dt
                for k in range(plan.steps[w, p]):
                    if not forces(body, w, state, row, row + stride, h) <= limit:
                        bad = 1
                    meet()
                    move(body, w, state, row, row + stride, h, kick_of(plan, w, p, k))
                    row += stride
                    meet()
                    t = t0 + wp.float64(plan.done[w, p] + k + 1) * dt
                    hold_all(body, w, t0, t, paths, state, row)
                    if body.contact == 1:
                        meet_itself(body, w, state, row, h)
                        if stride > 0:
                            keep_list(body, w, state, row, state.shape[1] - LISTED)
                    if (k + 1) % CHECKED == 0:
                        if not mean_stretch(body, state, row) <= mean_limit:
                            bad = 1
                        if any_of(bad) != 0:
                            break
                    if t > body.torn_from[w]:
                        bad = 1
                        break
                if not mean_stretch(body, state, row) <= mean_limit:
                    bad = 1
                if body.contact == 1:  # noqa: SIM102 - Warp evaluates both sides of `and`
                    if body.near_count[w, 0] + body.near_count[w, 1] > body.near.shape[1]:
                        bad = 1
                if any_of(bad) != 0:
                    stopped[w] = p
                    stopped_at[w] = t
                else:
                    f = plan.frame[w, p]
                    if f >= 0:
                        for k in range(lane, points.shape[0], lanes):
                            i = body.slot[points[k]]
                            frames[f, w, k] = vec3(
                                state[row, 0, i], state[row, 1, i], state[row, 2, i]
                            )
                meet()

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def reverse(
        first: int,
        lanes: int,
        body: Body,
        paths: Paths,
        plan: Plan,
        s: wp.array(dtype=wp.int32),  # [W] the piece, recorded in rows as by ``advance``; -1: none
        offset: int,
        stride: int,
        state: wp.array3d(dtype=real),
        frames_bar: wp.array3d(dtype=vec3),  # [T, W, n]
        bars: Bars,
        turns_kept: wp.array3d(dtype=real),  # [., 6 turns, P] points before each of a step's turns
    ):
        w = first + wp.tid() // lanes
        lane = wp.tid() % lanes
        p = s[w]
        if p < 0:
            return
        f = plan.frame[w, p]
        if f >= 0:
            for k in range(lane, body.points, lanes):
                i = body.slot[k]
                for c in range(3):
                    bars.state[w, c, i] = bars.state[w, c, i] + frames_bar[f, w, k][c]
        meet()
        dt = plan.dt[w, p]
        h = real(dt)
        t0 = plan.begins[w, p]
        steps = plan.steps[w, p]
        for back in range(steps):
            k = steps - 1 - back
            row = w - offset + k * stride
            t = t0 + wp.float64(plan.done[w, p] + k + 1) * dt
            # recompute the scratch of the step; this rewrites the lagged strains of the next row
            forces(body, w, state, row, row + stride, h)
            meet()
            if body.contact == 1:
                # the next row as contacts found it; steps from there have been transposed
                move(body, w, state, row, row + stride, h, kick_of(plan, w, p, k))
                meet()
                hold_all(body, w, t0, t, paths, state, row + stride)
                meet_itself_adjoint(body, bars, turns_kept, w, w - offset, state, row + stride, h)
            hold_all_adjoint(body, bars, w, lane, t0, t, paths)
            move_adjoint(body, bars, w, state, row, h, kick_of(plan, w, p, k))
            meet()
            forces_adjoint(body, bars, w, state, row, h)
            meet()
            gather_adjoint(body, bars, w)
            meet()

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def begin_adjoint(
        first: int, lanes: int, body: Body, state: wp.array3d(dtype=real), offset: int, bars: Bars
    ):
        """Transpose of ``begin``; the scratch of the derivatives is 0."""
        w = first + wp.tid() // lanes
        forces_adjoint(body, bars, w, state, w - offset, real(1.0e30))
        meet()
        gather_adjoint(body, bars, w)

    return SimpleNamespace(
        begin=begin, advance=advance, reverse=reverse, begin_adjoint=begin_adjoint, meet=meet,
        any_of=any_of, forces=forces, move=move, hold_all=hold_all, mean_stretch=mean_stretch,
        hold_all_adjoint=hold_all_adjoint, meet_itself=meet_itself,
        forces_adjoint=forces_adjoint, gather_adjoint=gather_adjoint,
    )  # fmt: skip
