"""Steps of rods and shells whose grippers somebody leads.

5 ms of one rope take 30 us of its own: what a step needs is made once, and written in place.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from gendom.sim.gripper import Targets
from gendom.sim.paths import CommandedPaths, paths_on
from gendom.sim.setting import Frames
from gendom.sim.thin.run import Run, Schedule, put

LEAST = 5000
"""Steps of points that a thread is woken for: fewer take less time than that."""


class Steps:
    """Steps of all worlds of a ``ThinEngine``: runs of one piece that record nothing."""

    def __init__(self, engine: Any):
        self.engine, W, now = engine, engine.num_worlds, engine.now
        self._whole, self._every = slice(0, W), np.arange(W)
        nothing, x = np.zeros(0, dtype=int), np.empty((1, W, 0, 3))
        self._frames = Frames(now, np.full(1, now), nothing, x, None, False)
        self._shared = not engine.setting.device.is_cuda
        """Whether kernels read the host's memory."""
        self._shortest = float(engine.setting.substep.min())
        self._begin()

    def _begin(self) -> None:
        """Make the arrays of steps along the present paths."""
        e = self.engine
        self._run = Run(e, self._frames, Schedule(self._frames, e, None))
        self._made = made = self._run.on_device
        made.span = wp.zeros(2, dtype=wp.float64, device=e.setting.device)
        put(made.piece, self._whole, np.tile(np.array([0, 1], np.int32), (e.num_worlds, 1)))
        self._span, self._failed, self._least = made.span.numpy(), 0, 0
        self._read()

    def _read(self) -> None:
        self._stopped, self._last_dt = self._made.stopped.numpy(), self._made.dt.numpy()[:, 0]

    def take(self, until: float, targets: Targets | None, *, keep_going: bool) -> None:
        """Simulate all worlds to a time [s], with grippers at targets then, if any.

        Raises:
            ParameterError: If targets do not fit the grippers.
            SimulationError: If a world diverges, unless ``keep_going`` is set.
        """
        e = self.engine
        if targets is None and not e.commanded and self._switches_before(until):
            times = np.array([until])
            e.run(replace(self._frames, began=e.now, times=times, keep_going=keep_going))
            return
        if self._lead(until, targets) if targets is not None else not e.commanded:
            e.switch(self._every, np.full(e.num_worlds, e.now))
        if e.ties is not None and not e.ties.are_safe(e.paths, self._whole):
            going = np.setdiff1d(self._every, list(e.failures))
            e.failures.update(e.apart(going, *(np.full(len(going), t) for t in (e.now, until))))
        self._ready(until)
        e.in_threads(self._run.launch, self._groups)
        if not self._shared:
            self._read()
        e.ran(until, self._last_dt)
        if self._stopped.max() >= 0:
            e.note_stopped(self._run, self._whole)
            e.raise_failures(keep_going=keep_going)

    def _switches_before(self, until: float) -> bool:
        """Whether a gripper closes or opens on its path before a time [s], from now on."""
        at = np.stack([self.engine.stacked[name] for name in ("hold_from", "hold_until")])
        return bool(((at > self.engine.now) & (at < until)).any())

    def _lead(self, until: float, targets: Targets) -> bool:
        """Lead grippers to targets; returns whether some may close or open."""
        e = self.engine
        position, q, closed = targets.of(*e.closed.shape)
        first = not e.commanded
        if first:
            e.commanded, e.paths = True, CommandedPaths(e.paths, e.now)
            e.stacked = e.paths.arrays
            e.device_paths = paths_on(e.setting.device, e.stacked, e.real)
            self._begin()
        switched = e.paths.command(e.now, until, position - e.origin, q, closed) or first
        if switched:
            e.closed[e.paths.closed & (e.closed == 2)] = 0
        if not self._shared:
            for name in e.paths.changing:
                given = np.ascontiguousarray(e.stacked[name])
                getattr(e.device_paths, name).assign(given)
        return switched

    def _ready(self, until: float) -> None:
        """Write what kernels read for a step to a time [s]."""
        e, made = self.engine, self._made
        self._span[0], self._span[1] = e.now, until
        if not self._shared:
            made.span.assign(self._span)
        if e.last_dt is not self._last_dt:
            put(made.dt, self._whole, e.last_dt[:, None])
        if len(e.failures) > self._failed:
            self._failed = len(e.failures)
            put(made.stopped, np.array(list(e.failures)), np.int32(0))
        least = 1 + int(LEAST * self._shortest / ((until - e.now) * e.num_points))
        if least != self._least:
            self._least, self._groups = least, e.groups(e.num_worlds, least)
