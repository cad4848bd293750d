"""What a GPU keeps of a simulation to reverse it: all worlds together, graph by graph."""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.mpm.adjoint.sums import Sums, Trouble
from gendom.sim.mpm.engine import MpmEngine
from gendom.sim.mpm.grid import SparseGrid
from gendom.sim.mpm.model import CLOCK, POSE
from gendom.sim.mpm.native import MODULE_OPTIONS
from gendom.sim.mpm.runners.graph import LAP, SUBSTEPS_A_GRAPH, Batch
from gendom.sim.mpm.runners.graph_kernels import YIELDS, make_graph_kernels
from gendom.sim.mpm.step import NOT_FINITE, OK, make_closing, make_stages
from gendom.sim.mpm.types import Namespace

_LAYOUT = ("bounds", "low", "high", "start", "count")

wp.set_module_options(MODULE_OPTIONS)


@functools.cache
def make_reverse_kernels(real: Any, law_name: str, *, yields: bool) -> Namespace:
    """Build the stages of one substep backwards as kernels over all worlds.

    Returns:
        Namespace with ``g2p_back``, ``nodes_back``, ``p2g_back``, ``touch_back``, ``forces_back``,
        ``momenta_back`` and ``world_back``, to be called in this order after the forward stages
        that make again what the recording lacks. Substep r of a graph is reversed in the worlds
        that have done it (``r < lap.done[w]``).
    """
    k = make_stages(real, law_name, yields=yields)
    types = k.types
    Nodes, Pulls, Vectors = types.Nodes, types.Pulls, types.Vectors
    Clock, Matter, Scene, State = types.Clock, types.Matter, types.Scene, types.State
    Paths, Grips = types.Paths, types.Grips
    MatterBars, SceneBars = types.MatterBars, types.SceneBars
    close_substep, largest = make_closing(real).close_substep, k.largest
    Lap = make_graph_kernels(real, law_name, yields=yields).Lap
    plastic = wp.constant(int(yields))

    @wp.kernel
    def touch_back(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, state: State, pulls: Pulls,
        touched: Vectors, bars: MatterBars, scene_bars: SceneBars,
    ):  # fmt: skip
        w, s = wp.tid()
        if clock.near_table[w] == 1 and r < lap.done[w]:
            k.touch_adjoint(
                w, s, w, real(clock.dt[w]), matter, scene, state, pulls, touched, bars, scene_bars
            )

    @wp.kernel
    def g2p_back(
        r: int, clock: Clock, lap: Lap, scene: Scene, grips: Grips, grid: SparseGrid,
        velocity: Nodes, state: State, nodes_bar: Nodes, bars: MatterBars, scene_bars: SceneBars,
    ):  # fmt: skip
        w, p = wp.tid()
        if r < lap.done[w]:
            k.move_adjoint(
                w, p, w, r * clock.dt.shape[0] + w, w, w, real(clock.dt[w]), scene, grips, grid,
                velocity, state, nodes_bar, bars, scene_bars,
            )  # fmt: skip

    @wp.kernel
    def nodes_back(
        r: int, clock: Clock, lap: Lap, scene: Scene, grid: SparseGrid, momentum: Nodes,
        nodes_bar: Nodes, scene_bars: SceneBars,
    ):  # fmt: skip
        w, n = wp.tid()
        if n >= grid.count[w] or r >= lap.done[w]:
            return
        factor = wp.exp(-scene.velocity_damping[w] * real(clock.dt[w]))
        q_bar, factor_bar = k.transfer.node_velocity_adjoint(
            momentum[w, n], nodes_bar[w, n], factor
        )
        nodes_bar[w, n] = q_bar
        if scene.velocity_damping[w] > real(0.0):
            wp.atomic_add(scene_bars.damping_factor, w, wp.float64(factor_bar))

    @wp.kernel
    def p2g_back(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, grips: Grips,
        grid: SparseGrid, state: State, pulls: Pulls, touched: Vectors, nodes_bar: Nodes,
        bars: MatterBars, scene_bars: SceneBars, trouble: Trouble,
    ):  # fmt: skip
        w, p = wp.tid()
        if r >= lap.done[w]:
            return
        size = k.scatter_adjoint(
            w, p, w, r * clock.dt.shape[0] + w, w, w, real(clock.dt[w]), clock.near_table[w],
            matter, scene, grips, state, pulls, touched, grid, nodes_bar, bars, scene_bars,
        )  # fmt: skip
        # the first one found is named; a NaN is not below anything
        if not (size < real(largest)) and wp.atomic_max(trouble.status, w, NOT_FINITE) == OK:
            trouble.failed_particle[w] = p
            trouble.slot[w] = r

    @wp.kernel
    def forces_back(
        r: int, clock: Clock, lap: Lap, matter: Matter, state: State, bars: MatterBars,
        scene_bars: SceneBars, stretches: Pulls,
    ):  # fmt: skip
        w, p = wp.tid()
        if (matter.yield_stress[w] < real(YIELDS)) != (plastic == 1):
            return
        if r < lap.done[w]:
            h = real(clock.dt[w])
            keep, share = k.branch(matter.damping[w], h, clock.age[w] + r)
            keep_bar, share_bar = k.forces.particle_forces_adjoint(
                w, p, w, h, keep, share, matter, state, bars, stretches
            )
            if share > real(0.0):
                wp.atomic_add(scene_bars.branch_factor, w, wp.float64(keep_bar))
                wp.atomic_add(scene_bars.branch_share, w, wp.float64(share_bar))

    @wp.kernel
    def momenta_back(
        r: int, clock: Clock, lap: Lap, matter: Matter, scene: Scene, state: State,
        bars: MatterBars, scene_bars: SceneBars, stretches: Pulls,
    ):  # fmt: skip
        w, p = wp.tid()
        if r < lap.done[w]:
            g = k.momentum_adjoint(
                w, p, w, real(clock.dt[w]), matter, scene, state, bars, stretches
            )
            wp.atomic_add(scene_bars.gravity, w, k.boundary_adjoint.wide(g))

    @wp.kernel
    def world_back(
        r: int,
        clock: Clock,  # where the graph began
        lap: Lap,
        matter: Matter,
        scene: Scene,
        paths: Paths,
        grips: Grips,  # [GRAPH * W, G]
        state: State,
        bars: MatterBars,
        scene_bars: SceneBars,
    ):
        w = wp.tid()
        if r < lap.done[w]:
            dt = clock.dt[w]
            t = lap.time[0] + wp.float64(clock.step[w] + r) * dt
            row = r * clock.dt.shape[0] + w
            age = clock.age[w] + r
            close_substep(w, row, t, dt, age, matter, scene, paths, grips, scene_bars)
            k.boundary_adjoint.grasp_adjoint(
                w, t, age, w, matter, scene, paths, grips, state, bars, scene_bars
            )

    return Namespace(
        touch_back, g2p_back, nodes_back, p2g_back, forces_back, momenta_back, world_back,
    )  # fmt: skip


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
    lap: Any  # after it
    layouts: Any
    grips: Any
    rows: Any  # a state of [(GRAPH + 1) * W, N]
    momentum: wp.array  # [GRAPH, W, M]


class BatchTape:
    """States every few graphs, from which the graphs between are run again to be reversed.

    Args:
        simulator: Not run before.
        memory: Bound on what one segment records [bytes]; at least one graph is.
    """

    def __init__(self, simulator: MpmEngine, memory: float):
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
        types = worlds.types
        return Segment(
            now,
            _copy(types.Clock(), worlds.clock, CLOCK),
            _copy(types.State(), worlds.state, (*worlds.carried, "low")),
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
        layout = W * 4 * 3 * X * Y
        return max(1, int(self.memory / (SUBSTEPS_A_GRAPH * slot + layout)))

    def _record(self, segment: Segment) -> list[_Graph]:
        """Run a segment again and keep everything its reverse needs."""
        batch = self._batch
        self._return_to(segment)
        graphs: list[_Graph] = []
        more = True
        while more:
            batch.launch_rebuild()
            graphs.append(self._record_graph())
            batch.launch_tally()
            more = batch.settle(segment.time)
        return graphs

    def _return_to(self, segment: Segment) -> None:
        """Set worlds to the beginning of a segment; its grids are rebuilt first."""
        worlds, batch = self.simulator.worlds, self._batch
        for name in (*worlds.carried, "low"):
            wp.copy(getattr(worlds.state, name), getattr(segment.state, name))
        for name in ("dt", "step", "age", "frame"):
            wp.copy(getattr(worlds.clock, name), getattr(segment.clock, name))
        if segment.until is not None:
            wp.copy(worlds.clock.steps, segment.until)
        worlds.clock.status.zero_()
        batch.hold_as_at(worlds.clock.age)
        batch.begin()
        batch.lap.time.fill_(segment.time)

    def _record_graph(self) -> _Graph:
        worlds, batch = self.simulator.worlds, self._batch
        types, state, grid = worlds.types, worlds.state, batch.grid
        W = worlds.num_worlds
        rows = worlds.make_state((SUBSTEPS_A_GRAPH + 1) * W)
        for name in worlds.carried:
            wp.copy(getattr(rows, name)[:W], getattr(state, name))
        grips = _copy(types.Grips(), batch.grips, POSE)
        for name in ("since", "until", "count", "particle", "weight", "place", "free", "held_by"):
            setattr(grips, name, getattr(batch.grips, name))
        graph = _Graph(
            clock=_copy(types.Clock(), worlds.clock, CLOCK),
            lap=None,
            layouts=_copy(SparseGrid(), grid.layouts, _LAYOUT),
            grips=grips,
            rows=rows,
            momentum=worlds.zeros((SUBSTEPS_A_GRAPH, *grid.momentum.shape), types.vec4),
        )
        for r in range(SUBSTEPS_A_GRAPH):
            momentum: Any = graph.momentum[r]
            batch.launch_substep(r, self._row(rows, r), self._row(rows, r + 1), momentum)
        graph.lap = _copy(batch.stages.Lap(), batch.lap, LAP)
        # the state in which each world has left the graph
        last = worlds.array(W * batch.lap.done.numpy() + np.arange(W), wp.int32)
        for name in worlds.carried:
            wp.copy(getattr(state, name), getattr(rows, name)[last])
        return graph

    def _row(self, rows: Any, r: int) -> Any:
        """The worlds' state before substep r of a recorded graph."""
        W = self.simulator.num_worlds
        state = self.simulator.worlds.types.State()
        state.low = rows.low
        for name in ("x", "v", "C", "Z", "G"):
            carried = name in self.simulator.worlds.carried
            all_rows = getattr(rows, name)
            setattr(state, name, all_rows[r * W : (r + 1) * W] if carried else all_rows)
        return state

    def _reverse(self, segment: Segment, graph: _Graph, sums: Sums) -> None:
        """Carry derivatives from the end of a recorded graph to its beginning."""
        s, batch, launch = self.simulator.worlds, self._batch, self._batch.launch
        law, layouts, grips = "neo-hookean", graph.layouts, graph.grips
        every = [
            make_reverse_kernels(s.real, law, yields=yields)
            for yields in sorted({bool(one) for one in s.yields})
        ]
        k = every[0]
        W, N = s.num_worlds, s.num_particles
        nodes = graph.momentum.shape[1:]
        velocity = wp.empty(nodes, dtype=s.types.vec4, device=s.device)
        nodes_bar = wp.empty(nodes, dtype=s.types.vec4, device=s.device)
        bars, scene_bars = sums.matter, sums.scene
        for r in reversed(range(SUBSTEPS_A_GRAPH)):
            row: Any = self._row(graph.rows, r)
            momentum = graph.momentum[r]
            now: list[Any] = [r, graph.clock, graph.lap]
            batch.launch_forces(now, row, self._row(graph.rows, r + 1))
            batch.launch(batch.stages.nodes, nodes, [
                *now, s.matter, s.scene, layouts, 1, momentum, velocity,
            ])  # fmt: skip
            nodes_bar.zero_()
            launch(k.g2p_back, (W, N), [
                *now, s.scene, grips, layouts, velocity, row, nodes_bar, bars, scene_bars,
            ])  # fmt: skip
            launch(k.nodes_back, nodes, [
                *now, s.scene, layouts, momentum, nodes_bar, scene_bars,
            ])  # fmt: skip
            launch(k.p2g_back, (W, N), [
                *now, s.matter, s.scene, grips, layouts, row, s.pulls, s.touched, nodes_bar,
                bars, scene_bars, sums.trouble,
            ])  # fmt: skip
            launch(k.touch_back, s.touched.shape, [
                *now, s.matter, s.scene, row, s.pulls, s.touched, bars, scene_bars,
            ])  # fmt: skip
            for kind in every:
                launch(kind.forces_back, (W, N), [
                    *now, s.matter, row, bars, scene_bars, s.pulls,
                ])  # fmt: skip
            launch(k.momenta_back, (W, N), [
                *now, s.matter, s.scene, row, bars, scene_bars, s.pulls,
            ])  # fmt: skip
            launch(k.world_back, W, [
                *now, s.matter, s.scene, s.paths, grips, row, bars, scene_bars,
            ])  # fmt: skip

        def x(slot: int, w: int) -> NDArray[np.floating]:
            return graph.rows.x.numpy()[slot * W + w]

        self._check(sums, segment.time, graph.clock, x)

    def _check(self, sums: Sums, frame_start: float, clock: Any, x: Any) -> None:
        """Raise the error of a derivative that is not finite, see ``Sums.overflow``."""
        for w in np.flatnonzero(sums.trouble.status.numpy() == NOT_FINITE):
            begin = (getattr(clock, name).numpy()[w] for name in ("step", "age", "dt"))
            raise sums.overflow(self.simulator, int(w), (frame_start, *begin), x)


def _copy(copy: Any, of: Any, names: tuple[str, ...]) -> Any:
    """The struct ``copy`` with arrays of its own, equal to those of another."""
    for name in names:
        setattr(copy, name, wp.clone(getattr(of, name)))
    return copy
