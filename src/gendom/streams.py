"""Many generators of random numbers, and numbers of all of them at once."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from gendom.arrays import Array

_FACTOR = 0x2360ED051FC65DA4, 0x4385DF649FCCF645
_HALF = 0xFFFFFFFF


class Streams(Sequence[np.random.Generator]):
    """The generators ``numpy.random.default_rng([seed, i])`` of numbers i below 2^32.

    To make them takes 20 us each; `uniform` need not. Sources: SeedSequence and PCG64 (O'Neill
    2014, XSL-RR), which NumPy documents and keeps as they are.
    """

    def __init__(self, seed: int, numbers: range):
        self._seed, self._numbers = seed, numbers
        self._drawn = np.zeros(len(numbers), dtype=int)
        a, b, c, d = _words(seed, np.array(numbers, dtype=np.uint32))
        self._more = np.array([c << 1 | d >> 63, d << 1 | 1])
        self._state = _next(_sum(self._more, (a, b)), self._more)
        """[2, W] the high and the low half of their states."""

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, w):  # pyright: ignore[reportIncompatibleMethodOverride]
        return self._made[w]

    @cached_property
    def _made(self) -> list[np.random.Generator]:
        made = [np.random.default_rng([self._seed, i]) for i in self._numbers]
        for rng, count in zip(made, self._drawn.tolist(), strict=True):
            rng.random(count)
        return made

    def random(self, count: int, which: NDArray[np.intp]) -> Array:
        """As `uniform`, before they are made."""
        found = np.empty((len(which), count))
        state, more = self._state[:, which], self._more[:, which]
        for k in range(count):
            state = _next(state, more)
            mixed, turn = state[0] ^ state[1], state[0] >> 58
            found[:, k] = ((mixed >> turn | mixed << (64 - turn & 63)) >> 11) * 2.0**-53
        self._state[:, which] = state
        self._drawn[which] += count
        return found


def uniform(
    rngs: Sequence[np.random.Generator], count: int, which: NDArray[np.intp] | None = None
) -> Array:
    """[k, count] the next numbers in [0, 1) of generators [k] among W (default: of all)."""
    which = np.arange(len(rngs)) if which is None else which
    if isinstance(rngs, Streams) and "_made" not in vars(rngs):
        return rngs.random(count, which)
    return np.array([rngs[w].random(count) for w in which.tolist()])


def _next(state: Array, more: Array) -> Array:
    """States [2, W] after one step of PCG: state * _FACTOR + more."""
    (high, low), (by_high, by_low) = state, _FACTOR
    a, b, c, d = low >> 32, low & _HALF, by_low >> 32, by_low & _HALF
    t = a * d + (b * d >> 32)
    u = b * c + (t & _HALF)
    over = a * c + (t >> 32) + (u >> 32)
    return _sum((high * by_low + low * by_high + over, low * by_low), more)


def _sum(a: Sequence[Array] | Array, b: Sequence[Array] | Array) -> Array:
    low = a[1] + b[1]
    return np.array([a[0] + b[0] + (low < b[1]), low])


def _words(seed: int, numbers: Array) -> list[Array]:
    """Four words of 64 bits [W] of ``SeedSequence([seed, i])`` for each number i [W]."""
    given = [np.full_like(numbers, seed >> k & _HALF) for k in range(0, seed.bit_length() or 1, 32)]
    given.append(numbers)
    by = 0x43B0D7E5

    def hashed(value: Array, factor: int) -> Array:
        nonlocal by
        value, by = value ^ by, by * factor & _HALF
        value = value * by
        return value ^ value >> 16

    def mixed(value: Array, other: Array) -> Array:
        value = value * 0xCA01F9DD - hashed(other, 0x931E8875) * 0x4973F715
        return value ^ value >> 16

    pool = [hashed(word, 0x931E8875) for word in (given + [np.zeros_like(numbers)] * 2)[:4]]
    for source, to in permutations(range(4), 2):
        pool[to] = mixed(pool[to], pool[source])
    for word in given[4:]:
        pool = [mixed(value, word) for value in pool]
    by = 0x8B51F9DD
    halves = [hashed(pool[k % 4], 0x58F38DED).astype(np.uint64) for k in range(8)]
    return [low | high << 32 for low, high in zip(halves[::2], halves[1::2], strict=True)]
