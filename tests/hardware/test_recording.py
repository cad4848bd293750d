"""Cameras that record through the SDK, and a robot's motion beside them."""

import json
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
from gendom.hardware.replay import ReplayedCamera
from gendom.perception import Camera, Pictures, read_cameras
from gendom.robot import XARM7, JointMotion, read_joints, tcp_pose
from software_camera import SoftwareCamera, connected

RATE = 30.0
OBJECT = '[object]\nkind = "rope"\nlength = 0.3\ndiameter = 0.01\ngrasp = "end"\n'


def camera(name="left"):
    K = np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]])
    return Camera(name=name, width=64, height=48, K=K, T_world_camera=np.eye(4), depth_unit=1e-4)


def pictures(k):
    colour = np.full((48, 64, 3), k % 256, np.uint8)
    return Pictures(np.full((48, 64), 6000 + k, np.uint16), colour)


class Cameraman(threading.Thread):
    """Shows pictures on software cameras in real time until told to stop."""

    def __init__(self, softwares, number=lambda _, k: k + 1, stamp=lambda _, k: 100.0 + k / RATE):
        super().__init__(daemon=True)
        self.softwares, self.number, self.stamp = softwares, number, stamp
        self.over, self.shown = threading.Event(), 0

    def run(self):
        while not self.over.wait(1.0 / RATE):
            for c, software in enumerate(self.softwares):
                if (number := self.number(c, self.shown)) is not None:
                    software.show(self.stamp(c, self.shown), number, pictures(self.shown))
            self.shown += 1


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
def motion():
    q = np.stack([XARM7.home, XARM7.home + 0.1])
    return JointMotion(time=np.array([0.0, 1.0]), q=q)


@pytest.fixture
def record(sdk, tmp_path, motion):
    """Function (what `Cameraman` takes, robot) -> the folder, and how the cameras' recordings went
    or the error."""

    def recorded(robot=None, seconds=1.0, live=lambda made: made, **shows):
        softwares = [SoftwareCamera(camera(name)) for name in ("left", "right")]
        cameras = live([connected(software) for software in softwares])
        man = Cameraman(softwares, **shows)
        man.start()
        try:
            slow = motion.stretched(seconds)
            arm = cast(Any, robot or Arm())
            found = record_motion(arm, cameras, slow, tmp_path / "lift", description=OBJECT)
        except BaseException as error:
            return tmp_path / "lift", error
        finally:
            man.over.set()
            man.join()
            for one in cameras:
                one.disconnect()
        return tmp_path / "lift", found

    return recorded


def test_a_motion_is_recorded_as_perception_reads_it(record, motion, tmp_path):
    folder, found = record()
    assert isinstance(connected(SoftwareCamera(camera())), DepthCamera)
    read = read_cameras(folder)
    for source in read.sources:
        name = source.camera.name
        went = found[name]
        frames = list(source)
        assert source.camera.name == name and went.missing == 0
        assert 0 <= went.pictures - 2 * len(frames) <= 1 and 20 <= len(frames) <= 60
        for frame in frames:
            seen = frame.read()
            k = round(RATE * (frame.time - 100.0))
            assert seen.colour is not None
            assert (seen.depth == 6000 + k).all() and (seen.colour[..., 0] == k % 256).all()
    joints = read_joints(folder / "joints.csv", XARM7)
    np.testing.assert_allclose(joints.q, motion.at(joints.time - 100.0), atol=1e-5)
    tool = tcp_pose(XARM7, joints.q)[:, :3, 3]
    np.testing.assert_allclose(read.robot.position[:, 0], tool, atol=1e-5)
    said = json.loads((folder / "recording.json").read_text())
    assert said["ended"] == "done" and said["cameras"]["left"]["missing"] == 0
    # a recording is replayed
    folder, _ = record()
    described = CellCamera(
        name="left", device="replay", serial=str(folder), T_world_camera=np.eye(4)
    )
    again = ReplayedCamera(described)
    again.connect()
    assert isinstance(again, DepthCamera)
    still = JointMotion(time=np.array([0.0, 0.1]), q=np.stack([XARM7.home] * 2))
    found = record_motion(cast(Any, Arm()), [again], still, tmp_path / "again", description=OBJECT)
    (old, _), (new,) = (read_cameras(f).sources for f in (folder, tmp_path / "again"))
    assert found["left"].pictures == len(list(old)) == len(list(new))
    with pytest.raises(GendomError, match="holds a recording already"):
        record_motion(cast(Any, Arm()), [], still, folder, description=OBJECT)


def test_pictures_that_never_came_are_counted(record):
    folder, found = record(number=lambda c, k: None if c == 1 and k % 10 == 5 else k + 1)
    assert found["left"].missing == 0
    lost, every = found["right"].missing, found["left"].pictures
    assert abs(lost - every / 10.0) <= 4 and lost % 2 == 0 and lost > 0
    said = json.loads((folder / "recording.json").read_text())
    assert said["cameras"]["right"]["missing"] == lost


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
    ids=["frozen", "silent", "unplugged"],
)
def test_a_camera_that_fails_stops_the_robot(record, how, words):
    arm = cast(Any, Arm())
    began = time.monotonic()
    folder, error = record(arm, seconds=60.0, **how)
    assert isinstance(error, DeviceError) and f"camera {words}" in str(error)
    assert arm.stopped.is_set() and time.monotonic() - began < 15.0
    assert words in json.loads((folder / "recording.json").read_text())["ended"]
    assert all(len(list(source)) > 5 for source in read_cameras(folder).sources)


@pytest.mark.parametrize(
    ("left", "seconds", "words"),
    [(5e12, 60.0, "the disk has 100 MB left"), (0.2e9, 1.0, "the disk has 0.2 GB left, 1 s take")],
    ids=["fills", "full"],
)
def test_a_disk_that_fills_stops_the_robot_and_a_full_one_is_told_before(
    record, monkeypatch, left, seconds, words
):
    rooms = [left]
    usage = lambda _: SimpleNamespace(free=rooms[-1])  # noqa: E731
    monkeypatch.setattr("gendom.files.shutil.disk_usage", usage)
    arm = cast(Any, Arm())
    if seconds > 1.0:
        threading.Timer(0.6, rooms.append, [1e8]).start()
    folder, error = record(arm, seconds=seconds)
    assert isinstance(error, DeviceError) and words in str(error)
    if seconds > 1.0:
        assert arm.stopped.is_set() and len(list(read_cameras(folder).sources[0])) > 5
    else:
        assert not folder.exists()


@pytest.mark.parametrize("breaks", [KeyboardInterrupt(), DeviceError("joint 3 is hot", fix="wait")])
def test_what_was_recorded_before_the_robot_failed_is_kept(record, breaks):
    folder, error = record(Arm(breaks=breaks))
    assert error is breaks
    read = read_cameras(folder)
    assert len(read.robot.time) > 10 and all(len(list(s)) > 3 for s in read.sources)
    ended = json.loads((folder / "recording.json").read_text())["ended"]
    assert ended in ("KeyboardInterrupt", "joint 3 is hot; wait")


def test_a_camera_that_never_gives_a_picture(record, monkeypatch):
    monkeypatch.setattr("gendom.hardware.realsense._FIRST_PICTURE", 0.3)
    _, error = record(number=lambda c, k: k + 1 if c == 0 else None)
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
