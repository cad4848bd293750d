"""The neo-Hookean law as Warp functions, made for one floating-point type.

It maps the deformation gradient F to the first Piola-Kirchhoff stress P. Its transpose stands
beside it and carries derivatives of a loss from P back to F, mu and lam. A name with ``_bar`` is
the derivative of the loss by that quantity.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from typing import Any, NamedTuple

import warp as wp


class Law(NamedTuple):
    """The Warp functions of an elastic law."""

    stress: Any
    """(F, mu, lam) -> P [Pa]."""
    stress_adjoint: Any
    """(F, mu, lam, P_bar) -> F_bar, mu_bar, lam_bar."""


@functools.cache
def make_neo_hookean(real: Any) -> Law:
    """Build the law for ``wp.float32`` or ``wp.float64``.

    Source: Bonet and Wood (2008), "Nonlinear Continuum Mechanics", chapter 6.
    """
    mat33 = wp.types.matrix((3, 3), real)
    vec3 = wp.types.vector(3, real)

    @wp.func
    def cofactors(F: mat33):
        """J F^-T: columns are cross products of those of F."""
        a = vec3(F[0, 0], F[1, 0], F[2, 0])
        b = vec3(F[0, 1], F[1, 1], F[2, 1])
        c = vec3(F[0, 2], F[1, 2], F[2, 2])
        return wp.matrix_from_cols(wp.cross(b, c), wp.cross(c, a), wp.cross(a, b))

    @wp.func
    def stress(F: mat33, mu: real, lam: real):
        """P = mu (F - F^-T) + lam log(J) F^-T."""
        J = wp.determinant(F)
        return mu * F + ((lam * wp.log(J) - mu) / J) * cofactors(F)

    @wp.func
    def stress_adjoint(F: mat33, mu: real, lam: real, P_bar: mat33):
        """Transpose of ``stress``; d(F^-T) = -F^-T dF^T F^-T."""
        J = wp.determinant(F)
        B = (real(1.0) / J) * cofactors(F)
        log_J = wp.log(J)
        share = wp.ddot(P_bar, B)
        F_bar = mu * P_bar + (lam * share) * B
        F_bar -= (lam * log_J - mu) * (B * (wp.transpose(P_bar) * B))
        return F_bar, wp.ddot(P_bar, F) - share, log_J * share

    return Law(stress, stress_adjoint)
