"""What a GPU keeps to reverse simulations of small bodies: a block of threads for each world."""

# pyright: basic

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.mpm.adjoint.block_kernels import make_block_reverse
from gendom.sim.mpm.adjoint.graph import BatchTape, Segment
from gendom.sim.mpm.adjoint.records import SUMS
from gendom.sim.mpm.adjoint.sums import Sums
from gendom.sim.mpm.runners.block_per_world import Blocks
from gendom.sim.mpm.runners.records import make_tape
from gendom.sim.mpm.step import GRID_FULL

SHORTEST, LONGEST = 8, 256
"""Bounds on the substeps of a segment."""

SUBSTEPS_A_LAYOUT = 2
"""Room for layouts in a recording of the forward run, which may end where they do."""


class _Recording:
    """States, grids and layouts of consecutive substeps of all worlds."""

    def __init__(self, blocks: Blocks, substeps: int, layouts: int):
        worlds = blocks.worlds
        W, N = worlds.num_worlds, worlds.num_particles
        # nothing is read before it was written
        self.room = worlds.room
        self.substeps = substeps
        self.grid = worlds.make_grid(layouts * W, rows=substeps * W, make=wp.empty)
        self.tape = worlds.allocate(
            make_tape(worlds.real),
            wp.empty,
            of=(substeps * W, _taped(blocks), N),
            order=(layouts * W, N),
            place=(layouts * W, N),
            layout_of=substeps * W,
        )


def _taped(blocks: Blocks) -> int:
    """Components of a record on a tape."""
    return max(variant.taped for variant, _ in blocks.variants)


class BlockTape(BatchTape):
    """Every substep where the memory holds them all.

    Otherwise states every few substeps, from which the substeps between are run again.
    """

    def _make_batch(self) -> Blocks:
        worlds = self.simulator.worlds
        self._blocks = blocks = Blocks(worlds)
        self._recording: _Recording | None = None
        self._keeps = False
        W, N = worlds.num_worlds, worlds.num_particles
        components = max(variant.components for variant, _ in blocks.variants)
        self._bars = worlds.allocate(
            make_block_reverse(blocks.variants[0][0]).BarRecords,
            of=(1 if blocks.room else W, components, N),
            sums=(W, SUMS, N),
            spare=(W, components + SUMS, N),
            near=(W, 3, N),
            place=(W, N),
        )
        return blocks

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
        layout = 4 * (3 * X * Y + 2 * N + 7)
        return worlds.num_worlds * (
            real * (_taped(self._blocks) * N + 4 * M) + layout / substeps_a_layout
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
        velocity = wp.empty(nodes, dtype=s.types.vec4, device=s.device)
        nodes_bar = wp.empty_like(velocity)
        for variant, order in blocks.variants:
            blocks.launch_block(make_block_reverse(variant).reverse, order, [
                segment.time, segment.until, segment.clock, s.matter, s.scene, s.paths, s.grips,
                grid.layouts, grid.momentum, recording.tape, velocity, nodes_bar, s.touched,
                self._bars, blocks.held, sums.matter, sums.scene, sums.trouble,
            ])  # fmt: skip
        segment.recording = None

        def x(slot: int, w: int) -> NDArray[np.floating]:
            row = slot * s.num_worlds + w
            place = recording.tape.place.numpy()[recording.tape.layout_of.numpy()[row]]
            record: Any = recording.tape.of[row]
            return record.numpy()[:3, place].T

        self._check(sums, segment.time, segment.clock, x)

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
                recording = _Recording(blocks, substeps, layouts)
                self._recording = recording
            self._return_to(segment)
            blocks.launch_advance(substeps, np.inf, segment.plan, recording.grid, recording.tape)
            if not (s.clock.status.numpy() == GRID_FULL).any():
                return recording
            # made where the segment begins, grids may need a little more than they did
            s.make_room(recording.grid, layouts=s.num_worlds)
            blocks.make_grid()
