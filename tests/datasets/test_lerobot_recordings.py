"""Recordings as LeRobot data sets: nothing is lost on the way there and back."""

import json
from dataclasses import fields

import numpy as np
import pyarrow.parquet as pq
import pytest

from gendom import cli
from gendom.datasets import ObjectDescription, Recording
from gendom.datasets.lerobot import export_recording, read_lerobot
from gendom.datasets.lerobot.format import seal
from gendom.errors import RecordingError

DATA = "data/chunk-000/file-000.parquet"


@pytest.fixture
def uneven(lift):
    """The lift with an empty frame, at uneven times, and another gripper that lets go."""
    T = lift.num_frames
    clouds = [cloud if t != 2 else cloud[:0] for t, cloud in enumerate(lift.frames())]
    other = lift.gripper_position[:, 0] * [0.0, 1.0, 1.0]
    return Recording.from_frames(
        clouds,
        time=[0.1, 0.2, 1.0 / 3.0, 0.5, 2.0],
        gripper_position=np.stack([lift.gripper_position[:, 0], other + 1e-9], axis=1),
        gripper_closed=np.stack([np.ones(T, bool), np.arange(T) < 3], axis=1),
        object=ObjectDescription(kind="rope", length=0.4),
        gripper_source="measured",
    )


def equal(a, b):
    for f in fields(Recording):
        own, other = getattr(a, f.name), getattr(b, f.name)
        if isinstance(own, np.ndarray):
            assert own.dtype == other.dtype
            np.testing.assert_array_equal(own, other, err_msg=f.name)
        else:
            assert own == other, f.name


@pytest.mark.parametrize("which", ["lift", "uneven"])
def test_there_and_back(which, request, tmp_path):
    recording = request.getfixturevalue(which)
    export_recording(recording, tmp_path / "out")
    equal(Recording.read(tmp_path / "out"), recording)


def test_what_lerobot_finds(uneven, tmp_path):
    info = export_recording(uneven, tmp_path / "out")
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (1, 5, 7)
    features = info["features"]
    assert features["observation.points"]["shape"] == [24, 3]
    assert features["observation.state"]["names"][5:8] == [
        "gripper1.position.z",
        "gripper0.closed",
        "gripper1.closed",
    ]
    assert features["observation.state"]["units"][5:] == ["m", "1", "1"]
    table = pq.read_table(tmp_path / "out" / DATA)
    assert table["observation.num_points"].to_pylist() == [20, 21, 0, 23, 24]
    padded = np.array(table["observation.points"].to_pylist())
    assert not padded[0, 20:].any() and not padded[2].any() and padded[4].any(axis=1).all()
    assert table["timestamp"].to_pylist() == pytest.approx(np.arange(5) / 7.0)
    action = np.array(table["action"].to_pylist())
    assert action[:4, :6] == pytest.approx(uneven.gripper_position[1:].reshape(4, 6))
    assert action[:, 7].tolist() == [1.0, 1.0, 0.0, 0.0, 0.0]
    stats = json.loads((tmp_path / "out/meta/stats.json").read_text())["observation.points"]
    assert np.shape(stats["mean"]) == (24, 3) and stats["count"] == [5]
    assert stats["mean"][23] == pytest.approx(uneven.points.mean(axis=0), abs=1e-6)
    episodes = tmp_path / "out/meta/episodes/chunk-000/file-000.parquet"
    (episode,) = pq.read_table(episodes).to_pylist()
    assert (episode["length"], episode["dataset_to_index"]) == (5, 5)
    assert episode["stats/observation.points/mean"] == stats["mean"]


def test_the_commands(lift, tmp_path, capsys):
    lift.write(tmp_path / "lift.npz")
    words = ["export", str(tmp_path / "lift.npz"), "--out", str(tmp_path / "out")]
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"{tmp_path / 'out'}: 1 episodes, LeRobot v3.0\n")
    assert "gripper0.position.x [m]" in out
    assert cli.main(["check", str(tmp_path / "out")]) == 0
    assert "points    20 to 24 a frame" in capsys.readouterr().out
    assert cli.main(words) == 2
    assert "is there already" in capsys.readouterr().err


def no_meta(root):
    (root / "meta/gendom.json").unlink()


def change(name, **entries):
    def spoil(root):
        path = root / "meta" / f"{name}.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | entries))

    return spoil


def rows(edit):
    def spoil(root):
        pq.write_table(edit(pq.read_table(root / DATA)), root / DATA)

    return spoil


def more_points(table):
    n = table.column_names.index("observation.num_points")
    return table.set_column(n, "observation.num_points", [[20, 21, 22, 23, 25]])


SPOILT = {
    "of others": (no_meta, "is a LeRobot data set that was not made of a recording; give one that"),
    "demonstrations": (change("gendom", format="gendom-demonstrations/2"), "holds demonstrations"),
    "two episodes": (change("info", total_episodes=2), "has 2 episodes, not one"),
    "fewer frames": (rows(lambda t: t.slice(0, 3)), "has not the 5 frames in order"),
    "other order": (rows(lambda t: t.take([1, 0, 2, 3, 4])), "has not the 5 frames in order"),
    "no times": (rows(lambda t: t.drop(["observation.time"])), "is incomplete or damaged ("),
    "no data": (lambda root: (root / DATA).unlink(), "is incomplete or damaged ("),
    "cut": (lambda r: (r / DATA).write_bytes((r / DATA).read_bytes()[:900]), "is incomplete or da"),
    "more points": (rows(more_points), "observation.num_points is 25 of 24 points"),
    "no features": (change("info", features={}), "is incomplete or damaged ("),
}


@pytest.mark.parametrize("case", SPOILT)
def test_what_cannot_be_read(case, lift, tmp_path):
    spoil, said = SPOILT[case]
    export_recording(lift, tmp_path / "out")
    spoil(tmp_path / "out")
    if case != "of others":
        (tmp_path / "out/meta/gendom.sha256").write_text(seal(tmp_path / "out"))
    with pytest.raises(RecordingError) as caught:
        read_lerobot(tmp_path / "out")
    assert str(caught.value).startswith(str(tmp_path / "out"))
    assert f": {said}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_lerobot_reads_it(uneven, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "cache"))
    reader = pytest.importorskip(
        "lerobot.datasets.lerobot_dataset", reason="needs lerobot, which no extra brings"
    )
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
    later = reader.LeRobotDataset(
        "gendom/test", root=tmp_path / "out", delta_timestamps={"action": [0.0, 1.0 / 7.0]}
    )
    assert later[4]["action_is_pad"].tolist() == [False, True]


def test_one_without_a_digest_is_not_read(lift, tmp_path):
    """Of a damaged Parquet file pyarrow may end the process."""
    export_recording(lift, tmp_path / "out")
    (tmp_path / "out/meta/gendom.sha256").unlink()
    with pytest.raises(RecordingError, match=r"gendom\.sha256: no such file; export it again"):
        Recording.read(tmp_path / "out")


def test_changed_numbers_are_found(lift, tmp_path):
    """Of 150 bits turned over none changes numbers unseen: Parquet has no checksums by default."""
    export_recording(lift, tmp_path / "out")
    rng = np.random.default_rng(0)
    for name in (DATA, "meta/gendom.json", "meta/info.json"):
        path = tmp_path / "out" / name
        whole = path.read_bytes()
        for at in rng.integers(8 * len(whole), size=50):
            data = bytearray(whole)
            data[at // 8] ^= 1 << (at % 8)
            path.write_bytes(data)
            with pytest.raises(RecordingError, match="are not those that were written"):
                Recording.read(tmp_path / "out")
        path.write_bytes(whole)
    equal(Recording.read(tmp_path / "out"), lift)
