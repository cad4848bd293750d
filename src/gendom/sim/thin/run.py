"""A run of a thin engine: its events, its arrays, what it records, and what ends it."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.setting import Frames
from gendom.sim.thin.contact import PAIRS
from gendom.sim.thin.grips import Grip
from gendom.sim.thin.poses import Pose
from gendom.sim.thin.schedule import Schedule
from gendom.sim.thin.tears import tear_error


@dataclass
class Event:
    """The closing or opening of one gripper in some worlds."""

    g: int
    closes: bool
    worlds: NDArray[np.int64]
    """[k] indices of the worlds."""
    time: NDArray[np.float64]
    """[k] times of the event [s]."""
    pose: Pose
    grip: Grip
    x: NDArray[np.float64]
    """[k, n, 3] points at that time [m]."""


@dataclass
class Round:
    """The part of a group's run between two gripper events."""

    events: list[Event]
    pieces: NDArray[np.int32]
    """[W, 2] indices of the first piece and of the one after the last."""
    held: tuple[NDArray[Any], ...] = ()
    """Points held by grippers in this part, for the reverse pass."""
    steps: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 2), dtype=np.int32))
    """[W, 2] first and last records of implicit steps."""


class Job:
    """Arrays of one run, shared by the groups of worlds."""

    def __init__(self, engine: Any, plan: Schedule, frames: Frames, kept: Any):
        self.engine, self.plan, self.frames = engine, plan, frames
        e, t = engine, engine.types
        self.on_device = device_plan(e, plan)
        self.pieces = e.zeros((e.num_worlds, 2), wp.int32)
        self.stopped = wp.full(e.num_worlds, -1, dtype=wp.int32, device=e.setting.device)
        self.stopped_at = e.zeros(e.num_worlds, wp.float64)
        self.points = e.array(frames.particles, wp.int32)
        shape = (len(frames.times), e.num_worlds, len(frames.particles))
        self.x = wp.full(
            shape, t.vec3(np.nan, np.nan, np.nan), dtype=t.vec3, device=e.setting.device
        )
        self.kept, self.every = (e.kept_state, 0) if kept is None else (kept, e.num_worlds)

    def advance(self, group: slice, round: Round) -> None:
        e, plan = self.engine, self.plan
        pieces = round.pieces.copy()
        for w in list(e.failures):
            if group.start <= w < group.stop:
                pieces[w - group.start, 1] = pieces[w - group.start, 0]
        put(self.pieces, group, pieces)
        e.advance(self, group)
        stopped, stopped_at = self.stopped.numpy(), self.stopped_at.numpy()
        for w in (int(k) for k in np.flatnonzero(stopped >= 0) if group.start <= k < group.stop):
            if w in e.failures:
                continue
            s = int(stopped[w])
            begin = plan.time(w, s)
            e.kept_time[w] = begin
            if e.setting.self_contact and e.body.near_count.numpy()[w].sum() > e.body.near.shape[1]:
                e.failures[w] = e.setting.error(
                    w,
                    float(begin),
                    f"more than {PAIRS} pairs a point are about to meet",
                    where="contact of the body with itself",
                    fix="fewer points, or a thinner body",
                )
                continue
            if w in e.torn and stopped_at[w] > e.torn[w].time:
                e.failures[w] = tear_error(e, w)
                continue
            e.failures[w] = e.end_error(w, float(stopped_at[w]), float(plan.dt[w, s]))

    def finish(self) -> None:
        e = self.engine
        x = self.x.numpy().reshape(self.frames.x.shape)
        self.frames.x[...] = x + e.origin.astype(e.setting.dtype)
        alive = [w for w in range(e.num_worlds) if w not in e.failures]
        e.kept_time[alive] = self.plan.time(alive, self.plan.count[alive] - 1)


def device_plan(engine: Any, plan: Schedule, *, record: bool = True) -> Any:
    """Convert a schedule to the kernels' struct."""
    on_device = engine.types.Plan()
    on_device.begins = engine.array(plan.begins, wp.float64)
    on_device.done = engine.array(plan.done, wp.int32)
    on_device.steps = engine.array(plan.steps, wp.int32)
    on_device.dt = engine.array(plan.dt, wp.float64)
    on_device.before = engine.array(plan.before, wp.float64)
    on_device.frame = engine.array(plan.frame if record else 0 * plan.frame - 1, wp.int32)
    return on_device


def put_worlds(array: wp.array, worlds: NDArray[np.int64], values: NDArray[Any]) -> None:
    """Set rows [k] of an array on its device without writing to other rows.

    On the CPU, groups of worlds run in separate threads, whose concurrent writes to other rows
    must not be overwritten. On CUDA there is only one group.
    """
    if wp.get_device(array.device).is_cpu:
        array.numpy()[worlds] = values  # the array's own memory
        return
    if np.array_equal(worlds, np.arange(len(array))):
        array.assign(np.ascontiguousarray(values))
        return
    rows = array.numpy()
    rows[worlds] = values
    array.assign(rows)


def put(array: wp.array, rows: slice, values: NDArray[Any]) -> None:
    """Set rows of an array on its device."""
    if rows.stop > rows.start and values.size:
        sent = wp.array(np.ascontiguousarray(values), dtype=array.dtype, device="cpu")
        wp.copy(array, sent, dest_offset=rows.start * (array.size // len(array)), count=sent.size)
