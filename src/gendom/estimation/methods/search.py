"""What methods have in common: where they begin, which start is best, the noise of a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gendom.estimation.likelihood import Comparison, NoiseModel
from gendom.estimation.problem import Problem, Start

Array = NDArray[np.floating]


def first_starts(problem: Problem, scanned: int, initial: Sequence[Array] = ()) -> list[Start]:
    """What a scan over the modulus finds best, and random places about it.

    Args:
        problem: Has the number of starts, and the seed.
        scanned: Moduli of the scan, over the whole range.
        initial: [P] transformed: where to begin instead.
    """
    if initial:
        return [Start(initial=v, vector=v) for v in initial]
    prior, rng = problem.prior, np.random.default_rng(problem.settings.seed)
    middle, k = prior.vector(problem.base), None
    found = [middle]
    if "specific_modulus" in prior.names:
        k = prior.names.index("specific_modulus")
        scan = np.linspace(prior.low[k], prior.high[k], scanned + 2)[1:-1]
        bases = [prior.vector(problem.base.with_values(guess)) for guess in problem.scene.guesses]
        vectors = [np.where(np.arange(len(b)) == k, x, b) for b in bases for x in scan]
        compared = problem.compare(vectors, derivatives=False)
        rms = [np.inf if c is None else c.rms for c in compared]
        found = [vectors[n] for n in np.argsort(rms)]
    starts = [Start(initial=found[0], vector=found[0])]
    while len(starts) < problem.settings.starts:
        drawn = prior.mean + prior.sd * rng.standard_normal(len(middle))
        if k is not None:
            # one of the better half of the scan: beyond, shapes hardly depend on the modulus
            drawn[k] = found[rng.integers(1, max(2, len(found) // 2))][k]
        drawn = prior.clipped(drawn)
        starts.append(Start(initial=drawn, vector=drawn))
    return starts


def best_of(starts: Sequence[Start]) -> Start | None:
    """The start with the least value, None where none could be simulated."""
    tried = [s for s in starts if s.comparison is not None]
    return min(tried, key=lambda s: s.value) if tried else None


def estimated_noise(comparison: Comparison, noise: NoiseModel, rounds: int = 6) -> NoiseModel:
    """Noise that makes clouds more likely, by rounds of expectation and maximisation."""
    for _ in range(rounds):
        noise = comparison.fit(noise).better_noise()
    return noise
