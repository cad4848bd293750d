"""Demonstrations and recordings as LeRobot data sets, format v3.0; recordings come back whole.

Features and files are those of docs/data.md. Numbers are in SI units, stored in info.json as
`units` of a feature beside its `names`. A feature of one number is a plain column, as LeRobot's
reader requires; the P points of a frame are padded with zeros, which statistics leave out.

What cameras saw (`export_pictures`) becomes an episode with the last three of these, and

    observation.images.NAME [height, width, 3] colour, where a camera gives it, as PNG
    observation.depth.NAME  [height, width, 1] depth [mm] as 16 bit PNG, LeRobot's `is_depth_map`

LeRobot computes `timestamp` as the frame index over `fps`, so it is correct only for evenly spaced
frames; `observation.time` is always correct.

Source: the documentation of LeRobotDataset v3.0 (huggingface.co/docs/lerobot), and the reader of
lerobot 0.4.4.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from PIL import Image

from gendom.arguments import require
from gendom.arrays import Array
from gendom.datasets.demonstrations import GOAL, load, read_description, succeeded, write_parquet
from gendom.datasets.npz import short
from gendom.datasets.recording_form import RecordingData
from gendom.errors import DatasetError, RecordingError
from gendom.files import atomic_folder, to_json
from gendom.materials import KINDS, QUANTITIES
from gendom.reading import check_unpacked, file_size, read_bytes, read_json

VERSION = "v3.0"
STATE, ACTION = "observation.state", "action"
INFO, ABOUT = Path("meta/info.json"), Path("meta/gendom.json")
SEAL = Path("meta/gendom.sha256")

QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
FILE = Path("chunk-000/file-000.parquet")
"""Of all frames, and of all episodes."""

_NAMED = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

POINTS, NUM_POINTS, TIME = "observation.points", "observation.num_points", "observation.time"

Units = Mapping[str, Mapping[str, str]]
"""Units by the names of its numbers, for each feature with units."""


# ---- demonstrations ----------------------------------------------------------------------------


def export_demonstrations(folder: str | os.PathLike, out: str | os.PathLike) -> dict[str, Any]:
    """Write the finished part of a folder of demonstrations into a new folder, completely or not at
    all, and return the content of info.json.

    Raises:
        DatasetError: The folder holds no set, or one without a usable demonstration.
        GendomError: `out` is there already or cannot be written, or the disk is full.
    """
    where = str(folder)
    about = read_description(folder)
    table = load(folder, part=True)
    quantities = _quantities(about, where)
    names = [name for units in quantities.values() for name in units]
    apart = {*names, "demonstration", "E", "ok", "fault"}
    others = [name for name in table.column_names if name not in apart]
    columns = succeeded(table, ["demonstration", *names, *others], where=where)
    count, fix = len(columns["demonstration"]), "simulate more with gendom dataset"
    what = "holds no demonstration that did not fail"
    require(count, what, where=where, fix=fix, error=DatasetError)
    frames = {}
    for feature, units in quantities.items():
        values = np.stack([columns[name] for name in units], axis=1).astype(np.float32)
        what, fix = f"{feature} holds numbers that are not finite", "simulate the set again"
        require(np.isfinite(values).all(), what, where=where, fix=fix, error=DatasetError)
        frames[feature] = values
    extra = {f"outcome/{name}": pa.array(columns[name]) for name in others}
    extra["demonstration"] = pa.array(columns["demonstration"].astype(np.int64))
    lengths, task = np.ones(count, np.int64), about["task"]["name"]
    return _write(out, frames, lengths, task=task, units=quantities, about=about, extra=extra)


def _quantities(about: Mapping[str, Any], where: str) -> dict[str, dict[str, str]]:
    """Units by column name, for the state and the action."""
    try:
        kind = KINDS[about["kind"]]
        goals = dict(zip(about["goal_names"], about["goal_units"], strict=True))
        actions = dict(zip(about["action_names"], about["action_units"], strict=True))
    except (KeyError, TypeError, ValueError):
        what = "does not say what its actions and goals are"
        fix = "make it again with this version of gendom dataset"
        raise DatasetError(what, where=where, fix=fix) from None
    state = {GOAL + name: unit for name, unit in goals.items()}
    state |= dict.fromkeys(kind.sizes, "m")
    state |= {name: quantity.unit for name, quantity in QUANTITIES.items()}
    return {STATE: state, ACTION: actions}


# ---- recordings --------------------------------------------------------------------------------


def export_recording(recording: RecordingData, out: str | os.PathLike) -> dict[str, Any]:
    """Write a recording into a new folder, completely or not at all, and return the content of
    info.json.

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
    action = _following(recording.gripper_position.reshape(T, -1), recording.holds)
    frames = {
        POINTS: padded,
        NUM_POINTS: counts.astype(np.int64)[:, None],
        STATE: np.concatenate(state, axis=1),
        TIME: recording.time[:, None],
        ACTION: action,
    }
    found = _statistics(recording.points).items()
    alike = {name: [values] * padded.shape[1] for name, values in found if name != "count"}
    return _write(
        out,
        frames,
        np.array([T]),
        task=f"move a {recording.object.kind} that is held by: {recording.object.grasp}",
        units={STATE: units, TIME: {"time": "s"}, ACTION: {**places, **closed}},
        about=recording.meta(),
        fps=_rate(recording.time),
        of_all={POINTS: {**alike, "count": [T]}},
    )


def export_pictures(
    pictures: Mapping[str, Sequence[Array]],
    time: Array,
    position: Array,
    out: str | os.PathLike,
    *,
    task: str,
    about: Mapping[str, Any],
) -> dict[str, Any]:
    """Write what cameras saw of a lift into a new folder, completely or not at all.

    Args:
        pictures: T pictures of each camera, by the feature's name: [height, width, 3] uint8 colour
            or [height, width] uint16 depth [mm].
        time: [T] [s].
        position: [T, G, 3] where the grippers hold the object [m].
        out: The folder.
        task: What is done.
        about: Content of meta/gendom.json.

    Returns:
        The content of info.json.

    Raises:
        GendomError: `out` is there already or cannot be written, or the disk is full.
    """
    T, G = position.shape[:2]
    places = {f"gripper{g}.position.{axis}": "m" for g in range(G) for axis in "xyz"}
    at = position.reshape(T, -1)
    return _write(
        out,
        {STATE: at, TIME: time[:, None], ACTION: _following(at)},
        np.array([T]),
        task=task,
        units={STATE: places, TIME: {"time": "s"}, ACTION: places},
        about=about,
        fps=_rate(time),
        pictures=pictures,
    )


def _following(*columns: Array) -> Array:
    """What the next frame's columns are, in the last one its own."""
    return np.concatenate(
        [np.vstack([of[1:], of[-1:]]) for of in columns], axis=1, dtype=np.float32
    )


def _rate(time: Array) -> int:
    """Frames a second."""
    return max(1, round(1.0 / float(np.median(np.diff(time))))) if len(time) > 1 else 1


def _read_table(path: Path) -> pa.Table:
    """The table of a file that does not unpack to too much."""
    size = file_size(path, RecordingError, missing="is incomplete or damaged (no such file)")
    # not by its name, which may hold a colon or be no UTF-8
    with open(path, "rb") as data, pq.ParquetFile(data) as file:
        groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
        numbers = sum(g.column(k).num_values for g in groups for k in range(g.num_columns))
        check_unpacked(8 * numbers, size, str(path), RecordingError)
        return file.read()


def read_lerobot(folder: str | os.PathLike) -> tuple[dict[str, Array], dict[str, Any]]:
    """Arrays by their names in a recording's file, and its `meta`, of what `export_recording` made.

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
    try:
        names = info["features"][STATE]["names"]
        table = _read_table(folder / "data" / FILE)
        counts, state = table[NUM_POINTS].to_numpy(), np.array(table[STATE].to_pylist(), float)
        flat = table[POINTS].combine_chunks().flatten().flatten().to_numpy(zero_copy_only=False)
        padded = np.asarray(flat, dtype=np.float32).reshape(len(table), -1, 3)
        arrays = {
            "points": padded[np.arange(padded.shape[1]) < counts[:, None]],
            "offsets": np.concatenate([[0], np.cumsum(counts)]),
            "time": table[TIME].to_numpy(),
        }
        for what, width in (("position", 3), ("axis", 3), ("closed", 1)):
            own = [n for n, name in enumerate(names) if f".{what}" in name]
            if own:
                values = state[:, own].reshape(len(table), -1, width)
                arrays[f"gripper_{what}"] = values if width == 3 else values[..., 0] == 1.0
    except (OSError, LookupError, TypeError, ValueError, pa.ArrowException) as error:
        raise fault(f"is incomplete or damaged ({short(error)})") from None
    return arrays, meta


# ---- the format --------------------------------------------------------------------------------


def _write(
    out: str | os.PathLike,
    frames: Mapping[str, Array],
    lengths: NDArray[np.integer],
    *,
    task: str,
    units: Units,
    about: Mapping[str, Any],
    fps: int = 1,
    of_all: Mapping[str, Mapping[str, Any]] | None = None,
    extra: Mapping[str, pa.Array] | None = None,
    pictures: Mapping[str, Sequence[Array]] | None = None,
) -> dict[str, Any]:
    """Write values [N, ...] of each feature, one row a frame, episode after episode, into a new
    folder, completely or not at all, and return the content of info.json.

    Args:
        lengths: [E] number of frames of each episode; all 1 where there are several.
        about: Content of meta/gendom.json.
        of_all: Statistics of all frames, for features with padded rows.
        extra: [E] further columns of the episodes.
        pictures: N pictures by feature, as of `export_pictures`.
    """
    count, frames = len(lengths), {**frames, **_counted(lengths, fps)}
    found = {feature: _statistics(values) for feature, values in frames.items()}
    found |= dict(of_all or {})
    features, columns = _features(frames, units), {n: _column(x) for n, x in frames.items()}
    for feature, of in (pictures or {}).items():
        features[feature], columns[feature], found[feature] = _pictures(of)
    info = {
        "codebase_version": VERSION,
        "robot_type": None,
        "total_episodes": count,
        "total_frames": int(lengths.sum()),
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{count}"},
        "data_path": f"data/{_NAMED}",
        "video_path": None,
        "features": features,
    }
    tables = {
        Path("meta/tasks.parquet"): _tasks(task),
        "meta/episodes" / FILE: _episodes(lengths, task, extra or {}),
        "data" / FILE: pa.table(columns),
    }
    with atomic_folder(out) as root:
        for path, table in tables.items():
            (root / path).parent.mkdir(parents=True, exist_ok=True)
            write_parquet(table, root / path)
        for name, content in (("info", info), ("gendom", about), ("stats", found)):
            (root / f"meta/{name}.json").write_text(to_json(content) + "\n", encoding="utf-8")
        (root / SEAL).write_text(seal(root) + "\n", encoding="ascii")
    return info


def seal(root: Path) -> str:
    """SHA-256 of what is read of a data set: Parquet has no checksums."""
    found = hashlib.sha256()
    for path in (root / INFO, root / ABOUT, *sorted((root / "data").rglob("*.parquet"))):
        file_size(path)
        with open(path, "rb") as file:
            found.update(hashlib.file_digest(file, "sha256").digest())
    return found.hexdigest()


def _counted(lengths: NDArray[np.integer], fps: int) -> dict[str, Array]:
    """Features with frame indices and time stamps, [N, 1] each."""
    starts = np.repeat(np.cumsum(lengths) - lengths, lengths)
    number = np.arange(int(lengths.sum()))
    within = (number - starts)[:, None]
    return {
        "timestamp": (within / fps).astype(np.float32),
        "frame_index": within,
        "episode_index": np.repeat(np.arange(len(lengths)), lengths)[:, None],
        "index": number[:, None],
        "task_index": 0 * within,
    }


def _features(frames: Mapping[str, Array], units: Units) -> dict[str, dict[str, Any]]:
    """Entries of info.json for the features."""
    features: dict[str, dict[str, Any]] = {
        feature: {"dtype": str(values.dtype), "shape": list(values.shape[1:]), "names": None}
        for feature, values in frames.items()
    }
    for feature, of in units.items():
        features[feature] |= {"names": list(of), "units": list(of.values())}
    return features


def _pictures(of: Sequence[Array]) -> tuple[dict[str, Any], pa.Array, dict[str, Any]]:
    """The feature, its column and statistics of pictures; colours count from 0 to 1."""
    depth, encoded = of[0].ndim == 2, []
    for picture in of:
        file = io.BytesIO()
        Image.fromarray(picture).save(file, "PNG")
        encoded.append(file.getvalue())
    column = pa.StructArray.from_arrays(
        [pa.array(encoded), pa.nulls(len(of), pa.string())], ["bytes", "path"]
    )
    shape = [*of[0].shape[:2], 1 if depth else 3]
    info = {"is_depth_map": True, "depth_unit": "mm"} if depth else None
    feature = {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"]}
    some = np.stack([x[::8, ::8] for x in of]).reshape(-1, shape[2]) / (1.0 if depth else 255.0)
    statistics = _statistics(some).items()
    found: dict[str, Any] = {n: np.reshape(v, (-1, 1, 1)).tolist() for n, v in statistics}
    found["count"] = [len(of)]
    return feature | {"info": info}, column, found


def _statistics(values: Array) -> dict[str, list[Any]]:
    """Statistics of [N, ...] over N, under the format's names."""
    x = values.astype(float)
    found = {"min": x.min(axis=0), "max": x.max(axis=0), "mean": x.mean(axis=0)}
    found |= {"std": x.std(axis=0), "count": np.array([len(x)])}
    found |= {f"q{100 * q:02.0f}": np.quantile(x, q, axis=0) for q in QUANTILES}
    return {name: value.tolist() for name, value in found.items()}


def _tasks(task: str) -> pa.Table:
    """Table of the single task; its text is the index, as pandas stores it."""
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    about = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {"name": n, "field_name": n, "pandas_type": p, "numpy_type": t, "metadata": None}
            for n, (p, t) in kinds.items()
        ],
    }
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": [task]})
    return table.replace_schema_metadata({"pandas": json.dumps(about)})


def _episodes(lengths: NDArray[np.integer], task: str, extra: Mapping[str, pa.Array]) -> pa.Table:
    """Table with one row for each episode."""
    count, ends = len(lengths), np.cumsum(lengths)
    columns: dict[str, Any] = {
        "episode_index": np.arange(count),
        "tasks": [[task]] * count,
        "length": lengths,
        "dataset_from_index": ends - lengths,
        "dataset_to_index": ends,
    }
    for what in ("data", "meta/episodes"):
        columns |= dict.fromkeys(
            (f"{what}/chunk_index", f"{what}/file_index"), np.zeros(count, int)
        )
    return pa.table(columns | dict(extra))


def _column(values: Array) -> pa.Array:
    """[N, K] as lists of the fixed length K, or as plain numbers if K is 1; [N, K, L] as lists of
    lists."""
    flat = pa.array(values.ravel())
    if values.ndim == 2:
        K = values.shape[1]
        return flat if K == 1 else pa.FixedSizeListArray.from_arrays(flat, K)
    for n in values.shape[:0:-1]:
        flat = pa.ListArray.from_arrays(pa.array(np.arange(0, len(flat) + 1, n), pa.int32()), flat)
    return flat
