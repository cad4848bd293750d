"""Running on CUDA where bodies are small: a block of threads for each world."""

from typing import Any

import numpy as np
import warp as wp

from gendom.sim.block import ROOM_ALONE, ROOMS_OF_TWO
from gendom.sim.block_kernels import SPARE, make_block_kernels, record_components
from gendom.sim.columns import Grid
from gendom.sim.paced import Paced
from gendom.sim.worlds import Worlds

MOST_PARTICLES = 10_240
"""Of a body that one block simulates; indices in ``near`` have 15 bits."""

FEWEST_WORLDS = 16
"""Below, teams or the stages of ``Batch`` make more use of a GPU; of large bodies more are
needed."""

PARTICLES_A_WORLD = 128
"""There must be so many worlds that each block has the time to be the slower one."""

MANY_WORLDS = 132
"""Above, two blocks share a multiprocessor, which wants them small."""

LARGE_BODY = 2048
"""Particles above which blocks are wide however many there are."""

WIDE = 256
"""Threads of a block that has a multiprocessor to itself."""

NARROW = 192
"""Threads of one of two blocks that share one; more leave too few registers for each."""

NARROW_IN_ARRAYS = 128
"""The same where particles stand in arrays."""


def suits_blocks(worlds: Worlds) -> bool:
    """Whether a block a world is the faster way (measured: docs/performance.md)."""
    W, N = worlds.num_worlds, worlds.num_particles
    return N <= MOST_PARTICLES and max(FEWEST_WORLDS, N / PARTICLES_A_WORLD) <= W


def shared_room(worlds: Worlds) -> int:
    """Shared memory of a block in which its particles fit [bytes]; 0 if they do not."""
    components = record_components(worlds.real)
    taken = components * worlds.num_particles * worlds.numpy_type.itemsize
    if worlds.device.is_cuda:
        for room in (*ROOMS_OF_TWO, ROOM_ALONE):
            blocks = 2 if room in ROOMS_OF_TWO else 1
            if taken <= room and blocks * room <= worlds.device.max_shared_memory_per_block:
                return room
    return 0


class Blocks(Paced):
    """A block of threads a world.

    Args:
        worlds: On any device; on the CPU, where tests run it, a block is one thread.
        lanes: Threads of a block, a multiple of 32 (default: by worlds and particles).
    """

    def __init__(self, worlds: Worlds, lanes: int | None = None):
        setting = worlds.setting
        W, N = worlds.num_worlds, worlds.num_particles
        self.room = shared_room(worlds)
        crowded = W > MANY_WORLDS and N <= LARGE_BODY
        pairs = crowded and self.room != ROOM_ALONE
        narrow = NARROW if self.room else NARROW_IN_ARRAYS
        self.lanes = lanes or (narrow if pairs else WIDE)
        self.kernels = make_block_kernels(
            worlds.real, setting.law, plastic=worlds.plastic, room=self.room,
            lanes=self.lanes,
        )  # fmt: skip
        if not worlds.device.is_cuda:
            self.lanes = 1
        self.records = self.kernels.Records()
        rows = 1 if self.room else W
        self.records.of = worlds.zeros((rows, record_components(worlds.real), N), worlds.real)
        self.records.moduli = worlds.zeros((W, 2, N), worlds.real)
        self.records.near = worlds.zeros((W, 3, 0 if worlds.plastic else N), wp.int32)
        self.records.spare = worlds.zeros((W, SPARE, N), worlds.real)
        self.records.strayed = worlds.zeros(W, worlds.real)
        for name in ("order", "place", "spare_order"):
            setattr(self.records, name, worlds.zeros((W, N), wp.int32))
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

    def load(self) -> None:
        module = self.kernels.advance.module
        wp.load_module(module, device=self.worlds.device, block_dim=self.lanes)

    def launch_slices(self, slices: list[tuple[int, float]]) -> None:
        several = len(self._groups) > 1
        if several:
            wp.synchronize_device(self.worlds.device)
        for substeps, pause in slices:
            for order, stream in self._groups:
                self.launch_advance(
                    self.kernels.advance, substeps, pause, self.frame_plan, self.grid,
                    self.kernels.Tape(), order, stream,
                )  # fmt: skip
        if several:
            wp.synchronize_device(self.worlds.device)

    def launch_advance(
        self,
        kernel: Any,
        most: int,
        pause: float,
        plan: Any,
        grid: Grid,
        tape: Any,
        order: Any = None,
        stream: Any = None,
    ) -> None:
        """Call the kernel on the worlds ``order`` (default: all); see there."""
        s = self.worlds
        self.launch_block(kernel, self.order if order is None else order, [
            most, pause, plan, s.clock, s.matter, s.scene, s.paths, s.grips, s.state, s.last_good,
            grid.columns, grid.momentum, self.velocity, self.records, tape,
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
