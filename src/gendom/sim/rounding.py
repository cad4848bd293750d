"""Positions in float32 that lose nothing: what rounding leaves out comes with the next step."""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp


@functools.cache
def make_rounding(real: Any) -> SimpleNamespace:
    """Build the sum for one scalar type.

    Returns:
        Namespace with ``rounds``, 1 where positions keep what rounding leaves out (float32) and 0
        elsewhere, and ``sum_up``.
    """
    vec3 = wp.types.vector(3, real)

    @wp.func
    def sum_up(x: vec3, step: vec3, low: vec3):
        """x + low + step as a rounded number and what that leaves out.

        Rounded alone, x loses what is smaller than its last bit: slow bodies stand still. Source:
        Kahan (1965), "Further remarks on reducing truncation errors".
        """
        more = step + low
        there = x + more
        return there, more - (there - x)

    return SimpleNamespace(rounds=wp.constant(1 if real == wp.float32 else 0), sum_up=sum_up)
