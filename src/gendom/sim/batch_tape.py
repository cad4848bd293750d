"""What a GPU keeps of a simulation to reverse it: all worlds together, graph by graph."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.batch import SUBSTEPS_A_GRAPH, Batch
from gendom.sim.columns import Columns
from gendom.sim.gradients import Sums, overflow
from gendom.sim.reverse import NOT_FINITE
from gendom.sim.simulator import Simulator
from gendom.sim.worlds import CLOCK

_LAYOUT = ("bounds", "low", "high", "start", "cell", "level", "count")
_PLACED = ("centre", "velocity", "spin", "closed")


@dataclass
class Segment:
    """Some graphs of one frame: where they begin, and how far each world has come in the end."""

    time: float  # of the frame's substep 0 [s]
    clock: Any
    state: Any
    until: Any = None  # [W] substeps of the frame done after
    plan: Any = None  # of the frame, where worlds advance by themselves
    recording: Any = None  # if it is kept from the forward run


@dataclass
class _Graph:
    """The substeps of one graph: states, grids, layout, grippers."""

    clock: Any
    columns: Any
    grips: Any
    rows: Any  # a state of [(GRAPH + 1) * W, N]
    momentum: wp.array  # [GRAPH, W, M]
    done: wp.array | None = None  # [W] substeps done in it


class BatchTape:
    """States every few graphs, from which the graphs between are run again to be reversed.

    Args:
        simulator: Not run before.
        memory: Bound on what one segment records [bytes]; at least one graph is.
    """

    def __init__(self, simulator: Simulator, memory: float):
        self.simulator = simulator
        self.memory = memory
        self._batch = self._make_batch()
        self._frames: list[list[Segment]] = []

    def _make_batch(self) -> Batch:
        return Batch(self.simulator.worlds)

    def forward(self, times: NDArray[np.float64]) -> NDArray[np.floating]:
        """Positions [T, W, N, 3] at the times [m].

        Raises:
            SimulationError: If a world diverges.
        """
        s, batch, clock = self.simulator, self._batch, self.simulator.worlds.clock
        frames = np.empty((len(times), s.num_worlds, s.body.num_particles, 3), dtype=s.dtype)
        now = s.time
        for f, until in enumerate(times):
            batch.plan(now, until)
            frame: list[Segment] = []
            more = bool(clock.steps.numpy().any())
            while more:
                segment = self._begin_segment(now)
                more = self._run_segment(segment)
                segment.until = wp.clone(clock.step)
                frame.append(segment)
            self._frames.append(frame)
            frames[f] = s.positions()
            now = float(until)
        return frames

    def _begin_segment(self, now: float) -> Segment:
        worlds = self.simulator.worlds
        k = worlds.kernels
        return Segment(
            now,
            _copy(k.Clock(), worlds.clock, CLOCK),
            _copy(k.transfers.State(), worlds.state, (*worlds.carried, "low")),
        )

    def _run_segment(self, segment: Segment) -> bool:
        """Advance by one segment; whether the frame goes on."""
        return self._batch.advance(segment.time, most=self._segment())

    def backward(self, bar: NDArray[np.floating], sums: Sums) -> None:
        """Carry derivatives [T, W, N, 3] by the positions back to the first state.

        Raises:
            SimulationError: If a derivative is not finite.
        """
        for frame, frame_bar in zip(reversed(self._frames), bar[::-1], strict=True):
            sums.add_positions(slice(None), frame_bar)
            for segment in reversed(frame):
                self._reverse_segment(segment, sums)

    def _reverse_segment(self, segment: Segment, sums: Sums) -> None:
        for graph in reversed(self._record(segment)):
            self._reverse(segment, graph, sums)

    def _segment(self) -> int:
        """Graphs that the memory holds."""
        worlds = self.simulator.worlds
        W = worlds.num_worlds
        X, Y, M = worlds.room
        real = worlds.numpy_type.itemsize
        slot = W * (worlds.state_bytes + real * 4 * M)
        layout = W * 4 * (3 * X * Y + 2 * M)
        return max(1, int(self.memory / (SUBSTEPS_A_GRAPH * slot + layout)))

    def _record(self, segment: Segment) -> list[_Graph]:
        """Run a segment again and keep everything its reverse needs."""
        batch = self._batch
        self._return_to(segment)
        graphs: list[_Graph] = []
        more = True
        while more:
            batch.launch_layout()
            graphs.append(self._record_graph())
            batch.launch_tally()
            more = batch.settle(segment.time)
        return graphs

    def _return_to(self, segment: Segment) -> None:
        """Set worlds to the beginning of a segment; its columns are laid anew first."""
        worlds, batch = self.simulator.worlds, self._batch
        for name in (*worlds.carried, "low"):
            wp.copy(getattr(worlds.state, name), getattr(segment.state, name))
        for name in ("dt", "step", "age", "frame"):
            wp.copy(getattr(worlds.clock, name), getattr(segment.clock, name))
        if segment.until is not None:
            wp.copy(worlds.clock.steps, segment.until)
        worlds.clock.status.zero_()
        batch.begin()
        batch.lap.time.fill_(segment.time)

    def _record_graph(self) -> _Graph:
        worlds, batch = self.simulator.worlds, self._batch
        k, state, grid = worlds.kernels, worlds.state, batch.grid
        W, N = worlds.num_worlds, worlds.num_particles
        rows = worlds.make_state(((SUBSTEPS_A_GRAPH + 1) * W, N))
        for name in worlds.carried:
            wp.copy(getattr(rows, name)[:W], getattr(state, name))
        graph = _Graph(
            clock=_copy(k.Clock(), worlds.clock, CLOCK),
            columns=_copy(Columns(), grid.columns, _LAYOUT),
            grips=_copy(k.boundary.Grips(), batch.grips, _PLACED),
            rows=rows,
            momentum=worlds.zeros((SUBSTEPS_A_GRAPH, *grid.momentum.shape), k.vec4),
        )
        for r in range(SUBSTEPS_A_GRAPH):
            momentum: Any = graph.momentum[r]
            batch.launch_substep(r, self._row(rows, r), self._row(rows, r + 1), momentum)
        graph.done = wp.clone(batch.lap.done)
        batch.launch(k.take, (W, N), [graph.done, rows, state])
        return graph

    def _row(self, rows: Any, r: int) -> Any:
        """The worlds' state before substep r of a recorded graph."""
        W = self.simulator.num_worlds
        state = self.simulator.worlds.kernels.transfers.State()
        state.low = rows.low
        for name in self.simulator.worlds.carried:
            setattr(state, name, getattr(rows, name)[r * W : (r + 1) * W])
        return state

    def _reverse(self, segment: Segment, graph: _Graph, sums: Sums) -> None:
        """Carry derivatives from the end of a recorded graph to its beginning."""
        s, k, launch = self.simulator.worlds, self.simulator.worlds.reverse, self._batch.launch
        columns, grips, dt = graph.columns, graph.grips, segment.clock.dt
        W, N = s.num_worlds, s.num_particles
        nodes = graph.momentum.shape[1:]
        velocity = wp.empty(nodes, dtype=s.kernels.vec4, device=s.device)
        grid_bar = wp.empty(nodes, dtype=s.kernels.vec4, device=s.device)
        for r in reversed(range(SUBSTEPS_A_GRAPH)):
            row: Any = self._row(graph.rows, r)
            momentum = graph.momentum[r]
            going: list[Any] = [r, graph.done, dt]
            if not s.plastic:
                launch(k.tense_again, (W, N), [*going, s.matter, row, s.pulls])
            launch(k.grid_again, nodes, [
                *going, s.scene, s.paths, grips, columns, momentum, velocity, grid_bar,
            ])  # fmt: skip
            launch(k.gather_back, (W, N), [
                *going, s.matter, s.scene, columns, velocity, row, grid_bar, sums.matter,
            ])  # fmt: skip
            launch(k.grid_back, nodes, [
                *going, s.scene, s.paths, grips, columns, momentum, grid_bar, sums.scene,
            ])  # fmt: skip
            launch(k.scatter_back, (W, N), [
                *going, s.matter, s.scene, columns, row, s.pulls, grid_bar, sums.matter,
                sums.trouble,
            ])  # fmt: skip
            launch(k.world_back, W, [
                *going, graph.clock.step, segment.time, s.scene, s.paths, grips, sums.scene,
            ])  # fmt: skip
            if not s.plastic:
                launch(k.tense_back, (W, N), [*going, s.matter, row, sums.matter, s.pulls])
                launch(k.slacken_all, (W, N), [r, graph.done, s.matter, sums.matter, s.pulls])

        def F(slot: int, w: int, particle: int) -> NDArray[np.floating]:
            return s.deformation(graph.rows, slot * W + w)[particle]

        raise_trouble(self.simulator, segment.time, graph.clock, sums, F)


def raise_trouble(
    s: Simulator,
    time: float,
    clock: Any,
    sums: Sums,
    F: Callable[[int, int, int], NDArray[np.floating]],
) -> None:
    """Raise what a derivative that is not finite calls for, if there is one.

    Args:
        s: Whose derivatives.
        time: Of the frame's substep 0 [s].
        clock: Where the substeps begin that were reversed.
        sums: Derivatives.
        F: The recorded F of (substep, world, particle).
    """
    failed = np.flatnonzero(sums.trouble.status.numpy() == NOT_FINITE)
    if len(failed):
        w = int(failed[0])
        slot = int(sums.trouble.slot.numpy()[w])
        particle = int(sums.trouble.culprit.numpy()[w])
        step = int(clock.step.numpy()[w]) + slot
        raise overflow(
            s,
            w,
            substep=int(clock.age.numpy()[w]) + slot,
            time=time + step * float(clock.dt.numpy()[w]),
            particle=particle,
            F=F(slot, w, particle),
        )


def _copy(copy: Any, of: Any, names: tuple[str, ...]) -> Any:
    """The struct ``copy`` with arrays of its own, equal to those of another."""
    for name in names:
        setattr(copy, name, wp.clone(getattr(of, name)))
    return copy
