"""Internal forces of a particle: what it does to its neighbours, and what the air does to it.

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
  stress and Z the same filtered with the branch's time tau: per substep, with
  a = exp(-dt / tau) and g = (1 + a) / 2,

      P <- (1 + g) P - g F Z,      Z <- Z + (1 - a) (S - Z).

  In slow motion that is a viscosity of tau times the elastic moduli, so tau is
  ``Material.damping``; above 1 / tau it is an additional stiffness, at most that of the law:
  substeps shrink by sqrt(2). Both lines are exact to second order in dt / tau. At rest Z = S:
  static shapes do not change.
- **Air**: -1/2 rho c |v_n| v_n A n on each patch of a sheet with the velocity v_n along its normal,
  -1/2 rho c d l |v_t| v_t across each stretch l of a rope, v_t the velocity less its part along it.

Forces go to particles as impulses of a substep: each particle pulls the neighbour behind it along a
lattice axis back and the one before it forth. Each function has its transpose beside it;
``internal_forces`` calls them for the particles of a body.
"""

import functools
from typing import Any

import warp as wp

from gendom.materials.laws import make_law
from gendom.sim.mpm.types import Namespace, make_types

FILLS = 1.0e-30
"""Share of the branch with which Z is filled and nothing else happens."""


@functools.cache
def make_maxwell_branch(real: Any) -> Namespace:
    """Build ``branch`` (a and g of a substep) and its transpose, for one scalar type."""

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

    return Namespace(branch, branch_adjoint)


@functools.cache
def make_elasticity(real: Any, law_name: str, *, yields: bool, damped: bool = True) -> Namespace:
    """Build the forces of one particle, for one scalar type and one material.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        law_name: Elastic law, see ``gendom.materials.laws``.
        yields: Whether particles yield.
        damped: Whether any material has damping.

    Returns:
        Namespace with ``pull`` and ``air``, and the transpose of each.
    """
    types = make_types(real)
    vec3, mat33 = types.vec3, types.mat33
    law = make_law(law_name, real, plastic=yields)
    plastic = wp.constant(int(yields))
    maxwell = wp.constant(int(damped))

    @wp.func
    def elastic_part(F: mat33, G: mat33, mu: real, yield_stress: real):
        """Elastic part of F and the new G."""
        elastic = F
        if plastic == 1:
            tried = F * G
            elastic = law.return_map(tried, mu, yield_stress)
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
        P = law.stress(elastic, mu, lam)
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
            P = law.stress(elastic, mu, lam)
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
        by_F, mu_bar, lam_bar = law.stress_back(elastic, mu, lam, law_bar)
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
                by_tried, mu_more, yield_bar = law.return_map_back(
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
    def per(spans: int):
        """One over so many lattice spacings, 1 or 2."""
        return wp.where(spans == 1, real(1.0), real(0.5))

    @wp.func
    def air(D: mat33, v: vec3, spans: wp.vec3i, sheet: int, drag: real, dt: real):
        """Impulse of the air on a particle.

        ``drag`` is 1/2 rho c times the diameter for each particle of a rope's section, or times the
        particle's share of a sheet's thickness.
        """
        first = vec3(D[0, 0], D[1, 0], D[2, 0]) * per(spans[0])
        if sheet == 1:
            second = vec3(D[0, 1], D[1, 1], D[2, 1]) * per(spans[1])
            area = wp.cross(first, second)
            flow = wp.dot(v, area) / wp.length(area)
            return (-dt * drag * wp.abs(flow) * flow) * area
        square = wp.length_sq(first)
        across = v - (wp.dot(v, first) / square) * first
        return (-dt * drag * wp.sqrt(square * wp.length_sq(across))) * across

    @wp.func
    def air_adjoint(
        D: mat33, v: vec3, spans: wp.vec3i, sheet: int, drag: real, dt: real, bar: vec3
    ):
        """Derivatives by D, v and drag from that by the impulse."""
        D_bar = mat33()
        v_bar = vec3()
        drag_bar = real(0.0)
        first = vec3(D[0, 0], D[1, 0], D[2, 0]) * per(spans[0])
        first_bar = vec3()
        if sheet == 1:
            second = vec3(D[0, 1], D[1, 1], D[2, 1]) * per(spans[1])
            area = wp.cross(first, second)
            size = wp.length(area)
            flow = wp.dot(v, area) / size
            drag_bar = -dt * wp.abs(flow) * flow * wp.dot(area, bar)
            flow_bar = real(-2.0) * dt * drag * wp.abs(flow) * wp.dot(area, bar)
            v_bar = (flow_bar / size) * area
            area_bar = (-dt * drag * wp.abs(flow) * flow) * bar
            area_bar += (flow_bar / size) * (v - (flow / size) * area)
            first_bar = wp.cross(second, area_bar)
            second_bar = wp.cross(area_bar, first) * per(spans[1])
            for n in range(3):
                D_bar[n, 1] = second_bar[n]
        else:
            square = wp.length_sq(first)
            per_square = real(1.0) / square
            length = wp.sqrt(square)
            share = wp.dot(v, first) * per_square
            across = v - share * first
            speed = wp.length(across)
            if speed > real(0.0):
                work = wp.dot(across, bar)
                drag_bar = -dt * length * speed * work
                across_bar = (-dt * drag * length) * (speed * bar + (work / speed) * across)
                inward = wp.dot(across_bar, first) * per_square
                v_bar = across_bar - inward * first
                first_bar = inward * (real(2.0) * share * first - v) - share * across_bar
                first_bar -= (dt * drag * speed * work * length * per_square) * first
        for n in range(3):
            D_bar[n, 0] = first_bar[n] * per(spans[0])
        return D_bar, v_bar, drag_bar

    return Namespace(pull, pull_adjoint, air, air_adjoint)
