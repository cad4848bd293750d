"""Internal forces of bodies, forward and transposed: ``elasticity`` for all particles of a world.

Each particle's impulses on its neighbours are computed first and then gathered by the neighbours,
so that no two threads write the same number. CUDA does so particle by particle, the CPU for several
particles at once (SIMD).

Shapes: W worlds, N particles.
"""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.block import get_near, make_block, make_store, spans_of
from gendom.sim.mpm.elasticity import make_elasticity
from gendom.sim.mpm.particles import (
    DRAG,
    IMPULSES,
    LAM,
    LOW,
    MU,
    STRESS,
    TAPED_STRESS,
    V,
    Variant,
    X,
    make_adjoint,
    make_moving,
    make_taped,
)
from gendom.sim.mpm.types import Namespace, make_types


def make_internal_forces(variant: Variant) -> Namespace:
    """Build the forces of a variant.

    Returns:
        Namespace with ``forces``, which sets the impulses of particles on their neighbours, adds
        the air's and moves Z on; ``impulse_on``, what a particle gets of them; and the transposes
        ``forces_adjoint`` and ``impulse_on_adjoint``.
    """
    return _by_rows(variant) if variant.rows else _by_records(variant)


@functools.cache
def _by_rows(variant: Variant) -> Namespace:
    real = variant.real
    types = make_types(real)
    vec3, impulses = types.vec3, types.impulses
    Matter, State, Clock = types.Matter, types.State, types.Clock
    StateAdjoint, ConditionsAdjoint = types.StateAdjoint, types.ConditionsAdjoint
    Tape = make_taped(variant).Struct
    elasticity = make_elasticity(real, damped=variant.damped)
    vec2 = wp.types.vector(2, real)
    WIDTH = wp.constant(8 if real == wp.float32 else 4)
    cpu = "\n#if !defined(__CUDA_ARCH__)\n{}\n#else\nreturn {{}};\n#endif\n"

    # first: of the particles side by side; fresh: the first of them whose forces are asked for
    @wp.func_native(
        cpu.format(
            "return gendom::internal_forces(w, first, fresh, dt, keep, share, matter, state);"
        )
    )
    def side_by_side(
        w: int, first: int, fresh: int, dt: real, keep: real, share: real, matter: Matter,
        state: State,
    ) -> int: ...  # fmt: skip

    @wp.func_native(
        cpu.format(
            "return gendom::internal_forces_adjoint(w, first, fresh, row, dt, keep, share, matter,"
            " tape, adjoint);"
        )
    )
    def side_by_side_adjoint(
        w: int, first: int, fresh: int, row: int, dt: real, keep: real, share: real,
        matter: Matter, tape: Tape, adjoint: StateAdjoint,
    ) -> vec2: ...  # fmt: skip

    @wp.func_native("return gendom::pulled(p, lattice, impulses, w);")
    def pulled(
        p: int, lattice: wp.array3d(dtype=wp.int32), impulses: wp.array2d(dtype=impulses), w: int
    ) -> vec3: ...

    @wp.func
    def padding_of(stored: Any, w: int, p: int):
        own = stored.impulses[w, p]
        return vec3(own[0, 3], own[1, 3], own[2, 3])

    @wp.func
    def forces(
        w: int, thread: int, threads: int, dt: real, keep: real, share: real, mass: real,
        matter: Matter, clock: Clock, state: State,
    ):  # fmt: skip
        """Return whether a particle is inverted, which the clock names."""
        N = state.x.shape[1]
        failed = int(-1)
        p = int(0)
        while p < N:
            # the last group overlaps with particles that are already done
            found = side_by_side(w, wp.min(p, N - WIDTH), p, dt, keep, share, matter, state)
            failed = wp.max(failed, found)
            p += WIDTH
        if failed >= 0:
            clock.failed_particle[w] = failed
        return int(failed >= 0)

    @wp.func
    def impulse_on(w: int, i: int, matter: Matter, state: State):
        """Impulse of a substep on a particle by its neighbours and by the air."""
        return pulled(i, matter.lattice, state.impulses, w) + padding_of(state, w, i)

    @wp.func
    def differences(p: int, row: int, matter: Matter, of: wp.array2d(dtype=vec3)):
        """Differences [3, axis] of ``of`` between a particle's neighbours along the lattice."""
        near = matter.lattice
        return wp.matrix_from_cols(
            of[row, near[p, 0, 1]] - of[row, near[p, 0, 0]],
            of[row, near[p, 1, 1]] - of[row, near[p, 1, 0]],
            of[row, near[p, 2, 1]] - of[row, near[p, 2, 0]],
        )

    @wp.func
    def air_adjoint(
        w: int, p: int, row: int, dt: real, mass: real, matter: Matter, tape: Tape,
        adjoint: StateAdjoint,
    ):  # fmt: skip
        """Add what the air does to a particle to the derivatives by differences and by v."""
        spans = wp.vec3i(2, 2, 2)
        for axis in range(3):
            if matter.lattice[p, axis, 0] == p or matter.lattice[p, axis, 1] == p:
                spans[axis] = 1
        D_bar, v_bar, drag_bar = elasticity.air_adjoint(
            differences(p, row, matter, tape.x), tape.v[row, p], spans, matter.sheet,
            matter.drag[w], dt, adjoint.v[w, p] / mass,
        )  # fmt: skip
        adjoint.sums[w, DRAG, p] = adjoint.sums[w, DRAG, p] + drag_bar
        H = adjoint.impulses[w, p]
        for axis in range(3):
            for n in range(3):
                H[axis, n] = H[axis, n] + D_bar[n, axis]
            H[axis, 3] = H[axis, 3] + v_bar[axis]
        adjoint.impulses[w, p] = H

    @wp.func
    def forces_adjoint(
        w: int, thread: int, threads: int, row: int, age: int, dt: real, keep: real, share: real,
        mass: real, matter: Matter, tape: Tape, adjoint: StateAdjoint, by: ConditionsAdjoint,
    ):  # fmt: skip
        """Transpose of ``forces``; derivatives by impulses are found in those by v."""
        N = tape.x.shape[1]
        p = int(0)
        while p < N:
            sums = side_by_side_adjoint(
                w, wp.min(p, N - WIDTH), p, row, dt, keep, share, matter, tape, adjoint
            )
            if share > real(0.0) and age > 0:
                by.branch_share[w] = by.branch_share[w] + wp.float64(sums[0])
                by.branch_factor[w] = by.branch_factor[w] + wp.float64(sums[1])
            p += WIDTH
        if matter.drag[w] > real(0.0):
            p = int(0)
            while p < N:
                air_adjoint(w, p, row, dt, mass, matter, tape, adjoint)
                p += 1

    @wp.func
    def impulse_on_adjoint(w: int, i: int, matter: Matter, adjoint: StateAdjoint):
        """Derivatives by x, through all differences, and by v, through the air."""
        return -pulled(i, matter.lattice, adjoint.impulses, w), padding_of(adjoint, w, i)

    return Namespace(forces, impulse_on, forces_adjoint, impulse_on_adjoint)


@functools.cache
def _by_records(variant: Variant) -> Namespace:
    real = variant.real
    types = make_types(real)
    vec3, mat33 = types.vec3, types.mat33
    Matter, Clock, ConditionsAdjoint = types.Matter, types.Clock, types.ConditionsAdjoint
    Records, Tape = make_moving(variant).Struct, make_taped(variant).Struct
    Adjoint = make_adjoint(variant).Struct
    elasticity = make_elasticity(real, damped=variant.damped)
    store = make_store(real, resident=variant.room > 0)
    kept = make_store(real, resident=False)
    block = make_block(real)
    damped = wp.constant(int(variant.damped))

    @wp.func
    def forces(
        w: int, thread: int, threads: int, h: real, keep: real, share: real, mass: real,
        matter: Matter, clock: Clock, records: Records,
    ):  # fmt: skip
        """Return whether a particle is inverted, which the clock names."""
        of = records.of
        moduli = records.moduli
        drag = matter.drag[w]
        per_mass = real(1.0) / mass
        inverted = int(0)
        for i in range(thread, of.shape[2], threads):
            p = records.order[w, i]
            near = get_near(records.near, w, i)
            D = store.differences(of, w, X, near)
            filtered = mat33()
            if damped == 1:
                filtered = store.symmetric(of, w, STRESS, i)
            pull, filtered_after, upright = elasticity.pull(
                D, matter.rest_frame[p], moduli[w, 0, i], moduli[w, 1, i], keep, share, filtered,
                h * matter.volume,
            )  # fmt: skip
            if drag > real(0.0):
                v = store.vector(of, w, V, i)
                wind = elasticity.air(D, v, spans_of(near, i), matter.sheet, drag, h)
                store.put_vector(of, w, V, i, v + per_mass * wind)
            store.put_matrix(of, w, IMPULSES, i, pull)
            if damped == 1:
                store.put_symmetric(of, w, STRESS, i, filtered_after)
            if not upright:
                inverted = 1
                clock.failed_particle[w] = p
        return block.any(inverted)

    @wp.func
    def impulse_on(w: int, i: int, matter: Matter, records: Records):
        """Impulse of a substep on a particle by its neighbours."""
        return store.pulled(records.of, w, IMPULSES, get_near(records.near, w, i), i)

    @wp.func
    def forces_adjoint(
        w: int, thread: int, threads: int, row: int, age: int, h: real, keep: real, share: real,
        mass: real, matter: Matter, tape: Tape, adjoint: Adjoint, by: ConditionsAdjoint,
    ):  # fmt: skip
        """Transpose of ``forces``; derivatives by impulses are found in those by v."""
        of, sums = adjoint.of, adjoint.sums
        drag = matter.drag[w]
        per_mass = real(1.0) / mass
        keep_sum = wp.float64(0.0)
        share_sum = wp.float64(0.0)
        for i in range(thread, sums.shape[2], threads):
            p = adjoint.order[w, i]
            near = get_near(adjoint.near, w, i)
            D = kept.differences(tape.of, row, X, near)
            filtered = mat33()
            Z_bar = mat33()
            if damped == 1:
                filtered = kept.symmetric(tape.of, row, TAPED_STRESS, i)
                Z_bar = store.symmetric(of, w, STRESS, i)
            # an impulse draws one neighbour forth and the other back
            pull_bar = -per_mass * store.differences(of, w, V, near)
            D_bar, mu_bar, lam_bar, keep_bar, share_bar, Z_before = elasticity.pull_adjoint(
                D, matter.rest_frame[p], matter.mu[w, p], matter.lam[w, p], keep, share, filtered,
                h * matter.volume, pull_bar, Z_bar,
            )  # fmt: skip
            wind = vec3()
            if drag > real(0.0):
                by_air, wind_bar, drag_bar = elasticity.air_adjoint(
                    D, kept.vector(tape.of, row, V, i), spans_of(near, i), matter.sheet, drag, h,
                    per_mass * store.vector(of, w, V, i),
                )  # fmt: skip
                D_bar += by_air
                wind = wind_bar
                sums[w, DRAG, i] = sums[w, DRAG, i] + drag_bar
            store.put_vector(of, w, LOW, i, wind)
            store.put_matrix(of, w, IMPULSES, i, D_bar)
            sums[w, MU, i] = sums[w, MU, i] + mu_bar
            sums[w, LAM, i] = sums[w, LAM, i] + lam_bar
            if damped == 1 and share > real(0.0):
                store.put_symmetric(of, w, STRESS, i, Z_before)
                keep_sum += wp.float64(keep_bar)
                share_sum += wp.float64(share_bar)
        if damped == 1 and age > 0:
            wp.atomic_add(by.branch_factor, w, keep_sum)
            wp.atomic_add(by.branch_share, w, share_sum)

    @wp.func
    def impulse_on_adjoint(w: int, i: int, matter: Matter, adjoint: Adjoint):
        """Derivatives by x, through all differences, and by v, through the air."""
        slack = store.pulled(adjoint.of, w, IMPULSES, get_near(adjoint.near, w, i), i)
        return -slack, store.vector(adjoint.of, w, LOW, i)

    return Namespace(forces, impulse_on, forces_adjoint, impulse_on_adjoint)
