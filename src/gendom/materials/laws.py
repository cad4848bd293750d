"""Constitutive laws as Warp functions, made for one floating-point type.

A law maps the deformation gradient F to the Kirchhoff stress tau = J sigma; a return mapping
maps a trial F to the F that the yield surface allows. The simulator's kernels only loop.
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
        stress: (F, mu, lam) -> tau [Pa].
        return_map: (F trial, mu, yield stress) -> F [-].
    """

    stress: Any
    return_map: Any


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

    @wp.func
    def neo_hookean(F: mat33, mu: real, lam: real):
        """tau = mu (F F^T - I) + lam log(J) I. Source: Bonet and Wood (2008), chapter 6."""
        eye = wp.identity(n=3, dtype=real)
        return mu * (F * wp.transpose(F) - eye) + (lam * wp.log(wp.determinant(F))) * eye

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
        """tau = 2 mu (F - R) F^T + lam J (J - 1) I. Source: Stomakhin et al. (2012)."""
        J = wp.determinant(F)
        eye = wp.identity(n=3, dtype=real)
        return (real(2.0) * mu) * ((F - rotation_of(F)) * wp.transpose(F)) + (
            lam * J * (J - real(1.0))
        ) * eye

    @wp.func
    def von_mises(F: mat33, mu: real, yield_stress: real):
        """Radial return in Hencky strain: |2 mu dev(eps)| <= yield stress.

        Source: Klar et al. (2016), section 6, with a von Mises surface.
        """
        U = mat33()
        s = vec3()
        V = mat33()
        wp.svd3(F, U, s, V)
        floor = real(SMALLEST_STRETCH)
        eps = vec3(
            wp.log(wp.max(s[0], floor)), wp.log(wp.max(s[1], floor)), wp.log(wp.max(s[2], floor))
        )
        mean = (eps[0] + eps[1] + eps[2]) / real(3.0)
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
    def elastic(F: mat33, mu: real, yield_stress: real):
        """No plastic flow."""
        return F

    laws = {"neo-hookean": neo_hookean, "fixed-corotated": fixed_corotated}
    if name not in laws:
        raise ValueError(f"unknown elastic law {name!r}: choose one of {', '.join(LAWS)}")
    return Law(stress=laws[name], return_map=von_mises if plastic else elastic)
