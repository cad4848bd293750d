"""Sets of demonstrations as LeRobot data sets, format v3.0.

    meta/info.json                            features with names and units, counts, paths
    meta/stats.json                           statistics of every feature over all frames
    meta/tasks.parquet                        the task's name and its number, 0
    meta/episodes/chunk-000/file-000.parquet  one row an episode: where its frames are, statistics
    meta/gendom.json                          dataset.json of the set that it was made from
    data/chunk-000/file-000.parquet           one row a frame

A demonstration becomes an episode of one frame, at time 0: an action is a whole motion, chosen
before it begins, and nothing is observed on the way. Those that failed are left out.

    observation.state  [S] float32: what was reached as the goal, sizes, parameters, in the order of
                       `gendom.reality.envs`; parameters are those of `PARAMETERS`
    action             [A] float32: the task's

All numbers are in SI units, which info.json has as `units` of a feature beside its `names`. A
feature of one number is a plain column, as LeRobot's reader wants it. Beyond what the format asks
for, rows of episodes have `demonstration`, the number in the set, and `outcome/NAME` for whatever
else the task measured.

Source: the documentation of LeRobotDataset v3.0 (huggingface.co/docs/lerobot), and the reader of
lerobot 0.4.4.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gendom.datasets.demonstrations import GOAL, load, read_description, succeeded
from gendom.errors import DatasetError
from gendom.files import atomic_folder, to_json
from gendom.materials import KINDS, PARAMETERS

VERSION = "v3.0"
STATE, ACTION = "observation.state", "action"

EPISODES_PER_FILE = 50_000
"""So that no file exceeds the 100 MB that the format asks for, statistics of episodes included."""

FILES_PER_CHUNK = 1000
QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"


def export_lerobot(folder: str | os.PathLike, out: str | os.PathLike) -> dict[str, Any]:
    """Write a set of demonstrations, as far as it is finished, as a LeRobot data set.

    Args:
        folder: Of the set.
        out: Folder to make; whole or absent.

    Returns:
        The content of info.json.

    Raises:
        DatasetError: The folder holds no set, or one without a usable demonstration.
        GendomError: `out` is there already or cannot be written, or the disk is full.
    """
    where = str(folder)
    about = read_description(folder)
    table = load(folder, part=True)
    quantities = _quantities(about, where)
    names = [name for units in quantities.values() for name in units]
    apart = {*names, "demonstration", "youngs_modulus", "ok", "fault"}
    others = [name for name in table.column_names if name not in apart]
    columns = succeeded(table, ["demonstration", *names, *others], where=where)
    count = len(columns["demonstration"])
    if not count:
        raise DatasetError(
            "holds no demonstration that did not fail",
            where=where,
            fix="simulate more with gendom dataset",
        )
    frames = _frames(columns, quantities, where)
    task = about["task"]["name"]
    info = {
        "codebase_version": VERSION,
        "robot_type": None,
        "total_episodes": count,
        "total_frames": count,
        "total_tasks": 1,
        "chunks_size": FILES_PER_CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": 1,
        "splits": {"train": f"0:{count}"},
        "data_path": f"data/{_FILE}",
        "video_path": None,
        "features": _features(frames, quantities),
    }
    extra = {f"outcome/{name}": pa.array(columns[name]) for name in others}
    extra["demonstration"] = pa.array(columns["demonstration"].astype(np.int64))
    statistics = {feature: _statistics(values) for feature, values in frames.items()}
    with atomic_folder(out) as root:
        meta = root / "meta"
        meta.mkdir()
        for name, content in (("info", info), ("gendom", about), ("stats", statistics)):
            (meta / f"{name}.json").write_text(to_json(content) + "\n", encoding="utf-8")
        pq.write_table(_tasks(task), meta / "tasks.parquet")
        _write(root / "data", pa.table({f: _column(v) for f, v in frames.items()}))
        _write(meta / "episodes", _episodes(frames, task, extra))
    return info


def _frames(
    columns: Mapping[str, NDArray[np.float64]],
    quantities: Mapping[str, Mapping[str, str]],
    where: str,
) -> dict[str, NDArray[Any]]:
    """[N, K] of every feature, one row a frame."""
    frames: dict[str, NDArray[Any]] = {}
    for feature, units in quantities.items():
        frames[feature] = np.stack([columns[name] for name in units], axis=1).astype(np.float32)
        if not np.isfinite(frames[feature]).all():
            raise DatasetError(
                f"{feature} holds numbers that are not finite",
                where=where,
                fix="simulate the demonstrations again",
            )
    number = np.arange(len(frames[ACTION]))[:, None]
    frames["timestamp"] = np.zeros(number.shape, np.float32)
    frames |= {"frame_index": 0 * number, "episode_index": number, "index": number}
    frames["task_index"] = 0 * number
    return frames


def _features(
    frames: Mapping[str, NDArray[Any]], quantities: Mapping[str, Mapping[str, str]]
) -> dict[str, dict[str, Any]]:
    """What info.json says of them."""
    features: dict[str, dict[str, Any]] = {
        feature: {"dtype": str(values.dtype), "shape": [values.shape[1]], "names": None}
        for feature, values in frames.items()
    }
    for feature, units in quantities.items():
        features[feature] |= {"names": list(units), "units": list(units.values())}
    return features


def _quantities(about: Mapping[str, Any], where: str) -> dict[str, dict[str, str]]:
    """Units by column name, for the state and the action."""
    try:
        kind = KINDS[about["kind"]]
        goals = dict(zip(about["goal_names"], about["goal_units"], strict=True))
        actions = dict(zip(about["action_names"], about["action_units"], strict=True))
    except (KeyError, TypeError, ValueError):
        raise DatasetError(
            "does not say what its actions and goals are",
            where=where,
            fix="make it again with this version of gendom dataset",
        ) from None
    state = {GOAL + name: unit for name, unit in goals.items()}
    state |= dict.fromkeys(kind.sizes, "m")
    state |= {parameter.column: parameter.unit for parameter in PARAMETERS.values()}
    return {STATE: state, ACTION: actions}


def _statistics(values: NDArray[Any]) -> dict[str, list[float]]:
    """Of [N, K] over N, as the format names them."""
    x = values.astype(float)
    found = {"min": x.min(axis=0), "max": x.max(axis=0), "mean": x.mean(axis=0)}
    found |= {"std": x.std(axis=0), "count": np.array([len(x)])}
    found |= {_quantile(q): np.quantile(x, q, axis=0) for q in QUANTILES}
    return {name: value.tolist() for name, value in found.items()}


def _quantile(q: float) -> str:
    return f"q{round(100 * q):02d}"


def _tasks(task: str) -> pa.Table:
    """The one task, as pandas reads it: its text is the index."""
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
    frames: Mapping[str, NDArray[Any]], task: str, extra: Mapping[str, pa.Array]
) -> pa.Table:
    """One row an episode; all statistics of its one frame are the frame itself."""
    count = len(frames["index"])
    number = np.arange(count)
    file = number // EPISODES_PER_FILE
    columns: dict[str, Any] = {
        "episode_index": number,
        "tasks": _lists(np.full((count, 1), task)),
        "length": np.ones(count, np.int64),
        "dataset_from_index": number,
        "dataset_to_index": number + 1,
    }
    for what in ("data", "meta/episodes"):
        columns[f"{what}/chunk_index"] = file // FILES_PER_CHUNK
        columns[f"{what}/file_index"] = file % FILES_PER_CHUNK
    for feature, values in frames.items():
        same = _lists(values.astype(float))
        columns |= {f"stats/{feature}/{name}": same for name in ("min", "max", "mean")}
        columns[f"stats/{feature}/std"] = _lists(np.zeros(values.shape))
        columns[f"stats/{feature}/count"] = _lists(np.ones((count, 1), np.int64))
        columns |= {f"stats/{feature}/{_quantile(q)}": same for q in QUANTILES}
    return pa.table(columns | dict(extra))


def _lists(values: NDArray[Any]) -> pa.Array:
    """[N, K] as lists of K."""
    starts = np.arange(len(values) + 1, dtype=np.int32) * values.shape[1]
    return pa.ListArray.from_arrays(pa.array(starts), pa.array(values.ravel().tolist()))


def _column(values: NDArray[Any]) -> pa.Array:
    """[N, K] as lists of the fixed length K, or as plain numbers if K is 1."""
    flat = pa.array(values.ravel())
    return (
        flat if values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    )


def _write(folder: Path, table: pa.Table) -> None:
    """A table of one row an episode, cut into files."""
    for number, first in enumerate(range(0, len(table), EPISODES_PER_FILE)):
        chunk, file = divmod(number, FILES_PER_CHUNK)
        path = folder / _FILE.format(chunk_index=chunk, file_index=file)
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table.slice(first, EPISODES_PER_FILE), path)
