"""Sets of demonstrations as LeRobot data sets: what is written, and that lerobot reads it."""

import errno
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gendom import cli
from gendom.datasets.demonstrations import generate, load, read_description
from gendom.datasets.lerobot import export_demonstrations
from gendom.errors import DatasetError, GendomError
from gendom.tasks import ClothSpreading, RopeReaching
from gendom.tasks.demonstrator import Demonstrator
from gendom.tasks.task import Outcome
from gendom.tasks.world import Simulation

DATA = "data/chunk-000/file-000.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
OBJECT = ["E_over_rho", "nu", "damping", "friction", "density"]


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """A world that reaches twice as far as the release; every fifth demonstration fails."""

    def carry_out(self, task, items, actions, **_):
        rope = task.name == "rope-reaching"
        return [
            Outcome(
                values={"x": 2.0 * a[0], "sideways": 0.01 * k}
                if rope
                else {"share": 0.8, "unspread": 0.2},
                fault=None if k % 5 else "diverged",
            )
            for k, a in enumerate(np.asarray(actions))
        ]

    monkeypatch.setattr(Simulation, "carry_out", carry_out)


@pytest.fixture
def made(tmp_path):
    """Folder of a set of 12 with 9 that did not fail, and that of its export."""
    generate(Demonstrator(task=RopeReaching()), 12, tmp_path / "set", seed=3, shard_size=12)
    export_demonstrations(tmp_path / "set", tmp_path / "out")
    return tmp_path / "set", tmp_path / "out"


def files(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())


def test_every_demonstration_that_did_not_fail_is_an_episode(made):
    table = load(made[0]).to_pylist()
    kept = [row for row in table if row["ok"]]
    frames = pq.read_table(made[1] / DATA)
    meta = ("gendom.json", "gendom.sha256", "info.json", "stats.json", "tasks.parquet")
    assert files(made[1]) == sorted([DATA, EPISODES, *(f"meta/{name}" for name in meta)])
    assert len(frames) == len(kept) == 9
    names = ["goal_x", "length", "diameter", *OBJECT]
    expected = np.array([[row[name] for name in names] for row in kept])
    assert np.array(frames["observation.state"].to_pylist()) == pytest.approx(expected, rel=1e-6)
    expected = np.array([[row[name] for name in ("release_x", "release_z")] for row in kept])
    assert np.array(frames["action"].to_pylist()) == pytest.approx(expected, rel=1e-6)
    episodes = pq.read_table(made[1] / EPISODES)
    assert episodes["demonstration"].to_pylist() == [row["demonstration"] for row in kept]
    assert episodes["outcome/sideways"].to_pylist() == [row["sideways"] for row in kept]
    assert json.loads((made[1] / "meta/gendom.json").read_text()) == read_description(made[0])


def test_what_describes_the_frames_agrees_with_them(made):
    info = json.loads((made[1] / "meta/info.json").read_text())
    frames, episodes = (pq.read_table(made[1] / name) for name in (DATA, EPISODES))
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (9, 9, 1)
    assert info["splits"] == {"train": "0:9"}
    assert info["data_path"].format(chunk_index=0, file_index=0) == DATA
    state = info["features"]["observation.state"]
    assert state["names"] == ["goal_x", "length", "diameter", *OBJECT]
    assert state["units"] == ["m", "m", "m", "m^2/s^2", "1", "s", "1", "kg/m^3"]
    assert info["features"]["action"]["units"] == ["m", "m"]
    assert frames.column_names == list(info["features"])
    for name, about in info["features"].items():
        kind = getattr(pa, {"float32": "float32", "int64": "int64"}[about["dtype"]])()
        size = about["shape"][0]
        assert frames.schema.field(name).type == (kind if size == 1 else pa.list_(kind, size))
    for name in ("frame_index", "task_index", "timestamp"):
        assert set(frames[name].to_pylist()) == {0}
    assert frames["index"].to_pylist() == frames["episode_index"].to_pylist() == list(range(9))
    assert episodes["dataset_from_index"].to_pylist() == list(range(9))
    assert episodes["dataset_to_index"].to_pylist() == list(range(1, 10))
    assert set(episodes["length"].to_pylist()) == {1}
    assert episodes["tasks"].to_pylist() == [["rope-reaching"]] * 9
    tasks = pq.read_table(made[1] / "meta/tasks.parquet")
    assert tasks.to_pylist() == [{"task_index": 0, "task": "rope-reaching"}]


def test_statistics(made):
    frames, episodes = (pq.read_table(made[1] / name) for name in (DATA, EPISODES))
    stats = json.loads((made[1] / "meta/stats.json").read_text())
    assert set(stats) == set(frames.column_names)
    for name, found in stats.items():
        x = np.array(frames[name].to_pylist(), dtype=float).reshape(9, -1)
        assert found["count"] == [9]
        assert found["mean"] == pytest.approx(x.mean(axis=0))
        assert found["std"] == pytest.approx(x.std(axis=0))
        assert (found["min"], found["max"]) == (x.min(axis=0).tolist(), x.max(axis=0).tolist())
        assert found["q50"] == pytest.approx(np.median(x, axis=0))
        assert set(found) == {
            "min",
            "max",
            "mean",
            "std",
            "count",
            "q01",
            "q10",
            "q50",
            "q90",
            "q99",
        }
        for statistic in found:
            each = np.array(episodes[f"stats/{name}/{statistic}"].to_pylist())
            own = {"std": 0.0 * x, "count": np.ones((9, 1))}.get(statistic, x)
            np.testing.assert_array_equal(each, own)


def test_an_action_of_one_number_and_no_goal(tmp_path):
    generate(Demonstrator(task=ClothSpreading()), 6, tmp_path / "set", seed=0)
    info = export_demonstrations(tmp_path / "set", tmp_path / "out")
    assert info["features"]["observation.state"]["names"][:2] == ["side", "thickness"]
    assert info["features"]["action"] == {
        "dtype": "float32", "shape": [1], "names": ["A"], "units": ["1"],
    }  # fmt: skip
    frames = pq.read_table(tmp_path / "out" / DATA)
    assert frames.schema.field("action").type == pa.float32()


def test_what_is_there_is_left_alone(made):
    before = files(made[1])
    with pytest.raises(GendomError, match="is there already; name a new folder"):
        export_demonstrations(*made)
    assert files(made[1]) == before


def test_a_full_disk_leaves_nothing(made, tmp_path, monkeypatch):
    def fill(*_, **__):
        raise OSError(errno.ENOSPC, "Error writing bytes to file")

    monkeypatch.setattr(pq, "write_table", fill)
    with pytest.raises(GendomError, match="the disk is full"):
        export_demonstrations(made[0], tmp_path / "new")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "set"]


def test_a_set_that_only_failed_is_refused(tmp_path):
    generate(Demonstrator(task=RopeReaching()), 1, tmp_path / "set", seed=3)
    with pytest.raises(DatasetError, match="holds no demonstration that did not fail"):
        export_demonstrations(tmp_path / "set", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_command(made, tmp_path, capsys):
    words = ["export", str(made[0]), "--out"]
    assert cli.main([*words, str(tmp_path / "new")]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"{tmp_path / 'new'}: 9 episodes, LeRobot v3.0\n")
    assert "goal_x [m]" in out and "release_z [m]" in out
    assert files(tmp_path / "new") == files(made[1])
    assert cli.main([*words, str(tmp_path / "new")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert cli.main([*words, str(tmp_path / "more"), "--to", "json"]) == 2
    assert cli.main(["export", str(tmp_path / "none"), "--out", str(tmp_path / "more")]) == 2
    assert "no such folder" in capsys.readouterr().err


@pytest.mark.parametrize("task", [RopeReaching, ClothSpreading])
def test_lerobot_reads_it(tmp_path, monkeypatch, task):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "cache"))
    reader = pytest.importorskip(
        "lerobot.datasets.lerobot_dataset", reason="needs lerobot, which no extra brings"
    )

    generate(Demonstrator(task=task()), 12, tmp_path / "set", seed=3, shard_size=12)
    info = export_demonstrations(tmp_path / "set", tmp_path / "out")
    frames = pq.read_table(tmp_path / "out" / DATA).to_pylist()
    found = reader.LeRobotDataset("gendom/test", root=tmp_path / "out")
    assert (found.num_episodes, found.num_frames, found.fps) == (len(frames), len(frames), 1)
    assert found.meta.get_task_index(task.name) == 0
    assert found.meta.features["action"]["units"] == info["features"]["action"]["units"]
    for index, row in enumerate(frames):
        item = found[index]
        assert item["task"] == task.name
        assert item["observation.state"].tolist() == row["observation.state"]
        assert item["action"].tolist() == row["action"]
    some = reader.LeRobotDataset("gendom/test", root=tmp_path / "out", episodes=[1, 3])
    assert [int(some[k]["episode_index"]) for k in range(2)] == [1, 3]
    later = {"action": [0.0, 1.0]}
    chunks = reader.LeRobotDataset("gendom/test", root=tmp_path / "out", delta_timestamps=later)
    assert chunks[2]["action_is_pad"].tolist() == [False, True]
