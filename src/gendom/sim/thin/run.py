"""Runs and steps of a thin engine: schedule, gripper events, and arrays on the device."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.arrays import Array, distinct
from gendom.sim.paths import CommandedPaths, Pose, paths_on
from gendom.sim.setting import Frames
from gendom.sim.thin.grips import Grip

LEAST = 5000
"""Steps of points that a thread is woken for in a step: fewer take less time than that."""


@dataclass
class Event:
    """The closing or opening of one gripper in some worlds."""

    g: int
    closes: bool
    worlds: NDArray[np.int64]
    """[k] indices of the worlds."""
    time: Array
    """[k] times of the event [s]."""
    pose: Pose
    grip: Grip
    x: Array
    """[k, n, 3] points at that time [m]."""


class Schedule:
    """Pieces of equal steps of W worlds up to the last frame, at most S pieces for each world.

    Args:
        frames: Frames to record.
        engine: A ``ThinEngine``.
        most_steps: Maximum number of steps in a piece, or None.
    """

    def __init__(self, frames: Frames, engine: Any, most_steps: int | None):
        substep, hold = engine.setting.substep, engine.stacked
        switches = np.concatenate([hold["hold_from"], hold["hold_until"]], axis=1)
        W, within = len(substep), (switches > frames.began) & (switches < frames.times[-1])
        # worlds that have the same pieces, with different numbers of steps
        alike, which = distinct(np.where(within, switches, np.inf))
        blocks = []
        for k, row in enumerate(alike):
            worlds = np.flatnonzero(which == k)
            blocks.append((worlds, _pieces(frames, row, substep[worlds], most_steps)))
        self.count = np.zeros(W, dtype=int)
        """[W] number of pieces."""
        for worlds, of in blocks:
            self.count[worlds] = of["steps"].shape[1]

        def joined(name: str, usual: float) -> Array:
            every = [of[name] for _, of in blocks]
            shape = W, max(of.shape[-1] for of in every)
            if len(every) == 1:
                return np.broadcast_to(every[0], shape)
            found = np.full(shape, usual, dtype=every[0].dtype)
            for (worlds, _), of in zip(blocks, every, strict=True):
                found[worlds, : of.shape[-1]] = of
            return found

        self.begins, self.dt = joined("begins", 0.0), joined("dt", 1.0)
        self.done, self.steps, self.frame = (
            joined("done", 0),
            joined("steps", 0),
            joined("frame", -1),
        )
        """[W, S] as of the kernels' ``ThinRun``."""
        self.due = joined("due", False)
        """[W, S + 1] whether a gripper closes or opens at the start of a piece."""
        S = self.steps.shape[1]
        moves = self.steps > 0
        if (moves == moves[:1]).all():
            at = np.maximum.accumulate(np.where(moves[0], np.arange(S), -1))[None]
            last = self.dt[:, np.maximum(at[0], 0)]
        else:
            at = np.maximum.accumulate(np.where(moves, np.arange(S), -1), axis=1)
            last = np.take_along_axis(self.dt, np.maximum(at, 0), axis=1)
        if at.min() < 0:
            last = np.where(at < 0, engine.last_dt[:, None], last)
        self.before = np.concatenate([engine.last_dt[:, None], last[:, :-1]], axis=1)
        self.last_dt = last[:, -1].copy()
        """[W] length of the last step [s]."""

    def time(self, w: Any, s: Any) -> Array:
        """Start times of pieces s of worlds w [s]."""
        return self.begins[w, s] + self.done[w, s] * self.dt[w, s]

    def until(self, worlds: slice, at: NDArray[np.int64]) -> NDArray[np.int64]:
        """Next pieces after ``at`` [k] that begin with a gripper event, or the end, [k]."""
        index, count = np.arange(self.due.shape[1]), self.count[worlds]
        later = self.due[worlds] & (index > at[:, None]) & (index < count[:, None])
        return np.where(later.any(axis=1), later.argmax(axis=1), count)


def _pieces(
    frames: Frames, switches: Array, substep: Array, most_steps: int | None
) -> dict[str, Array]:
    """Pieces [k, S] between frames and the times [M] at which grippers switch (infinite: never), of
    equal steps no longer than substeps [k]."""
    inside = switches[np.isfinite(switches)]
    times = np.concatenate([[frames.began], frames.times, inside])
    frame = np.concatenate([[-1], np.arange(len(frames.times)), np.full(len(inside), -1)])
    order = np.lexsort((frame, times))
    times, frame = times[order], frame[order]
    span = np.diff(times)
    moves = (span > 0.0).astype(float)
    n = span / substep[:, None] - 1e-9
    np.maximum(np.ceil(n, out=n), moves, out=n)
    dt = np.divide(span, n, out=np.ones(n.shape), where=moves > 0.0)
    n = n.astype(np.int32)
    # an interval of many steps is several pieces
    most = max(1, int(n.max())) if most_steps is None else most_steps
    parts = np.maximum(1, -(-n.max(axis=0) // most))
    of = np.repeat(np.arange(len(parts)), parts)
    part = np.arange(len(of)) - np.repeat(np.cumsum(parts) - parts, parts)
    part = part.astype(np.int32)
    if len(of) > len(parts):
        n, dt = n[:, of], dt[:, of]
    last, done = part == parts[of] - 1, np.minimum(part * most, n if part.any() else 0)
    return {
        "begins": times[:-1][of],
        "done": done,
        "steps": np.minimum(n - done, most),
        "dt": dt,
        "frame": np.where(last, frame[1:][of], -1).astype(np.int32),
        "due": np.append(False, last & np.isin(times, switches)[1:][of]),
    }


class Run:
    """A schedule on the device and what is recorded, shared by the groups of worlds.

    Args:
        engine: A ``ThinEngine``.
        plan: Schedule; on the CPU the kernels read the same memory.
        frames: Frames to record, if any.
        kept: [S, W, ...] array that receives the states at the start of pieces, if any.
    """

    def __init__(self, engine: Any, plan: Schedule, frames: Frames | None = None, kept: Any = None):
        W, T, device, vec3 = engine.num_worlds, 0, engine.setting.device, engine.types.vec3
        points, nan = np.zeros(0), np.nan
        if frames is not None:
            T, points = len(frames.times), frames.particles
        self.plan, self._engine = plan, engine
        self.on_device = made = engine.types.ThinRun()
        for name in ("begins", "done", "steps", "dt", "before", "frame"):
            own = getattr(plan, name)
            values = (
                np.ascontiguousarray(own) if device.is_cuda else np.require(own, None, ["C", "W"])
            )
            setattr(made, name, wp.array(values, device=device, copy=device.is_cuda))
        shape = (T, W, len(points))
        self.x = made.frames = wp.full(shape, vec3(nan, nan, nan), dtype=vec3, device=device)
        made.points, made.piece = engine.array(points, wp.int32), engine.zeros((W, 2), wp.int32)
        made.stopped = wp.full(W, -1, dtype=wp.int32, device=device)
        made.stopped_at, made.span = engine.zeros(W, wp.float64), engine.zeros(0, wp.float64)
        made.substep = engine.array(engine.setting.substep, wp.float64)
        made.state = engine.state
        made.kept, made.every = (engine.state, -1) if kept is None else (kept, W)
        self._launches: dict[tuple[int, int], Any] = {}

    def launch(self, group: slice) -> None:
        """Take the steps of a group's pieces."""
        e, own, which = self._engine, self._launches, (group.start, group.stop)
        if which not in own:
            given = [e.device_model, e.device_paths, self.on_device]
            if e.interleaved and self.on_device.every < 0:
                kernel, given = e.kernels.advance_interleaved, [group.stop, *given]
            else:
                kernel = e.kernels.advance
            own[which] = e.launch(kernel, group, given, record_cmd=True)
        e.first = None
        own[which].launch()


class Steps:
    """Steps of an engine whose grippers somebody leads: runs of one piece that record nothing.

    5 ms of one rope take 30 us of its own: what a step needs is made once, and written in place.
    """

    def __init__(self, engine: Any):
        W, now, device = engine.num_worlds, engine.now, engine.setting.device
        self.engine, self._whole, self._every = engine, slice(0, W), np.arange(W)
        self._shared = not device.is_cuda
        self._shortest = float(engine.setting.substep.min())
        engine.paths = CommandedPaths(engine.paths, now)
        engine.stacked = engine.paths.arrays
        engine.device_paths = paths_on(device, engine.stacked, engine.real)
        frames = Frames(now, np.full(1, now), np.zeros(0, int), np.empty((1, W, 0, 3)), None, False)
        self._run = Run(engine, Schedule(frames, engine, None))
        self._made = made = self._run.on_device
        made.span = engine.zeros(2, wp.float64)
        put(made.piece, self._whole, np.tile(np.array([0, 1], np.int32), (W, 1)))
        self._span, self._failed, self._least = made.span.numpy(), 0, 0
        self._switched = True
        self._read()

    def _read(self) -> None:
        self._stopped, self._last_dt = self._made.stopped.numpy(), self._made.dt.numpy()[:, 0]

    def take(self, until: float, *, keep_going: bool) -> None:
        """Simulate all worlds to a time [s]; errors as of ``Simulator.step``."""
        e = self.engine
        if self._switched:
            e.switch(self._every, np.full(len(self._every), e.now))
            self._switched = False
        if e.ties is not None and not e.ties.are_safe(e.paths, self._whole):
            going = np.setdiff1d(self._every, list(e.failures))
            times = (np.full(len(going), t) for t in (e.now, until))
            e.failures.update(e.ties.broken(e.paths, going, *times))
        self._ready(until)
        e.in_threads(self._run.launch, self._groups)
        if not self._shared:
            self._read()
        e.used, e.now, e.last_dt = True, until, self._last_dt
        if self._stopped.max() >= 0:
            e.note_stopped(self._made, self._whole)
            e.raise_failures(keep_going=keep_going)

    def lead(self, until: float, position: Array, *more: Any) -> None:
        """Lead grippers to what ``Targets.of`` gives, by a time [s]."""
        e = self.engine
        if e.paths.command(e.now, until, position - e.origin, *more):
            self._switched = True
            e.closed[e.paths.closed & (e.closed == 2)] = 0
        if not self._shared:
            for name in ("time", "position", "orientation", "turn", "hold_from", "hold_until"):
                getattr(e.device_paths, name).assign(np.ascontiguousarray(e.stacked[name]))

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
            put(made.stopped, np.array(list(e.failures)), np.zeros(self._failed, np.int32))
        least = 1 + int(LEAST * self._shortest / ((until - e.now) * e.num_points))
        if least != self._least:
            self._least, self._groups = least, e.groups(e.num_worlds, least)


def put(array: wp.array, rows: slice | NDArray[np.int64], values: Array) -> None:
    """Set rows of an array on its device without writing to others.

    On the CPU, groups of worlds run in separate threads, whose concurrent writes to other rows
    must not be overwritten. On CUDA there is only one group.
    """
    if wp.get_device(array.device).is_cpu:
        array.numpy()[rows] = values  # the array's own memory
    elif array.size:
        every, whole = np.asarray(values), np.arange(len(array))
        if not np.array_equal(whole[rows], whole):
            every = array.numpy()
            every[rows] = values
        array.assign(np.ascontiguousarray(every))
