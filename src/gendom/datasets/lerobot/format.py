"""LeRobot data sets, format v3.0: writing of one episode, or of many of one frame each.

    meta/info.json                            features with names and units, counts, paths
    meta/stats.json                           statistics of every feature over all frames
    meta/tasks.parquet                        the task's name and its number, 0
    meta/episodes/chunk-000/file-000.parquet  one row an episode: where its frames are, statistics
    meta/gendom.json                          what the data set was made from
    data/chunk-000/file-000.parquet           one row a frame

All numbers are in SI units, stored in info.json as `units` of a feature beside its `names`. A
feature of one number is a plain column, as LeRobot's reader requires.

Source: the documentation of LeRobotDataset v3.0 (huggingface.co/docs/lerobot), and the reader of
lerobot 0.4.4.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from gendom.datasets.demonstrations import write_parquet
from gendom.files import atomic_folder, to_json
from gendom.reading import file_size

VERSION = "v3.0"
STATE, ACTION = "observation.state", "action"
INFO, ABOUT = Path("meta/info.json"), Path("meta/gendom.json")
SEAL = Path("meta/gendom.sha256")

QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
FILE = Path("chunk-000/file-000.parquet")
"""Of all frames, and of all episodes."""

_NAMED = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

Units = Mapping[str, Mapping[str, str]]
"""Units by the names of its numbers, for each feature with units."""


def write_lerobot(
    out: str | os.PathLike,
    frames: Mapping[str, NDArray[Any]],
    lengths: NDArray[np.integer],
    *,
    task: str,
    units: Units,
    about: Mapping[str, Any],
    fps: int = 1,
    of_all: Mapping[str, Mapping[str, Any]] | None = None,
    extra: Mapping[str, pa.Array] | None = None,
) -> dict[str, Any]:
    """Write a data set.

    Args:
        out: Folder to create; it is written completely or not at all.
        frames: [N, ...] values of each feature, one row for each frame, episode after episode;
            frame indices and time stamps are added.
        lengths: [E] number of frames of each episode; all 1 where there are several.
        task: Description of the task, the same for all episodes.
        units: Units of features.
        about: Content of meta/gendom.json.
        fps: Frames a second, for time stamps.
        of_all: Statistics of all frames, for features with padded rows.
        extra: [E] further columns of the episodes.

    Returns:
        The content of info.json.

    Raises:
        GendomError: `out` is there already or cannot be written, or the disk is full.
    """
    count, frames = len(lengths), {**frames, **_counted(lengths, fps)}
    found = {feature: statistics(values) for feature, values in frames.items()}
    found |= dict(of_all or {})
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
        "features": _features(frames, units),
    }
    tables = {
        Path("meta/tasks.parquet"): _tasks(task),
        "meta/episodes" / FILE: _episodes(frames, lengths, task, found, extra or {}),
        "data" / FILE: pa.table({name: _column(values) for name, values in frames.items()}),
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


def _counted(lengths: NDArray[np.integer], fps: int) -> dict[str, NDArray[Any]]:
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


def _features(frames: Mapping[str, NDArray[Any]], units: Units) -> dict[str, dict[str, Any]]:
    """Entries of info.json for the features."""
    features: dict[str, dict[str, Any]] = {
        feature: {"dtype": str(values.dtype), "shape": list(values.shape[1:]), "names": None}
        for feature, values in frames.items()
    }
    for feature, of in units.items():
        features[feature] |= {"names": list(of), "units": list(of.values())}
    return features


def statistics(values: NDArray[Any]) -> dict[str, list[Any]]:
    """Statistics of [N, ...] over N, under the format's names."""
    x = values.astype(float)
    found = {"min": x.min(axis=0), "max": x.max(axis=0), "mean": x.mean(axis=0)}
    found |= {"std": x.std(axis=0), "count": np.array([len(x)])}
    found |= {_quantile(q): np.quantile(x, q, axis=0) for q in QUANTILES}
    return {name: value.tolist() for name, value in found.items()}


def _quantile(q: float) -> str:
    return f"q{round(100 * q):02d}"


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


def _episodes(
    frames: Mapping[str, NDArray[Any]],
    lengths: NDArray[np.integer],
    task: str,
    whole: Mapping[str, Mapping[str, Any]],
    extra: Mapping[str, pa.Array],
) -> pa.Table:
    """Table with one row for each episode."""
    count, ends = len(lengths), np.cumsum(lengths)
    columns: dict[str, Any] = {
        "episode_index": np.arange(count),
        "tasks": _lists(np.full((count, 1), task)),
        "length": lengths,
        "dataset_from_index": ends - lengths,
        "dataset_to_index": ends,
    }
    for what in ("data", "meta/episodes"):
        columns |= {
            f"{what}/{name}": np.zeros(count, int) for name in ("chunk_index", "file_index")
        }
    for feature, values in frames.items():
        for name, rows in _by_episode(values, count, whole[feature]).items():
            columns[f"stats/{feature}/{name}"] = _lists(rows)
    return pa.table(columns | dict(extra))


def _by_episode(
    values: NDArray[Any], count: int, whole: Mapping[str, Any]
) -> dict[str, NDArray[Any]]:
    """Statistics [E, ...] of the only episode, or of many of one frame, which are its values."""
    if count == 1:
        return {name: np.array(found)[None] for name, found in whole.items()}
    x = values.astype(float)
    found = {name: x for name in ("min", "max", "mean")} | {"std": np.zeros(x.shape)}
    found |= {"count": np.ones((len(x), 1), np.int64)}
    return found | {_quantile(q): x for q in QUANTILES}


def _lists(values: NDArray[Any]) -> pa.Array:
    """[N, K, ...] as lists of K, of lists and so on."""
    if values.ndim == 1:
        return pa.array(values.tolist()) if values.dtype.kind == "U" else pa.array(values)
    starts = np.arange(len(values) + 1, dtype=np.int32) * values.shape[1]
    return pa.ListArray.from_arrays(pa.array(starts), _lists(values.reshape(-1, *values.shape[2:])))


def _column(values: NDArray[Any]) -> pa.Array:
    """[N, K] as lists of the fixed length K, or as plain numbers if K is 1; [N, K, L] as lists of
    lists."""
    if values.ndim > 2:
        return _lists(values)
    flat, K = pa.array(values.ravel()), values.shape[1]
    return flat if K == 1 else pa.FixedSizeListArray.from_arrays(flat, K)
