"""Running on CUDA where bodies are small: a block of threads for each world."""

from typing import Any

import numpy as np
import warp as wp

from gendom.sim.mpm.block import ROOM_ALONE, ROOMS_OF_TWO
from gendom.sim.mpm.grid import Grid
from gendom.sim.mpm.model import Worlds
from gendom.sim.mpm.poses import AHEAD
from gendom.sim.mpm.runners.block_kernels import make_block_kernels
from gendom.sim.mpm.runners.held import empty_list
from gendom.sim.mpm.runners.paced import Paced
from gendom.sim.mpm.runners.records import Variant

MOST_PARTICLES = 10_240
"""Of a body that one block simulates; indices in ``near`` have 15 bits."""

PARTICLES_A_WORLD = 4096
"""There must be so many worlds that each block has the time to be the slower one; with fewer, the
stages of ``Batch`` make more use of a GPU."""

MANY_WORLDS = 132
"""Above, two blocks share a multiprocessor, which wants them small."""

LARGE_BODY = 2048
"""Particles above which blocks are wide however many there are."""

WIDE = 256
"""Threads of a block that has a multiprocessor to itself."""

NARROW = 128
"""Threads of one of two blocks that share one; more leave too few registers for each."""

NARROW_IN_ARRAYS = 128
"""The same where particles stand in arrays."""


def suits_blocks(worlds: Worlds) -> bool:
    """Whether a block a world is the faster way (measured: docs/performance.md)."""
    W, N = worlds.num_worlds, worlds.num_particles
    return N <= MOST_PARTICLES and N / PARTICLES_A_WORLD <= W


def shared_room(worlds: Worlds, components: int) -> int:
    """Shared memory of a block in which its particles fit [bytes]; 0 if they do not."""
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
        W, N = worlds.num_worlds, worlds.num_particles
        every = self._variant(worlds, yields=bool(worlds.yields.any()), room=0, lanes=0)
        self.room = shared_room(worlds, every.components)
        crowded = W > MANY_WORLDS and N <= LARGE_BODY
        pairs = crowded and self.room != ROOM_ALONE
        narrow = NARROW if self.room else NARROW_IN_ARRAYS
        lanes = lanes or (narrow if pairs else WIDE)
        # worlds that yield have kernels of their own; the slowest worlds go first, so that no block
        # ends alone
        self.variants: list[tuple[Variant, Any]] = []
        slowest = np.argsort(worlds.substep)
        for yields in sorted({bool(one) for one in worlds.yields}):
            chosen = slowest[worlds.yields[slowest] == yields]
            variant = self._variant(worlds, yields=yields, room=self.room, lanes=lanes)
            self.variants.append((variant, worlds.array(chosen, wp.int32)))
        self.lanes = lanes if worlds.device.is_cuda else 1
        self.records = make_block_kernels(self.variants[0][0]).Records()
        rows = 1 if self.room else W
        self.records.of = worlds.zeros((rows, every.components, N), worlds.real)
        self.records.moduli = worlds.zeros((W, 2, N), worlds.real)
        self.records.near = worlds.zeros((W, 3, N), wp.int32)
        self.records.spare = worlds.zeros((W, every.components + 2, N), worlds.real)
        self.records.strayed = worlds.zeros(W, worlds.real)
        self.held = empty_list(worlds)
        for name in ("order", "place", "spare_order"):
            setattr(self.records, name, worlds.zeros((W, N), wp.int32))
        self._streams: list[Any] = [None]
        if crowded and worlds.device.is_cuda:
            # two groups take turns: one fills the multiprocessors that the other leaves idle
            self._streams = [wp.Stream(worlds.device) for _ in range(2)]
        super().__init__(worlds)

    @staticmethod
    def _variant(worlds: Worlds, *, yields: bool, room: int, lanes: int) -> Variant:
        return Variant(
            worlds.real, worlds.setting.law, yields, worlds.damped, room=room, lanes=lanes
        )

    @property
    def grip_rows(self) -> int:
        return AHEAD * self.worlds.num_worlds

    def make_grid(self) -> None:
        super().make_grid()
        self.records.tally = self.worlds.zeros(self.grid.momentum.shape, wp.int32)

    def load(self) -> None:
        for variant, _ in self.variants:
            module = make_block_kernels(variant).advance.module
            wp.load_module(module, device=self.worlds.device, block_dim=self.lanes)

    def launch_slices(self, slices: list[tuple[int, float]]) -> None:
        several = len(self._streams) > 1
        if several:
            wp.synchronize_device(self.worlds.device)
        for substeps, pause in slices:
            for group, stream in enumerate(self._streams):
                self.launch_advance(
                    substeps, pause, self.frame_plan, self.grid, share=(group, len(self._streams)),
                    stream=stream,
                )  # fmt: skip
        if several:
            wp.synchronize_device(self.worlds.device)

    def launch_advance(
        self,
        most: int,
        pause: float,
        plan: Any,
        grid: Grid,
        tape: Any = None,
        *,
        share: tuple[int, int] = (0, 1),
        stream: Any = None,
    ) -> None:
        """Call the kernel, on a share of the worlds; with a tape that which keeps all substeps."""
        s = self.worlds
        for variant, order in self.variants:
            kernels = make_block_kernels(variant, taped=tape is not None)
            self.launch_block(kernels.advance, order[share[0] :: share[1]], [
                most, pause, plan, s.clock, s.matter, s.scene, s.paths, s.grips, s.state,
                s.last_good, grid.layouts, grid.momentum, self.velocity, self.records, self.held,
                kernels.Tape() if tape is None else tape,
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
