"""What the CPU keeps of a simulation to reverse it: each world by itself, on its own thread."""

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim import kernels
from gendom.sim.gradients import Sums, overflow
from gendom.sim.reverse import NOT_FINITE, make_reverse
from gendom.sim.simulator import Simulator

STRETCH = 64
"""Substeps that are recorded, and reversed, at a time."""


class WorldTape:
    """Stretches of every world, recorded, or their first states from which they are run again.

    Args:
        simulator: Not run before, on the CPU.
        memory: Bound on what is kept [bytes].
    """

    def __init__(self, simulator: Simulator, memory: float):
        self.simulator = simulator
        self.memory = memory
        self._stretches: list[list[_Stretch]] = []

    def forward(self, times: NDArray[np.float64]) -> NDArray[np.floating]:
        """Positions [T, W, N, 3] at the times [m].

        Raises:
            SimulationError: If a world diverges.
        """
        s = self.simulator
        self._stretches = [_plan(s, w, s.time, times) for w in range(s.num_worlds)]
        substeps = sum(stretch.substeps for world in self._stretches for stretch in world)
        keeps_all = substeps * _Recording.bytes_a_substep(s) <= self.memory
        frames = np.empty((len(times), s.num_worlds, s.body.num_particles, 3), dtype=s.dtype)

        def one_world(w: int) -> None:
            grid = s._make_grid(1)
            for stretch in self._stretches[w]:
                begin = {name: view[w].copy() for name, view in s._state_views.items()}
                if not stretch.substeps:
                    pass
                elif keeps_all:
                    stretch.recording = _record(s, w, stretch, begin)
                    for name, rows in stretch.recording.rows.items():
                        s._state_views[name][w] = rows.numpy()[stretch.substeps]
                else:
                    stretch.begin = begin
                    _begin(s, w, stretch)
                    grid = s._advance_world(w, stretch.time, grid)
                if stretch.ends_frame >= 0:
                    frames[stretch.ends_frame, w] = s._state_views["x"][w]

        _for_worlds(s, one_world)
        return frames

    def backward(self, bar: NDArray[np.floating], sums: Sums) -> None:
        """Carry derivatives [T, W, N, 3] by the positions back to the first state.

        Raises:
            SimulationError: If a derivative is not finite.
        """
        s = self.simulator

        def one_world(w: int) -> None:
            spare: _Recording | None = None
            for stretch in reversed(self._stretches[w]):
                if stretch.ends_frame >= 0:
                    sums.add_positions(w, bar[stretch.ends_frame, w])
                if stretch.substeps:
                    recording = stretch.recording
                    if recording is None:
                        assert stretch.begin is not None  # kept by forward
                        recording = spare = _record(s, w, stretch, stretch.begin, spare)
                    _reverse(s, w, stretch, recording, sums)

        _for_worlds(s, one_world)


@dataclass
class _Stretch:
    """Consecutive substeps of one world inside one frame."""

    time: float  # of the frame's substep 0 [s]
    dt: float  # [s]
    begun: int  # number in the frame of the first substep
    age: int  # substeps before it in all
    substeps: int
    ends_frame: int  # the frame that its last substep completes, or -1
    begin: dict[str, NDArray[Any]] | None = None
    recording: "_Recording | None" = None


def _plan(s: Simulator, w: int, began: float, times: NDArray[np.float64]) -> list[_Stretch]:
    """Cut a world's substeps into stretches that end with frames."""
    plan: list[_Stretch] = []
    now, age = began, 0
    for f, until in enumerate(times):
        n, dt = (value.item() for value in s._divide(w, until - now))
        cuts = [*range(0, n, STRETCH), n] if n else [0, 0]
        for a, b in itertools.pairwise(cuts):
            ends = f if b == n else -1
            plan.append(_Stretch(now, dt, a, age + a, b - a, ends))
        age += n
        now = float(until)
    return plan


class _Recording:
    """States, grids and layouts of consecutive substeps of one world."""

    def __init__(self, s: Simulator, slots: int):
        # nothing is read before it was written: memory that is never needed is never touched
        shape = (slots + 1, s.body.num_particles)
        k = s._k
        self.slots = slots
        self.grid = s._make_grid(slots, make=wp.empty)
        self.rows = {
            "x": wp.empty(shape, dtype=k.vec3, device=s.device),
            "v": wp.empty(shape, dtype=k.vec3, device=s.device),
            "C": wp.empty(shape, dtype=k.mat33, device=s.device),
            "F": wp.empty(shape, dtype=k.mat33, device=s.device),
        }
        self.velocity = s._zeros((1, self.grid["grid"].shape[1]), k.vec4)

    @staticmethod
    def bytes_a_substep(s: Simulator) -> int:
        X, Y, M = s._columns
        real = np.dtype(s.dtype).itemsize
        return real * (24 * s.body.num_particles + 4 * M) + 4 * (3 * X * Y + 2 * M + 6)


def _begin(s: Simulator, w: int, stretch: _Stretch) -> None:
    """Set world w's counters to the stretch; its columns are laid anew first."""
    views = s._views
    views["step"][w] = stretch.begun
    views["steps"][w] = stretch.begun + stretch.substeps
    views["dt"][w] = stretch.dt
    views["age"][w] = stretch.age
    views["travel"][w] = 1e30
    views["status"][w] = kernels.OK


def _record(
    s: Simulator,
    w: int,
    stretch: _Stretch,
    begin: dict[str, NDArray[Any]],
    spare: _Recording | None = None,
) -> _Recording:
    """Run a stretch from its first state and keep everything its reverse needs.

    Into ``spare`` where that is long enough.
    """
    recording = spare
    if recording is None or recording.slots < stretch.substeps:
        recording = _Recording(s, stretch.substeps)
    while True:
        for name, rows in recording.rows.items():
            rows.numpy()[0] = begin[name]
        _begin(s, w, stretch)
        s._launch_advance(w, stretch.time, recording.grid, recording.rows, 0, 1, recording.velocity)
        status = s._views["status"][w]
        if status != kernels.GRID_FULL:
            break
        s._make_room(recording.grid["bounds"].numpy()[:1], recording.grid)
        recording = _Recording(s, stretch.substeps)
    if status != kernels.OK:
        raise s._failure(w, stretch.time, s._views)
    return recording


def _reverse(s: Simulator, w: int, stretch: _Stretch, recording: _Recording, sums: Sums) -> None:
    """Carry world w's derivatives from the end of a recorded stretch to its beginning."""
    a, r, g, b = s._world, recording.rows, recording.grid, sums.arrays
    nodes = g["grid"].shape[1]
    wp.launch(
        make_reverse(s._real, s.law, plastic=s._plastic),
        dim=1,
        inputs=[
            w, stretch.substeps, stretch.begun, stretch.age, stretch.time, stretch.dt,
            a["mu"], a["lam"], a["yield_stress"], a["mass"], s.body.volume,
            s._lattice, s._rest_frames, s._recovery,
            s.body.dx, s._z0, a["gravity"], a["damping"],
            int(s._table is not None), a["friction"], *s._walls(),
            a["path_time"], a["path_position"], a["path_spin"],
            a["hold_from"], a["hold_until"], a["grip_radius"],
            a["grip_centre"], a["grip_velocity"], a["grip_spin"], a["grip_closed"],
            r["x"], r["v"], r["C"], r["F"],
            g["bounds"], g["start"], g["cell"], g["level"], g["count"], g["layout_of"], g["grid"],
            recording.velocity, s._zeros((1, nodes), s._k.vec4),
            b["grip_centre"], b["grip_velocity"], b["keep"],
            b["x"], b["v"], b["C"], b["F"],
            b["mu"], b["lam"], b["mass"], b["yield"],
            b["friction"], b["damping"], b["gravity"], b["path"],
            b["status"], b["slot"], a["culprit"],
        ],
        device=s.device,
    )  # fmt: skip
    if b["status"].numpy()[w] == NOT_FINITE:
        slot, particle = int(b["slot"].numpy()[w]), int(s._views["culprit"][w])
        raise overflow(
            s,
            w,
            substep=stretch.age + slot,
            time=stretch.time + (stretch.begun + slot) * stretch.dt,
            particle=particle,
            F=r["F"].numpy()[slot, particle],
        )


def _for_worlds(s: Simulator, work: Any) -> None:
    """Do the work for every world on the simulator's threads; the first failure is raised."""
    order = np.argsort(s.substep)
    with ThreadPoolExecutor(max_workers=s.threads) as pool:
        for job in [pool.submit(work, int(w)) for w in order]:
            job.result()
