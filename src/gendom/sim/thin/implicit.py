"""Rods that move in implicit steps, see ``native/rod_implicit.h``.

A step whose Newton's method does not converge is halved, down to ``SHORTEST`` of it.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.errors import ParameterError
from gendom.sim.device import making
from gendom.sim.paths import make_path_type
from gendom.sim.setting import Setting
from gendom.sim.thin.native import MODULE_OPTIONS
from gendom.sim.thin.rods import Rods
from gendom.sim.thin.run import Job
from gendom.sim.thin.schedule import Schedule
from gendom.sim.thin.stepping import make_stepping
from gendom.sim.thin.tears import LOCAL_STRETCH, STRETCH
from gendom.sim.thin.types import make_types

SHARE = 1.0 - math.sqrt(0.5)
"""Length of a stage over that of a step."""

FURTHER = (1.0 - SHARE) / SHARE
"""How much further the second stage begins than the first one went."""

SUBSTEP = 0.002
"""Default length of an implicit step [s]."""

SHORTEST = 1.0 / 64.0
"""Share of a step below which it is not halved any more."""

BLOCK_ROW, TOUCHING = 152, 4
"""Numbers of a point in Newton's matrix, and of what it touches."""


@functools.cache
def make_implicit(real: Any) -> SimpleNamespace:
    """Build the kernels for one scalar type.

    Returns:
        Namespace with ``advance`` and ``reverse``.
    """
    types, step = make_types(real), make_stepping(real, "rod")
    meet, any_of, hold_all, mean_stretch = step.meet, step.any_of, step.hold_all, step.mean_stretch
    Paths = make_path_type(real)
    Body, Bars, Plan, vec3 = types.Body, types.Bars, types.Plan, types.vec3
    Record = make_record(real)
    hold_all_adjoint = step.hold_all_adjoint

    @wp.func_native("gendom::stage_begin(body, w, base, ahead, work, touches, span);")
    def begin(
        body: Body, w: int, base: wp.array3d(dtype=real), ahead: wp.array3d(dtype=real),
        work: wp.array3d(dtype=real), touches: wp.array3d(dtype=real), span: real,
    ): ...  # fmt: skip

    @wp.func_native("return gendom::stage_find(body, w, base, ahead, work, touches, span);")
    def find(
        body: Body, w: int, base: wp.array3d(dtype=real), ahead: wp.array3d(dtype=real),
        work: wp.array3d(dtype=real), touches: wp.array3d(dtype=real), span: real,
    ) -> int: ...  # fmt: skip

    @wp.func_native("return gendom::stage_finish(body, w, base, ahead, work, touches, span);")
    def finish(
        body: Body, w: int, base: wp.array3d(dtype=real), ahead: wp.array3d(dtype=real),
        work: wp.array3d(dtype=real), touches: wp.array3d(dtype=real), span: real,
    ) -> int: ...  # fmt: skip

    @wp.func_native("gendom::stage_go_on(body, w, state, base, ahead, work, touches, further);")
    def go_on(
        body: Body, w: int, state: wp.array3d(dtype=real), base: wp.array3d(dtype=real),
        ahead: wp.array3d(dtype=real), work: wp.array3d(dtype=real),
        touches: wp.array3d(dtype=real), further: real,
    ): ...  # fmt: skip

    @wp.func_native("return gendom::stage_stretch(body, w, ahead, work, touches);")
    def stretched(
        body: Body, w: int, ahead: wp.array3d(dtype=real), work: wp.array3d(dtype=real),
        touches: wp.array3d(dtype=real),
    ) -> real: ...  # fmt: skip

    @wp.func
    def copy(
        lane: int, lanes: int, a: wp.array3d(dtype=real), row: int, b: wp.array3d(dtype=real),
        to: int,
    ):  # fmt: skip
        """Copy what one row of a has to a row of b."""
        for c in range(a.shape[1]):
            for i in range(lane, a.shape[2], lanes):
                b[to, c, i] = a[row, c, i]
        meet()

    @wp.func
    def stage(
        body: Body, w: int, lane: int, began: wp.float64, until: wp.float64, paths: Paths,
        base: wp.array3d(dtype=real), ahead: wp.array3d(dtype=real), work: wp.array3d(dtype=real),
        touches: wp.array3d(dtype=real), solves: wp.array(dtype=wp.int32), span: real,
    ) -> int:  # fmt: skip
        """Take a stage that ends at ``until``: -1: not found, 1: something landed, 0: else."""
        if lane == 0:
            begin(body, w, base, ahead, work, touches, span)
        meet()
        hold_all(body, w, began, until, paths, ahead, w)
        failed = int(0)
        landed = int(0)
        if lane == 0:
            systems = find(body, w, base, ahead, work, touches, span)
            if systems < 0:
                failed = 1
            else:
                solves[w] = solves[w] + systems
                landed = finish(body, w, base, ahead, work, touches, span)
        if any_of(failed) != 0:
            return -1
        return any_of(landed)

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def advance(
        first: int,  # world
        lanes: int,  # threads of a world
        body: Body,
        paths: Paths,
        plan: Plan,
        piece: wp.array2d(dtype=wp.int32),  # [W, 2] first piece, and the one after the last
        state: wp.array3d(dtype=real),
        base: wp.array3d(dtype=real),  # [W, ., P] from where a stage begins
        ahead: wp.array3d(dtype=real),  # [W, ., P] where it ends
        work: wp.array3d(dtype=real),  # [W, n, BLOCK_ROW]
        touches: wp.array3d(dtype=real),  # [W, n, TOUCHING]
        kept: wp.array3d(dtype=real),  # [W, ., P] states at the start of pieces
        limit: real,  # of the squared stretch of an edge
        mean_limit: real,  # of the mean stretch
        solves: wp.array(dtype=wp.int32),  # [W] linear systems, added
        stuck: wp.array(dtype=wp.int32),  # [W] 2: Newton's method does not converge, 3: no room
        stopped: wp.array(dtype=wp.int32),  # [W] the piece in which a world ended, or -1
        stopped_at: wp.array(dtype=wp.float64),  # [W] when [s]
        frames: wp.array3d(dtype=vec3),  # [T, W, K]
        points: wp.array(dtype=wp.int32),  # [K] recorded
        record: Record,
    ):
        w = first + wp.tid() // lanes
        lane = wp.tid() % lanes
        for p in range(piece[w, 0], piece[w, 1]):
            if stopped[w] < 0:
                copy(lane, lanes, state, w, kept, w)
                t0 = plan.begins[w, p]
                whole = plan.dt[w, p]
                bad = int(0)
                t = t0
                for k in range(plan.steps[w, p]):
                    t = t0 + wp.float64(k) * whole
                    until = t0 + wp.float64(k + 1) * whole
                    dt = whole
                    while t < until and bad == 0:
                        part = wp.float64(SHARE) * dt
                        stages = int(2)
                        r = w * record.most + record.count[w]
                        if record.most > 0:
                            if record.count[w] + 1 >= record.most:
                                bad = 3
                                break
                            copy(lane, lanes, state, w, record.starts, r)
                        copy(lane, lanes, state, w, base, w)
                        copy(lane, lanes, state, w, ahead, w)
                        found = stage(
                            body, w, lane, t0, t + part, paths, base, ahead, work, touches, solves,
                            real(part),
                        )  # fmt: skip
                        if found == 0:
                            if record.most > 0:
                                copy(lane, lanes, ahead, w, record.firsts, r)
                                copy(lane, lanes, touches, w, record.first_touches, r)
                            if lane == 0:
                                go_on(
                                    body, w, state, base, ahead, work, touches,
                                    real(FURTHER),
                                )  # fmt: skip
                            meet()
                            found = stage(
                                body, w, lane, t0, t + dt, paths, base, ahead, work, touches,
                                solves, real(part),
                            )  # fmt: skip
                        if found != 0:  # it lands, or is not found: a single stage
                            stages = 1
                            copy(lane, lanes, state, w, base, w)
                            copy(lane, lanes, state, w, ahead, w)
                            found = stage(
                                body, w, lane, t0, t + dt, paths, base, ahead, work, touches,
                                solves, real(dt),
                            )  # fmt: skip
                        if found < 0:
                            dt = wp.float64(0.5) * dt
                            if dt < wp.float64(SHORTEST) * whole:
                                bad = 2
                        else:
                            copy(lane, lanes, ahead, w, state, w)
                            if record.most > 0:
                                copy(lane, lanes, ahead, w, record.ends, r)
                                copy(lane, lanes, touches, w, record.touches, r)
                                if lane == 0:
                                    record.stages[r] = stages
                                    record.frame[r] = -1
                                    record.began[r] = t0
                                    record.time[r] = t
                                    record.dt[r] = dt
                                    record.count[w] = record.count[w] + 1
                                meet()
                            t += dt
                            if t > until - wp.float64(1.0e-6) * whole:
                                t = until
                            hold_all(body, w, t0, t, paths, state, w)
                            dt = wp.min(whole, until - t)
                            if not stretched(body, w, state, work, touches) <= limit:
                                bad = 1
                    if t > body.torn_from[w]:
                        bad = wp.max(bad, 1)
                    if bad != 0:
                        break
                if not mean_stretch(body, state, w) <= mean_limit:
                    bad = 1
                if bad != 0:
                    stopped[w] = p
                    stopped_at[w] = t
                    stuck[w] = bad
                else:
                    f = plan.frame[w, p]
                    if f >= 0:
                        if record.most > 0:
                            r = w * record.most + record.count[w]
                            if lane == 0:
                                record.stages[r] = 0
                                record.frame[r] = f
                                record.count[w] = record.count[w] + 1
                            meet()
                        for k in range(lane, points.shape[0], lanes):
                            i = body.slot[points[k]]
                            frames[f, w, k] = vec3(state[w, 0, i], state[w, 1, i], state[w, 2, i])
                meet()

    def adjoint_of(name: str) -> Any:
        @wp.func_native(
            f"gendom::stage_{name}_adjoint(body, bars, w, base, ahead, work, touches, base_bars, "
            "span);"
        )
        def adjoint(
            body: Body, bars: Bars, w: int, base: wp.array3d(dtype=real),
            ahead: wp.array3d(dtype=real), work: wp.array3d(dtype=real),
            touches: wp.array3d(dtype=real), base_bars: wp.array3d(dtype=real), span: real,
        ): ...  # fmt: skip

        return adjoint

    begin_adjoint, solve_adjoint = adjoint_of("begin"), adjoint_of("solve")
    end_adjoint, add_base = adjoint_of("end"), adjoint_of("add_base")
    go_on_adjoint = adjoint_of("go_on")
    forces_adjoint, gather_adjoint = step.forces_adjoint, step.gather_adjoint

    @wp.func
    def stage_adjoint(
        body: Body, w: int, lane: int, began: wp.float64, until: wp.float64, paths: Paths,
        base: wp.array3d(dtype=real), ahead: wp.array3d(dtype=real), work: wp.array3d(dtype=real),
        touches: wp.array3d(dtype=real), base_bars: wp.array3d(dtype=real), bars: Bars, span: real,
    ):  # fmt: skip
        """Transpose of ``stage``, whose base and end are given."""
        if lane == 0:
            begin_adjoint(body, bars, w, base, ahead, work, touches, base_bars, span)
        meet()
        # lagged strains follow the shape
        forces_adjoint(body, bars, w, ahead, w, span)
        meet()
        gather_adjoint(body, bars, w)
        meet()
        if lane == 0:
            solve_adjoint(body, bars, w, base, ahead, work, touches, base_bars, span)
        meet()
        hold_all_adjoint(body, bars, w, lane, began, until, paths)
        forces_adjoint(body, bars, w, ahead, w, span)
        meet()
        gather_adjoint(body, bars, w)
        meet()
        if lane == 0:
            end_adjoint(body, bars, w, base, ahead, work, touches, base_bars, span)
        meet()

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def reverse(
        first: int,
        lanes: int,
        body: Body,
        paths: Paths,
        record: Record,
        steps: wp.array2d(dtype=wp.int32),  # [W, 2] the first record, and the one after the last
        begun: wp.array3d(dtype=real),  # [W, ., P]
        base: wp.array3d(dtype=real),
        ahead: wp.array3d(dtype=real),
        work: wp.array3d(dtype=real),
        touches: wp.array3d(dtype=real),
        base_bars: wp.array3d(dtype=real),  # [W, 18, P]
        start_bars: wp.array3d(dtype=real),
        frames_bar: wp.array3d(dtype=vec3),  # [T, W, n]
        bars: Bars,
    ):
        w = first + wp.tid() // lanes
        lane = wp.tid() % lanes
        for back in range(steps[w, 1] - steps[w, 0]):
            r = w * record.most + steps[w, 1] - 1 - back
            stages = record.stages[r]
            f = record.frame[r]
            if f >= 0:
                for k in range(lane, body.points, lanes):
                    i = body.slot[k]
                    for c in range(3):
                        bars.state[w, c, i] = bars.state[w, c, i] + frames_bar[f, w, k][c]
            meet()
            t0 = record.began[r]
            t = record.time[r]
            dt = record.dt[r]
            part = wp.float64(SHARE) * dt
            if stages > 0:
                copy(lane, lanes, record.starts, r, begun, w)
                copy(lane, lanes, record.starts, r, base, w)
                if stages == 2:
                    copy(lane, lanes, record.firsts, r, ahead, w)
                    if lane == 0:
                        go_on(body, w, begun, base, ahead, work, touches, real(FURTHER))
                    meet()
                copy(lane, lanes, record.ends, r, ahead, w)
                copy(lane, lanes, record.touches, r, touches, w)
                span = dt
                if stages == 2:
                    span = part
                stage_adjoint(
                    body, w, lane, t0, t + dt, paths, base, ahead, work, touches, base_bars, bars,
                    real(span),
                )  # fmt: skip
            if stages == 2:
                copy(lane, lanes, record.firsts, r, ahead, w)
                copy(lane, lanes, record.first_touches, r, touches, w)
                if lane == 0:
                    go_on_adjoint(
                        body, bars, w, begun, ahead, work, touches, start_bars, real(FURTHER)
                    )
                meet()
                stage_adjoint(
                    body, w, lane, t0, t + part, paths, begun, ahead, work, touches, base_bars,
                    bars, real(part),
                )  # fmt: skip
                if lane == 0:
                    add_base(body, bars, w, begun, ahead, work, touches, start_bars, real(part))
                meet()

    return SimpleNamespace(advance=advance, reverse=reverse)


@functools.cache
def make_record(real: Any) -> Any:
    """Make the struct of what the reverse pass needs of R steps or frames of each world."""

    @wp.struct
    class Record:
        most: int  # R; 0: nothing is recorded
        count: wp.array(dtype=wp.int32)  # [W]
        starts: wp.array3d(dtype=real)  # [W R, ., P] states where steps begin
        firsts: wp.array3d(dtype=real)  # where their first stages end
        ends: wp.array3d(dtype=real)  # where they end
        first_touches: wp.array3d(dtype=real)  # [W R, n, TOUCHING]
        touches: wp.array3d(dtype=real)
        stages: wp.array(dtype=wp.int32)  # [W R] 0: a frame
        frame: wp.array(dtype=wp.int32)
        began: wp.array(dtype=wp.float64)  # when the piece did [s]
        time: wp.array(dtype=wp.float64)  # when the step did [s]
        dt: wp.array(dtype=wp.float64)

    return Record


class ImplicitRods(Rods):
    """W rods of one shape that move in implicit steps."""

    def __init__(self, setting: Setting, *, substep: float | None, cfl: float | None):
        if cfl is not None:
            raise ParameterError("implicit steps have no limit of stability", fix="give substep")
        if setting.self_contact:
            raise ParameterError(
                "implicit steps do not resolve contact of a rod with itself",
                fix="integrator='explicit'",
            )
        if setting.dtype != "float64":
            raise ParameterError("implicit steps are solved in float64", fix="dtype='float64'")
        super().__init__(setting, substep=substep, cfl=cfl)
        W, n, P = self.num_worlds, self.num_points, self.row_length
        self.base = self.zeros((W, self.state_rows, P))
        self.ahead = self.zeros((W, self.state_rows, P))
        self.work = self.zeros((W, n, BLOCK_ROW))
        self.touches = self.zeros((W, n, TOUCHING))
        self.solves = self.zeros(W, wp.int32)
        """[W] number of linear systems solved so far."""
        self.stuck = self.zeros(W, wp.int32)
        self.body.implicit = 1
        self.record = self.recorded(0)
        self.implicit = make_implicit(self.real)
        with making:
            wp.load_module(
                self.implicit.advance.module, device=setting.device, block_dim=self.block
            )

    def recorded(self, most: int) -> Any:
        """Room for ``most`` steps and frames of each world."""
        record, W, P = make_record(self.real)(), self.num_worlds, self.row_length
        record.most = most
        record.count = self.zeros(W, wp.int32)
        for name in ("starts", "firsts", "ends"):
            setattr(record, name, self.zeros((W * most, self.state_rows, P)))
        for name in ("touches", "first_touches"):
            setattr(record, name, self.zeros((W * most, self.num_points, TOUCHING)))
        for name in ("stages", "frame"):
            setattr(record, name, self.zeros(W * most, wp.int32))
        for name in ("began", "time", "dt"):
            setattr(record, name, self.zeros(W * most, wp.float64))
        return record

    def substeps(self, substep: float | None, cfl: float | None) -> NDArray[np.float64]:
        return np.full(self.num_worlds, substep or SUBSTEP)

    def advance(self, job: Job, group: slice) -> None:
        self.launch(
            self.implicit.advance,
            group,
            [
                self.body, self.paths, job.on_device, job.pieces, self.state, self.base, self.ahead,
                self.work, self.touches, self.kept_state, LOCAL_STRETCH**2, STRETCH, self.solves,
                self.stuck, job.stopped, job.stopped_at, job.x, job.points,
                self.record,
            ],
        )  # fmt: skip

    def end_error(self, w: int, time: float, dt: float) -> Any:
        why = self.stuck.numpy()[w]
        if why == 1:
            return super().end_error(w, time, dt)
        if why == 3:
            return self.setting.error(
                w,
                time,
                f"more than {self.record.most} steps would have to be recorded",
                where=f"steps of {dt:.3g} s that are halved",
                fix="a smaller substep, or integrator='explicit'",
            )
        return self.setting.error(
            w,
            time,
            f"an implicit step of {SHORTEST * dt:.2g} s has no solution that Newton's method finds",
            where=f"steps of {dt:.3g} s",
            fix="a smaller substep, or integrator='explicit'",
        )

    def ended(self, plan: Schedule) -> NDArray[np.float64]:
        return np.zeros(self.num_worlds)  # velocities are those at the current time

    def tape(self, memory: float) -> Any:
        from gendom.sim.thin.implicit_tape import ImplicitTape

        return ImplicitTape(self)
