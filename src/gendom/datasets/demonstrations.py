"""Sets of simulated demonstrations: a folder of Parquet shards.

    dataset.json         format, task with its settings, simulation, size, seed, shard_size,
                         device, gendom version, and the SHA-256 of every shard
    shard-00000.parquet  demonstrations 0 to shard_size - 1, one row each
    shard-00001.parquet  ...

Columns are `demonstration` (its number, int64), the numbers that the task drew (actions,
parameters, sizes) and measured (`goal_x`, ...; null where the simulation failed), `ok`, and
`fault`, the reason of a failure (null without failure). Numbers are in SI units.

Demonstration i is drawn from `numpy.random.default_rng([seed, i])` and depends on nothing else:
shards can be simulated in any order, on any machine, and a set can be continued or extended.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import json
import logging
import os
import queue
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from filelock import FileLock, Timeout

from gendom import __version__
from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import DatasetError
from gendom.files import atomic_path, write_json
from gendom.materials.names import current_name
from gendom.reading import read_bytes, read_json, record_of
from gendom.streams import Streams

FORMAT = "gendom-demonstrations/2"

GOAL = "goal_"
"""Prefix of columns of goals."""

SHARD_SIZE = {"cpu": 4096, "cuda": 262144}
"""Default numbers of demonstrations in a shard, of cost 1."""

_DESCRIPTION, _LOCK = "dataset.json", ".lock"
_METADATA = b"gendom"  # key of the set's identity in the metadata of a shard
_IN_FLIGHT = 2  # parts of a set on a GPU: one is prepared while the other is simulated
_WORKERS = 8  # of a cluster, at least
_FEWEST_TOGETHER = 1024  # demonstrations that use a GPU well; of several GPUs none gets fewer
_MOST_TOGETHER = 8192
_PARTS_PER_DEVICE = 8  # of several devices; several parts balance the load between them
_MAKE_AGAIN = "make it again with this version of gendom dataset"
_COLUMNS = {"demonstration": pa.int64(), "ok": pa.bool_(), "fault": pa.string()}  # others: float64

MOST_SHARDS = 100_000
"""Of a set: their names have five digits."""

LARGEST_SHARD = 1 << 28
"""In memory [bytes]."""

_log = logging.getLogger(__name__)


Columns = Mapping[str, Array]
"""[W] numbers by name."""


@dataclass(frozen=True, kw_only=True)
class Outcomes:
    """The outcomes of W demonstrations."""

    columns: Columns
    """Results; NaN where a demonstration failed."""
    faults: tuple[str | None, ...]
    """[W] reasons of failures, None without failure."""


class DemonstrationSource(Protocol):
    """Source of demonstrations, see `gendom.tasks.demonstrator`."""

    @property
    def cost(self) -> float:
        """About how long one takes, in those of rope reaching."""
        ...

    def about(self) -> dict[str, Any]:
        """Settings common to all demonstrations, ready for JSON; `task` has a `name`."""
        ...

    def draw(self, rngs: Sequence[np.random.Generator]) -> Columns:
        """Draw the inputs of W demonstrations, each from its own generator."""
        ...

    def demonstrate(
        self, draws: Columns, *, device: str, on_frame: Callable[[int], None] | None = None
    ) -> Outcomes:
        """Simulate draws in parallel. Returned columns replace drawn ones of the same name.
        `on_frame` is called regularly; an exception that it raises stops the simulation."""
        ...


def generate(
    source: DemonstrationSource,
    size: int,
    out: str | os.PathLike,
    *,
    seed: int,
    device: str = "cpu",
    cluster: str | None = None,
    shard_size: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pa.Table:
    """Simulate a set of demonstrations, or its missing part, and load it.

    Shards are written completely or not at all, so an interrupted set continues where it stopped.
    A larger `size` extends a set; a smaller one completes an interrupted set at that size. A
    demonstration that diverges is kept with `ok` false.

    Args:
        source: Source of the demonstrations.
        size: Number of demonstrations.
        out: Folder of the set; made if it is missing.
        seed: Seed of all draws, 0 or more.
        device: ``cpu``, ``cuda`` or ``cuda:0`` and so on; several with commas between them, or
            ``all`` GPUs. On one GPU a shard is handed to the task at once.
        cluster: A Ray cluster that shares the work, see `gendom.datasets.cluster`; the result is
            the same. ``device`` is then that of each worker.
        shard_size: Demonstrations in a shard (default: that of the set which is continued, or
            ``SHARD_SIZE`` of the device by the source's cost).
        progress: Called with the number of demonstrations done, those already there included,
            and `size`.

    Returns:
        As `load`.

    Raises:
        DatasetError: The folder holds a set with other settings, or a larger one that is whole, or
            another process writes to it.
        ParameterError: A number is out of range.
        DeviceError: The device is not there.
    """
    kinds = {"cpu" if name.strip() == "cpu" else "cuda" for name in device.split(",")}
    require(len(kinds) == 1, f"is {device!r}", where="device", fix="give GPUs or the CPU, not both")
    folder, kind = Path(out), kinds.pop()
    if shard_size is None:
        usual = max(1, round(SHARD_SIZE[kind] / source.cost))
        begun = (folder / _DESCRIPTION).exists()
        shard_size = int(read_description(folder)["shard_size"]) if begun else usual
    for name, value, least in [("size", size, 1), ("shard_size", shard_size, 1), ("seed", seed, 0)]:
        require(value >= least, f"is {value}", where=name, fix=f"give {least} or more")
    most = min(MOST_SHARDS * shard_size, 1 << 32)
    require(size <= most, f"is {size}", where="size", fix=f"give {most} at most")
    description = {"format": FORMAT, "gendom": __version__, **source.about(), "size": size}
    # rounding differs between CPU and CUDA, not between two cards
    description |= {"seed": seed, "shard_size": shard_size, "device": kind}
    _check_same(folder, description)
    with _alone(folder):
        _complete(source, folder, description, device, kind, cluster, progress)
    return load(folder)


def _complete(
    source: DemonstrationSource,
    folder: Path,
    description: dict[str, Any],
    device: str,
    kind: str,
    cluster: str | None,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Simulate the missing part of a set."""
    size, seed, shard_size = (description[name] for name in ("size", "seed", "shard_size"))
    identity = _identity(description)
    there = read_description(folder) if (folder / _DESCRIPTION).exists() else {}
    hashes: dict[str, str] = dict(there.get("sha256", {}))
    report = progress or (lambda done, total: None)

    # by shard; one of a set that is extended need not be full
    parts: dict[int, list[pa.Table]] = {n: [] for n in range(_count_shards(size, shard_size))}
    for number, own in parts.items():
        try:
            rows = _read_shard(folder, number, identity, hashes)
            own += [] if rows is None else [rows.slice(0, size - number * shard_size)]
        except DatasetError as error:
            _log.warning("%s: %s; simulating it again", error.where, error.what)
    done = sum(len(rows) for own in parts.values() for rows in own)
    report(done, size)
    if done == size:
        if there["size"] != size:
            write_json(folder / _DESCRIPTION, {**description, "sha256": hashes})
        return
    devices = [device]
    if cluster is None and (device == "all" or "," in device):
        from gendom.sim import list_devices  # Warp: a task that needs it imports it itself

        devices = list_devices(device)
    places = len(devices) if cluster is None else _WORKERS
    together = _count_together(kind, shard_size, size - done, places)
    jobs: list[range] = []
    for number, own in parts.items():
        begin, end = number * shard_size + sum(map(len, own)), min((number + 1) * shard_size, size)
        jobs += [range(i, min(i + together, end)) for i in range(begin, end, together)]
    simulate = functools.partial(_simulate, source, seed=seed)
    if cluster is None:
        results = _on_devices(simulate, jobs, devices)
    else:
        from gendom.datasets.cluster import on_cluster

        results = on_cluster(simulate, jobs, cluster, kind, (source, *vars(source).values()))
    for job, found in results:
        number = job.start // shard_size
        parts[number].append(_table(job, found))
        done += len(job)
        report(done, size)
        if sum(map(len, parts[number])) < min(shard_size, size - number * shard_size):
            continue
        own = sorted(parts.pop(number), key=lambda rows: rows["demonstration"][0].as_py())
        table = pa.concat_tables(own).combine_chunks()
        path = _shard_path(folder, number)
        with atomic_path(path) as temporary:
            tagged = table.replace_schema_metadata({_METADATA: json.dumps(identity)})
            write_parquet(tagged, temporary)
            hashes[path.name] = hashlib.sha256(temporary.read_bytes()).hexdigest()
            # before the shard: one without its hash would have to be simulated again
            write_json(folder / _DESCRIPTION, {**description, "sha256": hashes})


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Lock a set for writing; a folder into which nothing was written is removed.

    Raises:
        DatasetError: Another process is writing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / _LOCK)
    try:
        lock.acquire(timeout=0.0)
    except Timeout:
        what = "is being written by another process"
        fix = "wait for it to end, or choose a new folder"
        raise DatasetError(what, where=str(folder), fix=fix) from None
    try:
        yield
    finally:
        if {path.name for path in folder.iterdir()} <= {_LOCK}:
            (folder / _LOCK).unlink(missing_ok=True)
            folder.rmdir()
        lock.release()


def _count_together(kind: str, shard_size: int, left: int, places: int) -> int:
    """Number of demonstrations passed to a task at once."""
    if kind == "cpu":
        # threads go through groups of them, which take as long in Python whatever their size
        return min(shard_size, max(16, shard_size // 8 // places, left // (16 * places)))
    parts = 1 if places == 1 else _PARTS_PER_DEVICE * places
    return min(shard_size, _MOST_TOGETHER, max(_FEWEST_TOGETHER, -(-left // parts)))


class _StoppedError(Exception):
    """Ends a simulation whose result is not needed any more."""


def _on_devices(
    simulate: Callable[..., dict[str, Any]], jobs: list[range], devices: list[str]
) -> Iterator[tuple[range, dict[str, Any]]]:
    """Run jobs in parallel on the devices, and yield jobs and results as they finish."""
    if len(devices) == 1 and not devices[0].startswith("cuda"):
        for job in jobs:
            yield job, simulate(job, device=devices[0])
        return
    free: queue.SimpleQueue[str] = queue.SimpleQueue()
    places = devices if "cpu" in devices else _IN_FLIGHT * devices
    for device in places:
        free.put(device)
    stop = threading.Event()

    def go_on(_: int) -> None:
        if stop.is_set():
            raise _StoppedError

    def work(job: range) -> dict[str, Any]:
        device = free.get()
        try:
            return simulate(job, device=device, on_frame=go_on)
        finally:
            free.put(device)

    with ThreadPoolExecutor(max_workers=len(places)) as pool:
        threading.Thread(target=_open_driver, args=[devices[0]], daemon=True).start()
        at_work = {pool.submit(work, job): job for job in jobs}
        try:
            for done in as_completed(list(at_work)):
                yield at_work.pop(done), done.result()
        finally:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)


def _open_driver(device: str) -> None:
    """Open a GPU while Python imports what needs it; what fails is told then."""
    context = ctypes.c_void_p()
    with suppress(OSError, AttributeError, ValueError):
        driver = ctypes.CDLL("libcuda.so.1")
        driver.cuInit(0)
        driver.cuDevicePrimaryCtxRetain(ctypes.byref(context), int(device.partition(":")[2] or 0))


def load(folder: str | os.PathLike, *, part: bool = False) -> pa.Table:
    """All demonstrations of a set, in order, failed ones included (`ok` is false); with `part`
    those of an unfinished set that are there.

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
        rows = _read_shard(folder, number, identity, description["sha256"])
        if rows is None:
            continue
        parts.append(rows.slice(0, size - number * shard_size))
        where, first = (str(_shard_path(folder, n)) for n in (number, 0))
        same = parts[0].schema.equals(rows.schema)
        what = f"has not the columns of {Path(first).name}"
        require(same, what, where=where, fix=_MAKE_AGAIN, error=DatasetError)
    have = sum(map(len, parts))
    fix = "finish it with the gendom dataset command that began it"
    what, enough = f"holds {have} of {size} demonstrations", have >= (1 if part else size)
    require(enough, what, where=str(folder), fix=fix, error=DatasetError)
    table = pa.concat_tables(parts).replace_schema_metadata(None)
    return table.rename_columns([current_name(name) for name in table.column_names])


def write_parquet(table: pa.Table, path: Path) -> None:
    """Write a table to a file of any name: pyarrow takes one with a colon for an address, and none
    that is no UTF-8."""
    with open(path, "wb") as file:
        pq.write_table(table, file)


def succeeded(table: pa.Table, names: Sequence[str], *, where: str) -> dict[str, Array]:
    """[N] columns of what `load` returned of a folder (`where`), by name, without demonstrations
    that failed.

    Raises:
        DatasetError: The set lacks a column.
    """
    missing = [name for name in (*names, "ok") if name not in table.column_names]
    what, fix = f"lacks the columns {', '.join(missing)}", _MAKE_AGAIN
    require(not missing, what, where=where, fix=fix, error=DatasetError)
    kept = table.filter(table["ok"])
    return {name: kept[name].to_numpy().astype(float) for name in names}


def read_description(folder: str | os.PathLike) -> dict[str, Any]:
    """The content of a set's `dataset.json`.

    `task` holds the task's `name` and the settings that rebuild it.

    Raises:
        DatasetError: The folder is missing, or holds no set of demonstrations.
    """
    folder = Path(folder)
    make = "make a set with gendom dataset"

    wanted = functools.partial(require, where=folder, fix=make, error=DatasetError)
    what = "is not a folder" if folder.exists() else "no such folder"
    wanted(folder.is_dir(), what, fix=f"check the path, or {make}")
    path = folder / _DESCRIPTION
    wanted(path.exists(), f"holds no {_DESCRIPTION}")
    description = read_json(path, DatasetError)
    form = description.get("format")
    wanted(form == FORMAT, f"has the format {form!r}, not {FORMAT!r}", where=path)
    set_ = record_of(_Described, description, where=str(path), fix=make, error=DatasetError)
    for name, value in (("size", set_.size), ("shard_size", set_.shard_size)):
        wanted(value > 0, f"{name} is {value}", where=path)
    wanted(isinstance(set_.task.get("name"), str), "its task has no name", where=path)
    count = _count_shards(set_.size, set_.shard_size)
    what = f"has {count} shards, at most {MOST_SHARDS} are read"
    wanted(count <= MOST_SHARDS, what, where=path)
    return description


@dataclass(frozen=True, kw_only=True)
class _Described:
    """What readers need of `dataset.json`; sets of other sources than tasks lack some."""

    task: dict[str, Any]
    kind: str = ""
    action_names: tuple[str, ...] = ()
    action_units: tuple[str, ...] = ()
    goal_names: tuple[str, ...] = ()
    goal_units: tuple[str, ...] = ()
    size: int
    shard_size: int
    sha256: dict[str, str]


def _identity(description: Mapping[str, Any]) -> dict[str, Any]:
    """Fields that identify a set, common to all its shards."""
    return {k: value for k, value in description.items() if k not in ("size", "sha256")}


def _check_same(folder: Path, wanted: Mapping[str, Any]) -> None:
    """Check that a folder is empty or holds a part of the wanted set."""
    where, shards = str(folder), list(folder.glob("shard-*.parquet"))
    if not (folder / _DESCRIPTION).exists():
        what, fix = f"holds shards but no {_DESCRIPTION}", "choose a new folder"
        require(not shards, what, where=where, fix=fix, error=DatasetError)
        return
    there = read_description(folder)
    differing = list(_differences(_identity(there), _identity(wanted)))
    count = _count_shards(there["size"], there["shard_size"])
    whole = all(_shard_path(folder, n).exists() for n in range(count))
    if there["size"] > wanted["size"] and whole:
        differing.append(f"size is {there['size']} there and only {wanted['size']} here")
    fix = "choose a new folder, or the settings of that set"
    what = f"holds another set: {', '.join(differing)}"
    require(not differing, what, where=where, fix=fix, error=DatasetError)


def _differences(there: Any, here: Any, at: str = "") -> Iterator[str]:
    """What differs, with nested names."""
    if isinstance(there, Mapping) and isinstance(here, Mapping):
        for name in sorted({*there, *here}):
            yield from _differences(there.get(name), here.get(name), f"{at}.{name}".strip("."))
    else:
        told = [json.dumps(of) if of is not None else "absent" for of in (there, here)]
        if told[0] != told[1]:
            yield f"{at} is {told[0]} there and {told[1]} here"


def _count_shards(size: int, shard_size: int) -> int:
    return -(-size // shard_size)


def _shard_path(folder: Path, number: int) -> Path:
    return folder / f"shard-{number:05d}.parquet"


def _read_shard(
    folder: Path, number: int, identity: Mapping[str, Any], hashes: Mapping[str, str]
) -> pa.Table | None:
    """Read a shard's rows; None: it does not exist.

    Raises:
        DatasetError: The shard is damaged, or belongs to another set.
    """
    path = _shard_path(folder, number)
    fix = "delete it, and run the gendom dataset command that made the set"

    wanted = functools.partial(require, where=path, fix=fix, error=DatasetError)
    if not path.is_file():
        return None
    try:
        content = read_bytes(path, DatasetError, most=LARGEST_SHARD)
        is_whole = hashlib.sha256(content).hexdigest() == hashes.get(path.name)
        wanted(is_whole, "is damaged (its SHA-256 is not that of dataset.json)")
        # not read_table: threads of its scanner may drop Python's bytes after Python has ended, and
        # abort (https://github.com/apache/arrow/issues/33975)
        file = pq.ParquetFile(pa.BufferReader(content))
        schema = file.schema_arrow
        types = {n: t for n, t in zip(schema.names, schema.types, strict=True)}
        wanted(types.keys() >= _COLUMNS.keys(), f"lacks columns: it has {', '.join(types)}")
        for name, kind in types.items():
            usual = _COLUMNS.get(name, pa.float64())
            wanted(kind == usual, f"{name} holds {kind}, not {usual}")
        wanted(_unpacked(file) <= LARGEST_SHARD, "unpacks to more than is read")
        rows = file.read(use_threads=False)
        about = json.loads((schema.metadata or {}).get(_METADATA, b"null"))
    except (OSError, ValueError, RecursionError) as error:  # Arrow's own are of the first two
        reason = (str(error).splitlines() or ["unreadable"])[0]
        raise DatasetError(f"is damaged ({reason})", where=str(path), fix=fix) from None
    wanted(about == identity, "belongs to another set")
    first = number * identity["shard_size"]
    named = pa.chunked_array([_column(first + np.arange(len(rows)))])
    in_order = len(rows) and rows["demonstration"].equals(named)
    wanted(in_order, f"does not hold demonstrations {first} and following")
    return rows


def _unpacked(file: pq.ParquetFile) -> int:
    """At most so many bytes do the rows take in memory: a text that repeats is stored once."""
    about, bytes_ = file.metadata, 0
    for group in map(about.row_group, range(about.num_row_groups)):
        for column in map(group.column, range(group.num_columns)):
            text = column.physical_type == "BYTE_ARRAY"
            bytes_ += group.num_rows * (column.total_uncompressed_size if text else 8)
    return bytes_


def _simulate(
    source: DemonstrationSource,
    indices: range,
    *,
    seed: int,
    device: str,
    on_frame: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Draw and simulate the demonstrations with these numbers: columns, and `fault`."""
    draws = source.draw(Streams(seed, indices))
    outcomes = source.demonstrate(draws, device=device, on_frame=on_frame)
    return {**draws, **outcomes.columns, "fault": outcomes.faults}


def _table(indices: range, found: dict[str, Any]) -> pa.Table:
    """What `_simulate` found, as rows of a shard."""
    faults, fine = found.pop("fault"), np.full(len(indices), True)
    fine[[n for n, fault in enumerate(faults) if fault is not None]] = False
    columns = {"demonstration": _column(np.array(indices, dtype=np.int64))}
    columns |= {name: _column(np.array(values, dtype=float)) for name, values in found.items()}
    columns["ok"] = _column(fine)
    none = pa.nulls(len(faults), pa.string())
    columns["fault"] = none if fine.all() else pa.array(faults, pa.string())
    return pa.table(columns)


def _column(values: Array) -> pa.Array:
    """Numbers, or whether something holds; NaN is null. `pyarrow.array` would import pandas."""
    missing = np.isnan(values)
    bits = [np.packbits(of, bitorder="little") for of in (~missing, values) if of.dtype == bool]
    buffers = [bits[0] if missing.any() else None, bits[1] if len(bits) > 1 else values]
    buffers = [None if of is None else pa.py_buffer(of) for of in buffers]
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), buffers)
