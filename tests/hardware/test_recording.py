"""Cameras that record through the SDK, and a robot's motion beside them."""

import threading
import time
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gendom.errors import DeviceError, GendomError
from gendom.hardware import DepthCamera
from gendom.hardware.cell import CellCamera
from gendom.hardware.contracts import Tick
from gendom.hardware.realsense import RealSenseCamera
from gendom.hardware.recording import record_motion
from gendom.perception import Camera, Pictures, read_cameras
from gendom.reading import read_json
from gendom.robot import XARM7, JointMotion, read_joints, tcp_pose
from software_camera import SoftwareCamera, connected

RATE = 30.0
OBJECT = '[object]\nkind = "rope"\nlength = 0.3\ndiameter = 0.01\ngrasp = "end"\n'
STILL = JointMotion(time=np.array([0.0, 0.1]), q=np.stack([XARM7.home] * 2))
MOTION = JointMotion(time=np.array([0.0, 1.0]), q=np.stack([XARM7.home, XARM7.home + 0.1]))


def camera(name="left"):
    K = np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]])
    return Camera(name=name, width=64, height=48, K=K, T_world_camera=np.eye(4), depth_unit=1e-4)


def filmed(softwares, over, number=lambda c, k: k + 1, stamp=lambda c, k: 100.0 + k / RATE):
    """Shows pictures on software cameras in real time until it is over."""
    k = 0
    while not over.wait(1.0 / RATE):
        seen = np.full((48, 64), 6000 + k, np.uint16), np.full((48, 64, 3), k % 256, np.uint8)
        for c, software in enumerate(softwares):
            if number(c, k) is not None:
                software.show(stamp(c, k), number(c, k), Pictures(*seen))
        k += 1


class Arm:
    """Of a robot what recordings need; it follows every motion exactly, in real time."""

    arm = XARM7

    def __init__(self, breaks=None):
        self.stopped, self.breaks = threading.Event(), breaks

    def play(self, motion, *, on_tick):
        began = time.monotonic()
        while (t := time.monotonic() - began) < motion.end and not self.stopped.wait(0.01):
            q = motion.at(t)
            on_tick(Tick(time=t, command=q, measured=q, age=0.0, stamp=100.0 + t))
            if self.breaks is not None and t > 0.3:
                raise self.breaks

    def stop(self):
        self.stopped.set()


@pytest.fixture
def record(sdk, tmp_path):
    """Function (what `filmed` takes, robot) -> the folder, how the cameras' recordings went or the
    error, and what was written of it."""

    def recorded(robot=None, seconds=0.6, live=lambda made: made, **shows):
        softwares = [SoftwareCamera(camera(name)) for name in ("left", "right")]
        cameras = live([connected(software) for software in softwares])
        over, folder = threading.Event(), tmp_path / "lift"
        man = threading.Thread(target=filmed, args=(softwares, over), kwargs=shows)
        man.start()
        try:
            arm, slow = cast(Any, robot or Arm()), MOTION.stretched(seconds)
            found = record_motion(arm, cameras, slow, folder, description=OBJECT)
        except BaseException as error:
            found = error
        over.set()
        man.join()
        for one in cameras:
            one.disconnect()
        said = folder / "recording.json"
        return folder, found, read_json(said) if said.exists() else {}

    return recorded


def test_a_motion_is_recorded_as_perception_reads_it(record):
    folder, found, said = record(seconds=1.0)
    assert isinstance(connected(SoftwareCamera(camera())), DepthCamera)
    assert said["ended"] == "done" and said["cameras"]["left"]["missing"] == 0
    read = read_cameras(folder)
    for source, name in zip(read.sources, ("left", "right"), strict=True):
        frames = list(source)
        assert source.camera.name == name and found[name].missing == 0
        assert 0 <= found[name].pictures - 2 * len(frames) <= 1 and 20 <= len(frames) <= 60
        for frame in frames:
            seen, k = frame.read(), round(RATE * (frame.time - 100.0))
            assert (seen.depth == 6000 + k).all() and (seen.colour[..., 0] == k % 256).all()
    joints = read_joints(folder / "joints.csv", XARM7)
    np.testing.assert_allclose(joints.q, MOTION.at(joints.time - 100.0), atol=1e-5)
    tool = tcp_pose(XARM7, joints.q)[:, :3, 3]
    np.testing.assert_allclose(read.robot.position[:, 0], tool, atol=1e-5)
    with pytest.raises(GendomError, match="holds a recording already"):
        record_motion(cast(Any, Arm()), [], STILL, folder, description=OBJECT)


def test_pictures_that_never_came_are_counted(record):
    _, found, said = record(number=lambda c, k: None if c == 1 and k % 10 == 5 else k + 1)
    lost, every = found["right"].missing, found["left"].pictures
    assert abs(lost - every / 10.0) <= 4 and lost % 2 == 0 and lost > 0
    assert [said["cameras"][name]["missing"] for name in ("left", "right")] == [0, lost]


def _unplugged(cameras):
    removed = SimpleNamespace(was_removed=lambda which: which is cameras[1]._device)
    threading.Timer(0.6, cameras[1]._devices_changed, [removed]).start()
    return cameras


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"stamp": lambda c, k: 100.0 + min(k, 15 if c else k) / RATE}, "right has given no new"),
        ({"number": lambda c, k: None if c == 0 and k > 15 else k + 1}, "left has given no new"),
        ({"live": _unplugged}, "right was unplugged"),
    ],
)
def test_a_camera_that_fails_stops_the_robot(record, how, words, monkeypatch):
    monkeypatch.setattr("gendom.hardware.realsense._SILENT", 0.5)
    arm, began = Arm(), time.monotonic()
    folder, error, said = record(arm, seconds=60.0, **how)
    assert isinstance(error, DeviceError) and f"camera {words}" in str(error)
    assert arm.stopped.is_set() and time.monotonic() - began < 15.0 and words in said["ended"]
    assert all(len(list(source)) > 5 for source in read_cameras(folder).sources)


def test_a_disk_that_fills_stops_the_robot_and_a_full_one_is_told_before(record, monkeypatch):
    rooms, arm = [0.2e9], Arm()
    monkeypatch.setattr("gendom.files.shutil.disk_usage", lambda _: SimpleNamespace(free=rooms[-1]))
    folder, error, _ = record(arm)
    assert "the disk has 0.2 GB left, 1 s take" in str(error) and not folder.exists()
    rooms.append(5e12)
    threading.Timer(0.6, rooms.append, [1e8]).start()
    folder, error, _ = record(arm, seconds=60.0)
    assert isinstance(error, DeviceError) and "the disk has 100 MB left" in str(error)
    assert arm.stopped.is_set() and len(list(read_cameras(folder).sources[0])) > 5


@pytest.mark.parametrize("breaks", [KeyboardInterrupt(), DeviceError("joint 3 is hot", fix="wait")])
def test_what_was_recorded_before_the_robot_failed_is_kept(record, breaks):
    folder, error, said = record(Arm(breaks=breaks))
    assert error is breaks and said["ended"] in ("KeyboardInterrupt", "joint 3 is hot; wait")
    read = read_cameras(folder)
    assert len(read.robot.time) > 10 and all(len(list(s)) > 3 for s in read.sources)


def test_a_camera_that_never_gives_a_picture(record, monkeypatch):
    monkeypatch.setattr("gendom.hardware.realsense._FIRST_PICTURE", 0.3)
    error = record(number=lambda c, k: k + 1 if c == 0 else None)[1]
    assert "camera right: gives no depth and no color picture; check cable" in str(error)


def test_absent_cameras_and_modes(sdk, tmp_path):
    described = CellCamera(name="left", device="realsense", serial="0" * 12, T_world_camera=None)
    with pytest.raises(DeviceError, match=r"no RealSense camera.* is connected; "):
        RealSenseCamera(described).connect()
    device = SoftwareCamera(camera()).device
    with pytest.raises(DeviceError, match=r"no depth of 848 x 480 at 30.*choose of 64 x 48"):
        RealSenseCamera(described, device=device).connect()
    with pytest.raises(DeviceError, match="is not connected; call connect"):
        RealSenseCamera(described).start_recording(tmp_path)
