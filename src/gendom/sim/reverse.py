"""The substep backwards: derivatives of a loss carried from a later state to an earlier one.

The CPU kernel walks through one recorded stretch of one world from its last substep to its
first; on CUDA each stage of a substep is a kernel over all worlds. Each substep's grid is kept by
the recording, so only the grid's velocities are made again; the transposes are those of
``transfers``, ``boundary`` and ``materials.laws``.

A name with ``_bar`` is the derivative of the loss by that quantity. Shapes: W worlds, N
particles, G grippers, K path knots, S recorded substeps, X x Y grid columns, M nodes.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.columns import Columns
from gendom.sim.kernels import OK, make_kernels
from gendom.sim.stencil import FUSED

NOT_FINITE = 4
"""Status of a world whose derivatives overflowed."""


@functools.cache
def make_reverse(real: Any, law_name: str, *, plastic: bool) -> SimpleNamespace:
    """Build the kernels that reverse recorded substeps.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        law_name: Elastic law, see ``gendom.materials.laws``.
        plastic: Whether particles yield.

    Returns:
        Namespace with ``reverse`` (CPU: a recorded stretch of one world) and with the stages of
        one substep of all worlds (CUDA): ``tense_again`` (of elastic bodies), ``grid_again``,
        ``gather_back``, ``grid_back``, ``scatter_back``, ``world_back``, and of elastic bodies
        ``tense_back`` and ``slacken_all``, to be called in this order. Substep r of a graph is
        reversed in the worlds that have done it (``r < done[w]``).
    """
    k = make_kernels(real, law_name, plastic=plastic)
    vec3, vec4 = k.vec3, k.vec4
    boundary, transfers = k.boundary, k.transfers
    Scene, Paths, Grips = boundary.Scene, boundary.Paths, boundary.Grips
    SceneBars = boundary.SceneBars
    Matter, State, MatterBars = transfers.Matter, transfers.State, transfers.MatterBars
    place_gripper = boundary.place_gripper
    place_gripper_back = boundary.place_gripper_back
    update_node = boundary.update_node
    update_node_back = boundary.update_node_back
    scatter_particle_back = transfers.scatter_particle_back
    move_particle_back = transfers.move_particle_back
    tense_particle = transfers.tense_particle
    tense_body = transfers.tense_body
    tense_body_back = transfers.tense_body_back
    pull_type = transfers.pull_type
    tense_particle_back = transfers.tense_particle_back
    slacken = transfers.slacken
    yields = transfers.yields
    largest = 1.0e37 if real == wp.float32 else 1.0e300

    @wp.struct
    class Trouble:
        """Where a derivative overflowed."""

        status: wp.array(dtype=wp.int32)  # [W]
        slot: wp.array(dtype=wp.int32)  # [W] substep
        culprit: wp.array(dtype=wp.int32)  # [W] particle

    @wp.func
    def close_substep(
        w: int,
        row: int,
        t: wp.float64,
        dt: wp.float64,
        scene: Scene,
        paths: Paths,
        grips: Grips,
        bars: SceneBars,
    ):
        """What a substep's nodes say of grippers' paths and of damping; both begin anew."""
        for g in range(grips.closed.shape[1]):
            if grips.closed[row, g] == 1:
                place_gripper_back(w, g, t, dt, paths, bars)
            bars.centre[w, g] = wp.vec3d()
            bars.velocity[w, g] = wp.vec3d()
        h = real(dt)
        bars.damping[w] = (
            bars.damping[w] - wp.float64(h * wp.exp(-scene.damping[w] * h)) * bars.keep[w]
        )
        bars.keep[w] = wp.float64(0.0)

    # ---- CPU: one thread, one world, many substeps -------------------------------------------

    @wp.kernel(enable_backward=False, module="unique", module_options=FUSED)
    def reverse(
        w: int,
        slots: int,  # substeps to reverse
        begun: int,  # number in its frame of the first recorded substep
        time: wp.float64,  # [s] at substep 0 of the frame
        dt: wp.float64,  # [s]
        matter: Matter,
        scene: Scene,
        paths: Paths,
        grips: Grips,  # [W]
        pulls: wp.array2d(dtype=pull_type),  # [W, N] scratch
        # the recording
        state: State,  # [S + 1, N]
        columns: Columns,  # S layouts
        layout_of: wp.array(dtype=wp.int32),  # [S]
        momentum: wp.array2d(dtype=vec4),  # [S, M]
        # scratch
        velocity: wp.array2d(dtype=vec4),  # [1, M]
        grid_bar: wp.array2d(dtype=vec4),  # [1, M]
        # by the state: of the last row on entry, of the first on return
        bars: MatterBars,
        scene_bars: SceneBars,
        trouble: Trouble,
    ):
        N = state.x.shape[1]
        z0 = scene.z0
        inv_dx = real(1.0) / scene.dx
        h = real(dt)
        keep = wp.exp(-scene.damping[w] * h)
        status = int(OK)
        slot = int(slots - 1)
        while slot >= 0 and status == OK:
            layout = layout_of[slot]
            nodes = columns.count[layout]
            t = time + wp.float64(begun + slot) * dt
            for g in range(grips.closed.shape[1]):
                place_gripper(w, w, g, t, dt, paths, grips)
            # while, not range: see ``gendom.sim.kernels``
            if yields == 0:
                tense_body(w, slot, h, matter, state, pulls)
            n = int(0)
            while n < nodes:
                grid_bar[0, n] = vec4()
                velocity[0, n] = vec4()
                q = momentum[slot, n]
                if q[3] > real(0.0):
                    u = update_node(w, w, layout, n, q, h, keep, scene, paths, grips, columns)
                    velocity[0, n] = vec4(u[0], u[1], u[2], q[3])
                n += 1
            p = int(0)
            while p < N:
                move_particle_back(
                    w, p, slot, layout, 0, h, inv_dx, z0, matter, columns, velocity, state,
                    grid_bar, bars,
                )  # fmt: skip
                p += 1
            by_keep = wp.float64(0.0)
            by_gravity = wp.vec3d()
            n = int(0)
            while n < nodes:
                q = momentum[slot, n]
                if q[3] > real(0.0):
                    b = grid_bar[0, n]
                    node_bar, keep_bar, gravity_bar = update_node_back(
                        w, w, layout, n, q, vec3(b[0], b[1], b[2]), h, keep, scene, paths, grips,
                        columns, scene_bars,
                    )  # fmt: skip
                    grid_bar[0, n] = node_bar
                    by_keep += keep_bar
                    by_gravity += gravity_bar
                n += 1
            scene_bars.keep[w] = scene_bars.keep[w] + by_keep
            scene_bars.gravity[w] = scene_bars.gravity[w] + by_gravity
            close_substep(w, w, t, dt, scene, paths, grips, scene_bars)
            p = int(0)
            while p < N:
                size = scatter_particle_back(
                    w, p, slot, layout, 0, h, inv_dx, z0, matter, state, pulls, columns, grid_bar,
                    bars,
                )  # fmt: skip
                if not (size < real(largest)) and status == OK:
                    status = NOT_FINITE
                    trouble.culprit[w] = p
                    trouble.slot[w] = slot
                p += 1
            if yields == 0:
                tense_body_back(w, slot, h, matter, state, bars, pulls)
                p = int(0)
                while p < N:
                    slacken(w, p, matter, bars, pulls)
                    p += 1
            slot -= 1
        trouble.status[w] = status

    # ---- CUDA: one substep of all worlds, stage by stage ---------------------------------------

    @wp.kernel(enable_backward=False)
    def tense_again(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        matter: Matter,
        state: State,
        pulls: wp.array2d(dtype=pull_type),
    ):
        """The substep's pulls once more."""
        w, p = wp.tid()
        if r < done[w]:
            tense_particle(w, p, w, real(dt[w]), matter, state, pulls)

    @wp.kernel(enable_backward=False)
    def grid_again(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        scene: Scene,
        paths: Paths,
        grips: Grips,  # [GRAPH * W, G]
        columns: Columns,
        momentum: wp.array2d(dtype=vec4),
        velocity: wp.array2d(dtype=vec4),
        grid_bar: wp.array2d(dtype=vec4),
    ):
        """Velocities of the substep's grid once more, and an empty grid of derivatives."""
        w, n = wp.tid()
        if n >= columns.count[w] or r >= done[w]:
            return
        q = momentum[w, n]
        u = vec3()
        if q[3] > real(0.0):
            h = real(dt[w])
            u = update_node(
                w, r * done.shape[0] + w, w, n, q, h, wp.exp(-scene.damping[w] * h),
                scene, paths, grips, columns,
            )  # fmt: skip
        velocity[w, n] = vec4(u[0], u[1], u[2], q[3])
        grid_bar[w, n] = vec4()

    @wp.kernel(enable_backward=False)
    def gather_back(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        matter: Matter,
        scene: Scene,
        columns: Columns,
        velocity: wp.array2d(dtype=vec4),
        state: State,
        grid_bar: wp.array2d(dtype=vec4),
        bars: MatterBars,
    ):
        w, p = wp.tid()
        if r < done[w]:
            move_particle_back(
                w, p, w, w, w, real(dt[w]), real(1.0) / scene.dx, scene.z0, matter, columns,
                velocity, state, grid_bar, bars,
            )  # fmt: skip

    @wp.kernel(enable_backward=False)
    def grid_back(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        scene: Scene,
        paths: Paths,
        grips: Grips,  # [GRAPH * W, G]
        columns: Columns,
        momentum: wp.array2d(dtype=vec4),
        grid_bar: wp.array2d(dtype=vec4),
        scene_bars: SceneBars,
    ):
        w, n = wp.tid()
        if n >= columns.count[w] or r >= done[w]:
            return
        q = momentum[w, n]
        if q[3] > real(0.0):
            h = real(dt[w])
            b = grid_bar[w, n]
            node_bar, keep_bar, gravity_bar = update_node_back(
                w, r * done.shape[0] + w, w, n, q, vec3(b[0], b[1], b[2]), h,
                wp.exp(-scene.damping[w] * h), scene, paths, grips, columns, scene_bars,
            )  # fmt: skip
            grid_bar[w, n] = node_bar
            wp.atomic_add(scene_bars.keep, w, keep_bar)
            wp.atomic_add(scene_bars.gravity, w, gravity_bar)

    @wp.kernel(enable_backward=False)
    def scatter_back(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        matter: Matter,
        scene: Scene,
        columns: Columns,
        state: State,
        pulls: wp.array2d(dtype=pull_type),
        grid_bar: wp.array2d(dtype=vec4),
        bars: MatterBars,
        trouble: Trouble,
    ):
        w, p = wp.tid()
        if r >= done[w]:
            return
        size = scatter_particle_back(
            w, p, w, w, w, real(dt[w]), real(1.0) / scene.dx, scene.z0, matter, state, pulls,
            columns, grid_bar, bars,
        )  # fmt: skip
        # the first one found is named; a NaN is not below anything
        if not (size < real(largest)) and wp.atomic_max(trouble.status, w, NOT_FINITE) == OK:
            trouble.culprit[w] = p
            trouble.slot[w] = r

    @wp.kernel(enable_backward=False)
    def world_back(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        step: wp.array(dtype=wp.int32),  # [W] substeps of the frame done before the graph
        time: wp.float64,
        scene: Scene,
        paths: Paths,
        grips: Grips,  # [GRAPH * W, G]
        scene_bars: SceneBars,
    ):
        w = wp.tid()
        if r < done[w]:
            t = time + wp.float64(step[w] + r) * dt[w]
            row = r * done.shape[0] + w
            close_substep(w, row, t, dt[w], scene, paths, grips, scene_bars)

    @wp.kernel(enable_backward=False)
    def tense_back(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        matter: Matter,
        state: State,
        bars: MatterBars,
        stretches: wp.array2d(dtype=pull_type),
    ):
        w, p = wp.tid()
        if r < done[w]:
            tense_particle_back(w, p, w, real(dt[w]), matter, state, bars, stretches)

    @wp.kernel(enable_backward=False)
    def slacken_all(
        r: int,
        done: wp.array(dtype=wp.int32),
        matter: Matter,
        bars: MatterBars,
        stretches: wp.array2d(dtype=pull_type),
    ):
        w, p = wp.tid()
        if r < done[w]:
            slacken(w, p, matter, bars, stretches)

    return SimpleNamespace(
        Trouble=Trouble,
        close_substep=close_substep,
        largest=largest,
        reverse=reverse,
        tense_again=tense_again,
        grid_again=grid_again,
        gather_back=gather_back,
        grid_back=grid_back,
        scatter_back=scatter_back,
        world_back=world_back,
        tense_back=tense_back,
        slacken_all=slacken_all,
    )
