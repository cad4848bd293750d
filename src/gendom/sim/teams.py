"""Running on CUDA where worlds are few: several blocks of threads for each."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.block import ROOM_ALONE
from gendom.sim.bodies import Body
from gendom.sim.paced import Paced
from gendom.sim.team_kernels import AHEAD, COMPONENTS, Parts, make_team_kernels
from gendom.sim.worlds import Worlds

OWN = (64, 128, 256)
"""Particles of a block, of which the fewest are taken with which all teams fit on the device."""

LANES = 384
"""Threads on a multiprocessor that registers are sure to suffice for."""

BLOCKS_AT_ONCE = 4
"""Blocks on a multiprocessor at the most; more are no faster."""


@dataclass(frozen=True)
class Split:
    """The particles of a body shared out among the blocks of a team, see ``Parts``."""

    particles: NDArray[np.int32]
    count: NDArray[np.int32]
    near: NDArray[np.int32]

    def lanes(self) -> list[int]:
        """Threads that a block may have: for each plane of nodes around each of its own particles,
        or for each particle."""
        K = self.particles.shape[1]
        return sorted({max(K, 32 * math.ceil(3 * self.count[:, 0].max() / 32)), K}, reverse=True)

    def at_once(self, lanes: int, number: int) -> int:
        """Blocks that are sure to fit on a multiprocessor, for numbers of so many bytes."""
        taken = COMPONENTS * self.particles.shape[1] * number
        return min(BLOCKS_AT_ONCE, LANES // lanes, ROOM_ALONE // taken)


def split_body(body: Body, members: int, *, alone: bool) -> Split:
    """Share a body's particles out among so many blocks; ``alone``: without their neighbours."""
    blocks, counts = [], []
    for own in _bisected(body.material_coordinates, np.arange(body.num_particles), members):
        rings = [own]
        for _ in range(0 if alone else 2):
            have = np.concatenate(rings)
            rings.append(np.setdiff1d(body.lattice[rings[-1]], have))
        blocks.append(np.concatenate(rings))
        counts.append(np.cumsum([len(ring) for ring in rings])[[0, -2, -1] if not alone else 0])
    K = -(-max(map(len, blocks)) // 32) * 32
    particles = np.zeros((members, K), dtype=np.int32)
    near = np.zeros((members, K, 6), dtype=np.int32)
    place = np.zeros(body.num_particles, dtype=np.int32)
    for b, block in enumerate(blocks):
        particles[b, : len(block)] = block
        place[block] = np.arange(len(block))
        if not alone:
            with_neighbours = block[: counts[b][1]]
            near[b, : counts[b][1]] = place[body.lattice[with_neighbours]].reshape(-1, 6)
    count = np.stack([np.broadcast_to(c, 3) for c in counts]).astype(np.int32)
    return Split(particles, count, near)


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


def split_for(worlds: Worlds) -> tuple[Split, int] | None:
    """The finest split, and the most threads of a block, with which the teams of all worlds fit on
    the device at once."""
    for own in OWN:
        members = math.ceil(worlds.num_particles / own)
        blocks = members * worlds.num_worlds
        if blocks <= BLOCKS_AT_ONCE * worlds.device.sm_count:
            split = split_body(worlds.setting.body, members, alone=worlds.plastic)
            for lanes in split.lanes():
                at_once = split.at_once(lanes, worlds.numpy_type.itemsize)
                if blocks <= at_once * worlds.device.sm_count:
                    return split, lanes
    return None


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
        whole = split_body(worlds.setting.body, 1, alone=worlds.plastic)
        split, lanes = (split_for(worlds) if cuda else None) or (whole, 1)
        self.members, room = split.particles.shape
        self.lanes = lanes
        self.kernels = make_team_kernels(
            worlds.real, worlds.setting.law, plastic=worlds.plastic, lanes=lanes,
            at_once=split.at_once(lanes, worlds.numpy_type.itemsize) if cuda else 1,
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
