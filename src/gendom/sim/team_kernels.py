"""The substep on CUDA where worlds are few: a team of blocks takes one world through many.

The same functions as in ``kernels``, called by all threads of the team. A lane has one particle;
what waits for what then decides the pace, not how much there is to do. So the team meets but twice
a substep: particles that have moved give to the grid at once what they give in the next substep.

Of an elastic body that is what their neighbours pull, whose strain depends on neighbours again. A
block therefore moves, besides its own particles, those two steps of the lattice around: it finds
by itself what other blocks would have to tell it.

Shapes: W worlds, N particles, M grid nodes, B blocks of a team, K particles in a block's memory.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.block import Near, make_block, make_store
from gendom.sim.columns import MARGIN, Columns
from gendom.sim.kernels import DIVERGED, GRID_FULL, INVERTED, OK, make_kernels
from gendom.sim.team import make_team
from gendom.sim.transfers import make_transfers

AHEAD = 32
"""Substeps for which grippers are placed at once."""

COMPONENTS = 44
"""Of a particle in a block's memory: x, v, C, F or pulls, mu, lam, rest frame, neighbours, low."""

_V, _C, _F, _MU, _LAM, _FRAME, _NEAR, _LOW = 3, 6, 15, 24, 25, 26, 35, 41


@wp.struct
class Parts:
    """Which particles the blocks of a team have."""

    # [B, K] its own, then their neighbours, then those' neighbours (of bodies that yield: its own)
    particles: wp.array2d(dtype=wp.int32)
    # [B, 3] how many: its own, with neighbours, in all
    count: wp.array2d(dtype=wp.int32)
    # [B, K, 6] where the neighbours of those with neighbours in the block's memory are
    near: wp.array3d(dtype=wp.int32)


@functools.cache
def make_team_kernels(
    real: Any, law_name: str, *, plastic: bool, lanes: int = 64, at_once: int = 1, room: int = 1
) -> SimpleNamespace:
    """Build the kernel for one scalar type and one material, see ``make_kernels``.

    Args:
        real, law_name, plastic: As there.
        lanes: Threads of a block.
        at_once: Blocks that are to fit on a multiprocessor at the same time.
        room: K.

    Returns:
        Namespace with ``advance``.
    """
    k = make_kernels(real, law_name, plastic=plastic)
    vec3, vec4, mat33 = k.vec3, k.vec4, k.mat33
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
    tension = k.transfers.tension
    impulse_of_stress = k.transfers.impulse_of_stress
    given_by = k.transfers.given_by
    scatter_plane = k.transfers.scatter_plane
    get_node, put_node = k.transfers.get_node, k.transfers.put_node
    yields, rounds = k.transfers.yields, k.transfers.rounds
    straight = make_transfers(real, k.law, straight=True)
    moved, gather_particle = straight.moved, straight.gather_particle
    numbers = wp.constant(COMPONENTS * room)
    store = make_store(real, resident=True)
    get, put = store.get, store.put
    vector, put_vector = store.vector, store.put_vector
    matrix, put_matrix = store.matrix, store.put_matrix
    differences, pulled, step_on = store.differences, store.pulled, store.step_on
    meet_block = make_block(real).meet
    team = make_team(real)
    meet, lift = team.meet, team.lift

    @wp.func
    def near_of(of: wp.array3d(dtype=real), block: int, i: int):
        near = Near()
        for n in range(6):
            near[n] = int(get(of, block, _NEAR + n, i))
        return near

    @wp.func
    def tense_block(
        of: wp.array3d(dtype=real), block: int, thread: int, threads: int, count: int, h: real,
        volume: real,
    ):  # fmt: skip
        """Set the pulls of a block's first particles; returns one that is not upright, or -1."""
        inverted = int(-1)
        for i in range(thread, count, threads):
            pull, upright = tension(
                differences(of, block, 0, near_of(of, block, i)), matrix(of, block, _FRAME, i),
                get(of, block, _MU, i), get(of, block, _LAM, i), h, volume,
            )  # fmt: skip
            put_matrix(of, block, _F, i, pull)
            if not upright:
                inverted = i
        return inverted

    @wp.func
    def scatter_block(
        of: wp.array3d(dtype=real), block: int, thread: int, threads: int, count: int, w: int,
        farthest: real, h: real, inv_dx: real, z0: real, mass: real, volume: real,
        columns: Columns, momentum: wp.array2d(dtype=vec4),
    ):  # fmt: skip
        """Scatter a block's first particles but those that go farther in a substep [m].

        A thread gives to one plane of a particle's nodes.
        """
        for n in range(thread, 3 * count, threads):
            i = n % count
            v = vector(of, block, _V, i)
            if h * wp.length(v) < farthest:
                q = mass * v
                T = mat33()
                if yields == 1:
                    T = impulse_of_stress(
                        matrix(of, block, _F, i), get(of, block, _MU, i), get(of, block, _LAM, i),
                        h, volume, inv_dx,
                    )  # fmt: skip
                else:
                    q += pulled(of, block, _F, near_of(of, block, i), i)
                node, f, c = given_by(
                    vector(of, block, 0, i), q, matrix(of, block, _C, i), T, mass, w, inv_dx, z0,
                    columns,
                )  # fmt: skip
                scatter_plane(momentum, w, columns.start, w, node, f, c, n // count)

    @wp.kernel(enable_backward=False, module="unique", launch_bounds=(lanes, at_once))
    def advance(
        members: int,  # blocks of a team; world w has blocks w * members and following
        threads: int,  # of a block
        most: int,  # substeps at the most
        pause: wp.float64,  # [s] no substep begins from here on
        parts: Parts,
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
        of: wp.array3d(dtype=real),  # [W * B, COMPONENTS, K]; on CUDA [1, ...]
        gate: wp.array(dtype=wp.int32),  # [W]
        # [W, 3] longest way in even and in odd substeps; what is wrong before a substep
        peak: wp.array2d(dtype=real),
    ):
        block, thread = wp.tid()
        wp.tile_empty(shape=numbers, dtype=real, storage="shared")
        w = block // members
        part = block % members
        lanes = members * threads
        lane = part * threads + thread
        frames = plan.steps.shape[0]
        frame = int(clock.frame[w])
        status = int(clock.status[w])
        if frame >= frames or status != OK:
            return
        dx = scene.dx
        z0 = scene.z0
        inv_dx = real(1.0) / dx
        mass = matter.mass[w]
        volume = matter.volume
        own = parts.count[part, 0]
        tense = parts.count[part, 1]
        present = parts.count[part, 2]
        for i in range(thread, present, threads):
            p = parts.particles[part, i]
            put_vector(of, block, 0, i, state.x[w, p])
            put_vector(of, block, _V, i, state.v[w, p])
            put_matrix(of, block, _C, i, state.C[w, p])
            put(of, block, _MU, i, matter.mu[w, p])
            put(of, block, _LAM, i, matter.lam[w, p])
            if yields == 1:
                put_matrix(of, block, _F, i, state.F[w, p])
            else:
                put_matrix(of, block, _FRAME, i, matter.rest_frame[p])
                for n in range(6):
                    put(of, block, _NEAR + n, i, real(parts.near[part, i, n]))
            if rounds == 1:
                put_vector(of, block, _LOW, i, state.low[w, p])
        begun = plan.time[frame]  # of the frame that the world is in
        steps = int(plan.steps[frame, w])
        dt = frame_substep(frame, w, plan)
        h = real(dt)
        keep = wp.exp(-scene.damping[w] * h)
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
                for i in range(thread, own, threads):
                    p = parts.particles[part, i]
                    last_good.x[w, p] = vector(of, block, 0, i)
                    last_good.v[w, p] = vector(of, block, _V, i)
                    last_good.C[w, p] = matrix(of, block, _C, i)
                    if yields == 1:
                        last_good.F[w, p] = matrix(of, block, _F, i)
                fresh = False
            if step < steps and travel >= real(MARGIN) * dx:
                scattered = False
                if lane == 0:
                    columns.count[w] = 0
                    forget_bounds(w, columns)
                came += members
                meet(gate, w, came)
                for i in range(thread, own, threads):
                    locate_particle(w, vector(of, block, 0, i), inv_dx, columns)
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
                    for i in range(thread, own, threads):
                        mark_particle(w, vector(of, block, 0, i), inv_dx, z0, columns)
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
            substep = step < steps and status == OK
            if substep:
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
                    if yields == 0:
                        wrong = real(0.0)
                        inverted = tense_block(of, block, thread, threads, tense, h, volume)
                        if inverted >= 0:
                            wrong = real(INVERTED)
                            clock.culprit[w] = parts.particles[part, inverted]
                        lift(peak, w, 2, wrong)
                        meet_block()
                    scatter_block(
                        of, block, thread, threads, own, w, real(1.0e30), h, inv_dx, z0, mass,
                        volume, columns, momentum,
                    )  # fmt: skip
                    came += members
                    meet(gate, w, came)
                    if peak[w, 2] > real(0.0):
                        status = int(INVERTED)
                        substep = False
            if substep:
                for n in range(lane, nodes, lanes):
                    q = get_node(momentum, w, n)
                    if q[3] > real(0.0):
                        put_node(momentum, w, n, vec4())
                        u = update_node(
                            w, w * AHEAD + step % AHEAD, w, n, q, h, keep, scene, paths, grips,
                            columns,
                        )  # fmt: skip
                        put_node(velocity, w, n, vec4(u[0], u[1], u[2], q[3]))
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
                )  # fmt: skip
                if lane == 0:
                    peak[w, age % 2] = real(0.0)  # of the next substep
                # the longest way, in squared cells; above 1 what went wrong
                worst = real(0.0)
                for i in range(thread, present, threads):
                    x = vector(of, block, 0, i)
                    v = vec3()
                    C = mat33()
                    upright = bool(True)
                    if yields == 1:
                        v, C, F = moved(
                            x, matrix(of, block, _F, i), get(of, block, _MU, i),
                            matter.yield_stress[w], w, w, h, inv_dx, z0, columns, velocity,
                        )  # fmt: skip
                        put_matrix(of, block, _F, i, F)
                        upright = wp.determinant(F) > real(0.0)
                    else:
                        v, C, _D = gather_particle(w, w, x, inv_dx, z0, columns, velocity)
                    x = step_on(of, block, _LOW, i, x, h * v)
                    put_vector(of, block, 0, i, x)
                    put_vector(of, block, _V, i, v)
                    put_matrix(of, block, _C, i, C)
                    if step == steps and i < own:
                        state.x[w, parts.particles[part, i]] = x
                    far = wp.length_sq(v) * h * h / (dx * dx)
                    # a NaN is not below anything
                    if not (wp.length_sq(v) * h * h <= dx * dx):
                        far = real(DIVERGED)
                    elif not upright:
                        far = real(INVERTED)
                        clock.culprit[w] = parts.particles[part, i]
                    worst = wp.max(worst, far)
                if scattered:
                    meet_block()
                    if yields == 0:
                        inverted = tense_block(of, block, thread, threads, tense, h, volume)
                        if inverted >= 0:
                            worst = wp.max(worst, real(INVERTED))
                            clock.culprit[w] = parts.particles[part, inverted]
                        meet_block()
                    scatter_block(
                        of, block, thread, threads, own, w, real(MARGIN) * dx - travel, h, inv_dx,
                        z0, mass, volume, columns, momentum,
                    )  # fmt: skip
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
                    step = 0
                    ahead = 0
                    fresh = True
                    t = begun
        for i in range(thread, own, threads):
            p = parts.particles[part, i]
            state.x[w, p] = vector(of, block, 0, i)
            state.v[w, p] = vector(of, block, _V, i)
            state.C[w, p] = matrix(of, block, _C, i)
            if yields == 1:
                state.F[w, p] = matrix(of, block, _F, i)
            if rounds == 1:
                state.low[w, p] = vector(of, block, _LOW, i)
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
