"""What a GPU keeps to reverse simulations of small bodies: a block of threads for each world."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.batch_tape import BatchTape, Segment, raise_trouble
from gendom.sim.block_kernels import STATE_COMPONENTS, make_block_kernels
from gendom.sim.block_reverse import BAR_COMPONENTS, make_block_reverse
from gendom.sim.blocks import Blocks
from gendom.sim.gradients import Sums
from gendom.sim.kernels import GRID_FULL

SHORTEST, LONGEST = 8, 256
"""Bounds on the substeps of a segment."""


class _Recording:
    """States, grids and layouts of consecutive substeps of all worlds."""

    def __init__(self, blocks: Blocks, tape_type: Any, substeps: int):
        worlds = blocks.worlds
        rows, N = substeps * worlds.num_worlds, worlds.num_particles
        # nothing is read before it was written
        self.room = worlds.room
        self.grid = worlds.make_grid(rows, make=wp.empty)
        self.tape = tape_type()

        def array(shape: Any, dtype: Any) -> wp.array:
            return wp.empty(shape, dtype=dtype, device=worlds.device)

        self.tape.of = array((rows, STATE_COMPONENTS, N), worlds.real)
        self.tape.order = array((rows, N), wp.int32)
        self.tape.place = array((rows, N), wp.int32)
        self.tape.layout_of = array(rows, wp.int32)


class BlockTape(BatchTape):
    """States every few substeps, from which the substeps between are run again to be reversed."""

    def _make_batch(self) -> Blocks:
        worlds = self.simulator.worlds
        law, plastic = worlds.setting.law, worlds.plastic
        self._taped = make_block_kernels(worlds.real, law, plastic=plastic, taped=True)
        self._back = make_block_reverse(worlds.real, law, plastic=plastic)
        self._blocks = Blocks(worlds)
        self._recording: _Recording | None = None
        self._bars = self._back.BarRecords()
        self._bars.of = worlds.zeros(
            (worlds.num_worlds, 2 * BAR_COMPONENTS, worlds.num_particles), worlds.real
        )
        return self._blocks

    def _segment(self) -> int:
        """Substeps that the memory holds."""
        worlds = self.simulator.worlds
        X, Y, M = worlds.room
        N, real = worlds.num_particles, worlds.numpy_type.itemsize
        row = real * (STATE_COMPONENTS * N + 4 * M) + 4 * (3 * X * Y + 2 * M + 2 * N + 7)
        return min(LONGEST, max(SHORTEST, int(self.memory / (row * worlds.num_worlds))))

    def _reverse_segment(self, segment: Segment, sums: Sums) -> None:
        recording = self._record_segment(segment)
        s, blocks, grid = self.simulator.worlds, self._blocks, recording.grid
        velocity = blocks.velocity
        blocks.launch_block(self._back.reverse, blocks.order, [
            segment.time, segment.until, segment.clock, s.matter, s.scene, s.paths, s.grips,
            grid.columns, grid.momentum, recording.tape, velocity, wp.empty_like(velocity),
            self._bars, sums.matter, sums.scene, sums.trouble,
        ])  # fmt: skip

        def F(slot: int, w: int, particle: int) -> NDArray[np.floating]:
            row = slot * s.num_worlds + w
            layout = int(recording.tape.layout_of.numpy()[row])
            place = int(recording.tape.place.numpy()[layout, particle])
            tape: Any = recording.tape.of[row]
            return tape.numpy()[15:, place].reshape(3, 3)

        raise_trouble(self.simulator, segment.time, segment.clock, sums, F)

    def _record_segment(self, segment: Segment) -> _Recording:
        """Run a segment again and keep everything its reverse needs."""
        s, blocks = self.simulator.worlds, self._blocks
        substeps = int((segment.until.numpy() - segment.clock.step.numpy()).max())
        while True:
            recording = self._recording
            if (
                recording is None
                or recording.room != s.room
                or recording.tape.of.shape[0] < substeps * s.num_worlds
            ):
                self._recording = recording = None  # its memory first
                recording = self._recording = _Recording(blocks, self._taped.Tape, substeps)
            self._return_to(segment)
            grid = recording.grid
            blocks.launch_block(self._taped.advance, blocks.order, [
                segment.time, substeps, s.clock, s.matter, s.scene, s.paths, s.grips, s.state,
                grid.columns, grid.momentum, blocks.velocity, blocks.records, recording.tape,
            ])  # fmt: skip
            if not (s.clock.status.numpy() == GRID_FULL).any():
                return recording
            # laid where the segment begins, columns may need a little more than they did
            s.make_room(grid, layouts=s.num_worlds)
            blocks.make_grid()
