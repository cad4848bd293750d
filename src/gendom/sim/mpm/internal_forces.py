"""Internal forces of bodies: ``elasticity`` for rows of particles, see ``types.State``.

Pulls are computed for all particles and then gathered by their neighbours, so that no two threads
write the same number. On the CPU several neo-Hookean particles are processed in parallel (SIMD).

Shapes: W worlds, N particles.
"""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.block import Near, make_store, spans_of
from gendom.sim.mpm.elasticity import make_elasticity
from gendom.sim.mpm.types import Namespace, make_types


@functools.cache
def make_internal_forces(real: Any, law_name: str, *, yields: bool) -> Namespace:
    """Build the forces on rows of particles, see ``types.State``.

    Returns:
        Namespace with ``particle_forces`` and ``body_forces``, which set the pulls [W, N] of one or
        of all particles and Z and G after the substep; ``impulse_on``, what a particle gets of
        them; and the transposes ``particle_forces_adjoint``, ``body_forces_adjoint`` and
        ``impulse_on_adjoint``. Those of bodies have several neo-Hookean particles side by side
        (``native/simd_elasticity.h``, CPU).
    """
    types = make_types(real)
    Pulls, Vectors = types.Pulls, types.Vectors
    vec3, mat33, pull_type = types.vec3, types.mat33, types.pull
    Matter, State = types.Matter, types.State
    MatterBars, SceneBars = types.MatterBars, types.SceneBars
    elasticity = make_elasticity(real, law_name, yields=yields)
    store = make_store(real, resident=False)
    plastic = wp.constant(int(yields))
    vec2 = wp.types.vector(2, real)
    width = wp.constant(8 if real == wp.float32 else 4)
    cpu = "\n#if !defined(__CUDA_ARCH__)\n{}\n#else\nreturn {{}};\n#endif\n"

    # first: of the particles side by side; fresh: the first of them whose forces are asked for
    @wp.func_native(
        cpu.format(
            "return gendom::internal_forces(w, first, fresh, row, row_out, dt, keep, share, matter,"
            " state, state_out, pulls);"
        )
    )
    def side_by_side(
        w: int, first: int, fresh: int, row: int, row_out: int, dt: real, keep: real, share: real,
        matter: Matter, state: State, state_out: State, pulls: Pulls,
    ) -> int: ...  # fmt: skip

    @wp.func_native(
        cpu.format(
            "return gendom::internal_forces_adjoint(w, first, fresh, row, dt, keep, share, matter,"
            " state, bars, stretches);"
        )
    )
    def side_by_side_adjoint(
        w: int, first: int, fresh: int, row: int, dt: real, keep: real, share: real,
        matter: Matter, state: State, bars: MatterBars, stretches: Pulls,
    ) -> vec2: ...  # fmt: skip

    @wp.func_native("return gendom::pulled(p, lattice, pulls, w);")
    def pulled(p: int, lattice: wp.array3d(dtype=wp.int32), pulls: Pulls, w: int) -> vec3: ...

    @wp.func
    def near_of(p: int, matter: Matter):
        near = matter.lattice
        return Near(
            near[p, 0, 0], near[p, 0, 1], near[p, 1, 0], near[p, 1, 1], near[p, 2, 0],
            near[p, 2, 1],
        )  # fmt: skip

    @wp.func
    def differences(p: int, row: int, matter: Matter, of: Vectors):
        """Differences [3, axis] of ``of`` between a particle's neighbours along the lattice."""
        near = matter.lattice
        return wp.matrix_from_cols(
            of[row, near[p, 0, 1]] - of[row, near[p, 0, 0]],
            of[row, near[p, 1, 1]] - of[row, near[p, 1, 0]],
            of[row, near[p, 2, 1]] - of[row, near[p, 2, 0]],
        )

    @wp.func
    def stored(H: mat33, padding: vec3):
        """Pulls [3, axis] and the air's impulse as they are stored."""
        return pull_type(
            H[0, 0], H[1, 0], H[2, 0], padding[0],
            H[0, 1], H[1, 1], H[2, 1], padding[1],
            H[0, 2], H[1, 2], H[2, 2], padding[2],
        )  # fmt: skip

    @wp.func
    def padding_of(pulls: Pulls, w: int, p: int):
        own = pulls[w, p]
        return vec3(own[0, 3], own[1, 3], own[2, 3])

    @wp.func
    def particle_forces(
        w: int, p: int, row: int, row_out: int, dt: real, keep: real, share: real, matter: Matter,
        state: State, state_out: State, pulls: Pulls,
    ):  # fmt: skip
        """Set a particle's pulls on its neighbours; return whether it is not inverted."""
        D = differences(p, row, matter, state.x)
        Z = mat33()
        G = mat33()
        if share > real(0.0):
            Z = store.symmetric(state.Z, row, 0, p)
        if plastic == 1:
            G = state.G[row, p]
        H, Z_after, G_after, upright = elasticity.pull(
            D, matter.rest_frame[p], matter.mu[w, p], matter.lam[w, p], matter.yield_stress[w],
            keep, share, Z, G, dt * matter.volume,
        )  # fmt: skip
        if share > real(0.0):
            store.put_symmetric(state_out.Z, row_out, 0, p, Z_after)
        if plastic == 1:
            state_out.G[row_out, p] = G_after
        wind = vec3()
        if matter.drag[w] > real(0.0):
            spans = spans_of(near_of(p, matter), p)
            wind = elasticity.air(D, state.v[row, p], spans, matter.sheet, matter.drag[w], dt)
        pulls[w, p] = stored(H, wind)
        return upright

    @wp.func
    def forces_one_by_one(
        w: int, row: int, row_out: int, dt: real, keep: real, share: real, matter: Matter,
        state: State, state_out: State, pulls: Pulls,
    ):  # fmt: skip
        """Set all pulls of a body; return an inverted particle, or -1."""
        failed = int(-1)
        p = int(0)
        while p < state.x.shape[1]:
            if not particle_forces(
                w, p, row, row_out, dt, keep, share, matter, state, state_out, pulls
            ):
                failed = p
            p += 1
        return failed

    @wp.func
    def forces_side_by_side(
        w: int, row: int, row_out: int, dt: real, keep: real, share: real, matter: Matter,
        state: State, state_out: State, pulls: Pulls,
    ):  # fmt: skip
        """The same as ``forces_one_by_one`` with SIMD, on the CPU."""
        N = state.x.shape[1]
        if N < width:
            return forces_one_by_one(
                w, row, row_out, dt, keep, share, matter, state, state_out, pulls
            )
        failed = int(-1)
        p = int(0)
        while p < N:
            # the last group overlaps with particles that are already done
            found = side_by_side(
                w, wp.min(p, N - width), p, row, row_out, dt, keep, share, matter, state, state_out,
                pulls,
            )  # fmt: skip
            failed = wp.max(failed, found)
            p += width
        return failed

    @wp.func
    def impulse_on(p: int, matter: Matter, pulls: Pulls, w: int):
        """Impulse of a substep on a particle by its neighbours and by the air."""
        return pulled(p, matter.lattice, pulls, w) + padding_of(pulls, w, p)

    @wp.func
    def air_on_adjoint(
        w: int, p: int, row: int, dt: real, matter: Matter, state: State, bars: MatterBars
    ):
        """Derivatives by the differences and by v of what the air does to a particle."""
        spans = spans_of(near_of(p, matter), p)
        D_bar, v_bar, drag_bar = elasticity.air_adjoint(
            differences(p, row, matter, state.x), state.v[row, p], spans, matter.sheet,
            matter.drag[w], dt, bars.v[w, p] / matter.mass[w],
        )  # fmt: skip
        bars.drag[w, p] = bars.drag[w, p] + drag_bar
        return D_bar, v_bar

    @wp.func
    def particle_forces_adjoint(
        w: int, p: int, row: int, dt: real, keep: real, share: real, matter: Matter, state: State,
        bars: MatterBars, stretches: Pulls,
    ):  # fmt: skip
        """Transpose of ``particle_forces`` and ``impulse_on`` but for its last step,
        ``impulse_on_adjoint``; returns the derivatives by ``keep`` and ``share``.

        Derivatives by impulses are found in those by v.
        """
        # a pull acts on both neighbours with opposite signs
        pull_bar = (real(-1.0) / matter.mass[w]) * differences(p, w, matter, bars.v)
        Z = mat33()
        G = mat33()
        Z_bar = mat33()
        G_bar = mat33()
        if share > real(0.0):
            Z = store.symmetric(state.Z, row, 0, p)
            Z_bar = store.symmetric(bars.Z, w, 0, p)
        if plastic == 1:
            G = state.G[row, p]
            G_bar = bars.G[w, p]
        D_bar, mu_bar, lam_bar, yield_bar, keep_bar, share_bar, Z_bar_before, G_bar_before = (
            elasticity.pull_adjoint(
                differences(p, row, matter, state.x), matter.rest_frame[p], matter.mu[w, p],
                matter.lam[w, p], matter.yield_stress[w], keep, share, Z, G, dt * matter.volume,
                pull_bar, Z_bar, G_bar,
            )
        )  # fmt: skip
        v_bar = vec3()
        if matter.drag[w] > real(0.0):
            by_air, v_bar_air = air_on_adjoint(w, p, row, dt, matter, state, bars)
            D_bar += by_air
            v_bar = v_bar_air
        stretches[w, p] = stored(D_bar, v_bar)
        bars.mu[w, p] = bars.mu[w, p] + mu_bar
        bars.lam[w, p] = bars.lam[w, p] + lam_bar
        if share > real(0.0):
            store.put_symmetric(bars.Z, w, 0, p, Z_bar_before)
        if plastic == 1:
            bars.G[w, p] = G_bar_before
            bars.yield_stress[w, p] = bars.yield_stress[w, p] + yield_bar
        return keep_bar, share_bar

    @wp.func
    def one_by_one_adjoint(
        w: int, row: int, dt: real, keep: real, share: real, matter: Matter, state: State,
        bars: MatterBars, scene_bars: SceneBars, stretches: Pulls,
    ):  # fmt: skip
        p = int(0)
        while p < state.x.shape[1]:
            keep_bar, share_bar = particle_forces_adjoint(
                w, p, row, dt, keep, share, matter, state, bars, stretches
            )
            if share > real(0.0):
                scene_bars.branch_factor[w] = scene_bars.branch_factor[w] + wp.float64(keep_bar)
                scene_bars.branch_share[w] = scene_bars.branch_share[w] + wp.float64(share_bar)
            p += 1

    @wp.func
    def side_by_side_all_adjoint(
        w: int, row: int, dt: real, keep: real, share: real, matter: Matter, state: State,
        bars: MatterBars, scene_bars: SceneBars, stretches: Pulls,
    ):  # fmt: skip
        N = state.x.shape[1]
        if N < width:
            one_by_one_adjoint(w, row, dt, keep, share, matter, state, bars, scene_bars, stretches)
        else:
            p = int(0)
            while p < N:
                sums = side_by_side_adjoint(
                    w, wp.min(p, N - width), p, row, dt, keep, share, matter, state, bars, stretches
                )
                if share > real(0.0):
                    scene_bars.branch_share[w] = scene_bars.branch_share[w] + wp.float64(sums[0])
                    scene_bars.branch_factor[w] = scene_bars.branch_factor[w] + wp.float64(sums[1])
                p += width
            if matter.drag[w] > real(0.0):
                p = int(0)
                while p < N:
                    by_air, v_bar = air_on_adjoint(w, p, row, dt, matter, state, bars)
                    stretches[w, p] = stretches[w, p] + stored(by_air, v_bar)
                    p += 1

    @wp.func
    def impulse_on_adjoint(w: int, p: int, matter: Matter, bars: MatterBars, stretches: Pulls):
        """Add to the derivatives by a particle's position those by all differences."""
        bars.x[w, p] = bars.x[w, p] - pulled(p, matter.lattice, stretches, w)
        bars.v[w, p] = bars.v[w, p] + padding_of(stretches, w, p)

    together = law_name == "neo-hookean" and not yields
    return Namespace(
        particle_forces, particle_forces_adjoint, impulse_on, impulse_on_adjoint,
        body_forces=forces_side_by_side if together else forces_one_by_one,
        body_forces_adjoint=side_by_side_all_adjoint if together else one_by_one_adjoint,
    )  # fmt: skip
