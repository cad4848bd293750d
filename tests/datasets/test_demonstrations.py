"""Sets of demonstrations: reproducible, resumable, and clear about what is wrong with them."""

import hashlib
import json
import os
import shutil
import threading
import time
from typing import ClassVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gendom import __version__
from gendom.datasets import demonstrations
from gendom.datasets.demonstrations import generate, load, read_description
from gendom.errors import DatasetError, GendomError, ParameterError
from gendom.streams import Streams, uniform
from gendom.tasks import RopeReaching
from gendom.tasks.demonstrator import Demonstrator
from throwing import Throwing

ROPES = Demonstrator(task=RopeReaching())


def make(folder, size=10, *, task=None, seed=5, shard_size: int | None = 4, **options):
    return generate(task or Throwing(), size, folder, seed=seed, shard_size=shard_size, **options)


def names(folder):
    """Files of a set, without the lock."""
    return sorted(p.name for p in folder.iterdir() if p.name != ".lock")


def shard(folder, number):
    return folder / f"shard-{number:05d}.parquet"


def rehash(folder):
    """As if the shards that are there were those of the set."""
    about = json.loads((folder / "dataset.json").read_text())
    about["sha256"] = {
        name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in about["sha256"]
    }
    (folder / "dataset.json").write_text(json.dumps(about))


@pytest.fixture
def whole(tmp_path):
    """A set of ten in three shards."""
    make(tmp_path / "whole")
    return tmp_path / "whole"


def test_columns_and_description(whole, tmp_path):
    schema = load(whole).schema
    assert {name: str(schema.field(name).type) for name in schema.names} == {
        "demonstration": "int64", "speed": "double", "mass": "double", "goal_x": "double",
        "ok": "bool", "fault": "string",
    }  # fmt: skip
    about = json.loads((whole / "dataset.json").read_text())
    hashes = about.pop("sha256")
    assert about == {
        "format": "gendom-demonstrations/2", "gendom": __version__, "units": ["m/s"], "size": 10,
        "task": {"name": "throwing", "gravity": 9.81}, "seed": 5, "shard_size": 4, "device": "cpu",
    }  # fmt: skip
    assert sorted(hashes) == [f"shard-0000{n}.parquet" for n in range(3)]
    assert names(whole) == ["dataset.json", *sorted(hashes)]
    # every number comes from the seed and the index
    table = make(tmp_path / "set", 60).to_pylist()
    assert [row["demonstration"] for row in table] == list(range(60))
    assert 0 < sum(not row["ok"] for row in table) < 30
    for row in table:
        rng = np.random.default_rng([5, row["demonstration"]])
        speed, failed = rng.uniform(0.0, 10.0), row["speed"] > 9.0
        assert row["speed"] == speed and row["mass"] == rng.uniform(1.0, 2.0)
        goal, fault = (None, "flew away") if failed else (speed**2 / 9.81, None)
        assert (row["goal_x"], row["fault"], row["ok"]) == (goal, fault, not failed)


@pytest.mark.parametrize("seed", [0, 7, 2**32, 2**63 - 1, 2**140 + 3])
@pytest.mark.parametrize("numbers", [range(3), range(2**32 - 40, 2**32)])
def test_numbers_are_those_of_each_generator(seed, numbers):
    """Before the generators are made, and after."""
    streams, some = Streams(seed, numbers), np.arange(0, len(numbers), 2)
    each = [np.random.default_rng([seed, i]) for i in numbers]
    for _ in range(2):
        np.testing.assert_array_equal(uniform(streams, 3), uniform(each, 3))
        np.testing.assert_array_equal(uniform(streams, 2, some), uniform(each, 2, some))
        assert [rng.integers(9) for rng in streams] == [rng.integers(9) for rng in each]


def test_an_interrupted_set_keeps_whole_shards_and_goes_on(tmp_path, whole):
    folder = tmp_path / "cut"
    with pytest.raises(KeyboardInterrupt):
        make(folder, task=Throwing(stop_at=2))
    assert names(folder) == ["dataset.json", "shard-00000.parquet", "shard-00001.parquet"]
    with pytest.raises(DatasetError, match="holds 8 of 10 demonstrations"):
        load(folder)
    assert load(folder, part=True).equals(load(whole).slice(0, 8))
    task = Throwing()
    assert make(folder, task=task).equals(load(whole))
    assert task.count == 2


def test_missing_and_damaged_shards_are_simulated_again(whole, caplog):
    before, good = [shard(whole, k).read_bytes() for k in range(3)], load(whole)
    make(whole, task=Throwing(stop_at=0))  # of a whole set nothing is simulated
    shard(whole, 0).unlink()
    shard(whole, 1).write_bytes(b"PAR1")
    task = Throwing()
    assert make(whole, task=task).equals(good)
    assert task.count == 8 and [shard(whole, k).read_bytes() for k in range(3)] == before
    assert "shard-00001.parquet" in caplog.text and "shard-00000" not in caplog.text


@pytest.mark.parametrize(("cut", "size"), [(None, 11), (None, 21), (2, 3), (2, 8), (2, 9)])
def test_another_size_extends_or_ends_a_set(tmp_path, cut, size):
    """A larger one any set, a smaller one an interrupted set; it is as one made at once."""
    folder, there = tmp_path / "set", 10 if cut is None else 4 * cut
    if cut is None:
        make(folder)
    else:
        with pytest.raises(KeyboardInterrupt):
            make(folder, 40, task=Throwing(stop_at=cut))
    task = Throwing()
    ended = make(folder, size, task=task)
    assert task.count == max(0, size - there) and read_description(folder)["size"] == size
    assert ended.equals(make(tmp_path / "fresh", size))
    again, larger = Throwing(), max(size, there) + 3
    assert make(folder, larger, task=again).equals(make(tmp_path / "longer", larger))
    assert again.count == 3


@pytest.mark.parametrize(
    "change, says",
    [
        ({"seed": 6}, "seed is 5 there and 6 here"),
        ({"shard_size": 5}, "shard_size is 4 there and 5 here"),
        ({"size": 9}, "size is 10 there and only 9 here"),
        ({"version": "99.0.0"}, f'gendom is "{__version__}" there and "99.0.0" here'),
        ({"device": "cuda:1"}, 'device is "cpu" there and "cuda" here'),
        ({"task": Throwing(gravity=1.6)}, "task.gravity is 9.81 there and 1.6 here"),
    ],
)
def test_another_set_is_refused(whole, change, says, monkeypatch):
    before = {path.name: path.read_bytes() for path in whole.iterdir()}
    monkeypatch.setattr(demonstrations, "__version__", change.pop("version", __version__))
    with pytest.raises(DatasetError, match=rf"^{whole}: .*{says}"):
        make(whole, **change)
    assert {path.name: path.read_bytes() for path in whole.iterdir()} == before


@pytest.mark.parametrize(
    ("error", "says", "options"),
    [
        (ParameterError, "size", {"size": 0}),
        (ParameterError, "shard_size", {"shard_size": 0}),
        (ParameterError, "seed", {"seed": -1}),
        (ParameterError, "not both", {"device": "cpu,cuda:0"}),
        (KeyboardInterrupt, None, {"task": Throwing(stop_at=0)}),
        (GendomError, "no device", {"device": "cuda:77", "task": ROPES}),
    ],
)
def test_what_fails_at_once_leaves_no_folder(tmp_path, error, says, options):
    with pytest.raises(error, match=says):
        make(tmp_path / "set", **options)
    assert list(tmp_path.iterdir()) == []


def changed(change):
    def spoil(folder):
        table = pq.read_table(shard(folder, 1))
        table = change(table).replace_schema_metadata(table.schema.metadata)
        pq.write_table(table, shard(folder, 1))
        rehash(folder)

    return spoil


def words(table):
    return pa.array(["x" * 10**6] * len(table))


def from_another_set(folder):
    make(folder.parent / "other", seed=6)
    shutil.copy(shard(folder.parent / "other", 1), shard(folder, 1))


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda f: shard(f, 1).write_bytes(b"not Parquet"), "is damaged"),
        (from_another_set, r"is damaged \(its SHA-256"),
        (lambda f: (from_another_set(f), rehash(f)), "belongs to another set"),
        (lambda f: (shutil.copy(shard(f, 0), shard(f, 1)), rehash(f)), "demonstrations 4 and"),
        (lambda f: (pq.write_table(pa.table({"a": [1]}), shard(f, 1)), rehash(f)), "lacks columns"),
        (changed(lambda t: t.drop_columns("goal_x")), "has not the columns of shard-00000"),
        (changed(lambda t: t.drop_columns("ok")), "lacks columns"),
        (changed(lambda t: t.set_column(1, "speed", words(t))), "holds string, not double"),
        (changed(lambda t: t.append_column("more", pa.array([1] * len(t)))), "more holds int64"),
        (changed(lambda t: t.set_column(5, "fault", words(t))), "unpacks to more than is read"),
    ],
)
def test_a_bad_shard_is_named(whole, spoil, says, monkeypatch):
    monkeypatch.setattr(demonstrations, "LARGEST_SHARD", 2 * 10**6)
    spoil(whole)
    with pytest.raises(DatasetError, match=rf"shard-00001\.parquet: .*{says}"):
        load(whole)


def described(**changes):
    """A description with other entries."""
    about = {"format": "gendom-demonstrations/2", "size": 4, "shard_size": 4, "sha256": {}}
    return json.dumps({**about, "task": {"name": "throwing"}, **changes})


@pytest.mark.parametrize(
    "text, says",
    [
        (described(format="gendom-demonstrations/1"), "has the format 'gendom-demonstrations/1'"),
        (described().replace("task", "tusk"), "field task"),
        (described(size=10**13), "has 2500000000000 shards"),
        (described(size=0), "size is 0"),
        (described(size=4.5), "size: expected int, got float"),
        (described(task={}), "its task has no name"),
        (described(sha256={"a": 3}), "sha256.*expected str"),
    ],
)
def test_a_bad_description_is_named(tmp_path, text, says):
    (tmp_path / "dataset.json").write_text(text)
    with pytest.raises(GendomError, match=rf"dataset\.json: .*{says}"):
        load(tmp_path)


def test_folders_that_hold_no_set(tmp_path, whole):
    (whole / "dataset.json").unlink()
    for name, says in (("none", "no such"), ("whole", "no dataset")):
        with pytest.raises(DatasetError, match=says):
            load(tmp_path / name)
    with pytest.raises(DatasetError, match=r"holds shards but no dataset\.json"):
        make(whole)


def test_one_writer_at_a_time(tmp_path, whole):
    """The second is refused, and the set stays as it was."""

    class Busy(Throwing):
        def demonstrate(self, draws, **options):
            with pytest.raises(DatasetError, match="is being written by another process; wait"):
                make(tmp_path / "set")
            return super().demonstrate(draws, **options)

    assert make(tmp_path / "set", task=Busy()).equals(load(whole))
    make(tmp_path / "set", 12)  # free again


class Meeting(Throwing):
    """Throws that wait until two are under way at the same time."""

    both = threading.Barrier(2)

    def demonstrate(self, draws, **options):
        self.both.wait(timeout=20.0)
        return super().demonstrate(draws, **options)


class Endless(Throwing):
    """Throws of which the first goes on until it is stopped, while another one breaks."""

    ended: ClassVar[list] = []

    def demonstrate(self, draws, *, device, on_frame=None):
        assert on_frame is not None
        if draws["speed"][0] != self.draw([np.random.default_rng([0, 0])])["speed"][0]:
            raise ParameterError("broke")
        try:
            while True:
                on_frame(1)
                time.sleep(0.01)
        finally:
            self.ended.append(True)


def test_devices_share_a_set(tmp_path):
    """Two devices work at the same time; the set is that of one, row for row."""
    batch = max(16, 2 * (os.cpu_count() or 1))
    size, two = 4 * batch - 3, {"shard_size": 2 * batch, "device": "cpu,cpu"}
    alone = make(tmp_path / "one", size, shard_size=2 * batch)
    assert make(tmp_path / "two", size, task=Meeting(), **two).equals(alone)
    assert read_description(tmp_path / "two") == read_description(tmp_path / "one")
    # a fault on one device ends the others
    with pytest.raises(ParameterError, match="broke"):
        make(tmp_path / "set", 2 * batch, task=Endless(), seed=0, **two)
    assert Endless.ended == [True]
    assert len(make(tmp_path / "set", 2 * batch, seed=0, **two)) == 2 * batch
