"""Positions in float32 that lose nothing: what rounding leaves out comes with the next step."""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.types import make_types


@functools.cache
def make_compensated_sum(real: Any) -> Any:
    """Build ``compensated_sum`` for one scalar type."""
    vec3 = make_types(real).vec3

    @wp.func
    def compensated_sum(x: vec3, step: vec3, low: vec3):
        """x + low + step as a rounded number and what that leaves out.

        Rounded alone, x loses what is smaller than its last bit: slow bodies stand still. Source:
        Kahan (1965), "Further remarks on reducing truncation errors".
        """
        more = step + low
        there = x + more
        return there, more - (there - x)

    return compensated_sum
