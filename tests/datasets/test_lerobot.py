"""Demonstrations and recordings as LeRobot data sets: what is written, and that it is read."""

import io
import json
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from datasets.test_recording import equal
from gendom import cli
from gendom.datasets import ObjectDescription, Recording
from gendom.datasets.demonstrations import generate, load, read_description
from gendom.datasets.lerobot import export_demonstrations, export_recording, seal
from gendom.errors import DatasetError, RecordingError
from gendom.perception import read_camera
from gendom.tasks import ClothSpreading, RopeReaching
from gendom.tasks.demonstrator import Demonstrator
from perception.conftest import write_lift

DATA = "data/chunk-000/file-000.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
QUANTILES = ("q01", "q10", "q50", "q90", "q99")
OBJECT = ["E_over_rho", "nu", "damping", "friction", "density"]


pytestmark = pytest.mark.usefixtures("quick")


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
    for feature, of in (("observation.state", names), ("action", ["release_x", "release_z"])):
        expected = np.array([[row[name] for name in of] for row in kept])
        assert np.array(frames[feature].to_pylist()) == pytest.approx(expected, rel=1e-6)
    episodes = pq.read_table(made[1] / EPISODES)
    assert episodes["demonstration"].to_pylist() == [row["demonstration"] for row in kept]
    assert episodes["outcome/sideways"].to_pylist() == [row["sideways"] for row in kept]
    assert json.loads((made[1] / "meta/gendom.json").read_text()) == read_description(made[0])
    # what describes the frames agrees with them
    info = json.loads((made[1] / "meta/info.json").read_text())
    assert (info["codebase_version"], info["splits"]) == ("v3.0", {"train": "0:9"})
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (9, 9, 1)
    assert info["data_path"].format(chunk_index=0, file_index=0) == DATA
    assert info["features"]["observation.state"]["names"] == names
    assert frames.column_names == list(info["features"])
    assert frames["index"].to_pylist() == frames["episode_index"].to_pylist() == list(range(9))
    assert episodes["dataset_to_index"].to_pylist() == list(range(1, 10))
    assert episodes["tasks"].to_pylist() == [["rope-reaching"]] * 9
    tasks = pq.read_table(made[1] / "meta/tasks.parquet")
    assert tasks.to_pylist() == [{"task_index": 0, "task": "rope-reaching"}]
    stats = json.loads((made[1] / "meta/stats.json").read_text())
    for name, found in stats.items():
        x = np.array(frames[name].to_pylist(), dtype=float).reshape(9, -1)
        assert set(found) == {"min", "max", "mean", "std", "count", *QUANTILES}
        assert found["std"] == pytest.approx(x.std(axis=0)) and found["count"] == [9]
        assert found["q50"] == pytest.approx(np.median(x, axis=0))


def test_an_action_of_one_number_and_no_goal(tmp_path):
    generate(Demonstrator(task=ClothSpreading()), 6, tmp_path / "set", seed=0)
    features = export_demonstrations(tmp_path / "set", tmp_path / "out")["features"]
    assert features["observation.state"]["names"][:2] == ["side", "thickness"]
    assert list(features["action"].values()) == ["float32", [1], ["A"], ["1"]]
    # of which all failed
    generate(Demonstrator(task=RopeReaching()), 1, tmp_path / "failed", seed=3)
    with pytest.raises(DatasetError, match="holds no demonstration that did not fail"):
        export_demonstrations(tmp_path / "failed", tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_the_command(made, tmp_path, capsys, refused, lift, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["export", "set", "--out", "new"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("new: 9 episodes, LeRobot v3.0\n")
    assert "goal_x [m]" in out and "release_z [m]" in out
    assert "is there already; name a new folder" in refused("export", "set", "--out", "new")
    assert files(tmp_path / "new") == files(made[1])
    assert "no such folder" in refused("export", "none", "--out", "more")
    # of recordings
    lift.write(tmp_path / "lift.npz")
    assert cli.main(["export", "lift.npz", "--out", "lift"]) == cli.main(["check", "lift"]) == 0
    out = capsys.readouterr().out
    assert "gripper0.position.x [m]" in out and "points    20 to 24 a frame" in out


@pytest.fixture
def reader(tmp_path, monkeypatch):
    """LeRobot's own."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "cache"))
    reason = "needs lerobot, which no extra brings"
    return pytest.importorskip("lerobot.datasets.lerobot_dataset", reason=reason)


# ---- recordings ------------------------------------------------------------------------------


@pytest.fixture
def uneven(lift):
    """The lift with an empty frame, at uneven times, and another gripper that lets go."""
    clouds = [cloud if t != 2 else cloud[:0] for t, cloud in enumerate(lift.frames())]
    return Recording.from_frames(
        clouds,
        time=[0.1, 0.2, 1.0 / 3.0, 0.5, 2.0],
        gripper_position=lift.gripper_position * [[1, 1, 1], [0, 1, 1]] + [[0.0], [1e-9]],
        gripper_closed=[[True, t < 3] for t in range(5)],
        object=ObjectDescription(kind="rope", length=0.4),
        gripper_source="measured",
    )


@pytest.mark.parametrize("which", ["lift", "uneven"])
def test_there_and_back(which, request, tmp_path):
    recording = request.getfixturevalue(which)
    export_recording(recording, tmp_path / "out")
    assert equal(Recording.read(tmp_path / "out"), recording)


def test_what_lerobot_finds(uneven, tmp_path):
    info = export_recording(uneven, tmp_path / "out")
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (1, 5, 7)
    state = info["features"]["observation.state"]
    names = ["gripper1.position.z", "gripper0.closed", "gripper1.closed"]
    assert (state["names"][5:8], state["units"][5:]) == (names, ["m", "1", "1"])
    table = pq.read_table(tmp_path / "out" / DATA)
    assert table["observation.num_points"].to_pylist() == [20, 21, 0, 23, 24]
    padded = np.array(table["observation.points"].to_pylist())
    assert padded.shape == (5, 24, 3) and not padded[0, 20:].any() and not padded[2].any()
    assert table["timestamp"].to_pylist() == pytest.approx(np.arange(5) / 7.0)
    action = np.array(table["action"].to_pylist())
    assert action[:4, :6] == pytest.approx(uneven.gripper_position[1:].reshape(4, 6))
    assert action[:, 7].tolist() == [1.0, 1.0, 0.0, 0.0, 0.0]
    stats = json.loads((tmp_path / "out/meta/stats.json").read_text())["observation.points"]
    assert np.shape(stats["mean"]) == (24, 3) and stats["count"] == [5]
    assert stats["mean"][23] == pytest.approx(uneven.points.mean(axis=0), abs=1e-6)


def change(root, name, **entries):
    path = root / "meta" / f"{name}.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | entries))


def rows(edit):
    return lambda root: pq.write_table(edit(pq.read_table(root / DATA)), root / DATA)


def more_points(table):
    n = table.column_names.index("observation.num_points")
    return table.set_column(n, "observation.num_points", [[20, 21, 22, 23, 25]])


SEAL = "meta/gendom.sha256"
SPOILT = [
    (lambda r: (r / "meta/gendom.json").unlink(), ": is a LeRobot data set that was not"),
    (lambda r: change(r, "gendom", format="gendom-demonstrations/2"), ": holds demonstrations"),
    (rows(lambda t: t.take([1, 0, 2, 3, 4])), ": time, frame 1: goes from 0.1 s to 0 s"),
    (rows(lambda t: t.slice(0, 0)), ": "),
    (rows(lambda t: t.drop(["observation.time"])), ": is incomplete or damaged ("),
    (lambda r: (r / DATA).unlink(), f"/{DATA}: is incomplete or damaged ("),
    (lambda r: (r / DATA).write_bytes((r / DATA).read_bytes()[:900]), ": is incomplete or da"),
    (rows(more_points), ": offsets: runs from 0 to 111, but there are 110 points"),
    (lambda r: change(r, "info", features={}), ": is incomplete or damaged ("),
]


@pytest.mark.parametrize(("spoil", "said"), SPOILT)
def test_what_cannot_be_read(spoil, said, lift, tmp_path):
    """Parquet has no checksums by default, and of a damaged file pyarrow may end the process."""

    def told(root):
        with pytest.raises(RecordingError) as caught:
            Recording.read(root)
        assert "\n" not in str(caught.value)
        return str(caught.value).removeprefix(str(root))

    root = tmp_path / "out"
    export_recording(lift, root)
    spoil(root)
    if (root / "meta/gendom.json").exists():
        assert told(root).startswith((": is damaged: its files are not", f"/{DATA}: is incomplete"))
        (root / SEAL).write_text(seal(root))
    assert told(root).startswith(said)
    (root / SEAL).unlink()
    if (root / "meta/gendom.json").exists():
        assert told(root).startswith(f"/{SEAL}: no such file; export")


def test_lerobot_reads_recordings(uneven, tmp_path, reader):
    export_recording(uneven, tmp_path / "out")
    found = reader.LeRobotDataset("gendom/test", root=tmp_path / "out")
    assert (found.num_episodes, found.num_frames, found.fps) == (1, 5, 7)
    for t in range(5):
        item = found[t]
        count = int(item["observation.num_points"])
        np.testing.assert_array_equal(item["observation.points"][:count], uneven.frame(t))
        state = item["observation.state"][:3].tolist()  # which it hands out as float32
        assert state == pytest.approx(uneven.gripper_position[t, 0], rel=1e-6)
        assert float(item["observation.time"]) == pytest.approx(uneven.time[t], rel=1e-6)
        assert item["task"] == "move a rope that is held by: end"
    assert found.meta.stats["observation.points"]["mean"].shape == (24, 3)


# ---- pictures --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Depth pictures of a lift, and the set that the command makes of them."""
    folder = tmp_path_factory.mktemp("pictures")
    write_lift(folder / "lift", frames=4)
    assert cli.main(["export", str(folder / "lift"), "--out", str(folder / "set")]) == 0
    return folder / "lift", folder / "set"


def decoded(file):
    return np.asarray(Image.open(file))


def test_pictures_have_depth_in_millimetres(pictures):
    lift, made = pictures
    table, info = pq.read_table(made / DATA), json.loads((made / "meta/info.json").read_text())
    unit = 1e3 * read_camera(lift / "cameras/right/camera.toml").depth_unit
    for t in range(4):
        for name, folder in (("depth", "depth"), ("images", "colour")):
            feature = f"observation.{name}.right"
            picture = decoded(io.BytesIO(table[feature][t].as_py()["bytes"]))
            recorded = decoded(lift / f"cameras/right/{folder}/{t:06d}.png")
            wanted = (unit * recorded).round() if name == "depth" else recorded
            np.testing.assert_array_equal(picture, wanted)
            assert info["features"][feature]["shape"][:2] == list(picture.shape[:2])
    position = np.array(table["observation.state"].to_pylist())
    rows = np.loadtxt(lift / "gripper.csv", delimiter=",", skiprows=1)
    time = table["observation.time"].to_numpy()
    for a in range(3):
        np.testing.assert_allclose(position[:, a], np.interp(time, rows[:, 0], rows[:, 1 + a]))


def test_lerobot_reads_depth(pictures, reader):
    made = pictures[1]
    found = reader.LeRobotDataset("gendom/test", root=made)
    assert sorted(found.meta.depth_keys) == ["observation.depth.left", "observation.depth.right"]
    column = pq.read_table(made / DATA)["observation.depth.left"]
    for t in range(4):
        picture = decoded(io.BytesIO(column[t].as_py()["bytes"]))
        np.testing.assert_array_equal(found[t]["observation.depth.left"][0], picture)
        assert 0.2 < float(found[t]["observation.images.left"].max()) <= 1.0


def test_pictures_on_another_clock_are_refused(pictures, tmp_path, refused):
    folder = tmp_path / "lift"
    shutil.copytree(pictures[0], folder)
    (folder / "gripper.csv").write_text("time,x,y,z\n100,0,0,0.2\n101,0,0,0.3\n")
    told = refused("export", folder, "--out", tmp_path / "set")
    assert "no picture at a time of the gripper's path; put all times" in told
    assert not (tmp_path / "set").exists()
