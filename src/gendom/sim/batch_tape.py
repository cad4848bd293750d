"""What a GPU keeps of a simulation to reverse it: all worlds together, graph by graph."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.gradients import Sums, overflow
from gendom.sim.reverse import NOT_FINITE, make_reverse_stages
from gendom.sim.simulator import SUBSTEPS_A_GRAPH, Simulator

_LAYOUT = ("bounds", "start", "cell", "level", "count")
_PLACED = ("grip_centre", "grip_velocity", "grip_spin", "grip_closed")


@dataclass
class _Segment:
    """Some graphs of one frame: where they begin, and how far each world has come in the end."""

    time: float  # of the frame's substep 0 [s]
    dt: wp.array  # [W] [s]
    step: wp.array  # [W] substeps of the frame done before
    age: wp.array  # [W] substeps done in all before
    state: dict[str, wp.array]
    until: Any = None  # [W] substeps of the frame done after


@dataclass
class _Graph:
    """The substeps of one graph: states, grids, layout, grippers."""

    step: wp.array
    age: wp.array
    layout: dict[str, wp.array]
    placed: dict[str, wp.array]
    rows: dict[str, wp.array]  # [GRAPH + 1, W, N]
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
        self._frames: list[list[_Segment]] = []
        self._stages = make_reverse_stages(
            simulator._real, simulator.law, plastic=simulator._plastic
        )

    def forward(self, times: NDArray[np.float64]) -> NDArray[np.floating]:
        """Positions [T, W, N, 3] at the times [m].

        Raises:
            SimulationError: If a world diverges.
        """
        s = self.simulator
        a = s._world
        s._begin_batch()
        frames = np.empty((len(times), s.num_worlds, s.body.num_particles, 3), dtype=s.dtype)
        now = s.time
        for f, until in enumerate(times):
            s._plan_batch(now, until)
            frame: list[_Segment] = []
            more = bool(a["steps"].numpy().any())
            while more:
                segment = _Segment(
                    now, wp.clone(a["dt"]), wp.clone(a["step"]), wp.clone(a["age"]), _copy(s._state)
                )
                more = s._advance_batch(now, most=self._graphs_a_segment())
                segment.until = wp.clone(a["step"])
                frame.append(segment)
            self._frames.append(frame)
            frames[f] = s.positions()
            now = float(until)
        return frames

    def backward(self, bar: NDArray[np.floating], sums: Sums) -> None:
        """Carry derivatives [T, W, N, 3] by the positions back to the first state.

        Raises:
            SimulationError: If a derivative is not finite.
        """
        for frame, frame_bar in zip(reversed(self._frames), bar[::-1], strict=True):
            sums.add_positions(slice(None), frame_bar)
            for segment in reversed(frame):
                for graph in reversed(self._record(segment)):
                    self._reverse(segment, graph, sums)

    def _graphs_a_segment(self) -> int:
        s = self.simulator
        W, N = s.num_worlds, s.body.num_particles
        X, Y, M = s._columns
        real = np.dtype(s.dtype).itemsize
        slot = W * real * (24 * N + 4 * M)
        layout = W * 4 * (X * Y + 2 * M)
        return max(1, int(self.memory / (SUBSTEPS_A_GRAPH * slot + layout)))

    def _record(self, segment: _Segment) -> list[_Graph]:
        """Run a segment again and keep everything its reverse needs."""
        s = self.simulator
        a, g = s._world, s._scratch
        for name, array in segment.state.items():
            wp.copy(s._state[name], array)
        for name in ("dt", "step", "age"):
            wp.copy(a[name], getattr(segment, name))
        wp.copy(a["steps"], segment.until)
        a["status"].zero_()
        a["travel"].fill_(1e30)
        g["time"].fill_(segment.time)
        graphs: list[_Graph] = []
        more = True
        while more:
            s._launch_layout(g)
            graphs.append(self._record_graph())
            s._launch_tally(g)
            more = s._settle_batch(segment.time)
        return graphs

    def _record_graph(self) -> _Graph:
        s = self.simulator
        a, g = s._world, s._scratch
        W, N = s.num_worlds, s.body.num_particles
        rows = {
            name: wp.empty((SUBSTEPS_A_GRAPH + 1, W, N), dtype=state.dtype, device=s.device)
            for name, state in s._state.items()
        }
        for name, state in s._state.items():
            wp.copy(_row(rows, 0)[name], state)
        graph = _Graph(
            step=wp.clone(a["step"]),
            age=wp.clone(a["age"]),
            layout={name: wp.clone(g[name]) for name in _LAYOUT},
            placed={name: wp.clone(g[name]) for name in _PLACED},
            rows=rows,
            momentum=s._zeros((SUBSTEPS_A_GRAPH, *g["grid"].shape), s._k.vec4),
        )
        for r in range(SUBSTEPS_A_GRAPH):
            momentum: Any = graph.momentum[r]
            s._launch_substep(g, r, _row(rows, r), _row(rows, r + 1), momentum)
        graph.done = wp.clone(g["done"])
        s._launch(s._k.take, (W, N), [
            graph.done, *(rows[n] for n in "xvCF"), *(s._state[n] for n in "xvCF"),
        ])  # fmt: skip
        return graph

    def _reverse(self, segment: _Segment, graph: _Graph, sums: Sums) -> None:
        """Carry derivatives from the end of a recorded graph to its beginning."""
        s, k = self.simulator, self._stages
        a, b, layout, placed = s._world, sums.arrays, graph.layout, graph.placed
        W, N = s.num_worlds, s.body.num_particles
        shape = graph.momentum.shape[1:]
        velocity = wp.empty(shape, dtype=s._k.vec4, device=s.device)
        grid_bar = wp.empty(shape, dtype=s._k.vec4, device=s.device)
        boundary = [
            a["gravity"], a["damping"], int(s._table is not None), a["friction"], *s._walls(),
        ]  # fmt: skip
        nodes = [layout["bounds"], layout["cell"], layout["level"], layout["count"]]
        stencil = [layout["bounds"], layout["start"]]
        for r in reversed(range(SUBSTEPS_A_GRAPH)):
            rows = _row(graph.rows, r)
            momentum = graph.momentum[r]
            going: list[Any] = [r, graph.done, segment.dt]
            place = [*going, s.body.dx, s._z0]
            s._launch(k.grid_again, shape, [
                *place, *boundary, *(placed[name] for name in _PLACED), a["grip_radius"],
                *nodes, momentum, velocity, grid_bar,
            ])  # fmt: skip
            s._launch(k.gather_back, (W, N), [
                *place, a["mu"], a["yield_stress"], *stencil, velocity, grid_bar,
                rows["x"], rows["F"], b["x"], b["v"], b["C"], b["F"], b["mu"], b["yield"],
            ])  # fmt: skip
            s._launch(k.grid_back, shape, [
                *place, *boundary, placed["grip_centre"], placed["grip_spin"],
                placed["grip_closed"], a["grip_radius"], *nodes, momentum,
                b["grip_centre"], b["grip_velocity"], b["friction"], b["keep"], b["gravity"],
                grid_bar,
            ])  # fmt: skip
            s._launch(k.scatter_back, (W, N), [
                *place, a["mu"], a["lam"], a["mass"], s.body.volume, *stencil, grid_bar,
                rows["x"], rows["v"], rows["C"], rows["F"], b["x"], b["v"], b["C"], b["F"],
                b["mu"], b["lam"], b["mass"], b["status"], b["slot"], a["culprit"],
            ])  # fmt: skip
            s._launch(k.world_back, W, [
                *going, a["damping"], graph.step, segment.time, a["path_time"],
                placed["grip_closed"], b["grip_centre"], b["grip_velocity"], b["keep"],
                b["damping"], b["path"],
            ])  # fmt: skip
            s._launch(k.recover_back, (W, N), [
                *going, graph.age, s._lattice, s._rest_frames, s._recovery, rows["x"],
                b["x"], b["F"],
            ])  # fmt: skip
        failed = np.flatnonzero(b["status"].numpy() == NOT_FINITE)
        if len(failed):
            w = int(failed[0])
            slot, particle = int(b["slot"].numpy()[w]), int(a["culprit"].numpy()[w])
            raise overflow(
                s,
                w,
                substep=int(graph.age.numpy()[w]) + slot,
                time=segment.time
                + (int(graph.step.numpy()[w]) + slot) * float(segment.dt.numpy()[w]),
                particle=particle,
                F=graph.rows["F"].numpy()[slot, w, particle],
            )


def _copy(arrays: dict[str, wp.array]) -> dict[str, wp.array]:
    return {name: wp.clone(array) for name, array in arrays.items()}


def _row(rows: dict[str, wp.array], r: int) -> dict[str, Any]:
    """Row r of every array."""
    return {name: array[r] for name, array in rows.items()}
