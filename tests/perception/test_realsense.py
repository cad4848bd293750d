"""RealSense recordings: the SDK's own of three versions, and those that are written here."""

import lzma
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gendom.errors import DeviceError, RecordingError
from gendom.perception import Camera, FrameSource, Pictures, RealSenseRecording, read_cameras
from gendom.perception.aligned import Alignment
from gendom.perception.realsense import realsense_sdk
from gendom.perception.ros_messages import raw_picture
from software_camera import recording

RECORDINGS = Path(__file__).with_name("recordings")


@pytest.fixture
def copy(tmp_path):
    """Function (name) -> a copy of a stored recording, to spoil."""

    def copied(name="sdk-2.59.db3"):
        path = tmp_path / "left" / f"recording{Path(name.removesuffix('.xz')).suffix}"
        path.parent.mkdir(exist_ok=True)
        data = (RECORDINGS / name).read_bytes()
        path.write_bytes(lzma.decompress(data) if name.endswith(".xz") else data)
        return path

    return copied


def pictures(camera, number):
    """Noise, so that nothing is equal by chance."""
    rng = np.random.default_rng(number)
    shape = camera.height, camera.width
    depth = rng.integers(0, 65536, shape).astype(np.uint16)
    return Pictures(depth, rng.integers(0, 256, (*shape, 3)).astype(np.uint8))


@pytest.mark.parametrize("name", ["sdk-2.59.db3", "sdk-2.58.db3.xz", "sdk-2.55.bag.xz"])
def test_recordings_of_the_sdk(name, copy, request):
    """Older ones once they are converted as the message says."""
    path, faults = copy(name), []
    if ".bag" in name:
        request.getfixturevalue("sdk")
        with pytest.raises(RecordingError, match=r"python -c '.*'$") as told:
            RealSenseRecording(path.parent)
        code = str(told.value).partition("python -c '")[2][:-1]
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
        path = path.parent
    source = RealSenseRecording(path, on_warning=faults.append)
    camera = source.camera
    assert isinstance(source, FrameSource) and len(list(source)) == 4 and not faults
    assert (camera.width, camera.height, camera.depth_unit) == (32, 24, 1e-4)
    np.testing.assert_allclose(camera.K, [[31, 0, 16], [0, 31, 12], [0, 0, 1]])
    assert camera.T_world_camera is None and camera.distortion == ()
    v, u = np.mgrid[:24, :32]
    for i, frame in enumerate(source):
        assert frame.time == pytest.approx(1.7e9 + i / 30, abs=1e-6)
        seen = frame.read()
        np.testing.assert_array_equal(seen.depth, 6000 + 100 * i + 10 * v + u)
        assert seen.depth.dtype == np.uint16 and seen.colour is not None
        expected = np.stack([20 * i + 0 * v, 8 * u, 10 * v], axis=-1).astype(np.uint8)
        np.testing.assert_array_equal(seen.colour, expected)


def test_where_the_sdk_is_missing_or_does_not_load(monkeypatch):
    """A .db3 file needs none. Where a system library is missing, it is named."""

    class Broken:
        def find_spec(self, name, path=None, target=None):
            if name == "pyrealsense2":
                raise ImportError("libusb-1.0.so.0: cannot open shared object file")

    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    assert len(list(RealSenseRecording(RECORDINGS / "sdk-2.59.db3"))) == 4
    with pytest.raises(DeviceError, match=r"SDK is missing; pip install .*\[camera\]'"):
        realsense_sdk()
    monkeypatch.delitem(sys.modules, "pyrealsense2", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Broken(), *sys.meta_path])
    with pytest.raises(DeviceError, match=r"libusb-1\.0\.so\.0.*apt install libusb-1\.0-0"):
        realsense_sdk()


@pytest.mark.parametrize(
    ("encoding", "data", "pixels"),
    [
        ("bgr8", [1, 2, 3, 4, 5, 6], [[3, 2, 1], [6, 5, 4]]),
        ("rgba8", [1, 2, 3, 0, 4, 5, 6, 0], [[1, 2, 3], [4, 5, 6]]),
        ("mono16", [1, 2, 3, 4], [0x0201, 0x0403]),
    ],
)
def test_raw_formats(encoding, data, pixels):
    """Two pixels in a row that is longer than they are."""
    row = bytes([*data, 99, 99])
    found = raw_picture(row * 3, encoding, 2, 3, len(row), "<", "here")
    np.testing.assert_allclose(np.asarray(found, float), [pixels] * 3, atol=1)
    assert found.dtype == (np.uint16 if encoding == "mono16" else np.uint8)
    with pytest.raises(ValueError, match="fewer pixels"):
        raw_picture(row * 2, encoding, 2, 3, len(row), "<", "here")
    with pytest.raises(RecordingError, match="here: is stored as YUYV; record colour as RGB8"):
        raw_picture(row, "YUYV", 2, 3, 8, "<", "here")


def test_camera_toml_gives_pose_and_unit(copy):
    path = copy()
    toml = path.with_name("camera.toml")
    pose = [[1, 0, 0, 0.5], [0, 0, -1, 0.25], [0, 1, 0, 0.75], [0, 0, 0, 1]]
    toml.write_text(f"T_world_camera = {pose}\ndepth_unit = 0.001\nwidth = 32\n")
    camera = RealSenseRecording(path).camera
    np.testing.assert_array_equal(camera.T_world_camera, pose)
    assert camera.depth_unit == 1e-3 and camera.name == "left"
    for key, value in (("width", "640"), ("K", "[[9, 0, 16], [0, 31, 12], [0, 0, 1]]")):
        toml.write_text(f"{key} = {value}\n")
        with pytest.raises(RecordingError, match=rf"camera\.toml: {key}: is not that of the rec"):
            RealSenseRecording(path)


def test_folders_with_several_recordings(world, copy, tmp_path):
    path = copy()
    lift = tmp_path / "lift"
    world.write_lift(lift, frames=2, scale=0.1)
    shutil.copy(path, lift / "cameras" / "left" / "a.db3")
    with pytest.raises(RecordingError, match=r"left: holds frames\.csv and a\.db3"):
        read_cameras(lift)
    (lift / "cameras" / "left" / "frames.csv").unlink()
    (lift / "cameras" / "left" / "camera.toml").unlink()
    assert isinstance(read_cameras(lift).sources[0], RealSenseRecording)
    shutil.copy(path, lift / "cameras" / "left" / "b.db3")
    with pytest.raises(RecordingError, match=r"holds 2 recordings, a\.db3, b\.db3"):
        read_cameras(lift)


def test_damage_is_told_and_never_passes_as_depth(world, sdk, tmp_path):
    """Of 12 pictures of noise of 30 kB, which are most of the file: what comes before a cut is
    read, and of flipped bits the frames are lost that have them."""
    camera, path = world.make_camera(scale=0.2), tmp_path / "recording.db3"
    with recording(tmp_path, camera) as write:
        for t in range(12):
            write(t / 30.0, pictures(camera, t))
    whole = path.read_bytes()

    def good(data):
        """Pictures that can be read by their frames, and the warnings."""
        path.write_bytes(data)
        faults, read = [], {}
        for k, frame in enumerate(RealSenseRecording(path, on_warning=faults.append)):
            try:
                read[k] = frame.read()
            except RecordingError as error:
                assert f"recording.db3: frame {k}" in str(error)
        for t, seen in read.items():
            np.testing.assert_array_equal(seen.depth, pictures(camera, t).depth)
            np.testing.assert_array_equal(seen.colour, pictures(camera, t).colour)
        return [*read], faults

    for share in (0.3, 0.6, 0.9):
        found, (fault,) = good(whole[: int(share * len(whole))])
        assert found == list(range(len(found))) and abs(len(found) - 12 * share) < 2.5
        assert fault.severity == "warning"
        assert "is damaged or cut off: all after message" in str(fault)
    data, rng = bytearray(whole), np.random.default_rng(0)
    for position in rng.integers(len(data) // 4, len(data), 5):
        data[position] ^= 1 << int(rng.integers(8))
    assert 5 <= len(good(data)[0]) < 12
    # uncompressed pictures are held by a checksum: nothing else would show their damage
    path.unlink()
    camera = replace(camera, distortion=(0.05, -0.06, 1e-4, -2e-4, 0.02))
    with recording(tmp_path, camera, compress=False) as write:
        write(0.0, pictures(camera, 0))
    data = bytearray(path.read_bytes())
    assert good(data) == ([0], [])
    data[data.find(pictures(camera, 0).depth.tobytes()[:64])] ^= 4
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"recording\.db3: differs from its checksum; copy"):
        RealSenseRecording(path)
    (tmp_path / "recording.db3.sha256").unlink()
    source = RealSenseRecording(path)
    assert len(list(source)) == 1
    for key in ("K", "T_world_camera", "distortion", "depth_unit"):
        np.testing.assert_allclose(getattr(source.camera, key), getattr(camera, key), rtol=1e-7)


def changed(path, change):
    """A recording changed by SQL, or with another text of equal length in all messages."""
    with closing(sqlite3.connect(path)) as database, database:
        if isinstance(change, str):
            database.execute(change)
            return
        old, new = change
        assert len(old) == len(new)
        database.create_function("changed", 1, lambda data: data.replace(old, new))
        database.execute("UPDATE messages SET data = changed(data)")


FISH = b"model=None;coeffs=0,0,0,0,0", b"model=Fish;coeffs=1,0,0,0,0"
LACKING = [
    (None, "no such file"),
    (b"not found\n" * 100, r"is no \.db3 recording"),
    (b"SQLite format 3\0" + bytes(84), "has no table of topics"),
    ("DELETE FROM topics WHERE name LIKE '%Depth_Units/value'", "does not say its depth unit"),
    ("DELETE FROM topics WHERE name LIKE '%Depth_0/camera_info'", "camera_info is missing or dam"),
    ("UPDATE topics SET name = replace(name, 'Depth_0/', 'Infrared_1/')", "has no depth pictures"),
    (FISH, "the distortion 'Fish', which is not known"),
]


@pytest.mark.parametrize(("change", "said"), LACKING, ids=[said for _, said in LACKING])
def test_recordings_that_lack_something(copy, change, said):
    path = copy()
    changed(path, "UPDATE topics SET name = 'x' || id WHERE name LIKE '%Color_0%'")
    assert [frame.read().colour for frame in RealSenseRecording(path)] == [None] * 4
    if change is None:
        path.unlink()
    elif isinstance(change, bytes):
        path.write_bytes(change)
    else:
        changed(path, change)
    with pytest.raises(RecordingError, match=rf"recording\.db3.*: .*{said}"):
        RealSenseRecording(path)


CLOCK = b"timestamp_domain=Global Time;sys", b"timestamp_domain=Hardware Clock;"  # equally long
BACK = b"timestamp=1700000000066", b"timestamp=1600000000066"


def test_time_stamps_that_are_odd_are_told(copy):
    for change, frames, said in (
        (CLOCK, 4, "of the camera's own clock; record with the option Global Time Enabled"),
        (BACK, 3, "1 pictures have no time stamp, or one that goes back"),
    ):
        faults = []
        changed(path := copy(), change)
        source = RealSenseRecording(path, on_warning=faults.append)
        assert len(list(source)) == frames and said in str(faults[0])


def beside(world, shift=0.015, turn=0.01, **other):
    """A colour camera to the right of a depth camera, and T_colour_depth."""
    c, s = np.cos(turn), np.sin(turn)
    T = np.array([[c, 0, s, -shift], [0, 1, 0, 0.002], [-s, 0, c, 0.001], [0, 0, 0, 1]])
    depth = world.make_camera(scale=0.5)
    pose = {"T_world_camera": depth.calibrated() @ np.linalg.inv(T), **other}
    K = np.array([[460.0, 0, 320.0], [0, 462.0, 239.0], [0, 0, 1]])
    return depth, Camera(name="colour", width=640, height=480, K=K, **pose), T


def test_colour_is_laid_over_depth(world):
    """A chequered plane: each pixel gets the colour of its own point, to about a pixel."""
    depth, colour, T = beside(world, distortion=(0.1, -0.15, 0.002, -0.001, 0.05))
    pictures = []
    for camera in (depth, colour):
        rays = camera.rays() @ camera.calibrated()[:3, :3].T
        z = np.where(rays[:, 2] < 0, -camera.position[2] / np.minimum(rays[:, 2], -1e-9), 0.0)
        fields = (camera.position + rays * z[:, None])[:, :2] / 0.05
        even = np.floor(fields).sum(axis=1) % 2 == 0
        paint = np.where(even[:, None], [250, 200, 10], [10, 30, 240]).astype(np.uint8)
        pictures.append((z, paint.reshape(camera.height, camera.width, 3), fields))
    (z, own, fields), (_, seen, _) = pictures
    z[z > 1.5] = 0.0  # farther away a pixel is as large as a field
    counts = np.round(z / depth.depth_unit).astype(np.uint16).reshape(own.shape[:2])
    found = Alignment(depth, colour, T)(counts, seen)
    assert found.colour is not None
    np.testing.assert_array_equal(found.depth, counts)  # nothing hides anything
    painted = np.any(found.colour, axis=2)
    assert painted.mean() > 0.4 and not painted[counts == 0].any()
    # Pixels near a border of two colours may have either.
    inner = (np.abs(fields - np.round(fields)) > 0.12).all(axis=1).reshape(counts.shape) & painted
    assert inner.sum() > 10_000
    np.testing.assert_array_equal(found.colour[inner], own[inner])


def test_hidden_pixels_do_not_take_the_colour_of_what_hides_them(world):
    """A rope 30 cm above the table: without the test, a band of table beside it is red."""
    depth, colour, T = beside(world, shift=0.05, turn=0.0)
    rope = world.Rope(np.array([[-0.3, 0.0, 0.3], [0.3, 0.0, 0.3], [0.3, 0.0, 0.1]]), 0.01)
    scene = world.Scene([world.Plane(), rope])
    clean, aside = (scene.pictures(camera, sensor=world.EXACT) for camera in (depth, colour))
    found = Alignment(depth, colour, T)(clean.depth, aside.colour)
    assert found.colour is not None
    red = (found.colour[..., 0] > 1.8 * found.colour[..., 1]) & (found.depth > 0)
    rays = depth.rays() @ depth.calibrated()[:3, :3].T
    points = depth.position + rays * (found.depth.ravel() * depth.depth_unit)[:, None]
    away = rope.distance(points).reshape(red.shape)
    assert red[np.abs(away) < 1e-3].mean() > 0.95
    assert (red & (away > 0.02)).sum() == 0
    assert 0 < ((clean.depth > 0) & (found.depth == 0)).mean() < 0.03
