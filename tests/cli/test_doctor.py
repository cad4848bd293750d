"""`gendom doctor`: what it recognises, what it finds wrong, and that the command it names works."""

import json
import shlex
import shutil
from dataclasses import replace
from functools import cache
from importlib import import_module, resources
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from datasets.test_folder import write_ply
from fuzz import test_readers as tiny
from gendom import cli
from gendom.cli.parsing import parse
from gendom.datasets import Recording
from gendom.datasets.lerobot import export_recording
from gendom.materials.estimate import Estimate
from gendom.perception import read_camera, write_camera
from perception import conftest as world

ASSETS = Path(str(resources.files("gendom"))) / "assets"
DEMO = ASSETS / "demo-rope-lift.npz"
OBJECT = 'table_height = 0.0\n[object]\nkind = "rope"\nlength = 0.3\ndiameter = 0.016\n'


def demo(**changes):
    return replace(Recording.read(DEMO, on_warning=lambda _: None), **changes)


def clouds(folder):
    folder.mkdir()
    recording = demo()
    for t in range(recording.num_frames):
        write_ply(folder / f"{t:04d}.ply", recording.frame(t))
    rows = np.column_stack([recording.time, recording.gripper_position[:, 0]])
    np.savetxt(folder / "gripper.csv", rows, delimiter=",", header="time,x,y,z", comments="")
    (folder / "object.toml").write_text(OBJECT)


def board(folder):
    folder.mkdir()
    tiny.board(folder)
    write_camera(folder / "camera.toml", tiny.CAMERA)


@cache
def rendered():
    """Depth pictures of a lift, made once."""
    place = TemporaryDirectory()
    world.write_lift(Path(place.name), frames=4)
    return place


def depth(folder):
    shutil.copytree(rendered().name, folder)


@cache
def topics():
    return import_module("perception.test_ros_cameras").rows_of("raw")[0]


def bag(path, version, rows=None, length="0.4"):
    messages = pytest.importorskip("ros_messages")
    messages.write_bag(path, rows or topics(), version)
    beside = path.parent if path.is_file() else path
    (beside / "object.toml").write_text(OBJECT.replace("0.3", length))


KINDS = {  # name: how it is made, what it is called, whether the next command is run
    "lift.npz": (lambda p: demo().write(p), "a recording", False),
    "clouds": (clouds, "a recording", False),
    "lerobot": (lambda p: export_recording(demo(), p), "a recording as a data set", False),
    "pictures": (depth, "depth pictures of cameras", True),
    "old.bag": (lambda p: bag(p, "ROS1"), "a bag of ROS 1", True),
    "new": (lambda p: bag(p, "MCAP"), "a bag of ROS 2", False),
    "board": (board, "pictures of a board", False),
    "estimate.json": (lambda p: tiny.estimate(p.parent), "an estimate of a rope", True),
    "camera.toml": (lambda p: write_camera(p, world.make_camera()), "a camera", False),
}


@pytest.mark.parametrize("name", KINDS)
def test_what_lies_there_and_the_next_command(tmp_path, capsys, monkeypatch, name):
    make, called, run = KINDS[name]
    monkeypatch.chdir(tmp_path)
    make(tmp_path / name)
    assert cli.main(["doctor", name, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["is"].startswith(called) and found["valid"]
    assert (tmp_path / "doctor.png").exists() == (called.partition(" ")[2][:4] in DRAWN)
    for step in found["next"]:
        program, command, *words = shlex.split(step["command"])
        assert program == "gendom"
        parse(import_module(cli.COMMANDS[command][0]).Command, command, words)
        if run:
            assert cli.main([command, *words]) == 0, capsys.readouterr().err
    assert found["next"] or name == "camera.toml"
    assert cli.main(["check", name]) == 0
    assert "can be used" in capsys.readouterr().out


DRAWN = ("reco", "pict", "bag ", "dept")


def y_up(path):
    recording, turn = demo(), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    turned = {n: getattr(recording, n) @ turn for n in ("points", "gripper_position")}
    demo(**turned, gripper_axis=None, table_height=None).write(path)


def odd(**changes):
    """Depth pictures of which camera.toml says something else."""

    def write(folder):
        depth(folder)
        file = folder / "cameras/left/camera.toml"
        camera = read_camera(file)
        write_camera(file, replace(camera, **{n: of(camera) for n, of in changes.items()}))

    return write


def lacking(folder):
    clouds(folder)
    (folder / "gripper.csv").unlink()


def late_path(folder):
    depth(folder)
    rows = np.loadtxt(folder / "gripper.csv", delimiter=",", skiprows=1)
    rows[:, 0] += 1.7e9
    np.savetxt(folder / "gripper.csv", rows, delimiter=",", header="time,x,y,z", comments="")


TURN = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
ASIDE = np.array([[0, 0, 110.0], [0, 0, 60.0], [0, 0, 0]])
WRONG = {  # name: how it is made, what is said, exit code
    "lift.npz": (y_up, "the gripper rises along y, and the object hangs below it there; give z", 2),
    "lifted": (lacking, "gripper.csv: is missing; write one row a cloud: time,x,y,z in seconds", 2),
    "turned": (
        odd(T_world_camera=lambda c: TURN @ c.T_world_camera),
        "the largest plane lies across y",
        0,
    ),
    "units": (odd(depth_unit=lambda c: 0.01), "0.01 m a count; 0.0001 seems right", 2),
    "inverse": (
        odd(T_world_camera=lambda c: np.linalg.inv(c.T_world_camera)),
        "camera to world, not its inverse",
        2,
    ),
    "clocks": (late_path, "picture is of 0 s, the gripper's path of 1700000000 to", 2),
    "crop": (odd(K=lambda c: c.K + ASIDE), "is that of 539 x 359 pictures, not of 320 x 240", 0),
    "kept": (lambda p: p.mkdir() or (p / "a.bag.active").touch(), "rosbag reindex FILE", 2),
    "empty": (lambda p: p.mkdir(), "holds nothing that is known; unpack what is packed; docs", 2),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named(tmp_path, capsys, monkeypatch, name):
    make, said, code = WRONG[name]
    monkeypatch.chdir(tmp_path)
    make(tmp_path / name)
    assert cli.main(["doctor", name]) == code
    out, err = capsys.readouterr()
    assert said in out + err
    assert all(line.startswith("gendom doctor: ") for line in err.splitlines())


def test_a_folder_of_folders(tmp_path, capsys):
    """Each of them is named with the command that looks into it."""
    (tmp_path / "bags").mkdir()
    bag(tmp_path / "bags/old.bag", "ROS1")
    depth(tmp_path / "pictures")
    assert cli.main(["doctor", str(tmp_path), "--json"]) == 0
    steps = json.loads(capsys.readouterr().out)["next"]
    assert [shlex.split(s["command"])[2].split("/")[-1] for s in steps] == ["bags", "pictures"]


def test_an_estimate_is_compared_with_a_cantilever_test(tmp_path, capsys):
    tiny.estimate(tmp_path)
    file = tmp_path / "estimate.json"
    found = Estimate.load(file)
    ends = found.interval("bending_length")
    assert ends is not None
    for share, code in ((1.0, 0), (1.0 / 1.05, 0), (0.7, 3), (1.5, 3)):
        measured = found.bending_length * share
        assert cli.main(["check", str(file), "--bending-length", str(measured), "--json"]) == code
        said = json.loads(capsys.readouterr().out)
        assert said["agree"] is (code == 0) and said["measured"] == measured
        assert said["interval"] == list(ends)
    assert cli.main(["check", str(file), "--bending-length", str(found.bending_length * 0.7)]) == 3
    assert "(+42.9%): they disagree" in capsys.readouterr().out
    assert cli.main(["check", str(file), "--bending-length", "0"]) == 2
    assert "--bending-length: is 0; give metres" in capsys.readouterr().err
