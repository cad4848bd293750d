"""What a GPU keeps to reverse simulations of small bodies: a block of threads for each world."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.batch_tape import BatchTape, Segment, raise_trouble
from gendom.sim.block_kernels import COMPONENTS, make_block_kernels, taped_components
from gendom.sim.block_reverse import SUM_COMPONENTS, make_block_reverse
from gendom.sim.blocks import Blocks
from gendom.sim.gradients import Sums
from gendom.sim.kernels import GRID_FULL

SHORTEST, LONGEST = 8, 256
"""Bounds on the substeps of a segment."""

SUBSTEPS_A_LAYOUT = 2
"""Room for layouts in a recording of the forward run, which may end where they do."""


class _Recording:
    """States, grids and layouts of consecutive substeps of all worlds."""

    def __init__(self, blocks: Blocks, taped: Any, substeps: int, layouts: int):
        worlds = blocks.worlds
        W, N = worlds.num_worlds, worlds.num_particles
        components = taped_components(plastic=worlds.plastic)
        # nothing is read before it was written
        self.room = worlds.room
        self.substeps = substeps
        self.grid = worlds.make_grid(layouts * W, rows=substeps * W, make=wp.empty)

        def array(shape: Any, dtype: Any) -> wp.array:
            return wp.empty(shape, dtype=dtype, device=worlds.device)

        self.tape = taped.Tape()
        self.tape.of = array((substeps * W, components, N), worlds.real)
        self.tape.order = array((layouts * W, N), wp.int32)
        self.tape.place = array((layouts * W, N), wp.int32)
        self.tape.layout_of = array(substeps * W, wp.int32)


class BlockTape(BatchTape):
    """Every substep where the memory holds them all.

    Otherwise states every few substeps, from which the substeps between are run again.
    """

    def _make_batch(self) -> Blocks:
        worlds = self.simulator.worlds
        law, plastic = worlds.setting.law, worlds.plastic
        self._blocks = Blocks(worlds)
        self._taped = make_block_kernels(
            worlds.real, law, plastic=plastic, taped=True, room=self._blocks.room,
            lanes=self._blocks.lanes,
        )  # fmt: skip
        self._back = make_block_reverse(
            worlds.real, law, plastic=plastic, room=self._blocks.room,
            lanes=self._blocks.lanes,
        )  # fmt: skip
        self._recording: _Recording | None = None
        self._keeps = False
        W, N = worlds.num_worlds, worlds.num_particles
        self._bars = self._back.BarRecords()
        for name, rows, components in (
            ("of", 1 if self._blocks.room else W, COMPONENTS),
            ("sums", W, SUM_COMPONENTS),
            ("spare", W, COMPONENTS + SUM_COMPONENTS),
        ):
            setattr(self._bars, name, worlds.zeros((rows, components, N), worlds.real))
        self._bars.near = worlds.zeros((W, 3, 0 if worlds.plastic else N), wp.int32)
        return self._blocks

    def forward(self, times: NDArray[np.float64]) -> NDArray[np.floating]:
        worlds = self.simulator.worlds
        spans = np.diff(times, prepend=self.simulator.time)
        substeps = sum(int(worlds.divide(slice(None), span)[0].max()) for span in spans)
        self._keeps = substeps * self._row(SUBSTEPS_A_LAYOUT) <= self.memory
        return super().forward(times)

    def _row(self, substeps_a_layout: int) -> float:
        """Memory that a substep of all worlds takes [bytes]."""
        worlds = self.simulator.worlds
        X, Y, M = worlds.room
        N, real = worlds.num_particles, worlds.numpy_type.itemsize
        layout = 4 * (3 * X * Y + 2 * M + 2 * N + 7)
        return worlds.num_worlds * (
            real * (taped_components(plastic=worlds.plastic) * N + 4 * M)
            + layout / substeps_a_layout
        )

    def _segment(self) -> int:
        """Substeps that the memory holds at once."""
        return min(LONGEST, max(SHORTEST, int(self.memory / self._row(1))))

    def _begin_segment(self, now: float) -> Segment:
        segment = super()._begin_segment(now)
        segment.plan = self._blocks.frame_plan
        return segment

    def _run_segment(self, segment: Segment) -> bool:
        if not self._keeps:
            return super()._run_segment(segment)
        clock = self.simulator.worlds.clock
        left = int((clock.steps.numpy() - clock.step.numpy()).max())
        substeps = min(LONGEST, left)
        segment.recording = self._record_segment(segment, substeps, SUBSTEPS_A_LAYOUT)
        self._recording = None
        return self._blocks.look(segment.time)

    def _reverse_segment(self, segment: Segment, sums: Sums) -> None:
        recording = segment.recording
        if recording is None:
            substeps = int((segment.until.numpy() - segment.clock.step.numpy()).max())
            recording = self._record_segment(segment, substeps, 1)
        s, blocks = self.simulator.worlds, self._blocks
        grid = recording.grid
        nodes = (s.num_worlds, grid.momentum.shape[1])
        velocity = wp.empty(nodes, dtype=s.kernels.vec4, device=s.device)
        blocks.launch_block(self._back.reverse, blocks.order, [
            segment.time, segment.until, segment.clock, s.matter, s.scene, s.paths, s.grips,
            grid.columns, grid.momentum, recording.tape, velocity, wp.empty_like(velocity),
            self._bars, sums.matter, sums.scene, sums.trouble,
        ])  # fmt: skip
        segment.recording = None

        def F(slot: int, w: int, particle: int) -> NDArray[np.floating]:
            row = slot * s.num_worlds + w
            layout = int(recording.tape.layout_of.numpy()[row])
            place = recording.tape.place.numpy()[layout]
            record: Any = recording.tape.of[row]
            records = record.numpy()[:, place].T
            if s.plastic:
                return records[particle, 15:].reshape(3, 3)
            return s.deformation_at(records[:, :3])[particle]

        raise_trouble(self.simulator, segment.time, segment.clock, sums, F)

    def _record_segment(
        self, segment: Segment, substeps: int, substeps_a_layout: int
    ) -> _Recording:
        """Run a segment from its beginning and keep everything its reverse needs."""
        s, blocks = self.simulator.worlds, self._blocks
        while True:
            recording = self._recording
            if recording is None or recording.room != s.room or recording.substeps < substeps:
                self._recording = recording = None  # its memory first
                layouts = -(-substeps // substeps_a_layout)
                recording = _Recording(blocks, self._taped, substeps, layouts)
                self._recording = recording
            self._return_to(segment)
            blocks.launch_advance(
                self._taped.advance, substeps, np.inf, segment.plan, recording.grid,
                recording.tape,
            )  # fmt: skip
            if not (s.clock.status.numpy() == GRID_FULL).any():
                return recording
            # laid where the segment begins, columns may need a little more than they did
            s.make_room(recording.grid, layouts=s.num_worlds)
            blocks.make_grid()
