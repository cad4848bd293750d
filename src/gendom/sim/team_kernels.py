"""The substep on CUDA where worlds are few: a team of blocks takes one world through many.

The same functions as in ``kernels``, called by all threads of the team. A lane has one particle;
what waits for what then decides the pace, not how much there is to do. So the team meets but twice
a substep: particles that have moved give to the grid at once what they give in the next substep.

Shapes: W worlds, N particles, M grid nodes.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.columns import MARGIN, Columns
from gendom.sim.kernels import DIVERGED, GRID_FULL, INVERTED, OK, make_kernels
from gendom.sim.team import make_team
from gendom.sim.transfers import make_transfers

LANES = 64
"""Threads of a block."""

BLOCKS_AT_ONCE = 4
"""Blocks that are sure to fit on a multiprocessor at the same time."""

AHEAD = 32
"""Substeps for which grippers are placed at once."""


@functools.cache
def make_team_kernels(real: Any, law_name: str, *, plastic: bool) -> SimpleNamespace:
    """Build the kernel for one scalar type and one material, see ``make_kernels``.

    Returns:
        Namespace with ``advance``.
    """
    k = make_kernels(real, law_name, plastic=plastic)
    vec4 = k.vec4
    Clock, Plan, frame_substep = k.Clock, k.Plan, k.frame_substep
    forget_bounds = k.columns.forget_bounds
    locate_particle = k.columns.locate_particle
    mark_particle = k.columns.mark_particle
    empty_column = k.columns.empty_column
    lay_column = k.columns.lay_column
    Scene, Paths, Grips = k.boundary.Scene, k.boundary.Paths, k.boundary.Grips
    place_gripper = k.boundary.place_gripper
    update_node = k.boundary.update_node
    Matter, State = k.transfers.Matter, k.transfers.State
    scatter_particle = k.transfers.scatter_particle
    recovery_share = k.transfers.recovery_share
    recover_particle = k.transfers.recover_particle
    moved = make_transfers(real, k.law, straight=True).moved
    team = make_team(real)
    meet, lift = team.meet, team.lift

    @wp.kernel(enable_backward=False, module="unique", launch_bounds=(LANES, BLOCKS_AT_ONCE))
    def advance(
        members: int,  # blocks of a team; world w has blocks w * members and following
        lanes: int,  # threads of a team
        most: int,  # substeps at the most
        pause: wp.float64,  # [s] no substep begins from here on
        plan: Plan,
        clock: Clock,
        matter: Matter,
        scene: Scene,
        paths: Paths,
        grips: Grips,  # [W * AHEAD]
        state: State,  # [W, N]
        last_good: State,  # [W, N] where the last frame began
        columns: Columns,  # a layout a world
        momentum: wp.array2d(dtype=vec4),  # [W, M] and mass; empty before and after each substep
        velocity: wp.array2d(dtype=vec4),  # [W, M] and mass
        # scratch, 0 before the launch
        gate: wp.array(dtype=wp.int32),  # [W]
        peak: wp.array2d(dtype=real),  # [W, 2] longest way in even and in odd substeps
    ):
        block, thread = wp.tid()
        w = block // members
        lane = (block % members) * (lanes // members) + thread
        frames = plan.steps.shape[0]
        frame = int(clock.frame[w])
        status = int(clock.status[w])
        if frame >= frames or status != OK:
            return
        N = state.x.shape[1]
        dx = scene.dx
        z0 = scene.z0
        inv_dx = real(1.0) / dx
        begun = plan.time[frame]  # of the frame that the world is in
        steps = int(plan.steps[frame, w])
        dt = frame_substep(frame, w, plan)
        h = real(dt)
        keep = wp.exp(-scene.damping[w] * h)
        blend = recovery_share(h, matter)
        step = int(clock.step[w])
        t = begun + wp.float64(step) * dt
        age = clock.age[w]
        travel = clock.travel[w]
        left = int(most)
        ahead = int(0)  # substeps whose grippers are placed
        stride = real(0.0)  # longest way of the last substep [m]
        scattered = bool(False)  # whether the grid has what particles give in the next substep
        fresh = step == 0
        nodes = int(columns.count[w])
        came = int(members)
        meet(gate, w, came)
        while frame < frames and left > 0 and status == OK and t < pause:
            if fresh:
                for p in range(lane, N, lanes):
                    last_good.x[w, p] = state.x[w, p]
                    last_good.v[w, p] = state.v[w, p]
                    last_good.C[w, p] = state.C[w, p]
                    last_good.F[w, p] = state.F[w, p]
                fresh = False
            if step < steps and travel >= real(MARGIN) * dx:
                scattered = False
                if lane == 0:
                    columns.count[w] = 0
                    forget_bounds(w, columns)
                came += members
                meet(gate, w, came)
                for p in range(lane, N, lanes):
                    locate_particle(w, state.x[w, p], inv_dx, columns)
                came += members
                meet(gate, w, came)
                X = columns.bounds[w, 2] - columns.bounds[w, 0] + 1
                Y = columns.bounds[w, 3] - columns.bounds[w, 1] + 1
                status = GRID_FULL
                if X <= columns.low.shape[1] and Y <= columns.low.shape[2]:
                    for n in range(lane, X * Y, lanes):
                        empty_column(w, n // Y, n % Y, columns)
                    came += members
                    meet(gate, w, came)
                    for p in range(lane, N, lanes):
                        mark_particle(w, state.x[w, p], inv_dx, z0, columns)
                    came += members
                    meet(gate, w, came)
                    for n in range(lane, X * Y, lanes):
                        lay_column(w, n // Y, n % Y, columns)
                    came += members
                    meet(gate, w, came)
                    nodes = columns.count[w]
                    if nodes <= momentum.shape[1]:
                        status = OK
                        travel = real(0.0)
            if step < steps and status == OK:
                if ahead == 0:
                    # a path takes many steps to follow: once for all grippers of some substeps
                    ahead = AHEAD
                    G = grips.closed.shape[1]
                    for n in range(lane, AHEAD * G, lanes):
                        place_gripper(
                            w * AHEAD + (step + n // G) % AHEAD, w, n % G,
                            begun + wp.float64(step + n // G) * dt, dt, paths, grips,
                        )  # fmt: skip
                    scattered = False
                if not scattered:
                    recovers = age % RECOVER_EVERY == 0 and blend > real(0.0)
                    for p in range(lane, N, lanes):
                        if recovers:
                            recover_particle(p, w, blend, matter, state)
                        scatter_particle(
                            w, p, w, w, w, h, inv_dx, z0, matter, state, columns, momentum
                        )
                    came += members
                    meet(gate, w, came)
                for n in range(lane, nodes, lanes):
                    q = momentum[w, n]
                    if q[3] > real(0.0):
                        momentum[w, n] = vec4()
                        u = update_node(
                            w, w * AHEAD + step % AHEAD, w, n, q, h, keep, scene, paths, grips,
                            columns,
                        )  # fmt: skip
                        velocity[w, n] = vec4(u[0], u[1], u[2], q[3])
                came += members
                meet(gate, w, came)
                step += 1
                age += 1
                left -= 1
                ahead -= 1
                t = begun + wp.float64(step) * dt
                # unless something is to be done between substeps, particles go on to the next
                scattered = (
                    step < steps and left > 0 and t < pause and ahead > 0
                    and travel + real(1.2) * stride < real(MARGIN) * dx
                    and not (age % RECOVER_EVERY == 0 and blend > real(0.0))
                )  # fmt: skip
                if lane == 0:
                    peak[w, age % 2] = real(0.0)  # of the next substep
                # the longest way, in squared cells; above 1 what went wrong
                worst = real(0.0)
                for p in range(lane, N, lanes):
                    x = state.x[w, p]
                    v, C, F = moved(
                        x, state.F[w, p], matter.mu[w, p], matter.yield_stress[w], w, w, h, inv_dx,
                        z0, columns, velocity,
                    )  # fmt: skip
                    state.x[w, p] = x + h * v
                    state.v[w, p] = v
                    state.C[w, p] = C
                    state.F[w, p] = F
                    far = wp.length_sq(v) * h * h / (dx * dx)
                    # a NaN is not below anything
                    if not (wp.length_sq(v) * h * h <= dx * dx):
                        far = real(DIVERGED)
                    elif wp.determinant(F) <= real(0.0):
                        far = real(INVERTED)
                        clock.culprit[w] = p
                    worst = wp.max(worst, far)
                    if scattered and travel + dx * wp.sqrt(far) < real(MARGIN) * dx:
                        scatter_particle(
                            w, p, w, w, w, h, inv_dx, z0, matter, state, columns, momentum
                        )
                lift(peak, w, 1 - age % 2, worst)
                came += members
                meet(gate, w, came)
                worst = peak[w, 1 - age % 2]
                if worst > real(1.5):
                    status = int(worst)
                else:
                    stride = dx * wp.sqrt(worst)
                    travel += stride
                    if scattered and travel >= real(MARGIN) * dx:
                        # one went farther than it looked, and gave nothing
                        scattered = False
                        for n in range(lane, nodes, lanes):
                            momentum[w, n] = vec4()
                        came += members
                        meet(gate, w, came)
            if step == steps and status == OK:
                for c in range(lane, plan.particles.shape[0], lanes):
                    plan.x[frame, w, c] = state.x[w, plan.particles[c]]
                frame += 1
                if frame < frames:
                    begun = plan.time[frame]
                    steps = plan.steps[frame, w]
                    dt = frame_substep(frame, w, plan)
                    h = real(dt)
                    keep = wp.exp(-scene.damping[w] * h)
                    blend = recovery_share(h, matter)
                    step = 0
                    ahead = 0
                    fresh = True
                    t = begun
        came += members
        meet(gate, w, came)
        if lane == 0:
            clock.frame[w] = frame
            clock.dt[w] = dt
            clock.steps[w] = steps
            clock.step[w] = step
            clock.age[w] = age
            clock.travel[w] = travel
            clock.status[w] = status

    return SimpleNamespace(advance=advance)
