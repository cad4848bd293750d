"""Running on CUDA where bodies are small: a block of threads for each world."""

from typing import Any

import numpy as np
import warp as wp

from gendom.sim.batch import Batch
from gendom.sim.block_kernels import COMPONENTS, make_block_kernels
from gendom.sim.worlds import Worlds

MOST_PARTICLES = 16_384
"""Of a body that one block simulates."""

FEWEST_WORLDS = 16
"""Below, the stages of ``Batch`` make more use of a GPU; of large bodies more are needed."""

PARTICLES_A_WORLD = 128
"""There must be so many worlds that each block has the time to be the slower one."""

MANY_WORLDS = 132
"""Above, two blocks share a multiprocessor, which wants them small."""

LARGE_BODY = 2048
"""Particles above which blocks are wide however many there are."""

WIDE, NARROW = 256, 128
"""Threads of a block."""

SLICE = 128
"""Substeps of a launch where worlds take turns."""

ALL = 1 << 30


def suits_blocks(worlds: Worlds) -> bool:
    """Whether a block a world is the faster way (measured: docs/performance.md)."""
    W, N = worlds.num_worlds, worlds.num_particles
    return N <= MOST_PARTICLES and max(FEWEST_WORLDS, N / PARTICLES_A_WORLD) <= W


class Blocks(Batch):
    """Every world advances by itself through the substeps of a frame.

    Args:
        worlds: On any device; on the CPU, where tests run it, a block is one thread.
        lanes: Threads of a block, a multiple of 32 (default: by worlds and particles).
    """

    def __init__(self, worlds: Worlds, lanes: int | None = None):
        setting = worlds.setting
        self.kernels = make_block_kernels(worlds.real, setting.law, plastic=worlds.plastic)
        W, N = worlds.num_worlds, worlds.num_particles
        crowded = W > MANY_WORLDS and N <= LARGE_BODY
        self.lanes = lanes or (NARROW if crowded else WIDE)
        if not worlds.device.is_cuda:
            self.lanes = 1
        self.records = self.kernels.Records()
        self.records.of = worlds.zeros((W, 2 * COMPONENTS, N), worlds.real)
        self.records.order = worlds.zeros((W, 2, N), wp.int32)
        self.records.place = worlds.zeros((W, N), wp.int32)
        # the slowest worlds go first, so that no block ends alone
        slowest = np.argsort(worlds.substep)
        self.order = worlds.array(slowest, wp.int32)
        self._groups: list[tuple[Any, Any]] = [(self.order, None)]
        if crowded and worlds.device.is_cuda:
            # two groups take turns: one fills the multiprocessors that the other leaves idle
            self._groups = [
                (worlds.array(slowest[half::2], wp.int32), wp.Stream(worlds.device))
                for half in (0, 1)
            ]
        super().__init__(worlds)

    def make_grid(self) -> None:
        super().make_grid()
        self.records.tally = self.worlds.zeros(self.grid.momentum.shape, wp.int32)

    def advance(self, now: float, *, keep_going: bool = False, most: int = ALL) -> bool:
        clock = self.worlds.clock
        left = min(most, int((clock.steps.numpy() - clock.step.numpy()).max()))
        if left <= 0:
            return False
        if len(self._groups) == 1:
            self._launch_advance(now, left, *self._groups[0])
        else:
            wp.synchronize_device(self.worlds.device)
            for done in range(0, left, SLICE):
                for order, stream in self._groups:
                    self._launch_advance(now, min(SLICE, left - done), order, stream)
            wp.synchronize_device(self.worlds.device)
        return self.settle(now, keep_going=keep_going)

    def _launch_advance(self, now: float, most: int, order: Any, stream: Any) -> None:
        s, grid = self.worlds, self.grid
        self.launch_block(self.kernels.advance, order, [
            now, most, s.clock, s.matter, s.scene, s.paths, s.grips,
            s.state, grid.columns, grid.momentum, self.velocity, self.records, self.kernels.Tape(),
        ], stream)  # fmt: skip

    def launch_block(self, kernel: Any, order: Any, inputs: list[Any], stream: Any = None) -> None:
        """Launch a block for each of the worlds ``order``."""
        wp.launch(
            kernel,
            dim=(len(order), self.lanes),
            inputs=[order, self.lanes, *inputs],
            device=None if stream else self.worlds.device,
            stream=stream,
            block_dim=self.lanes,
        )
