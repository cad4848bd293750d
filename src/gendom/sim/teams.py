"""Running on CUDA where worlds are few: several blocks of threads for each."""

import functools
import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.block import ROOM_ALONE
from gendom.sim.blocks import suits_blocks
from gendom.sim.bodies import Body
from gendom.sim.paced import Paced
from gendom.sim.team_kernels import AHEAD, COMPONENTS, Parts, make_team_kernels
from gendom.sim.worlds import Worlds

OWN = (64, 128, 256)
"""Particles of a block, of which the fewest are taken with which all teams fit on the device."""

LANES = 384
"""Threads on a multiprocessor that registers are sure to suffice for."""

FEWEST_LANES = 0.6
"""Threads of a block for each particle in its memory, at the least; 1 where a block a world would
do."""

BLOCKS_AT_ONCE = 4
"""Blocks on a multiprocessor at the most; more are no faster."""


@dataclass(frozen=True)
class Split:
    """The particles of a body shared out among the blocks of a team, see ``Parts``."""

    particles: NDArray[np.int32]
    count: NDArray[np.int32]
    near: NDArray[np.int32]

    def lanes(self, at_once: int, number: int) -> int:
        """Most threads of a block, so many of which a multiprocessor is to hold, for numbers of so
        many bytes; 0 if it cannot."""
        K = self.particles.shape[1]
        if at_once * COMPONENTS * K * number > ROOM_ALONE:
            return 0
        # one for each plane of nodes around each of a block's own particles is enough
        enough = max(K, 32 * math.ceil(3 * self.count[:, 0].max() / 32))
        return min(enough, LANES // at_once // 32 * 32)


def split_body(body: Body, members: int, *, alone: bool) -> Split:
    """Share a body's particles out among so many blocks; ``alone``: without their neighbours."""
    N, near = body.num_particles, body.lattice.reshape(-1, 6).astype(np.int64)
    owner = np.empty(N, dtype=np.int64)
    parts = _bisected(body.material_coordinates, np.arange(N), members)
    owner[np.concatenate(parts)] = np.repeat(np.arange(members), [len(part) for part in parts])
    # pairs of a block and a particle in its memory, as one number each
    rings = [np.sort(owner * N + np.arange(N))]
    for _ in range(0 if alone else 2):
        block, p = np.divmod(rings[-1], N)
        rings.append(np.unique((block[:, None] * N + near[p]).ravel()))
    pairs = rings[-1]
    ring = np.zeros(len(pairs), dtype=int)
    for inner in rings[:-1]:
        ring += np.isin(pairs, inner, invert=True)
    order = np.lexsort((pairs, ring, pairs // N))
    block, p = np.divmod(pairs[order], N)
    present = np.bincount(block, minlength=members)
    place = np.empty(len(pairs), dtype=np.int64)
    place[order] = np.arange(len(pairs)) - np.repeat(np.cumsum(present) - present, present)
    K = 32 * math.ceil(present.max() / 32)
    particles = np.zeros((members, K), dtype=np.int32)
    particles[block, place[order]] = p
    tense = rings[-2:][0]
    around = np.zeros((members, K, 6), dtype=np.int32)
    if not alone:
        block, p = np.divmod(tense, N)
        at = np.searchsorted(pairs, block[:, None] * N + near[p])
        around[block, place[np.searchsorted(pairs, tense)]] = place[at]
    own = np.bincount(owner, minlength=members)
    count = np.stack([own, np.bincount(tense // N, minlength=members), present], axis=1)
    return Split(particles, count.astype(np.int32), around)


def _bisected(
    x: NDArray[np.floating], chosen: NDArray[np.integer], parts: int
) -> list[NDArray[np.integer]]:
    """Points [N, 3] shared out to so many parts that lie together."""
    if parts == 1:
        return [chosen]
    axis = int(np.argmax(np.ptp(x[chosen], axis=0)))
    order = chosen[np.argsort(x[chosen, axis], kind="stable")]
    half = parts // 2
    cut = round(len(order) * half / parts)
    return [*_bisected(x, order[:cut], half), *_bisected(x, order[cut:], parts - half)]


class _Same:
    """A body as the key of what is known of it: the one object, whatever is equal to it."""

    def __init__(self, body: Body):
        self.body = body

    def __hash__(self) -> int:
        return id(self.body)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and other.body is self.body


@functools.lru_cache(maxsize=64)
def _split_once(body: _Same, members: int, alone: bool) -> Split:
    return split_body(body.body, members, alone=alone)


def split_for(worlds: Worlds) -> tuple[Split, int] | None:
    """The finest split, and the threads of a block, with which the teams of all worlds fit on the
    device at once."""
    body = _Same(worlds.setting.body)
    shares = (1.0,) if suits_blocks(worlds) else (1.0, FEWEST_LANES)
    for share, own in itertools.product(shares, OWN):
        members = math.ceil(worlds.num_particles / own)
        at_once = _blocks_each(worlds, members)
        if at_once <= BLOCKS_AT_ONCE:
            split = _split_once(body, members, worlds.plastic)
            lanes = split.lanes(at_once, worlds.numpy_type.itemsize)
            if lanes >= share * split.particles.shape[1]:
                return split, lanes
    return None


def _blocks_each(worlds: Worlds, members: int) -> int:
    """Blocks that a multiprocessor must hold at the same time."""
    return math.ceil(members * worlds.num_worlds / max(1, worlds.device.sm_count))


def suits_teams(worlds: Worlds) -> bool:
    """Whether the teams of all worlds fit on the device at once: then they are the fastest way."""
    return split_for(worlds) is not None


class Teams(Paced):
    """A team of blocks a world.

    Args:
        worlds: Such as suit teams; on the CPU, where tests run it, a team is one thread.
    """

    substeps_a_slice = 2048

    def __init__(self, worlds: Worlds):
        cuda = worlds.device.is_cuda
        found = split_for(worlds) if cuda else None
        split, lanes = found or (split_body(worlds.setting.body, 1, alone=worlds.plastic), 1)
        self.members, room = split.particles.shape
        self.lanes = lanes
        self.kernels = make_team_kernels(
            worlds.real, worlds.setting.law, plastic=worlds.plastic, lanes=lanes,
            at_once=_blocks_each(worlds, self.members) if cuda else 1,
            room=room if cuda else 1,
        )  # fmt: skip
        self._parts: Any = Parts()
        for name in ("particles", "count", "near"):
            setattr(self._parts, name, worlds.array(getattr(split, name), wp.int32))
        rows = 1 if cuda else worlds.num_worlds
        self._of = worlds.zeros((rows, COMPONENTS, room), worlds.real)
        self._grips = worlds.make_grips(AHEAD * worlds.num_worlds)
        self._gate = worlds.zeros(worlds.num_worlds, wp.int32)
        self._peak = worlds.zeros((worlds.num_worlds, 3), worlds.real)
        super().__init__(worlds)

    def load(self) -> None:
        module = self.kernels.advance.module
        wp.load_module(module, device=self.worlds.device, block_dim=self.lanes)

    def launch_slices(self, slices: list[tuple[int, float]]) -> None:
        s, grid = self.worlds, self.grid
        for substeps, pause in slices:
            self._gate.zero_()
            self._peak.zero_()
            wp.launch(
                self.kernels.advance,
                dim=(s.num_worlds * self.members, self.lanes),
                inputs=[
                    self.members, self.lanes, substeps, pause, self._parts, self.frame_plan,
                    s.clock, s.matter, s.scene, s.paths, self._grips, s.state, s.last_good,
                    grid.columns, grid.momentum, self.velocity, self._of, self._gate, self._peak,
                ],
                device=s.device,
                block_dim=self.lanes,
            )  # fmt: skip
