"""Running on CUDA where a launch takes worlds through many substeps, each at its own pace."""

from abc import ABC, abstractmethod

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.mpm.model import Worlds
from gendom.sim.mpm.runners.graph import Batch
from gendom.sim.setting import Frames

SLICES = 16
"""Launches between two looks at how the worlds do."""

RECORDED = 1 << 30
"""Bound on the recorded positions that wait on the device [bytes]."""

ALL = 1 << 30


class Paced(Batch, ABC):
    """Every world advances by itself, through as many frames as there is room to record.

    Args:
        worlds: On any device; on the CPU, where tests run it, a world has one thread.
    """

    substeps_a_slice = 128
    """Of a world of median speed in one launch."""

    def __init__(self, worlds: Worlds):
        self._span = self.substeps_a_slice * float(np.median(worlds.substep))
        super().__init__(worlds)

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
        self.frame_plan = s.types.Plan()
        self.frame_plan.time = s.array(self._time, wp.float64)
        self.frame_plan.steps = s.array(steps, wp.int32)
        self.frame_plan.particles = s.array(particles, wp.int32)
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
        self.launch_slices(self._slices(most))
        return self.look(now, keep_going=keep_going)

    @abstractmethod
    def launch_slices(self, slices: list[tuple[int, float]]) -> None:
        """Take all worlds through some launches.

        Each is bounded by its substeps and by a time from which on none begins [s].
        """

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
