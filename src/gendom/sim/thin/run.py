"""Parts of a run of a thin engine, and how worlds' rows are written."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.paths import Pose
from gendom.sim.setting import Frames
from gendom.sim.thin.grips import Grip
from gendom.sim.thin.schedule import Schedule


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


@dataclass
class Held:
    """What grippers hold in a group of worlds."""

    holds: NDArray[np.int32]
    """[W, G, n] see ``Grip.holds``."""
    stiffer: NDArray[np.float64]
    """[W, G, M, n] see ``Grip.stiffer``."""
    place: NDArray[np.floating]
    """[W G, 7, P] see ``Grip.place``."""


@dataclass
class Run:
    """Arrays of one run on the device, shared by the groups of worlds."""

    plan: Schedule
    frames: Frames
    on_device: Any
    pieces: wp.array
    stopped: wp.array
    stopped_at: wp.array
    points: wp.array
    x: wp.array
    kept: wp.array
    every: int
    launches: dict[int, Any] = field(default_factory=dict)
    """By the first world of a group."""


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
    if wp.get_device(array.device).is_cpu:
        array.numpy()[rows] = values
    elif rows.stop > rows.start and values.size:
        sent = wp.array(np.ascontiguousarray(values), dtype=array.dtype, device="cpu")
        wp.copy(array, sent, dest_offset=rows.start * (array.size // len(array)), count=sent.size)
