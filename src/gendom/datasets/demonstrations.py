"""Sets of simulated demonstrations: a folder of Parquet shards.

    dataset.json         format, task with its settings, size, seed, shard_size, dtype, device,
                         parameter ranges, gendom version
    shard-00000.parquet  demonstrations 0 to shard_size - 1, one row each
    shard-00001.parquet  ...

Columns are `demonstration` (its number, int64), the numbers that the task drew (actions,
parameters, sizes) and measured (`goal_x`, ...; null where the simulation failed), `ok`, and
`fault`, what went wrong (null where nothing did).

Demonstration i is drawn from `numpy.random.default_rng([seed, i])` and depends on nothing else:
shards can be simulated in any order, on any machine, and a set can be continued or extended.
"""

from __future__ import annotations

import functools
import json
import logging
import os
import queue
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gendom import __version__
from gendom.errors import DatasetError, ParameterError
from gendom.files import atomic_path, read_json, write_json

if TYPE_CHECKING:
    from gendom.tasks import Task

FORMAT = "gendom-demonstrations/1"

_DESCRIPTION = "dataset.json"
_METADATA = b"gendom"  # key of the set's identity in the metadata of a shard

_log = logging.getLogger(__name__)


SHARD_SIZE = {"cpu": 256, "cuda": 4096}
"""Default numbers of demonstrations in a shard."""

AHEAD = 2
"""Parts of a set that a GPU has at once: one is made ready while the other is simulated."""

FEWEST_TOGETHER = 1024
"""Demonstrations that make good use of a GPU; where there are several, none gets fewer."""

TURNS = 8
"""Parts that each of several devices should get, lest one waits long for another in the end."""


def generate(
    task: Task,
    size: int,
    out: str | os.PathLike,
    *,
    seed: int,
    device: str = "cpu",
    dtype: str = "float32",
    shard_size: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pa.Table:
    """Simulate a set of demonstrations, or what is missing of one, and load it.

    Shards are written whole or not at all, so an interrupted set goes on where it stopped. A
    larger `size` extends a set. A demonstration that diverges is kept with `ok` false.

    Args:
        task: What is demonstrated.
        size: Number of demonstrations.
        out: Folder of the set; made if it is missing.
        seed: Seed of all draws, 0 or more.
        device: ``cpu``, ``cuda`` or ``cuda:0`` and so on; several with commas between them, or
            ``all`` GPUs. On one GPU a shard is handed to the task at once.
        dtype: ``float32`` or ``float64``.
        shard_size: Demonstrations in a shard (default: ``SHARD_SIZE`` of the device).
        progress: Called with the number of demonstrations done, those already there included,
            and `size`.

    Returns:
        As `load`.

    Raises:
        DatasetError: The folder holds a set with other settings, or a larger one.
        ParameterError: A number is out of range.
        DeviceError: The device is not there.
    """
    kind = device_kind(device)
    if shard_size is None:
        shard_size = SHARD_SIZE[kind]
    for name, value, least in [("size", size, 1), ("shard_size", shard_size, 1), ("seed", seed, 0)]:
        if value < least:
            raise ParameterError(f"is {value}", where=name, fix=f"give {least} or more")
    folder = Path(out)
    description = _describe(task, size, seed, kind, dtype, shard_size)
    _check_same(folder, description)
    identity = _identity(description)
    report = progress or (lambda done, total: None)

    kept: list[pa.Table | None] = []
    for number in range(_count_shards(size, shard_size)):
        try:
            kept.append(_read_shard(_shard_path(folder, number), number, identity))
        except FileNotFoundError:
            kept.append(None)
        except DatasetError as error:
            _log.warning("%s: %s; simulating it again", error.where, error.what)
            kept.append(None)
    done = sum(len(rows) for rows in kept if rows is not None)
    report(done, size)

    if done == size:
        return load(folder)
    devices = [device]
    if device == "all" or "," in device:
        from gendom.sim import list_devices  # Warp: a task that needs it imports it itself

        devices = list_devices(device)
    parts: dict[int, list[pa.Table]] = {}  # by shard
    jobs: list[range] = []
    together = _count_together(kind, shard_size, size - done, len(devices))
    for number, rows in enumerate(kept):
        # a set that is extended may end in a shard that is not full
        first, end = number * shard_size, min((number + 1) * shard_size, size)
        begin = first + (len(rows) if rows is not None else 0)
        if begin < end:
            parts[number] = [rows] if rows is not None else []
            jobs += [range(i, min(i + together, end)) for i in range(begin, end, together)]

    simulate = functools.partial(_simulate, task, seed=seed, dtype=dtype)
    for job, rows in _on_devices(simulate, jobs, devices):
        number = job.start // shard_size
        parts[number].append(rows)
        done += len(job)
        report(done, size)
        if sum(map(len, parts[number])) < min(shard_size, size - number * shard_size):
            continue
        # before the first new shard, not earlier: a run that fails at once leaves no trace
        write_json(folder / _DESCRIPTION, description)
        table = pa.concat_tables(parts.pop(number)).sort_by("demonstration")
        table = table.replace_schema_metadata({_METADATA: json.dumps(identity)})
        with atomic_path(_shard_path(folder, number)) as temporary:
            pq.write_table(table, temporary)
    return load(folder)


def device_kind(device: str) -> str:
    """``cpu`` or ``cuda`` of a device or a list of them.

    Raises:
        ParameterError: If the list holds both: their rounding differs.
    """
    kinds = {"cpu" if name.strip() == "cpu" else "cuda" for name in device.split(",")}
    if len(kinds) > 1:
        raise ParameterError(f"is {device!r}", where="device", fix="give GPUs or the CPU, not both")
    return kinds.pop()


def _count_together(kind: str, shard_size: int, left: int, devices: int) -> int:
    """Demonstrations that a task is given at once."""
    if kind == "cpu":
        return max(16, 2 * (os.cpu_count() or 1))
    together = shard_size
    while devices > 1 and together >= 2 * FEWEST_TOGETHER and left < TURNS * devices * together:
        together = -(-together // 2)
    return together


class _StoppedError(Exception):
    """Ends a simulation that nobody waits for."""


def _on_devices(
    simulate: Callable[..., pa.Table], jobs: list[range], devices: list[str]
) -> Iterator[tuple[range, pa.Table]]:
    """Jobs and their rows as they are done, side by side on the devices."""
    if len(devices) == 1 and not devices[0].startswith("cuda"):
        for job in jobs:
            yield job, simulate(job, device=devices[0])
        return
    free: queue.SimpleQueue[str] = queue.SimpleQueue()
    places = devices if "cpu" in devices else AHEAD * devices
    for device in places:
        free.put(device)
    stop = threading.Event()

    def go_on(_: int) -> None:
        if stop.is_set():
            raise _StoppedError

    def work(job: range) -> pa.Table:
        device = free.get()
        try:
            return simulate(job, device=device, on_frame=go_on)
        finally:
            free.put(device)

    with ThreadPoolExecutor(max_workers=len(places)) as pool:
        at_work = {pool.submit(work, job): job for job in jobs}
        try:
            for done in as_completed(list(at_work)):
                yield at_work.pop(done), done.result()
        finally:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)


def load(folder: str | os.PathLike) -> pa.Table:
    """All demonstrations of a set, in order, failed ones included (`ok` is false).

    Raises:
        DatasetError: The folder is missing or holds no set, demonstrations are missing, or a
            shard is damaged or belongs to another set.
    """
    folder = Path(folder)
    description = read_description(folder)
    size, shard_size = description["size"], description["shard_size"]
    identity = _identity(description)
    parts = []
    for number in range(_count_shards(size, shard_size)):
        try:
            rows = _read_shard(_shard_path(folder, number), number, identity)
        except FileNotFoundError:
            continue
        parts.append(rows.slice(0, size - number * shard_size))
    have = sum(map(len, parts))
    if have < size:
        raise DatasetError(
            f"holds {have} of {size} demonstrations",
            where=str(folder),
            fix="finish it with the gendom dataset command that began it",
        )
    return pa.concat_tables(parts).replace_schema_metadata(None)


def read_description(folder: str | os.PathLike) -> dict[str, Any]:
    """The content of a set's `dataset.json`.

    `task` holds the task's `name` and the settings that rebuild it.

    Raises:
        DatasetError: The folder is missing, or holds no set of demonstrations.
    """
    folder = Path(folder)
    make = "make a set with gendom dataset"
    if not folder.is_dir():
        what = "is not a folder" if folder.exists() else "no such folder"
        raise DatasetError(what, where=str(folder), fix=f"check the path, or {make}")
    path = folder / _DESCRIPTION
    if not path.exists():
        raise DatasetError(f"holds no {_DESCRIPTION}", where=str(folder), fix=make)
    description = read_json(path)
    if description.get("format") != FORMAT:
        raise DatasetError(
            f"has the format {description.get('format')!r}, not {FORMAT!r}",
            where=str(path),
            fix=make,
        )
    wrong = [
        name
        for name in ("size", "shard_size")
        if not (isinstance(description.get(name), int) and description[name] > 0)
    ]
    if wrong or not isinstance(description.get("task"), dict):
        raise DatasetError(
            f"lacks a usable {wrong[0] if wrong else 'task'}", where=str(path), fix=make
        )
    return description


def _describe(
    task: Task, size: int, seed: int, device: str, dtype: str, shard_size: int
) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "gendom": __version__,
        "task": {"name": task.name, **task.settings()},
        "action_names": list(task.action_names),
        "goal_names": list(task.goal_names),
        "parameter_ranges": {name: list(ends) for name, ends in task.parameter_ranges.items()},
        "size": size,
        "seed": seed,
        "shard_size": shard_size,
        # rounding differs between CPU and CUDA, not between two cards
        "device": device.partition(":")[0],
        "dtype": dtype,
    }


def _identity(description: Mapping[str, Any]) -> dict[str, Any]:
    """What all shards of a set have in common."""
    return {name: value for name, value in description.items() if name != "size"}


def _check_same(folder: Path, wanted: Mapping[str, Any]) -> None:
    """Refuse a folder that holds anything but a part of the wanted set."""
    if not (folder / _DESCRIPTION).exists():
        if folder.is_dir() and any(folder.glob("shard-*.parquet")):
            raise DatasetError(
                f"holds shards but no {_DESCRIPTION}", where=str(folder), fix="choose a new folder"
            )
        return
    there = read_description(folder)
    differing = [
        f"{name} is {_text(mine)} there and {_text(yours)} here"
        for name, mine, yours in _differences(_identity(there), _identity(wanted))
    ]
    if there["size"] > wanted["size"]:
        differing.append(f"size is {there['size']} there and only {wanted['size']} here")
    if differing:
        raise DatasetError(
            f"holds another set: {', '.join(differing)}",
            where=str(folder),
            fix="choose a new folder, or the settings of that set",
        )


def _differences(
    there: Mapping[str, Any], here: Mapping[str, Any], prefix: str = ""
) -> list[tuple[str, Any, Any]]:
    """Name, one value and the other of what differs, nested objects taken apart."""
    found = []
    for name in sorted({*there, *here}):
        mine, yours = there.get(name), here.get(name)
        if isinstance(mine, Mapping) and isinstance(yours, Mapping):
            found += _differences(mine, yours, f"{prefix}{name}.")
        elif mine != yours:
            found.append((f"{prefix}{name}", mine, yours))
    return found


def _text(value: Any) -> str:
    return "absent" if value is None else json.dumps(value)


def _count_shards(size: int, shard_size: int) -> int:
    return -(-size // shard_size)


def _shard_path(folder: Path, number: int) -> Path:
    return folder / f"shard-{number:05d}.parquet"


def _read_shard(path: Path, number: int, identity: Mapping[str, Any]) -> pa.Table:
    """A shard's rows.

    Raises:
        FileNotFoundError: There is none.
        DatasetError: It is damaged, or of another set.
    """
    fix = "delete it, and run the gendom dataset command that made the set"
    try:
        rows = pq.read_table(path)
        about = json.loads((rows.schema.metadata or {}).get(_METADATA, b"null"))
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:  # Arrow's own errors are of these two kinds
        reason = (str(error).splitlines() or ["unreadable"])[0]
        raise DatasetError(f"is damaged ({reason})", where=str(path), fix=fix) from None
    if about != identity:
        raise DatasetError("belongs to another set", where=str(path), fix=fix)
    first = number * identity["shard_size"]
    named = rows["demonstration"].to_numpy() if "demonstration" in rows.column_names else []
    if not len(named) or not np.array_equal(named, first + np.arange(len(named))):
        raise DatasetError(
            f"does not hold demonstrations {first} and following", where=str(path), fix=fix
        )
    return rows


def _simulate(
    task: Task,
    indices: range,
    *,
    seed: int,
    device: str,
    dtype: str,
    on_frame: Callable[[int], None] | None = None,
) -> pa.Table:
    """Draw and carry out the demonstrations of these numbers."""
    draws = [task.draw(np.random.default_rng([seed, i])) for i in indices]
    outcomes = task.demonstrate(draws, device=device, dtype=dtype, on_frame=on_frame)
    ok = np.array([fault is None for fault in outcomes.faults])
    columns = {"demonstration": pa.array(indices, pa.int64())}
    for name in draws[0]:
        columns[name] = pa.array([draw[name] for draw in draws], pa.float64())
    for name, values in outcomes.columns.items():
        columns[name] = pa.array(values, pa.float64(), from_pandas=True)  # NaN becomes null
    columns["ok"] = pa.array(ok)
    columns["fault"] = pa.array(outcomes.faults, pa.string())
    return pa.table(columns)
