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
    Model, State, Clock, Substep = types.Model, types.State, types.Clock, types.Substep
    StateAdjoint, ConditionsAdjoint = types.StateAdjoint, types.ConditionsAdjoint
    Tape = make_taped(variant).Struct
    elasticity = make_elasticity(real, damped=variant.damped)
    vec2 = wp.types.vector(2, real)
    WIDTH = wp.constant(8 if real == wp.float32 else 4)
    cpu = "\n#if !defined(__CUDA_ARCH__)\n{}\n#else\nreturn {{}};\n#endif\n"

    # first: of the particles side by side; fresh: the first of them whose forces are asked for
    @wp.func_native(
        cpu.format(
            "return gendom::internal_forces(w, first, fresh, dt, keep, share, model, state);"
        )
    )
    def side_by_side(
        w: int, first: int, fresh: int, dt: real, keep: real, share: real, model: Model,
        state: State,
    ) -> int: ...  # fmt: skip

    @wp.func_native(
        cpu.format(
            "return gendom::internal_forces_adjoint(w, first, fresh, row, dt, keep, share, model,"
            " tape, adjoint);"
        )
    )
    def side_by_side_adjoint(
        w: int, first: int, fresh: int, row: int, dt: real, keep: real, share: real, model: Model,
        tape: Tape, adjoint: StateAdjoint,
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
    def forces(now: Substep, model: Model, clock: Clock, state: State):
        """Return whether a particle is inverted, which the clock names."""
        N = state.x.shape[1]
        failed = int(-1)
        p = int(0)
        while p < N:
            # the last group overlaps with particles that are already done
            first = wp.min(p, N - WIDTH)
            found = side_by_side(now.w, first, p, now.h, now.keep, now.share, model, state)
            failed = wp.max(failed, found)
            p += WIDTH
        if failed >= 0:
            clock.failed_particle[now.w] = failed
        return int(failed >= 0)

    @wp.func
    def impulse_on(now: Substep, i: int, model: Model, state: State):
        """Impulse of a substep on a particle by its neighbours and by the air."""
        return pulled(i, model.lattice, state.impulses, now.w) + padding_of(state, now.w, i)

    @wp.func
    def differences(p: int, row: int, model: Model, of: wp.array2d(dtype=vec3)):
        """Differences [3, axis] of ``of`` between a particle's neighbours along the lattice."""
        near = model.lattice
        return wp.matrix_from_cols(
            of[row, near[p, 0, 1]] - of[row, near[p, 0, 0]],
            of[row, near[p, 1, 1]] - of[row, near[p, 1, 0]],
            of[row, near[p, 2, 1]] - of[row, near[p, 2, 0]],
        )

    @wp.func
    def air_adjoint(now: Substep, p: int, model: Model, tape: Tape, adjoint: StateAdjoint):
        """Add what the air does to a particle to the derivatives by differences and by v."""
        spans = wp.vec3i(2, 2, 2)
        for axis in range(3):
            if model.lattice[p, axis, 0] == p or model.lattice[p, axis, 1] == p:
                spans[axis] = 1
        D_bar, v_bar, drag_bar = elasticity.air_adjoint(
            differences(p, now.slot, model, tape.x), tape.v[now.slot, p], spans, model.sheet,
            model.drag[now.w], now.h, adjoint.v[now.w, p] / now.mass,
        )  # fmt: skip
        adjoint.sums[now.w, DRAG, p] = adjoint.sums[now.w, DRAG, p] + drag_bar
        H = adjoint.impulses[now.w, p]
        for axis in range(3):
            for n in range(3):
                H[axis, n] = H[axis, n] + D_bar[n, axis]
            H[axis, 3] = H[axis, 3] + v_bar[axis]
        adjoint.impulses[now.w, p] = H

    @wp.func
    def forces_adjoint(
        now: Substep, model: Model, tape: Tape, adjoint: StateAdjoint, by: ConditionsAdjoint
    ):
        """Transpose of ``forces``; derivatives by impulses are found in those by v."""
        N = tape.x.shape[1]
        p = int(0)
        while p < N:
            sums = side_by_side_adjoint(
                now.w, wp.min(p, N - WIDTH), p, now.slot, now.h, now.keep, now.share, model, tape,
                adjoint,
            )  # fmt: skip
            if now.share > real(0.0) and now.age > 0:
                by.branch_share[now.w] = by.branch_share[now.w] + wp.float64(sums[0])
                by.branch_factor[now.w] = by.branch_factor[now.w] + wp.float64(sums[1])
            p += WIDTH
        if model.drag[now.w] > real(0.0):
            p = int(0)
            while p < N:
                air_adjoint(now, p, model, tape, adjoint)
                p += 1

    @wp.func
    def impulse_on_adjoint(now: Substep, i: int, model: Model, adjoint: StateAdjoint):
        """Derivatives by x, through all differences, and by v, through the air."""
        return -pulled(i, model.lattice, adjoint.impulses, now.w), padding_of(adjoint, now.w, i)

    return Namespace(forces, impulse_on, forces_adjoint, impulse_on_adjoint)


@functools.cache
def _by_records(variant: Variant) -> Namespace:
    real = variant.real
    types = make_types(real)
    vec3, mat33 = types.vec3, types.mat33
    Model, Clock, Substep = types.Model, types.Clock, types.Substep
    ConditionsAdjoint = types.ConditionsAdjoint
    Records, Tape = make_moving(variant).Struct, make_taped(variant).Struct
    Adjoint = make_adjoint(variant).Struct
    elasticity = make_elasticity(real, damped=variant.damped)
    store = make_store(real, resident=variant.room > 0)
    kept = make_store(real, resident=False)
    block = make_block(real)
    damped = wp.constant(int(variant.damped))

    @wp.func
    def forces(now: Substep, model: Model, clock: Clock, records: Records):
        """Return whether a particle is inverted, which the clock names."""
        of = records.of
        moduli = records.moduli
        drag = model.drag[now.w]
        per_mass = real(1.0) / now.mass
        inverted = int(0)
        for i in range(now.thread, of.shape[2], now.threads):
            p = records.order[now.w, i]
            near = get_near(records.near, now.w, i)
            D = store.differences(of, now.w, X, near)
            filtered = mat33()
            if damped == 1:
                filtered = store.symmetric(of, now.w, STRESS, i)
            pull, filtered_after, upright = elasticity.pull(
                D, model.rest_frame[p], moduli[now.w, 0, i], moduli[now.w, 1, i], now.keep,
                now.share, filtered, now.h * model.volume,
            )  # fmt: skip
            if drag > real(0.0):
                v = store.vector(of, now.w, V, i)
                wind = elasticity.air(D, v, spans_of(near, i), model.sheet, drag, now.h)
                store.put_vector(of, now.w, V, i, v + per_mass * wind)
            store.put_matrix(of, now.w, IMPULSES, i, pull)
            if damped == 1:
                store.put_symmetric(of, now.w, STRESS, i, filtered_after)
            if not upright:
                inverted = 1
                clock.failed_particle[now.w] = p
        return block.any(inverted)

    @wp.func
    def impulse_on(now: Substep, i: int, model: Model, records: Records):
        """Impulse of a substep on a particle by its neighbours."""
        return store.pulled(records.of, now.w, IMPULSES, get_near(records.near, now.w, i), i)

    @wp.func
    def forces_adjoint(
        now: Substep, model: Model, tape: Tape, adjoint: Adjoint, by: ConditionsAdjoint
    ):
        """Transpose of ``forces``; derivatives by impulses are found in those by v."""
        of, sums = adjoint.of, adjoint.sums
        drag = model.drag[now.w]
        per_mass = real(1.0) / now.mass
        keep_sum = wp.float64(0.0)
        share_sum = wp.float64(0.0)
        for i in range(now.thread, sums.shape[2], now.threads):
            p = adjoint.order[now.w, i]
            near = get_near(adjoint.near, now.w, i)
            D = kept.differences(tape.of, now.slot, X, near)
            filtered = mat33()
            Z_bar = mat33()
            if damped == 1:
                filtered = kept.symmetric(tape.of, now.slot, TAPED_STRESS, i)
                Z_bar = store.symmetric(of, now.w, STRESS, i)
            # an impulse draws one neighbour forth and the other back
            pull_bar = -per_mass * store.differences(of, now.w, V, near)
            D_bar, mu_bar, lam_bar, keep_bar, share_bar, Z_before = elasticity.pull_adjoint(
                D, model.rest_frame[p], model.mu[now.w, p], model.lam[now.w, p], now.keep,
                now.share, filtered, now.h * model.volume, pull_bar, Z_bar,
            )  # fmt: skip
            wind = vec3()
            if drag > real(0.0):
                by_air, wind_bar, drag_bar = elasticity.air_adjoint(
                    D, kept.vector(tape.of, now.slot, V, i), spans_of(near, i), model.sheet, drag,
                    now.h, per_mass * store.vector(of, now.w, V, i),
                )  # fmt: skip
                D_bar += by_air
                wind = wind_bar
                sums[now.w, DRAG, i] = sums[now.w, DRAG, i] + drag_bar
            store.put_vector(of, now.w, LOW, i, wind)
            store.put_matrix(of, now.w, IMPULSES, i, D_bar)
            sums[now.w, MU, i] = sums[now.w, MU, i] + mu_bar
            sums[now.w, LAM, i] = sums[now.w, LAM, i] + lam_bar
            if damped == 1 and now.share > real(0.0):
                store.put_symmetric(of, now.w, STRESS, i, Z_before)
                keep_sum += wp.float64(keep_bar)
                share_sum += wp.float64(share_bar)
        if damped == 1 and now.age > 0:
            wp.atomic_add(by.branch_factor, now.w, keep_sum)
            wp.atomic_add(by.branch_share, now.w, share_sum)

    @wp.func
    def impulse_on_adjoint(now: Substep, i: int, model: Model, adjoint: Adjoint):
        """Derivatives by x, through all differences, and by v, through the air."""
        slack = store.pulled(adjoint.of, now.w, IMPULSES, get_near(adjoint.near, now.w, i), i)
        return -slack, store.vector(adjoint.of, now.w, LOW, i)

    return Namespace(forces, impulse_on, forces_adjoint, impulse_on_adjoint)
