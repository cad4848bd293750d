"""Running on CUDA where bodies are small: a block of threads for each world."""

import numpy as np
import warp as wp

from gendom.sim.batch import Batch
from gendom.sim.block_kernels import COMPONENTS, make_block_kernels
from gendom.sim.worlds import Worlds

MOST_PARTICLES = 4096
"""Of a body that one block simulates."""

FEWEST_WORLDS = 16
"""Below, the stages of ``Batch`` make more use of a GPU."""

MANY_WORLDS = 132
"""Above, two blocks share a multiprocessor, which wants them small."""

LANES, LANES_OF_MANY = 256, 128
"""Threads of a block: few worlds, many worlds."""

ALL = 1 << 30


def suits_blocks(worlds: Worlds) -> bool:
    """Whether a block a world is the faster way."""
    return worlds.num_particles <= MOST_PARTICLES and worlds.num_worlds >= FEWEST_WORLDS


class Blocks(Batch):
    """Every world advances by itself through all substeps of a frame.

    Args:
        worlds: On any device; on the CPU, where tests run it, a block is one thread.
        lanes: Threads of a block, a multiple of 32 (default: by the number of worlds).
    """

    def __init__(self, worlds: Worlds, lanes: int | None = None):
        setting = worlds.setting
        self.kernels = make_block_kernels(worlds.real, setting.law, plastic=worlds.plastic)
        few = worlds.num_worlds <= MANY_WORLDS
        self.lanes = lanes or (LANES if few else LANES_OF_MANY)
        if not worlds.device.is_cuda:
            self.lanes = 1
        W, N = worlds.num_worlds, worlds.num_particles
        self.records = self.kernels.Records()
        self.records.of = worlds.zeros((W, 2 * COMPONENTS, N), worlds.real)
        self.records.order = worlds.zeros((W, 2, N), wp.int32)
        self.records.place = worlds.zeros((W, N), wp.int32)
        # the slowest worlds go first, so that no block ends alone
        self.order = worlds.array(np.argsort(worlds.substep), wp.int32)
        super().__init__(worlds)

    def _make_grid(self) -> None:
        super()._make_grid()
        self.records.tally = self.worlds.zeros(self.grid.momentum.shape, wp.int32)

    def advance(self, now: float, *, keep_going: bool = False, most: int = ALL) -> bool:
        s, grid = self.worlds, self.grid
        wp.launch(
            self.kernels.advance,
            dim=(s.num_worlds, self.lanes),
            inputs=[
                self.order, self.lanes, now, most, s.clock, s.matter, s.scene, s.paths, s.grips,
                s.state, grid.columns, grid.momentum, self.velocity, self.records,
            ],
            device=s.device,
            block_dim=self.lanes,
        )  # fmt: skip
        return self.settle(now, keep_going=keep_going)
