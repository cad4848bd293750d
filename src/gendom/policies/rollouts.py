"""Searches that ask for rollouts, many of them answered side by side.

A search is a generator: it yields `Rollouts` and is sent their outcomes. One batch of worlds takes
little longer than one world, so searches for many goals or objects are as quick as one.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from itertools import islice
from typing import TypeVar

import numpy as np

from gendom.arrays import Array
from gendom.materials import Item
from gendom.tasks import Task
from gendom.tasks.task import Outcome, World

T = TypeVar("T")


Rollouts = tuple[Sequence[Item], Sequence[Array]]
"""Actions to carry out: W objects, and W actions [A] within the limits."""

Asking = Generator[Rollouts, list[Outcome], T]
"""A search with a result."""


def side_by_side(task: Task, world: World, searches: Sequence[Asking[T]]) -> list[T]:
    """The results of searches, whose rollouts are carried out together.

    Raises:
        Exception: Whatever a search raises.
    """
    results: dict[int, T] = {}
    answers: dict[int, list[Outcome] | None] = dict.fromkeys(range(len(searches)))
    while answers:
        asked: dict[int, Rollouts] = {}
        for k, answer in answers.items():
            try:
                asked[k] = searches[k].send(answer)  # pyright: ignore[reportArgumentType]
            except StopIteration as done:
                results[k] = done.value
        items = [item for many, _ in asked.values() for item in many]
        actions = [action for _, many in asked.values() for action in many]
        found = iter(world.carry_out(task, items, np.array(actions)) if items else [])
        answers = {k: list(islice(found, len(many))) for k, (many, _) in asked.items()}
    return [results[k] for k in range(len(searches))]


def stencil(at: Array, step: float) -> Array:
    """[..., 2 A + 1, A] points [..., A] themselves, then a step up and down along each axis."""
    A = at.shape[-1]
    steps = step * np.repeat(np.eye(A), 2, axis=0) * np.tile([[1.0], [-1.0]], (A, 1))
    return at[..., None, :] + np.concatenate([np.zeros((1, A)), steps])


def central_differences(points: Array, values: Array) -> Array:
    """Central differences, 0 where a point did not move or a value is not finite.

    Args:
        points: [..., 2 A + 1, A] as `stencil` gives them, perhaps moved into limits.
        values: [..., 2 A + 1, R] at these.

    Returns:
        [..., R, A].
    """
    up, down = points[..., 1::2, :], points[..., 2::2, :]
    width = np.diagonal(up - down, axis1=-2, axis2=-1)[..., None]  # [..., A, 1]
    with np.errstate(invalid="ignore"):
        rise = values[..., 1::2, :] - values[..., 2::2, :]
    usable = (width > 0.0) & np.isfinite(rise)
    J = np.where(usable, rise, 0.0) / np.where(usable, width, 1.0)
    return np.swapaxes(J, -1, -2)
