"""Camera models and the files of cameras: what these name and announce is bounded."""

import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from gendom.errors import RecordingError
from gendom.perception import PngCamera, read_camera, write_camera
from gendom.perception.calibration import read_views
from gendom.perception.frames import read_png

GOOD = """
width = 8
height = 4
depth_unit = 0.001
K = [[10.0, 0.0, 4.0], [0.0, 10.0, 2.0], [0.0, 0.0, 1.0]]
T_world_camera = [[1,0,0,0.1],[0,-1,0,0.2],[0,0,-1,0.8],[0,0,0,1]]
"""


def test_written_camera_reads_the_same(world, tmp_path):
    camera = world.make_camera(distortion=(0.1, -0.05, 1e-3, -2e-3, 0.01))
    write_camera(tmp_path / "left" / "camera.toml", camera)
    again = read_camera(tmp_path / "left" / "camera.toml")
    assert (again.name, again.width, again.height) == ("left", 640, 480)
    assert again.depth_unit == camera.depth_unit and again.distortion == camera.distortion
    np.testing.assert_array_equal(again.K, camera.K)
    np.testing.assert_array_equal(again.T_world_camera, camera.T_world_camera)


def test_rays_undo_distortion(world):
    """OpenCV's own projection of the rays gives the pixels back."""
    cv2 = pytest.importorskip("cv2", reason="needs the extra `camera`")
    camera = world.make_camera(distortion=(0.12, -0.2, 1e-3, -2e-3, 0.05), scale=0.25)
    none, k = np.zeros(3), np.array(camera.distortion)
    pixels = cv2.projectPoints(camera.rays(), none, none, camera.K, k)[0][:, 0]
    v, u = np.mgrid[: camera.height, : camera.width]
    np.testing.assert_allclose(pixels, np.stack([u.ravel(), v.ravel()], 1), atol=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("K = [[", "Q = [[", "lacks K"),
        ("depth_unit = 0.001", "depth_unit = 0", "depth_unit: is 0.0"),
        ("depth_unit = 0.001", "depth_unit = 'mm'", "depth_unit: is not a number"),
        ("10.0, 2.0]", "10.0]", "K: is not 3x3 numbers"),
        ("0.0, 4.0]", "0.0, 9.0]", "outside 8 x 4"),
        ("0.8]", "800.0]", "metres, not millimetres"),
        ("[0,-1,0,0.2]", "[0,1,0,0.2]", "is no rigid transform"),
        ("width = 8", "width = 8\nfx = 385", "unknown key 'fx'"),
        ("width = 8", "width = 8.5", "width: is 8.5; give pixels"),
        ("width", "distortion = [0.1]\nwidth", "distortion: has 1 numbers"),
        ("8\nheight = 4", "40000\nheight = 40000", "width, height: is 40000 x 40000"),
    ],
)
def test_bad_files(tmp_path, old, new, line):
    path = tmp_path / "camera.toml"
    assert old in GOOD
    path.write_text(GOOD)
    read_camera(path)
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(RecordingError) as error:
        read_camera(path)
    assert line in str(error.value) and str(error.value).count("\n") == 0


@pytest.fixture
def folder(tmp_path):
    """A camera's folder with one picture beside it and two in it."""
    folder = tmp_path / "left"
    (folder / "depth").mkdir(parents=True)
    (folder / "camera.toml").write_text(GOOD)
    for path in (tmp_path / "0.png", folder / "depth" / "0.png", folder / "depth" / "1.png"):
        Image.fromarray(np.full((4, 8), 900, np.uint16)).save(path)
    return folder


def frames(folder, *names):
    rows = [f"{0.1 * k},{name}" for k, name in enumerate(names)]
    (folder / "frames.csv").write_text("\n".join(["time,depth", *rows, ""]))
    return PngCamera(folder)


def test_pictures_elsewhere_are_refused(folder, tmp_path, name="../0.png"):
    with pytest.raises(RecordingError, match=r"frames\.csv, line 2: .* is not in"):
        frames(folder, name)
    (tmp_path / "board.toml").write_text("squares_x=7\nsquares_y=5\nsquare=0.04\nmarker=0.03\n")
    (tmp_path / "poses.csv").write_text(f"picture,x,y,z,qx,qy,qz,qw\n{name},0,0,0,0,0,0,1\n")
    with pytest.raises(RecordingError, match=r"poses\.csv, line 2: .* is not in"):
        read_views(tmp_path, read_camera(folder / "camera.toml"), on_warning=print)


def test_times_in_names_of_pictures(folder):
    names = [f"depth/{1700000000.0 + t:.3f}.png" for t in (0.0, 0.1, 0.2, 0.8, 0.9)]
    with pytest.raises(RecordingError, match=r"frames\.csv: times in names"):
        frames(folder, *names)


def test_pictures_of_too_many_pixels(tmp_path):
    head = struct.pack(">IIBBBBB", 40_000, 40_000, 16, 0, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(bytes(1 << 20))), (b"IEND", b"")]
    data = b"".join(
        struct.pack(">I", len(of)) + kind + of + struct.pack(">I", zlib.crc32(kind + of))
        for kind, of in chunks
    )
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + data)
    with pytest.raises(RecordingError, match=r"Image size .* exceeds limit"):
        read_png(tmp_path / "a.png")
