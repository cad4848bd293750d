"""Internal forces: what the particles of a body do to their neighbours, and what the air does.

A body remembers its shape at rest. F of a particle is what the differences D of the positions of
its neighbours in the rest lattice say, F = D B with the inverse B of the same at rest; the elastic
energy is a function of positions alone, and its derivatives are the forces (Lagrangian forces:
Jiang, Gast and Teran 2017). No energy comes from nowhere, and what has come to rest stays.

- **Elastic law**: P(F), see ``gendom.materials.laws``.
- **Yield**: F G is elastic, G the inverse of the plastic F that each particle keeps; where the
  elastic part passes the yield surface it is returned, and G changes (Simo and Hughes 1998, chapter
  9).
- **Material damping**: a standard linear solid with one Maxwell branch as stiff as the elastic law
  (Simo and Hughes 1998, chapter 10). The branch's stress is Q = S - Z, S the second Piola-Kirchhoff
  stress and Z the same filtered with the branch's time tau: per substep, with a = exp(-dt / tau)
  and
  g = (1 + a) / 2,

      P <- (1 + g) P - g F Z,      Z <- Z + (1 - a) (S - Z).

  In slow motion that is a viscosity of tau times the elastic moduli, so tau is
  ``Material.damping``; above 1 / tau it is an additional stiffness, at most that of the law:
  substeps shrink by sqrt(2). Both lines are exact to second order in dt / tau. At rest Z = S:
  static shapes do not change.
- **Air**: -1/2 rho c |v_n| v_n A n on each patch of a sheet with the velocity v_n along its normal,
  -1/2 rho c d l |v_t| v_t across each stretch l of a rope, v_t the velocity less its part along it.

Forces go to particles as impulses of a substep: each particle pulls the neighbour behind it along a
lattice axis back and the one before it forth. Each function has its transpose beside it.

Shapes: W worlds, N particles.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.materials.laws import make_law
from gendom.sim.mpm.block import Near, spans_of
from gendom.sim.mpm.types import make_types

FILLS = 1.0e-30
"""Share of the branch with which Z is filled and nothing else happens."""


@functools.cache
def make_elasticity(
    real: Any, law_name: str, *, yields: bool, damped: bool = True
) -> SimpleNamespace:
    """Build the forces of one particle, for one scalar type and one material.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        law_name: Elastic law, see ``gendom.materials.laws``.
        yields: Whether particles yield.
        damped: Whether any material has damping.

    Returns:
        Namespace with ``branch`` (a and g of a substep), ``pull`` and ``air``, and the transpose of
        each.
    """
    types = make_types(real)
    vec3, mat33 = types.vec3, types.mat33
    law = make_law(law_name, real, plastic=yields)
    stress, stress_adjoint = law.stress, law.stress_back
    return_map, return_map_adjoint = law.return_map, law.return_map_back
    plastic = wp.constant(int(yields))
    maxwell = wp.constant(int(damped))

    @wp.func
    def branch(damping: real, dt: real, age: int):
        """Of the Maxwell branch: the share of Z that a substep leaves, and g; (0, 0) without.

        A branch cannot be faster than the substep: it is softer instead. The first substep of all
        only fills Z: what stress a body begins with has relaxed.
        """
        keep = real(0.0)
        share = real(0.0)
        if damping > real(0.0):
            tau = wp.max(damping, dt)
            if age == 0:
                share = real(FILLS)
            else:
                keep = wp.exp(-dt / tau)
                share = real(0.5) * (damping / tau) * (real(1.0) + keep)
        return keep, share

    @wp.func
    def branch_adjoint(damping: real, dt: real, age: int, keep_bar: real, share_bar: real):
        """Derivative by the damping."""
        bar = real(0.0)
        if damping > real(0.0) and age > 0:
            if damping > dt:
                slope = wp.exp(-dt / damping) * dt / (damping * damping)
                bar = (keep_bar + real(0.5) * share_bar) * slope
            else:
                bar = share_bar * real(0.5) * (real(1.0) + wp.exp(real(-1.0))) / dt
        return bar

    @wp.func
    def elastic_part(F: mat33, G: mat33, mu: real, yield_stress: real):
        """Elastic part of F and the new G."""
        elastic = F
        if plastic == 1:
            tried = F * G
            elastic = return_map(tried, mu, yield_stress)
            if wp.ddot(elastic - tried, elastic - tried) > real(0.0):
                G = wp.inverse(F) * elastic
        return elastic, G

    @wp.func
    def pull(
        D: mat33, B: mat33, mu: real, lam: real, yield_stress: real, keep: real, share: real,
        Z: mat33, G: mat33, impulse: real,
    ):  # fmt: skip
        """Impulses [3, axis] by which a particle draws its neighbours together.

        ``impulse`` is the substep times the particle's volume.

        Returns:
            The pulls, Z and G after the substep, and whether the particle is upright (J > 0).
        """
        F = D * B
        elastic, G_after = elastic_part(F, G, mu, yield_stress)
        P = stress(elastic, mu, lam)
        Z_after = Z
        if maxwell == 1 and share > real(0.0):
            S = wp.inverse(elastic) * P
            P = (real(1.0) + share) * P - share * (elastic * Z)
            Z_after = Z + (real(1.0) - keep) * (S - Z)
        frame = B
        if plastic == 1:
            frame = B * G_after
        return (
            impulse * (P * wp.transpose(frame)), Z_after, G_after, wp.determinant(F) > real(0.0)
        )  # fmt: skip

    @wp.func
    def pull_adjoint(
        D: mat33, B: mat33, mu: real, lam: real, yield_stress: real, keep: real, share: real,
        Z: mat33, G: mat33, impulse: real, pull_bar: mat33, Z_bar: mat33, G_bar: mat33,
    ):  # fmt: skip
        """Transpose of ``pull``; Z_bar are derivatives by the six numbers of Z, as a matrix.

        Returns:
            Derivatives by D, mu, lam, yield stress, keep, share, Z and G.
        """
        F = D * B
        elastic, G_after = elastic_part(F, G, mu, yield_stress)
        frame = B
        if plastic == 1:
            frame = B * G_after
        P_bar = impulse * (pull_bar * frame)
        law_bar = P_bar
        elastic_bar = mat33()
        keep_bar = real(0.0)
        share_bar = real(0.0)
        P = mat33()
        damps = maxwell == 1 and share > real(0.0)
        if damps or plastic == 1:
            P = stress(elastic, mu, lam)
        total = P
        if damps:
            inverse = wp.inverse(elastic)
            S = inverse * P
            keep_bar = -sum_of(Z_bar, S - Z)
            share_bar = wp.ddot(P_bar, P - elastic * Z)
            total = (real(1.0) + share) * P - share * (elastic * Z)
            # S = F^-1 P: dS = F^-1 (dP - dF S); off the diagonal a number stands for two
            S_bar = (real(1.0) - keep) * halved(Z_bar)
            through = wp.transpose(inverse) * S_bar
            law_bar = (real(1.0) + share) * P_bar + through
            elastic_bar = -share * (P_bar * Z) - through * wp.transpose(S)
            twice = wp.transpose(elastic) * P_bar
            Z_bar = keep * Z_bar - share * doubled(twice)
        by_F, mu_bar, lam_bar = stress_adjoint(elastic, mu, lam, law_bar)
        elastic_bar += by_F
        F_bar = elastic_bar
        yield_bar = real(0.0)
        if plastic == 1:
            tried = F * G
            G_bar += wp.transpose(B) * (impulse * (wp.transpose(pull_bar) * total))
            by_tried = elastic_bar
            F_bar = mat33()
            if wp.ddot(elastic - tried, elastic - tried) > real(0.0):
                through = wp.transpose(wp.inverse(F)) * G_bar
                F_bar = -through * wp.transpose(G_after)
                G_bar = mat33()
                by_tried, mu_more, yield_bar = return_map_adjoint(
                    tried, mu, yield_stress, elastic_bar + through
                )
                mu_bar += mu_more
            F_bar += by_tried * wp.transpose(G)
            G_bar += wp.transpose(F) * by_tried
        return (
            F_bar * wp.transpose(B), mu_bar, lam_bar, yield_bar, keep_bar, share_bar, Z_bar, G_bar
        )  # fmt: skip

    @wp.func
    def sum_of(bar: mat33, A: mat33):
        """Sum of derivatives by six numbers times these, both as symmetric matrices."""
        return wp.ddot(halved(bar), A)

    @wp.func
    def halved(bar: mat33):
        """Derivatives by the entries of a symmetric matrix from those by its six numbers."""
        half = real(0.5)
        return mat33(
            bar[0, 0], half * bar[0, 1], half * bar[0, 2],
            half * bar[0, 1], bar[1, 1], half * bar[1, 2],
            half * bar[0, 2], half * bar[1, 2], bar[2, 2],
        )  # fmt: skip

    @wp.func
    def doubled(A: mat33):
        """Derivatives by six numbers, as a matrix, from those by the entries."""
        xy = A[0, 1] + A[1, 0]
        xz = A[0, 2] + A[2, 0]
        yz = A[1, 2] + A[2, 1]
        return mat33(A[0, 0], xy, xz, xy, A[1, 1], yz, xz, yz, A[2, 2])

    @wp.func
    def air(D: mat33, v: vec3, spans: wp.vec3i, sheet: int, drag: real, dt: real):
        """Impulse of the air on a particle.

        ``drag`` is 1/2 rho c times the diameter for each particle of a rope's section, or times the
        particle's share of a sheet's thickness.
        """
        first = vec3(D[0, 0], D[1, 0], D[2, 0]) / real(spans[0])
        if sheet == 1:
            second = vec3(D[0, 1], D[1, 1], D[2, 1]) / real(spans[1])
            area = wp.cross(first, second)
            flow = wp.dot(v, area) / wp.length(area)
            return (-dt * drag * wp.abs(flow) * flow) * area
        length = wp.length(first)
        along = first / length
        across = v - wp.dot(v, along) * along
        return (-dt * drag * length * wp.length(across)) * across

    @wp.func
    def air_adjoint(
        D: mat33, v: vec3, spans: wp.vec3i, sheet: int, drag: real, dt: real, bar: vec3
    ):
        """Derivatives by D, v and drag from that by the impulse."""
        D_bar = mat33()
        v_bar = vec3()
        drag_bar = real(0.0)
        first = vec3(D[0, 0], D[1, 0], D[2, 0]) / real(spans[0])
        first_bar = vec3()
        if sheet == 1:
            second = vec3(D[0, 1], D[1, 1], D[2, 1]) / real(spans[1])
            area = wp.cross(first, second)
            size = wp.length(area)
            flow = wp.dot(v, area) / size
            drag_bar = -dt * wp.abs(flow) * flow * wp.dot(area, bar)
            flow_bar = real(-2.0) * dt * drag * wp.abs(flow) * wp.dot(area, bar)
            v_bar = (flow_bar / size) * area
            area_bar = (-dt * drag * wp.abs(flow) * flow) * bar
            area_bar += (flow_bar / size) * (v - (flow / size) * area)
            first_bar = wp.cross(second, area_bar)
            second_bar = wp.cross(area_bar, first) / real(spans[1])
            for n in range(3):
                D_bar[n, 1] = second_bar[n]
        else:
            length = wp.length(first)
            along = first / length
            across = v - wp.dot(v, along) * along
            speed = wp.length(across)
            if speed > real(0.0):
                work = wp.dot(across, bar)
                drag_bar = -dt * length * speed * work
                across_bar = (-dt * drag * length) * (speed * bar + (work / speed) * across)
                inward = wp.dot(across_bar, along)
                v_bar = across_bar - inward * along
                along_bar = -wp.dot(v, along) * across_bar - inward * v
                first_bar = (along_bar - wp.dot(along_bar, along) * along) / length
                first_bar -= (dt * drag * speed * work) * along
        for n in range(3):
            D_bar[n, 0] = first_bar[n] / real(spans[0])
        return D_bar, v_bar, drag_bar

    return SimpleNamespace(
        branch=branch,
        branch_adjoint=branch_adjoint,
        pull=pull,
        pull_adjoint=pull_adjoint,
        air=air,
        air_adjoint=air_adjoint,
    )


@functools.cache
def make_internal_forces(real: Any, law_name: str, *, yields: bool) -> SimpleNamespace:
    """Build the forces on rows of particles, see ``types.State``.

    Returns:
        Namespace with ``particle_forces`` and ``body_forces``, which set the pulls [W, N] of one or
        of all particles and Z and G after the substep; ``impulse_on``, what a particle gets of
        them; and the transposes ``particle_forces_adjoint``, ``body_forces_adjoint`` and
        ``impulse_on_adjoint``. Those of bodies have several neo-Hookean particles side by side
        (``native/simd_elasticity.h``, CPU).
    """
    types = make_types(real)
    vec3, mat33, pull_type = types.vec3, types.mat33, types.pull
    Matter, State = types.Matter, types.State
    MatterBars, SceneBars = types.MatterBars, types.SceneBars
    elasticity = make_elasticity(real, law_name, yields=yields)
    pull, pull_adjoint = elasticity.pull, elasticity.pull_adjoint
    air, air_adjoint = elasticity.air, elasticity.air_adjoint
    plastic = wp.constant(int(yields))
    vec2 = wp.types.vector(2, real)
    width = wp.constant(8 if real == wp.float32 else 4)
    cpu = "\n#if !defined(__CUDA_ARCH__)\n{}\n#else\nreturn {{}};\n#endif\n"

    @wp.func_native(
        cpu.format(
            "return gendom::internal_forces(w, first, fresh, x, v, row, row_out, lattice, per_span,"
            " sheet, strength, frame, mu, lam, impulse, keep, share, Z, Z_out, pulls);"
        )
    )
    def side_by_side(
        w: int,
        first: int,
        fresh: int,  # the first whose forces are asked for
        x: wp.array2d(dtype=vec3),
        v: wp.array2d(dtype=vec3),
        row: int,
        row_out: int,
        lattice: wp.array3d(dtype=wp.int32),
        per_span: wp.array2d(dtype=real),
        sheet: int,
        strength: real,  # of the air: its drag times -dt
        frame: wp.array2d(dtype=real),
        mu: wp.array2d(dtype=real),
        lam: wp.array2d(dtype=real),
        impulse: real,
        keep: real,
        share: real,
        Z: wp.array3d(dtype=real),
        Z_out: wp.array3d(dtype=real),
        pulls: wp.array2d(dtype=pull_type),
    ) -> int: ...

    @wp.func_native(
        cpu.format(
            "return gendom::internal_forces_adjoint(w, first, fresh, x, row, lattice, frame, mu,"
            " lam, by_difference, keep, share, Z, v_bar, mu_bar, lam_bar, Z_bar, stretches);"
        )
    )
    def side_by_side_adjoint(
        w: int,
        first: int,
        fresh: int,
        x: wp.array2d(dtype=vec3),
        row: int,
        lattice: wp.array3d(dtype=wp.int32),
        frame: wp.array2d(dtype=real),
        mu: wp.array2d(dtype=real),
        lam: wp.array2d(dtype=real),
        by_difference: real,  # -(substep times volume over mass of a particle)
        keep: real,
        share: real,
        Z: wp.array3d(dtype=real),
        v_bar: wp.array2d(dtype=vec3),
        mu_bar: wp.array2d(dtype=real),
        lam_bar: wp.array2d(dtype=real),
        Z_bar: wp.array3d(dtype=real),
        stretches: wp.array2d(dtype=pull_type),
    ) -> vec2: ...

    @wp.func_native("return gendom::pulled(p, lattice, pulls, w);")
    def pulled(
        p: int, lattice: wp.array3d(dtype=wp.int32), pulls: wp.array2d(dtype=pull_type), w: int
    ) -> vec3: ...

    @wp.func
    def near_of(p: int, matter: Matter):
        near = matter.lattice
        return Near(
            near[p, 0, 0], near[p, 0, 1], near[p, 1, 0], near[p, 1, 1], near[p, 2, 0],
            near[p, 2, 1],
        )  # fmt: skip

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
    def stored(H: mat33, padding: vec3):
        """Pulls [3, axis] and the air's impulse as they are stored."""
        return pull_type(
            H[0, 0], H[1, 0], H[2, 0], padding[0],
            H[0, 1], H[1, 1], H[2, 1], padding[1],
            H[0, 2], H[1, 2], H[2, 2], padding[2],
        )  # fmt: skip

    @wp.func
    def padding_of(pulls: wp.array2d(dtype=pull_type), w: int, p: int):
        own = pulls[w, p]
        return vec3(own[0, 3], own[1, 3], own[2, 3])

    @wp.func
    def Z_of(Z: wp.array3d(dtype=real), row: int, p: int):
        """Z from its numbers xx, yy, zz, xy, xz, yz."""
        return mat33(
            Z[row, 0, p], Z[row, 3, p], Z[row, 4, p],
            Z[row, 3, p], Z[row, 1, p], Z[row, 5, p],
            Z[row, 4, p], Z[row, 5, p], Z[row, 2, p],
        )  # fmt: skip

    @wp.func
    def put_Z(Z: wp.array3d(dtype=real), row: int, p: int, A: mat33):
        for n in range(3):
            Z[row, n, p] = A[n, n]
        Z[row, 3, p] = A[0, 1]
        Z[row, 4, p] = A[0, 2]
        Z[row, 5, p] = A[1, 2]

    @wp.func
    def particle_forces(
        w: int, p: int, row: int, row_out: int, dt: real, keep: real, share: real, matter: Matter,
        state: State, state_out: State, pulls: wp.array2d(dtype=pull_type),
    ):  # fmt: skip
        """Set a particle's pulls on its neighbours; returns whether it is upright."""
        D = differences(p, row, matter, state.x)
        Z = mat33()
        G = mat33()
        if share > real(0.0):
            Z = Z_of(state.Z, row, p)
        if plastic == 1:
            G = state.G[row, p]
        H, Z_after, G_after, upright = pull(
            D, matter.rest_frame[p], matter.mu[w, p], matter.lam[w, p], matter.yield_stress[w],
            keep, share, Z, G, dt * matter.volume,
        )  # fmt: skip
        if share > real(0.0):
            put_Z(state_out.Z, row_out, p, Z_after)
        if plastic == 1:
            state_out.G[row_out, p] = G_after
        wind = vec3()
        if matter.drag[w] > real(0.0):
            spans = spans_of(near_of(p, matter), p)
            wind = air(D, state.v[row, p], spans, matter.sheet, matter.drag[w], dt)
        pulls[w, p] = stored(H, wind)
        return upright

    @wp.func
    def forces_one_by_one(
        w: int, row: int, row_out: int, dt: real, keep: real, share: real, matter: Matter,
        state: State, state_out: State, pulls: wp.array2d(dtype=pull_type),
    ):  # fmt: skip
        """Set all pulls of a body; returns a particle that is not upright, or -1."""
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
        state: State, state_out: State, pulls: wp.array2d(dtype=pull_type),
    ):  # fmt: skip
        """The same, faster, on the CPU."""
        N = state.x.shape[1]
        if N < width:
            return forces_one_by_one(
                w, row, row_out, dt, keep, share, matter, state, state_out, pulls
            )
        failed = int(-1)
        p = int(0)
        while p < N:
            # the last ones together with some that are done already
            found = side_by_side(
                w, wp.min(p, N - width), p, state.x, state.v, row, row_out, matter.lattice,
                matter.per_span, matter.sheet, -dt * matter.drag[w], matter.frame, matter.mu,
                matter.lam, dt * matter.volume, keep, share, state.Z, state_out.Z, pulls,
            )  # fmt: skip
            failed = wp.max(failed, found)
            p += width
        return failed

    @wp.func
    def impulse_on(p: int, matter: Matter, pulls: wp.array2d(dtype=pull_type), w: int):
        """Impulse of a substep on a particle by its neighbours and by the air."""
        return pulled(p, matter.lattice, pulls, w) + padding_of(pulls, w, p)

    @wp.func
    def air_on_adjoint(
        w: int, p: int, row: int, dt: real, matter: Matter, state: State, bars: MatterBars
    ):
        """Derivatives by the differences and by v of what the air does to a particle."""
        spans = spans_of(near_of(p, matter), p)
        D_bar, v_bar, drag_bar = air_adjoint(
            differences(p, row, matter, state.x), state.v[row, p], spans, matter.sheet,
            matter.drag[w], dt, bars.v[w, p] / matter.mass[w],
        )  # fmt: skip
        bars.drag[w, p] = bars.drag[w, p] + drag_bar
        return D_bar, v_bar

    @wp.func
    def particle_forces_adjoint(
        w: int, p: int, row: int, dt: real, keep: real, share: real, matter: Matter, state: State,
        bars: MatterBars, stretches: wp.array2d(dtype=pull_type),
    ):  # fmt: skip
        """Transpose of ``particle_forces`` and ``impulse_on`` but for its last step,
        ``impulse_on_adjoint``; returns the derivatives by ``keep`` and ``share``.

        Derivatives by impulses are found in those by v.
        """
        # a pull draws one neighbour forth and the other back
        pull_bar = (real(-1.0) / matter.mass[w]) * differences(p, w, matter, bars.v)
        Z = mat33()
        G = mat33()
        Z_bar = mat33()
        G_bar = mat33()
        if share > real(0.0):
            Z = Z_of(state.Z, row, p)
            Z_bar = Z_of(bars.Z, w, p)
        if plastic == 1:
            G = state.G[row, p]
            G_bar = bars.G[w, p]
        D_bar, mu_bar, lam_bar, yield_bar, keep_bar, share_bar, Z_bar_before, G_bar_before = (
            pull_adjoint(
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
            put_Z(bars.Z, w, p, Z_bar_before)
        if plastic == 1:
            bars.G[w, p] = G_bar_before
            bars.yield_stress[w, p] = bars.yield_stress[w, p] + yield_bar
        return keep_bar, share_bar

    @wp.func
    def one_by_one_adjoint(
        w: int, row: int, dt: real, keep: real, share: real, matter: Matter, state: State,
        bars: MatterBars, scene_bars: SceneBars, stretches: wp.array2d(dtype=pull_type),
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
        bars: MatterBars, scene_bars: SceneBars, stretches: wp.array2d(dtype=pull_type),
    ):  # fmt: skip
        N = state.x.shape[1]
        if N < width:
            one_by_one_adjoint(w, row, dt, keep, share, matter, state, bars, scene_bars, stretches)
        else:
            p = int(0)
            while p < N:
                sums = side_by_side_adjoint(
                    w, wp.min(p, N - width), p, state.x, row, matter.lattice, matter.frame,
                    matter.mu, matter.lam, -(dt * matter.volume) / matter.mass[w], keep, share,
                    state.Z, bars.v, bars.mu, bars.lam, bars.Z, stretches,
                )  # fmt: skip
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
    def impulse_on_adjoint(
        w: int, p: int, matter: Matter, bars: MatterBars, stretches: wp.array2d(dtype=pull_type)
    ):
        """Add to the derivatives by a particle's position those by all differences."""
        bars.x[w, p] = bars.x[w, p] - pulled(p, matter.lattice, stretches, w)
        bars.v[w, p] = bars.v[w, p] + padding_of(stretches, w, p)

    together = law_name == "neo-hookean" and not yields
    return SimpleNamespace(
        particle_forces=particle_forces,
        particle_forces_adjoint=particle_forces_adjoint,
        body_forces=forces_side_by_side if together else forces_one_by_one,
        body_forces_adjoint=side_by_side_all_adjoint if together else one_by_one_adjoint,
        impulse_on=impulse_on,
        impulse_on_adjoint=impulse_on_adjoint,
        branch=elasticity.branch,
        branch_adjoint=elasticity.branch_adjoint,
    )
