"""Running worlds: groups of them, which share a grid and advance by themselves.

On the CPU every world is a group, and threads take the groups in turn. On CUDA all worlds are one
group, with a block of threads for each world.
"""

# pyright: basic

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Event, Lock
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.arrays import Array
from gendom.sim.device import load_kernels
from gendom.sim.mpm.block import ROOM_ALONE, ROOMS_OF_TWO
from gendom.sim.mpm.kernels import make_advance
from gendom.sim.mpm.model import Worlds
from gendom.sim.mpm.particles import Variant
from gendom.sim.mpm.step import DIVERGED, GRID_FULL, OK
from gendom.sim.setting import Frames

MOST_PARTICLES = 32_767
"""Of a body on CUDA: indices of neighbours have 15 bits there."""

MANY_WORLDS = 132
"""Above, two blocks share a multiprocessor, which wants them small."""

LARGE_BODY = 2048
"""Particles above which blocks are wide however many there are."""

WIDE = 256
"""Threads of a block that has a multiprocessor to itself."""

NARROW = 128
"""Threads of one of two blocks that share one; more leave too few registers for each."""

SUBSTEPS_A_SLICE = 128
"""Of a world in one launch."""

SLICES = 16
"""Launches on CUDA between two looks at how the worlds do."""

RECORDED = 1 << 30
"""Bound on the recorded positions that wait on a GPU [bytes]."""

REBUILD = 1e30
"""Distance travelled [m] after which every world rebuilds its grid."""


class Program:
    """The kernels that worlds run, and the arrays that these share.

    Args:
        worlds: On any device.
        together: Whether all worlds are one group, as on CUDA.
    """

    def __init__(self, worlds: Worlds, *, together: bool):
        self.worlds, self.together = worlds, together
        W, N = worlds.num_worlds, worlds.num_particles
        self.variant = Variant(worlds.real, worlds.damped, together)
        self.crowded = W > MANY_WORLDS and N <= LARGE_BODY
        if worlds.device.is_cuda:
            room = self._shared_room()
            threads = NARROW if self.crowded and room != ROOM_ALONE else WIDE
            self.variant = Variant(worlds.real, worlds.damped, together, room, threads)
        self.particles = self.records(moduli=(W, 2, N))
        if not together:
            near = worlds.setting.body.lattice.transpose(2, 1, 0).reshape(6, N)
            self.particles.near = worlds.array(np.broadcast_to(near, (W, 6, N)), wp.int32)
        self.unsorted = worlds.zeros(W, worlds.real)
        self.load(make_advance(self.variant, taped=False))

    def _shared_room(self) -> int:
        """Shared memory of a block in which its particles fit [bytes]; 0 if they do not."""
        worlds = self.worlds
        taken = self.variant.components * worlds.num_particles * worlds.numpy_type.itemsize
        for room in (*ROOMS_OF_TWO, ROOM_ALONE):
            blocks = 2 if room in ROOMS_OF_TWO else 1
            if taken <= room and blocks * room <= worlds.device.max_shared_memory_per_block:
                return room
        return 0

    def records(self, **more: tuple[int, int, int]) -> Any:
        """Room for records of all worlds, with an array [W, n, N] more, and for reordering them."""
        W, N = self.worlds.num_worlds, self.worlds.num_particles
        ((_, n, _),), reordered = more.values(), W * self.variant.sorts
        return self.worlds.allocate(
            self.worlds.types.Records,
            of=(1 if self.variant.room else W, self.variant.components, N),
            near=(W, 3 if self.worlds.device.is_cuda else 6, N),
            **dict.fromkeys(("order", "place"), (W, N)),
            spare=(reordered, self.variant.components + n, N),
            spare_order=(reordered, N),
            **more,
        )

    def load(self, kernel: Any) -> None:
        """Compile a kernel, or load it from Warp's cache, before threads call it."""
        load_kernels(kernel.module, self.worlds.device, self.variant.threads)

    def groups(self) -> list["Group"]:
        """The groups of worlds, the slowest first."""
        slowest = np.argsort(self.worlds.substep)
        if self.together:
            return [Group(self, slowest)]
        return [Group(self, slowest[n : n + 1]) for n in range(len(slowest))]

    def plan(self, began: float, times: Array, particles: Any, x: Any) -> "Plan":
        """Set all worlds to go from ``began`` to each of the times [T] [s].

        The positions of the particles [P] are recorded at each into x [T, W, P].
        """
        s, clock = self.worlds, self.worlds.clock
        time = np.concatenate([[began], times])
        steps = np.stack([s.divide(slice(None), span)[0] for span in np.diff(time)])
        plan = s.filled(s.types.FramePlan, time=time, steps=steps, particles=particles)
        plan.x = x
        # worlds that failed are through
        frame = np.zeros(s.num_worlds, dtype=np.int32)
        frame[list(s.failures)] = len(times)
        clock.frame.assign(frame)
        clock.dt.assign(s.divide(slice(None), times[0] - began)[1])
        clock.step.zero_()
        clock.status.zero_()
        return Plan(time, steps, plan)

    def launch(
        self, kernel: Any, order: wp.array, inputs: list[Any], *, stream: Any = None
    ) -> None:
        """Launch a block for each of the worlds ``order``."""
        threads = self.variant.threads
        wp.launch(
            kernel,
            dim=(len(order), threads),
            inputs=[order, threads, *inputs],
            device=None if stream else self.worlds.device,
            stream=stream,
            block_dim=threads,
        )


@dataclass(frozen=True)
class Plan:
    """The frames that worlds go through."""

    time: Array
    """[T + 1] where each frame begins, and the last one's end [s]."""
    steps: NDArray[np.int32]
    """[T, W] substeps."""
    arrays: Any
    """``FramePlan``."""


class Group:
    """Worlds that share a grid.

    Args:
        program: What they run.
        own: [n] which worlds they are: one, or all.
    """

    def __init__(self, program: Program, own: NDArray[np.integer]):
        self.program, self.worlds, self.own = program, program.worlds, own
        self.shared = len(own)
        self.layouts = own % self.shared
        self.order = self.worlds.array(own, wp.int32)
        self._streams: list[Any] = [None]
        if program.crowded and self.worlds.device.is_cuda:
            # two halves take turns: one fills the multiprocessors that the other leaves idle
            self._streams = [wp.Stream(self.worlds.device) for _ in range(2)]

    def begin(self) -> None:
        """Make a grid, which the worlds will build first."""
        self.grid = self.worlds.make_grid(self.shared, self.shared, self.shared)
        self.set_clock("travel", REBUILD)

    def end(self) -> None:
        """Let go of the grid."""
        del self.grid

    def set_clock(self, name: str, values: Any) -> None:
        """Set these worlds' numbers of an array of the clock."""
        array = getattr(self.worlds.clock, name)
        numbers = array.numpy()
        numbers[self.own] = values
        if self.worlds.device.is_cuda:
            array.assign(numbers)

    def read(self, name: str) -> Array:
        """[n] a copy of an array of these worlds' clock."""
        return getattr(self.worlds.clock, name).numpy()[self.own]

    def run(
        self, plan: Plan, *, keep_going: bool, stopped: Callable[[], bool],
        report: Callable[[], None],
    ) -> None:  # fmt: skip
        """Take the worlds through all frames, or until one fails that is not to be left behind."""
        self.begin()
        more, launches = True, SLICES if self.worlds.device.is_cuda else 1
        while more and not stopped():
            self.advance(plan, SUBSTEPS_A_SLICE, len(plan.steps), launches)
            more = self.look(plan, keep_going=keep_going)
            report()
        self.end()

    def advance(self, plan: Plan, most: int, frames: int, launches: int = 1) -> None:
        """Take the worlds further, by ``most`` substeps at most in each launch, through the first
        ``frames`` of the plan."""
        several = len(self._streams) > 1
        if several:
            wp.synchronize_device(self.worlds.device)
        for _ in range(launches):
            for n, stream in enumerate(self._streams):
                order: Any = self.order[n :: len(self._streams)] if several else self.order
                self._launch(plan, order, most, frames, self.grid, None, stream)
        if several:
            wp.synchronize_device(self.worlds.device)

    def record(self, plan: Plan, recording: Any, *, most: int, frames: int) -> None:
        """Take the worlds further and keep everything that the reverse needs."""
        grid, tape = recording.grid, recording.tape
        self._launch(plan, self.order, most, frames, grid, tape, None)

    def _launch(
        self, plan: Plan, order: Any, most: int, frames: int, grid: Any, tape: Any, stream: Any
    ) -> None:
        s, program = self.worlds, self.program
        kernel = make_advance(program.variant, taped=tape is not None)
        program.launch(kernel, order, [
            self.shared, most, frames, plan.arrays, s.clock, program.unsorted, s.device_model,
            s.paths, s.grips, s.state, grid, program.particles,
            s.types.Records() if tape is None else tape,
        ], stream=stream)  # fmt: skip

    def look(self, plan: Plan, *, keep_going: bool) -> bool:
        """See to worlds that found no room or failed; return whether there is more to do."""
        s = self.worlds
        status, frame = self.read("status"), self.read("frame")
        full = status == GRID_FULL
        if full.any():
            diverged = s.make_room(self.grid, self.layouts[full])
            status[full] = np.where(diverged, DIVERGED, OK)
            self.set_clock("status", status)
            self.begin()
        last = len(plan.steps) - 1
        begins = plan.time[np.minimum(frame, last)]
        for n in np.flatnonzero(status != OK):
            w = int(self.own[n])
            if w not in s.failures:
                s.failures[w] = s.failure(w, begins[n])
        ok = status == OK
        if not ok.all() and not keep_going:
            return False
        return bool((ok & (frame <= last)).any())


def for_groups(
    groups: list[Group], work: Callable[[Group], None], stop: Event | None = None
) -> None:
    """Do the work for every group, in threads; what one of them raises is raised, and sets
    ``stop``."""
    if len(groups) == 1:
        work(groups[0])
        return
    with ThreadPoolExecutor(groups[0].worlds.setting.threads) as pool:
        jobs = [pool.submit(work, group) for group in groups]
        try:
            for job in jobs:
                job.result()
        except BaseException:
            if stop is not None:
                stop.set()
            raise


def run(program: Program, frames: Frames) -> None:
    """Simulate all worlds to all times.

    Raises:
        SimulationError: If a world diverges, unless told to keep going.
    """
    s = program.worlds
    row = s.num_worlds * len(frames.particles) * 3 * s.numpy_type.itemsize
    together = max(1, RECORDED // max(1, row)) if s.device.is_cuda else len(frames.times)
    now, groups = frames.began, program.groups()
    for first in range(0, len(frames.times), together):
        times = frames.times[first : first + together]
        failed_before = set(s.failures)
        x = wp.empty((len(times), s.num_worlds, len(frames.particles)), dtype=s.types.vec3,
                     device=s.device)  # fmt: skip
        plan = program.plan(now, times, frames.particles, x)
        _run_groups(program, groups, plan, frames, first)
        frames.x[first : first + together] = x.numpy()
        frame = s.clock.frame.numpy()
        for w in s.failures:
            since = 0 if w in failed_before else frame[w]
            frames.x[first + since :, w] = np.nan
        if s.failures and not frames.keep_going:
            raise s.failures[min(s.failures)]
        now = float(times[-1])


def _run_groups(
    program: Program, groups: list[Group], plan: Plan, frames: Frames, first: int
) -> None:
    s, done, stop, alone = program.worlds, 0, Event(), Lock()

    def report() -> None:
        nonlocal done
        with alone:
            frame = s.clock.frame.numpy()
            going = [w for w in range(s.num_worlds) if w not in s.failures]
            least = int(frame[going].min()) if going else len(plan.steps)
            if frames.on_frame is not None and least > done:
                done = least
                frames.on_frame(first + least)

    def work(group: Group) -> None:
        group.run(plan, keep_going=frames.keep_going, stopped=stop.is_set, report=report)

    for_groups(groups, work, stop)
