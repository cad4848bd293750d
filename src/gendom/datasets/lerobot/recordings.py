"""Recordings as LeRobot data sets, and back without loss.

A recording becomes an episode of T frames:

    observation.points      [P, 3] float32: the cloud [m], padded with zeros to the P points of
                            the largest frame
    observation.num_points  int64: number of points; the rest is padding
    observation.state       [S] float64: position of each gripper [m], its axis where known, and
                            whether it is closed, where known
    observation.time        float64: the recorded time [s]
    action                  [A] float32: position of each gripper in the next frame [m], and whether
                            it is closed; for LeRobot's own tools, and not read back

LeRobot computes `timestamp` as the frame index over `fps`, so it is correct only for evenly spaced
frames; `observation.time` is always correct. Statistics of points exclude the padding, and are the
same for each of the P rows. meta/gendom.json is the recording's `meta`.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gendom.datasets.lerobot.format import (
    ABOUT,
    ACTION,
    FILE,
    INFO,
    SEAL,
    STATE,
    seal,
    statistics,
    write_lerobot,
)
from gendom.datasets.npz import short
from gendom.datasets.recording_form import RecordingData
from gendom.errors import RecordingError
from gendom.reading import check_unpacked, file_size, read_bytes, read_json

POINTS, NUM_POINTS, TIME = "observation.points", "observation.num_points", "observation.time"


def export_recording(recording: RecordingData, out: str | os.PathLike) -> dict[str, Any]:
    """Write a recording as a LeRobot data set of one episode.

    Args:
        recording: T frames and G grippers.
        out: Folder to create; it is written completely or not at all.

    Returns:
        The content of info.json.

    Raises:
        GendomError: `out` is there already or cannot be written, or the disk is full.
    """
    counts = np.diff(recording.offsets)
    T, G = recording.gripper_position.shape[:2]
    padded = np.zeros((T, int(counts.max()), 3), np.float32)
    padded[np.arange(padded.shape[1]) < counts[:, None]] = recording.points

    def named(what: str, unit: str) -> dict[str, str]:
        """Names and units of three numbers for each gripper."""
        return {f"gripper{g}.{what}.{axis}": unit for g in range(G) for axis in "xyz"}

    places, closed = named("position", "m"), {f"gripper{g}.closed": "1" for g in range(G)}
    state, units = [recording.gripper_position.reshape(T, -1)], places
    if recording.gripper_axis is not None:
        state, units = [*state, recording.gripper_axis.reshape(T, -1)], units | named("axis", "1")
    if recording.gripper_closed is not None:
        state, units = [*state, recording.gripper_closed.astype(float)], units | closed
    following = np.minimum(np.arange(T) + 1, T - 1)
    action = [recording.gripper_position[following].reshape(T, -1), recording.holds[following]]
    frames = {
        POINTS: padded,
        NUM_POINTS: counts.astype(np.int64)[:, None],
        STATE: np.concatenate(state, axis=1),
        TIME: recording.time[:, None],
        ACTION: np.concatenate(action, axis=1).astype(np.float32),
    }
    steps = np.diff(recording.time)
    return write_lerobot(
        out,
        frames,
        np.array([T]),
        task=f"move a {recording.object.kind} that is held by: {recording.object.grasp}",
        units={STATE: units, TIME: {"time": "s"}, ACTION: {**places, **closed}},
        about=recording.meta(),
        fps=max(1, round(1.0 / float(np.median(steps)))) if len(steps) else 1,
        of_all={POINTS: _of_points(recording.points, T, padded.shape[1])},
    )


def _of_points(points: NDArray[np.float32], T: int, P: int) -> dict[str, Any]:
    """Statistics of x, y and z, repeated for each of P rows."""
    found = statistics(points)
    alike = {n: [values] * P for n, values in found.items() if n != "count"}
    return {**alike, "count": [T]}


def _read_table(path: Path) -> pa.Table:
    """The table of a file that does not unpack to too much."""
    size = file_size(path, RecordingError, missing="is incomplete or damaged (no such file)")
    # not by its name, which may hold a colon or be no UTF-8
    with open(path, "rb") as data, pq.ParquetFile(data) as file:
        groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
        numbers = sum(g.column(k).num_values for g in groups for k in range(g.num_columns))
        check_unpacked(8 * numbers, size, str(path), RecordingError)
        return file.read()


def read_lerobot(folder: str | os.PathLike) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read the arrays and meta of a recording from a LeRobot data set.

    Args:
        folder: Folder written by `export_recording`.

    Returns:
        Arrays by their names in a recording's file, and its `meta`.

    Raises:
        RecordingError: The data set was not made from a recording, or is incomplete or damaged.
    """
    folder = Path(folder)

    def fault(what: str, fix: str = "export it again") -> RecordingError:
        return RecordingError(what, where=str(folder), fix=fix)

    if not (folder / ABOUT).is_file():
        what = "is a LeRobot data set that was not made of a recording"
        raise fault(what, "give one that gendom export wrote: others lack the object's sizes")
    # before anything else: of damaged files pyarrow may end the process
    stated = read_bytes(folder / SEAL, RecordingError, fix="export it again with this version")
    if stated.decode("latin-1").strip() != seal(folder):
        raise fault("is damaged: its files are not those that were written")
    info, meta = (read_json(folder / name, RecordingError) for name in (INFO, ABOUT))
    if not str(meta.get("format")).startswith("gendom-recording/"):
        raise fault("holds demonstrations, not a recording", "train a policy on them")
    if info.get("total_episodes") != 1:
        raise fault(f"has {info.get('total_episodes')} episodes, not one")
    try:
        names = info["features"][STATE]["names"]
        table = _read_table(folder / "data" / FILE)
        counts, state = table[NUM_POINTS].to_numpy(), np.array(table[STATE].to_pylist(), float)
        time, order = table[TIME].to_numpy(), table["frame_index"].to_numpy()
        flat = table[POINTS].combine_chunks().flatten().flatten().to_numpy(zero_copy_only=False)
        padded = np.asarray(flat, dtype=np.float32).reshape(len(table), -1, 3)
    except (OSError, KeyError, TypeError, ValueError, pa.ArrowException) as error:
        raise fault(f"is incomplete or damaged ({short(error)})") from None
    if len(table) != info.get("total_frames") or (order != np.arange(len(table))).any():
        raise fault(f"has not the {info.get('total_frames')} frames in order that are announced")
    if state.ndim != 2 or state.shape[1] != len(names):
        raise fault(f"{STATE} has shape {list(state.shape)} for {len(names)} names")
    if (counts < 0).any() or (counts > padded.shape[1]).any():
        raise fault(f"{NUM_POINTS} is {counts.max()} of {padded.shape[1]} points")

    arrays = {
        "points": padded[np.arange(padded.shape[1]) < counts[:, None]],
        "offsets": np.concatenate([[0], np.cumsum(counts)]),
        "time": time,
    }
    for what, width in (("position", 3), ("axis", 3), ("closed", 1)):
        own = [n for n, name in enumerate(names) if f".{what}" in name]
        if own:
            values = state[:, own].reshape(len(table), -1, width)
            arrays[f"gripper_{what}"] = values if width == 3 else values[..., 0] == 1.0
    if "gripper_position" not in arrays:
        raise fault(f"{STATE} has no positions of grippers")
    return arrays, meta
