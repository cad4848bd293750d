"""Running on CUDA where bodies are small: a block of threads for each world."""

# pyright: basic

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.mpm.block import ROOM_ALONE, ROOMS_OF_TWO
from gendom.sim.mpm.grid import Grid
from gendom.sim.mpm.model import Worlds
from gendom.sim.mpm.poses import AHEAD
from gendom.sim.mpm.runners.block_kernels import make_block_kernels
from gendom.sim.mpm.runners.graph import Batch
from gendom.sim.mpm.runners.held import LIST, make_held
from gendom.sim.mpm.runners.records import Variant
from gendom.sim.setting import Frames

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

SLICES = 16
"""Launches between two looks at how the worlds do."""

RECORDED = 1 << 30
"""Bound on the recorded positions that wait on the device [bytes]."""

ALL = 1 << 30


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


class Blocks(Batch):
    """A block of threads a world, which advances by itself through many substeps and frames.

    Args:
        worlds: On any device; on the CPU, where tests run it, a block is one thread.
        lanes: Threads of a block, a multiple of 32 (default: by worlds and particles).
    """

    substeps_a_slice = 128
    """Of a world of median speed in one launch."""

    def __init__(self, worlds: Worlds, lanes: int | None = None):
        W, N = worlds.num_worlds, worlds.num_particles
        every = self._variant(worlds, yields=bool(worlds.yields.any()), room=0, lanes=0)
        self.room = shared_room(worlds, every.components)
        crowded = W > MANY_WORLDS and N <= LARGE_BODY
        pairs = crowded and self.room != ROOM_ALONE
        lanes = lanes or (NARROW if pairs else WIDE)
        # worlds that yield have kernels of their own; the slowest worlds go first, so that no block
        # ends alone
        self.variants: list[tuple[Variant, Any]] = []
        slowest = np.argsort(worlds.substep)
        for yields in sorted({bool(one) for one in worlds.yields}):
            chosen = slowest[worlds.yields[slowest] == yields]
            variant = self._variant(worlds, yields=yields, room=self.room, lanes=lanes)
            self.variants.append((variant, worlds.array(chosen, wp.int32)))
        self.lanes = lanes if worlds.device.is_cuda else 1
        self.records = worlds.allocate(
            make_block_kernels(self.variants[0][0]).Records,
            of=(1 if self.room else W, every.components, N),
            moduli=(W, 2, N),
            near=(W, 3, N),
            spare=(W, every.components + 2, N),
            strayed=W,
            **dict.fromkeys(("order", "place", "spare_order"), (W, N)),
        )
        self.held = worlds.allocate(
            make_held(worlds.real).Held, count=W, **dict.fromkeys(LIST, (W, N))
        )
        self._streams: list[Any] = [None]
        if crowded and worlds.device.is_cuda:
            # two groups take turns: one fills the multiprocessors that the other leaves idle
            self._streams = [wp.Stream(worlds.device) for _ in range(2)]
        self._span = self.substeps_a_slice * float(np.median(worlds.substep))
        super().__init__(worlds)

    @staticmethod
    def _variant(worlds: Worlds, *, yields: bool, room: int, lanes: int) -> Variant:
        return Variant(worlds.real, "neo-hookean", yields, worlds.damped, room=room, lanes=lanes)

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

    def run(self, frames: Frames) -> None:
        s = self.worlds
        self.begin()
        row = s.num_worlds * len(frames.particles) * 3 * s.numpy_type.itemsize
        together = max(1, RECORDED // max(1, row))
        now = frames.began
        for first in range(0, len(frames.times), together):
            times = frames.times[first : first + together]
            failed_before = set(s.failures)
            self.plan_frames(now, times, frames.particles)
            more, done = True, 0
            while more:
                more = self.advance(now, keep_going=frames.keep_going)
                going = [w for w in range(s.num_worlds) if w not in s.failures]
                least = min((int(self._frame[w]) for w in going), default=len(times))
                if frames.on_frame is not None and least > done:
                    frames.on_frame(first + least)
                done = least
            frames.x[first : first + together] = self.frame_plan.x.numpy()
            for w in s.failures:
                since = 0 if w in failed_before else self._frame[w]
                frames.x[first + since :, w] = np.nan
            now = float(times[-1])

    def plan(self, now: float, until: float) -> None:
        self.plan_frames(now, np.array([until]), np.array([], dtype=int))

    def plan_frames(
        self, now: float, times: NDArray[np.float64], particles: NDArray[np.integer]
    ) -> None:
        """Set all worlds to go from ``now`` to each of the times [T] [s].

        The positions of the particles [P] are recorded at each.
        """
        s, clock = self.worlds, self.worlds.clock
        self._time = np.concatenate([[now], times])
        self._pause = now
        steps = np.stack([s.divide(slice(None), span)[0] for span in np.diff(self._time)])
        self.frame_plan = s.filled(s.types.Plan, time=self._time, steps=steps, particles=particles)
        self.frame_plan.x = wp.empty(
            (len(times), s.num_worlds, len(particles)), dtype=s.types.vec3, device=s.device
        )
        # worlds that failed are through
        self._frame = np.zeros(s.num_worlds, dtype=np.int32)
        self._frame[list(s.failures)] = len(times)
        clock.frame.assign(self._frame)
        clock.steps.assign(steps[0])
        clock.dt.assign(s.divide(slice(None), times[0] - now)[1])
        clock.step.zero_()
        clock.status.zero_()

    def advance(self, now: float, *, keep_going: bool = False, most: int = ALL) -> bool:
        several = len(self._streams) > 1
        if several:
            wp.synchronize_device(self.worlds.device)
        for substeps, pause in self._slices(most):
            for group, stream in enumerate(self._streams):
                self.launch_advance(
                    substeps, pause, self.frame_plan, self.grid, share=(group, len(self._streams)),
                    stream=stream,
                )  # fmt: skip
        if several:
            wp.synchronize_device(self.worlds.device)
        return self.look(now, keep_going=keep_going)

    def look(self, now: float, *, keep_going: bool = False) -> bool:
        """See how far worlds have come, and ``settle``."""
        s, last = self.worlds, len(self._time) - 2
        self._frame = np.array(s.clock.frame.numpy())
        going = np.array([w not in s.failures for w in range(s.num_worlds)])
        s.last_good_time[going] = self._time[np.minimum(self._frame, last)][going]
        return self.settle(now, keep_going=keep_going)

    def _slices(self, most: int) -> list[tuple[int, float]]:
        """Bounds on the substeps of each launch, and on its time [s].

        Of a run by time, so that fast worlds end no sooner than slow ones; of a recording by
        substeps.
        """
        step = self.substeps_a_slice
        if most < ALL:
            return [(min(step, most - done), np.inf) for done in range(0, most, step)]
        slices = []
        while len(slices) < SLICES and (not slices or self._pause < np.inf):
            self._pause += self._span
            if self._pause >= self._time[-1]:
                self._pause = np.inf
            slices.append((ALL, self._pause))
        return slices

    def frame_start(self, w: int, now: float) -> float:
        return float(self._time[self._frame[w]])

    def unfinished(self) -> NDArray[np.bool_]:
        return self._frame < len(self._time) - 1

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
