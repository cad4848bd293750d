"""Clocks that are apart, from what cameras see of a lift: hands of capsules, cast by rays."""

import numpy as np
import pytest

from gendom.errors import DeviceError
from gendom.files import write_json
from gendom.hardware.clocks import check_clocks
from gendom.perception import PngWriter
from gendom.reading import read_json
from gendom.robot import XARM7, arm_shape, follow, lift, tcp_pose
from perception.conftest import Plane, Rope, Scene, make_camera

AHEAD = {"left": 0.035, "right": -0.005}


def write_table(file, columns):
    rows, head = np.column_stack([*columns.values()]), ",".join(columns)
    np.savetxt(file, rows, delimiter=",", header=head, comments="")


@pytest.fixture
def recorded(tmp_path):
    """A lift at 0.15 m/s; cameras 2 mm and 0.2 degrees off, joints with the encoders' noise."""
    motion = follow(XARM7, lift([0.45, 0.0, 0.02], height=0.15, speed=0.15, wait=0.4, after=0.4))
    rng, time = np.random.default_rng(0), motion.sampled(100.0)
    q = motion.at(time) + rng.normal(0.0, 1e-5, (len(time), 7))
    hand = tcp_pose(XARM7, q)[:, :3, 3]
    joints = {"time": time, **{f"q{j}": q[:, j] for j in range(7)}}
    write_table(tmp_path / "joints.csv", joints)
    write_table(tmp_path / "gripper.csv", {"time": time, **dict(zip("xyz", hand.T, strict=True))})
    (tmp_path / "object.toml").write_text('[object]\nkind = "rope"\nlength = 0.3\ngrasp = "end"\n')
    for name, side in (("left", -1.0), ("right", 1.0)):
        eye = (0.6, 0.6 * side, 0.45)
        camera = make_camera(name, eye=eye, target=(0.45, 0.0, 0.2), scale=0.3)
        stated = camera.calibrated().copy()
        stated[:3, 3] += rng.normal(0.0, 1e-3, 3)
        writer = PngWriter(tmp_path / "cameras" / name, camera.at(stated))
        for k, t in enumerate(np.arange(motion.start, motion.end, 1.0 / 25.0)):
            shape = arm_shape(XARM7, motion.at(t), 0.016)
            parts = [Rope(np.array([a, b + 1e-6]), r) for a, b, r, n in
                     zip(shape.start, shape.end, shape.radius, shape.names, strict=True)
                     if n.startswith(("link6", "link7", "gripper", "left", "right"))]  # fmt: skip
            writer.write(t + AHEAD[name], Scene([Plane(), *parts]).pictures(camera, seed=k))
    write_json(tmp_path / "recording.json", {"ended": "done"})
    return tmp_path


def test_a_clock_that_is_ahead_is_refused_and_by_how_much_is_written_down(recorded, monkeypatch):
    with pytest.raises(DeviceError, match=r"left: its clock is \+3\d ms off .*20 ms allowed; let"):
        check_clocks(recorded, XARM7)
    said = read_json(recorded / "recording.json")
    assert "camera left" in said["ended"] and said["clocks"].keys() == AHEAD.keys()
    for name, (offset, sd) in said["clocks"].items():
        assert abs(offset - AHEAD[name]) < 3.0 * sd < 0.012
    monkeypatch.setattr("gendom.hardware.clocks.MAX_OFFSET", 0.05)
    assert check_clocks(recorded, XARM7).keys() == AHEAD.keys()
    joints = np.loadtxt(recorded / "joints.csv", delimiter=",", skiprows=1) + 100.0 * np.eye(8)[0]
    names = ["time", *(f"q{j}" for j in range(7))]
    write_table(recorded / "joints.csv", dict(zip(names, joints.T, strict=True)))
    assert check_clocks(recorded, XARM7) == {}  # at other times they show nothing
