"""Internal forces of a particle: what it does to its neighbours, and what the air does to it.

A body remembers its shape at rest. F of a particle is what the differences D of the positions of
its neighbours in the rest lattice say, F = D B with the inverse B of the same at rest; the elastic
energy is a function of positions alone, and its derivatives are the forces (Lagrangian forces:
Jiang, Gast and Teran 2017). No energy comes from nowhere, and what has come to rest stays.

- **Elastic law**: neo-Hookean, P(F), see ``gendom.materials.laws``.
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
``internal_forces`` calls them for the particles of a body on CUDA; ``native/simd_elasticity.h``
does the same for several particles at once on the CPU.
"""

import functools
from typing import Any

import warp as wp

from gendom.materials.laws import make_neo_hookean
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
def make_elasticity(real: Any, *, damped: bool) -> Namespace:
    """Build the forces of one particle, for one scalar type.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        damped: Whether any material has damping.

    Returns:
        Namespace with ``pull`` and ``air``, and the transpose of each.
    """
    types = make_types(real)
    vec3, mat33 = types.vec3, types.mat33
    law = make_neo_hookean(real)
    maxwell = wp.constant(int(damped))

    @wp.func
    def pull(
        D: mat33, B: mat33, mu: real, lam: real, keep: real, share: real, Z: mat33, impulse: real,
    ):  # fmt: skip
        """Impulses [3, axis] by which a particle draws its neighbours together.

        ``impulse`` is the substep times the particle's volume.

        Returns:
            The impulses, Z after the substep, and whether the particle is not inverted (J > 0).
        """
        F = D * B
        P = law.stress(F, mu, lam)
        Z_after = Z
        if maxwell == 1 and share > real(0.0):
            S = wp.inverse(F) * P
            P = (real(1.0) + share) * P - share * (F * Z)
            Z_after = Z + (real(1.0) - keep) * (S - Z)
        return impulse * (P * wp.transpose(B)), Z_after, wp.determinant(F) > real(0.0)

    @wp.func
    def pull_adjoint(
        D: mat33, B: mat33, mu: real, lam: real, keep: real, share: real, Z: mat33, impulse: real,
        pull_bar: mat33, Z_bar: mat33,
    ):  # fmt: skip
        """Transpose of ``pull``; Z_bar are derivatives by the six numbers of Z, as a matrix.

        Returns:
            Derivatives by D, mu, lam, keep, share and Z.
        """
        F = D * B
        P_bar = impulse * (pull_bar * B)
        law_bar = P_bar
        F_bar = mat33()
        keep_bar = real(0.0)
        share_bar = real(0.0)
        if maxwell == 1 and share > real(0.0):
            P = law.stress(F, mu, lam)
            inverse = wp.inverse(F)
            S = inverse * P
            keep_bar = -wp.ddot(halved(Z_bar), S - Z)
            share_bar = wp.ddot(P_bar, P - F * Z)
            # S = F^-1 P: dS = F^-1 (dP - dF S); off the diagonal a number stands for two
            through = wp.transpose(inverse) * ((real(1.0) - keep) * halved(Z_bar))
            law_bar = (real(1.0) + share) * P_bar + through
            F_bar = -share * (P_bar * Z) - through * wp.transpose(S)
            Z_bar = keep * Z_bar - share * doubled(wp.transpose(F) * P_bar)
        by_F, mu_bar, lam_bar = law.stress_adjoint(F, mu, lam, law_bar)
        return (F_bar + by_F) * wp.transpose(B), mu_bar, lam_bar, keep_bar, share_bar, Z_bar

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
