"""Ways to teach a policy, one module each: a function ``teach(lesson)`` that returns its errors."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

from gendom.policies.policy import METHODS

if TYPE_CHECKING:
    from gendom.policies.lesson import Lesson


def teacher(method: str) -> Callable[[Lesson], dict[str, float]]:
    """The function of a method, one of `METHODS`."""
    assert method in METHODS
    return import_module(f"{__name__}.{method}").teach
