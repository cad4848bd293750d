"""Constitutive laws as Warp functions, made for one floating-point type.

A law maps the deformation gradient F to the first Piola-Kirchhoff stress P; a return mapping
maps a trial F to the F that the yield surface allows. Each has its transpose beside it, which
carries derivatives of a loss from the result to the arguments; a name with ``_bar`` is the
derivative of the loss by that quantity. The simulator's kernels only loop.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from typing import Any, NamedTuple

import warp as wp

LAWS = ("neo-hookean", "fixed-corotated")
"""Names of the elastic laws that a model can be built with."""

POLAR_ITERATIONS = 16
"""Upper bound on Newton steps of the polar decomposition; near a rotation it stops after four."""

SMALLEST_STRETCH = 0.05
"""Principal stretches are kept above this before their logarithm is taken (plasticity only)."""


class Law(NamedTuple):
    """The Warp functions of one material.

    Attributes:
        stress: (F, mu, lam) -> P [Pa].
        stress_back: (F, mu, lam, P_bar) -> F_bar, mu_bar, lam_bar.
        return_map: (F trial, mu, yield stress) -> F [-].
        return_map_back: (F trial, mu, yield stress, F_bar) -> F trial_bar, mu_bar, yield_bar.
        plastic: Whether the return mapping does anything.
        name: Of the elastic law.
    """

    stress: Any
    stress_back: Any
    return_map: Any
    return_map_back: Any
    plastic: bool
    name: str


@functools.cache
def make_law(name: str, real: Any, *, plastic: bool) -> Law:
    """Build a law's functions for a scalar type.

    Args:
        name: One of ``LAWS``.
        real: ``wp.float32`` or ``wp.float64``.
        plastic: Whether the return mapping is von Mises or does nothing.

    Raises:
        ValueError: If the name is not a known law.
    """
    mat33 = wp.types.matrix((3, 3), real)
    vec3 = wp.types.vector(3, real)
    close = 1.0e-3 if real == wp.float32 else 1.0e-7

    @wp.func
    def cofactors(F: mat33):
        """J F^-T: columns are cross products of those of F."""
        a = vec3(F[0, 0], F[1, 0], F[2, 0])
        b = vec3(F[0, 1], F[1, 1], F[2, 1])
        c = vec3(F[0, 2], F[1, 2], F[2, 2])
        return wp.matrix_from_cols(wp.cross(b, c), wp.cross(c, a), wp.cross(a, b))

    @wp.func
    def neo_hookean(F: mat33, mu: real, lam: real):
        """P = mu (F - F^-T) + lam log(J) F^-T. Source: Bonet and Wood (2008), chapter 6."""
        J = wp.determinant(F)
        return mu * F + ((lam * wp.log(J) - mu) / J) * cofactors(F)

    @wp.func
    def neo_hookean_back(F: mat33, mu: real, lam: real, P_bar: mat33):
        """Transpose of ``neo_hookean``; d(F^-T) = -F^-T dF^T F^-T."""
        J = wp.determinant(F)
        B = (real(1.0) / J) * cofactors(F)
        log_J = wp.log(J)
        share = wp.ddot(P_bar, B)
        F_bar = mu * P_bar + (lam * share) * B
        F_bar -= (lam * log_J - mu) * (B * (wp.transpose(P_bar) * B))
        return F_bar, wp.ddot(P_bar, F) - share, log_J * share

    @wp.func
    def rotation_of(F: mat33):
        """Rotation R of F = R S by Newton's iteration R <- (R + R^-T) / 2.

        Source: Higham (1986), "Computing the polar decomposition". Needs det F > 0.
        """
        R = F
        change = real(1.0)
        n = int(0)
        while n < POLAR_ITERATIONS and change > real(1.0e-14):
            R_next = real(0.5) * (R + wp.transpose(wp.inverse(R)))
            change = wp.ddot(R_next - R, R_next - R)
            R = R_next
            n += 1
        return R

    @wp.func
    def fixed_corotated(F: mat33, mu: real, lam: real):
        """P = 2 mu (F - R) + lam (J - 1) J F^-T. Source: Stomakhin et al. (2012)."""
        J = wp.determinant(F)
        return (real(2.0) * mu) * (F - rotation_of(F)) + (lam * (J - real(1.0))) * cofactors(F)

    @wp.func
    def rotation_of_back(F: mat33, R: mat33, R_bar: mat33):
        """Transpose of ``rotation_of``, from R^T dF - dF^T R = Omega P + P Omega, dR = R Omega."""
        P = wp.transpose(R) * F
        B = wp.transpose(R) * R_bar
        M = wp.trace(P) * wp.identity(n=3, dtype=real) - P
        y = wp.inverse(M) * vec3(B[2, 1] - B[1, 2], B[0, 2] - B[2, 0], B[1, 0] - B[0, 1])
        return R * wp.skew(y)

    @wp.func
    def fixed_corotated_back(F: mat33, mu: real, lam: real, P_bar: mat33):
        """Transpose of ``fixed_corotated``."""
        R = rotation_of(F)
        J = wp.determinant(F)
        B = (real(1.0) / J) * cofactors(F)
        share = J * wp.ddot(P_bar, B)
        grown = J - real(1.0)
        F_bar = (real(2.0) * mu) * (P_bar - rotation_of_back(F, R, P_bar))
        F_bar += (lam * (J + grown) * share) * B
        F_bar -= (lam * grown * J) * (B * (wp.transpose(P_bar) * B))
        return F_bar, real(2.0) * wp.ddot(P_bar, F - R), grown * share

    @wp.func
    def hencky(F: mat33):
        """F = U diag(s) V^T; the principal Hencky strains log(s), kept finite, and their mean."""
        U = mat33()
        s = vec3()
        V = mat33()
        wp.svd3(F, U, s, V)
        floor = real(SMALLEST_STRETCH)
        eps = vec3(
            wp.log(wp.max(s[0], floor)), wp.log(wp.max(s[1], floor)), wp.log(wp.max(s[2], floor))
        )
        return U, s, V, eps, (eps[0] + eps[1] + eps[2]) / real(3.0)

    @wp.func
    def von_mises(F: mat33, mu: real, yield_stress: real):
        """Radial return in Hencky strain: |2 mu dev(eps)| <= yield stress.

        Source: Klar et al. (2016), section 6, with a von Mises surface.
        """
        U, _s, V, eps, mean = hencky(F)
        dev = eps - vec3(mean, mean, mean)
        norm = wp.length(dev)
        excess = norm - yield_stress / (real(2.0) * mu)
        result = F
        if excess > real(0.0):
            eps = eps - dev * (excess / norm)
            stretch = wp.diag(vec3(wp.exp(eps[0]), wp.exp(eps[1]), wp.exp(eps[2])))
            result = U * stretch * wp.transpose(V)
        return result

    @wp.func
    def von_mises_back(F: mat33, mu: real, yield_stress: real, F_bar: mat33):
        """Transpose of ``von_mises``.

        For F' = U f(s) V^T the change of U^T F' V is, off the diagonal, (f_i - f_j)/(s_i - s_j)
        times the symmetric and (f_i + f_j)/(s_i + s_j) times the skew part of U^T dF V; on the
        diagonal it is df. Source: Papadopoulo and Lourakis (2000), on derivatives of the SVD.
        """
        U, s, V, eps, mean = hencky(F)
        dev = eps - vec3(mean, mean, mean)
        norm = wp.length(dev)
        reach = yield_stress / (real(2.0) * mu)
        result = F_bar
        mu_bar = real(0.0)
        yield_bar = real(0.0)
        if norm > reach:
            # kept strain: mean + reach * direction
            direction = dev / norm
            f = vec3()
            for i in range(3):
                f[i] = wp.exp(mean + reach * direction[i])
            A = wp.transpose(U) * F_bar * V
            strain_bar = vec3(A[0, 0] * f[0], A[1, 1] * f[1], A[2, 2] * f[2])
            reach_bar = wp.dot(strain_bar, direction)
            average = (strain_bar[0] + strain_bar[1] + strain_bar[2]) / real(3.0)
            eps_bar = vec3(average, average, average)
            centred = strain_bar - eps_bar
            eps_bar += (reach / norm) * (centred - wp.dot(centred, direction) * direction)
            B = mat33()
            for i in range(3):
                if s[i] > real(SMALLEST_STRETCH):
                    B[i, i] = eps_bar[i] / s[i]
            for i in range(3):
                for j in range(3):
                    if i != j:
                        even = real(0.5) * (A[i, j] + A[j, i])
                        odd = real(0.5) * (A[i, j] - A[j, i])
                        # equal stretches: the limit of (f_i - f_j) / (s_i - s_j)
                        slope = (reach / norm) * f[i] / s[i]
                        if wp.abs(s[i] - s[j]) > real(close) * s[i]:
                            slope = (f[i] - f[j]) / (s[i] - s[j])
                        B[i, j] = slope * even + (f[i] + f[j]) / (s[i] + s[j]) * odd
            result = U * B * wp.transpose(V)
            yield_bar = reach_bar / (real(2.0) * mu)
            mu_bar = -reach_bar * reach / mu
        return result, mu_bar, yield_bar

    @wp.func
    def elastic(F: mat33, mu: real, yield_stress: real):
        """No plastic flow."""
        return F

    @wp.func
    def elastic_back(F: mat33, mu: real, yield_stress: real, F_bar: mat33):
        """Transpose of ``elastic``."""
        return F_bar, real(0.0), real(0.0)

    stresses = {
        "neo-hookean": (neo_hookean, neo_hookean_back),
        "fixed-corotated": (fixed_corotated, fixed_corotated_back),
    }
    if name not in stresses:
        raise ValueError(f"unknown elastic law {name!r}: choose one of {', '.join(LAWS)}")
    maps = (von_mises, von_mises_back) if plastic else (elastic, elastic_back)
    return Law(*stresses[name], *maps, plastic, name)
